"""A small world with a robot that senses without noise, and a scene of viser to draw it in."""

from dataclasses import replace

import numpy as np
import viser

from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, Light, StartPose, Tag
from usarmjx.models.types.robot import Mount
from usarmjx.models.types.shapes import Shape
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.worlds.dynamic_world import DynamicWorld

WALLS = tuple(
    Shape(kind="box", size=(hx, hy, 0.6), at=(x, y, 0.6), rotation=(0.0, 0.0, yaw), surface="wall")
    for hx, hy, x, y, yaw in (
        (0.05, 3.0, 3.0, 0.0, 0.1),
        (0.05, 3.0, -3.0, 0.0, -0.2),
        (3.0, 0.05, 0.0, 3.0, 0.0),
        (3.0, 0.05, 0.0, -3.0, 0.3),
        (0.2, 0.2, 1.5, 1.0, 0.7),
    )
)
ROOM = ArenaSpec(
    name="room",
    starts=(StartPose(tag="S", at=(0.0, 0.0, 0.188)),),
    extent=((-3.6, 3.6), (-3.6, 3.6)),
    shapes=WALLS,
    tags=(Tag(at=(0.5, -1.0, 0.0), id=1007), Tag(at=(-1.0, 1.0, 0.0))),
)
LIT_ROOM = replace(ROOM, lights=(Light(at=(0.0, 0.0, 2.0)), Light(at=(1.0, 1.0, 2.0))))
P2AT = ROBOTS.get("P2AT")
HEAD = P2AT.cameras[0].parent
SENSOR_KINDS = ("RangeScanner", "IRScanner", "RangeScanner3D", "Sonar", "IR")
QUIET = ("Noise", 0.0)
SEER = replace(
    P2AT,
    name="Seer",
    sensors=(
        Mount(kind="RangeScanner", name="Head", parent=HEAD, options=(QUIET, ("MaxRange", 3.0))),
        Mount(kind="IRScanner", name="Low", at=(0.27, 0.0, 0.05), options=(QUIET, ("MaxRange", 6.0))),
        Mount(kind="RangeScanner3D", name="Deep", at=(0.2, 0.0, -0.3), options=(QUIET, ("MaxRange", 9.0))),
        *(replace(mount, options=(QUIET,)) for mount in P2AT.sensors if mount.kind == "Sonar"),
        Mount(kind="IR", name="Left", at=(0.0, -0.25, -0.1), direction=(0.0, 0.0, -1.5), options=(QUIET,)),
        Mount(kind="IR", name="Down", at=(0.28, 0.0, 0.0), direction=(0.0, -0.8, 0.0), options=(QUIET,)),
        Mount(kind="RFID", name="RFID", options=(("bTraceRFIDs", True),)),
        Mount(
            kind="VictSensor",
            name="Vict",
            at=(0.3, 0.0, -0.1),
            options=(("bShowResults", True), ("Sigma", 0.0)),
        ),
        Mount(kind="INS", name="INS", options=(("HiddenSensor", False),)),
    ),
)
ROOT = "/layers"


def seers(*places, arena=ROOM, robot=SEER):
    """A served world with a robot at each place (x, y, yaw), which have settled and read their sensors."""
    world = DynamicWorld(arena, seed=5)
    for number, (x, y, yaw) in enumerate(places):
        world.spawn(robot, f"robot{number}", (x, y, world.arena.floor + 0.28), (0.0, 0.0, yaw))
    run(world, 10)
    return world, ServedSource([world])


def run(world, steps):
    """Let a world go on, and its robots read their sensors."""
    for _ in range(steps):
        world.step()
    world.observe(list(world.robots.values()))


def drawn(layer, source, scene):
    """A layer of that class, switched on, that has seen a world as it is; and what it has seen."""
    made = layer()
    drawing, frame = source.drawing(0), source.frame(0)
    made.begin(scene, drawing, ROOT)
    made.show(True)
    made.update(drawing, frame)
    return made, drawing, frame


def nodes(scene, kind=viser.SceneNodeHandle):
    """All nodes below `ROOT`, by name, that are of a kind and not hidden themselves."""
    known = scene._handle_from_node_name  # viser lists its nodes nowhere else
    return {
        name.removeprefix(f"{ROOT}/"): handle
        for name, handle in known.items()
        if name.startswith(f"{ROOT}/") and isinstance(handle, kind) and handle.visible
    }


def distance_to_boxes(points, boxes=WALLS):
    """How far points (n, 3) are from the surface of the nearest box, or from the floor [m] (n,)."""
    least = np.abs(points[:, 2])
    for box in boxes:
        least = np.minimum(least, _distance(points, box))
    return least


def _distance(points, box):
    angle = box.rotation[2]
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    inside = np.abs((points - box.at) @ turn) - box.size
    out = np.linalg.norm(np.maximum(inside, 0.0), axis=-1)
    return np.abs(out + np.minimum(inside.max(-1), 0.0))
