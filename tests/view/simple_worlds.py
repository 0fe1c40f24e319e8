"""Drawings and frames made by hand, and a source that gives them: worlds with nothing running behind them."""

from dataclasses import replace

import mujoco
import numpy as np

from usarmjx.models.types.shapes import GLASS, OPAQUE
from usarmjx.view.drawing import (
    NOBODY,
    Drawing,
    DrawnBody,
    DrawnMount,
    DrawnRobot,
    DrawnShape,
    Frame,
    RobotFrame,
)

BOX, PLANE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_PLANE)
CAMERA_AT = (0.2, 0.0, 0.3)
QUARTER_LEFT = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""A camera so turned looks to the left."""


def solids(*rows):
    """A shape of boxes and planes: kind, size, and what it is made of."""
    count = len(rows)
    return DrawnShape(
        kind=np.array([row[0] for row in rows]),
        pos=np.zeros((count, 3)),
        mat=np.tile(np.eye(3), (count, 1, 1)),
        size=np.array([row[1] for row in rows], float),
        rgb=np.full((count, 3), 0.5),
        transparency=np.array([0.65 * (row[2] == GLASS) for row in rows]),
        material=np.array([row[2] for row in rows], object),
    )


ARENA = solids(
    (PLANE, (0.0, 0.0, 0.05), OPAQUE), (BOX, (5.0, 0.1, 1.0), OPAQUE), (BOX, (0.1, 5.0, 1.0), GLASS)
)
CHASSIS, WHEEL = solids((BOX, (0.3, 0.2, 0.1), OPAQUE)), solids((BOX, (0.1, 0.1, 0.05), OPAQUE))
SAME_WHEEL = replace(WHEEL, rgb=WHEEL.rgb.copy())


def robot(slot, body):
    """A robot with two wheels, and a camera that looks to the left."""
    camera = DrawnMount(
        kind="Camera",
        names=("Camera",),
        body=np.array([body]),
        pos=np.array([CAMERA_AT]),
        mat=QUARTER_LEFT[None],
        settings=({"fov": 1.0},),
    )
    return DrawnRobot(
        slot=slot,
        name=f"robot{slot}",
        robot="Cart",
        body=body,
        num_bodies=3,
        dimensions=np.array([0.6, 0.4, 0.2]),
        joints=(),
        sensors=(),
        cameras=(camera,),
        battery_life=3600.0,
    )


def drawing_of(robots=2, floor=0.0):
    """A drawing of an arena with some robots, whose two wheels look the same by different keys."""
    bodies, drawn = [DrawnBody("arena", "arena", NOBODY, 1)], {}
    for slot in range(robots):
        drawn[slot] = robot(slot, len(bodies))
        parts = ("chassis", "left", "right")
        bodies += [DrawnBody(f"robot/{slot}/{part}", f"Cart/{part}", slot, 16 + slot) for part in parts]
    return Drawing(
        arena="yard",
        floor=floor,
        has_floor=True,
        extent=np.array([[-5.0, 5.0], [-4.0, 4.0]]),
        shapes={"arena": ARENA, "Cart/chassis": CHASSIS, "Cart/left": WHEEL, "Cart/right": SAME_WHEEL},
        bodies=tuple(bodies),
        robots=drawn,
        tags=(),
        lamps=np.zeros((0, 3)),
        lamp_rgb=np.zeros((0, 3)),
    )


def frame_of(drawing, time=0.0):
    """All robots a metre apart on the x axis, upright."""
    count = len(drawing.bodies)
    pos, quat = np.zeros((count, 3), np.float32), np.tile(np.array([1.0, 0, 0, 0], np.float32), (count, 1))
    for slot, drawn in drawing.robots.items():
        pos[drawn.body : drawn.body + 3] = (slot, 0.0, drawing.floor + 0.2)
    robots = {
        slot: RobotFrame(
            pos=pos[drawn.body],
            quat=quat[drawn.body],
            linear=np.zeros(3),
            angular=np.zeros(3),
            joint_pos=np.zeros(0),
            battery=3600.0,
            light=False,
            drive=np.zeros(0),
            readings=(),
            fovs=np.array([1.0]),
        )
        for slot, drawn in drawing.robots.items()
    }
    return Frame(
        time=time,
        pos=pos,
        quat=quat,
        shown=np.ones(count, bool),
        robots=robots,
        dropped_tags=np.zeros((0, 3)),
    )


class HandMadeSource:
    """A `FrameSource` of some drawings; what a test changes is what comes next.

    Attributes:
        drawings: By world.
        frames: By world.
        asked: How often each world's frame was asked for.
    """

    def __init__(self, *drawings):
        self.drawings = list(drawings)
        self.frames = [frame_of(drawing) for drawing in drawings]
        self.asked = [0 for _ in drawings]

    @property
    def num_worlds(self):
        return len(self.drawings)

    def drawing(self, world):
        return self.drawings[world]

    def frame(self, world):
        self.asked[world] += 1
        return self.frames[world]

    def change(self, world, drawing):
        """Let a world look otherwise."""
        self.drawings[world], self.frames[world] = drawing, frame_of(drawing)
