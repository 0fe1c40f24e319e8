"""An arena's description to MuJoCo: what robots are added to.

Fixed solids and victims' bodies hang on one mocap body, `arena`, so that a batch can place them differently
in each world and from step to step. Loose objects are free bodies, doors hang on hinges.
"""

import mujoco
import numpy as np

from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.build.doors import door_panel
from usarmjx.models.build.geoms import add_geom
from usarmjx.models.build.victims import segment_poses, victim_table
from usarmjx.models.spec.arena import ArenaSpec, Door, LooseObject
from usarmjx.models.spec.shapes import Shape

FLOOR_SIZE = (0.0, 0.0, 1.0)
"""MuJoCo: a plane with zero half sizes is unbounded."""
FLOOR_RGBA = (0.87, 0.88, 0.88, 1.0)
"""Light grey, as pictures of cameras have it beyond their checkers."""
ARENA, LOOSE_PREFIX, DOOR, VICTIM_PREFIX = "arena/", "loose/", "door/", "victim/"
"""What the names of the geoms of fixed solids, and of loose objects, doors and victims' bones start with."""
MAX_BOX_PIECES = 512
"""Of an arena's boxes for engines that want short ones."""


def add_arena(spec: mujoco.MjSpec, arena: ArenaSpec) -> None:
    """Add the arena and its floor to an empty description.

    Raises:
        SpecError: A solid that cannot be built; see `geoms.add_geom` and `victims.victim_table`.
    """
    if arena.has_floor:
        at = (0.0, 0.0, arena.floor)
        floor = Shape(kind="box", size=FLOOR_SIZE, at=at, surface="ground", rgba=FLOOR_RGBA)
        add_geom(spec, spec.worldbody, "floor", floor, kind=mujoco.mjtGeom.mjGEOM_PLANE)
    body = spec.worldbody.add_body(name="arena", pos=[0.0, 0.0, arena.floor], mocap=True)
    for i, shape in enumerate(arena.shapes):
        add_geom(spec, body, f"{ARENA}{i}", shape)
    _add_victims(spec, body, arena)
    for loose in arena.loose:
        _add_loose(spec, loose, arena.floor)
    for door in arena.doors:
        _add_door(spec, door, arena.floor)


def _add_victims(spec: mujoco.MjSpec, body: mujoco.MjsBody, arena: ArenaSpec) -> None:
    """Add the boxes of victims and false alarms where they are at the start."""
    table = victim_table(arena.victims, arena.false_alarms)
    pos, quat = segment_poses(table, np.zeros(()))
    for i in range(table.num_boxes):
        skin = Shape(kind="box", size=tuple(table.size[i]), surface="ground", rgba=tuple(table.rgba[i]))
        geom = add_geom(spec, body, f"{VICTIM_PREFIX}{i}", skin)
        geom.pos, geom.quat = pos[i], quat[i]


def _add_loose(spec: mujoco.MjSpec, loose: LooseObject, floor: float) -> None:
    x, y, z = loose.at
    name = f"{LOOSE_PREFIX}{loose.name}"
    body = spec.worldbody.add_body(name=name, pos=(x, y, z + floor), quat=quat_from_angles(*loose.rotation))
    body.add_freejoint(name=name)
    for i, shape in enumerate(loose.shapes):
        add_geom(spec, body, f"{name}/{i}", shape)


def _add_door(spec: mujoco.MjSpec, door: Door, floor: float) -> None:
    x, y, z = door.at
    body = spec.worldbody.add_body(
        name=f"{DOOR}{door.name}", pos=(x, y, z + floor), quat=quat_from_angles(0.0, 0.0, door.yaw)
    )
    body.add_joint(
        name=f"{DOOR}{door.name}",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=(0.0, 0.0, 1.0),
        limited=True,
        range=door.limits,
        damping=[door.friction, 0.0, 0.0],
    )
    add_geom(spec, body, f"{DOOR}{door.name}", door_panel(door))


def split_long_boxes(spec: mujoco.MjSpec, longest: float) -> mujoco.MjModel:
    """Return the model with the arena's boxes cut into pieces of at most `longest` [m] along each axis.

    For engines that look for contacts by bounding spheres, to which a long wall is near everything. In an
    arena so large that this would give more than `MAX_BOX_PIECES`, the pieces are longer.
    """
    spec = spec.copy()
    arena = spec.body("arena")
    if arena is None:
        return spec.compile()
    touching = [geom for geom in arena.geoms if geom.type == mujoco.mjtGeom.mjGEOM_BOX and geom.contype]
    boxes = np.array([geom.size for geom in touching])
    while len(boxes) and np.ceil(2 * boxes / longest - 1e-6).prod(-1).sum() > MAX_BOX_PIECES:
        longest *= 1.25
    for geom in list(arena.geoms):
        parts = [max(1, int(np.ceil(2 * half / longest - 1e-6))) for half in geom.size]
        fixed = geom.name.startswith(ARENA) and geom.contype
        if geom.type != mujoco.mjtGeom.mjGEOM_BOX or max(parts) == 1 or not fixed:
            continue
        mat = np.zeros(9)
        mujoco.mju_quat2Mat(mat, geom.quat)
        kept = ("type", "quat", "rgba", "friction", "priority", "contype", "conaffinity", "condim", "mass")
        shared = {name: getattr(geom, name) for name in kept}
        for piece in np.ndindex(*parts):
            offset = (2 * (np.array(piece) + 0.5) / parts - 1) * geom.size
            name = f"{geom.name}/{'.'.join(map(str, piece))}"
            pos = geom.pos + mat.reshape(3, 3) @ offset
            arena.add_geom(name=name, pos=pos, size=geom.size / parts, **shared)
        spec.delete(geom)
    return spec.compile()
