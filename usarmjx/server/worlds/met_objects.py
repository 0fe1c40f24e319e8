"""Objects that the rays of a sensor meet in a world of C MuJoCo, by name."""

from typing import NamedTuple

import numpy as np

from usarmjx.models.compile.compose import DOOR_PREFIX, LOOSE_PREFIX, VICTIM_PREFIX
from usarmjx.sim.single_world import SingleWorld

STATIC = "StaticMeshActor"
"""Name of each piece of the arena: Unreal's tag of what has no other."""
FALSE_ALARM = "FalseAlarm"


class MetObject(NamedTuple):
    """An object.

    Attributes:
        name: Its name.
        pos: Position of its body, or of the piece of arena or victim that was met [m] (3,).
        mat: Its orientation (3, 3).
    """

    name: str
    pos: np.ndarray
    mat: np.ndarray


def met_objects(world: SingleWorld, slot: int, sensor: int, names: dict[int, str]) -> list[MetObject]:
    """Return the objects that a scanner's beams meet within its range, each once, in the order of the beams.

    Args:
        world: The world.
        slot: The robot's slot.
        sensor: Index of the scanner among its sensors.
        names: Names of the robots, by slot.
    """
    data, model = world.engine.data, world.engine.model
    robots = {int(body): slot for slot, index in world.robots.items() for body in index.body_ids}
    found = dict[object, MetObject]()
    for geom in world.met_geoms(slot, sensor).tolist():
        if geom < 0:
            continue
        body = int(model.geom_bodyid[geom])
        if body in robots:
            body = int(world.robots[robots[body]].body_ids[0])
            name = names[robots[body]]
        else:
            name = _name_of_body(model.body(body).name)
        if name:
            key, pose = body, (data.xpos[body], data.xmat[body])
        else:
            name, key = _name_of_piece(world, geom)
            pose = data.geom_xpos[geom], data.geom_xmat[geom]
        found.setdefault(key, MetObject(name, pose[0].copy(), pose[1].reshape(3, 3).copy()))
    return list(found.values())


def _name_of_body(body: str) -> str:
    """Return the name of a loose object or a door; empty: the body is neither."""
    prefix = next((one for one in (LOOSE_PREFIX, DOOR_PREFIX) if body.startswith(one)), None)
    return "" if prefix is None else body.removeprefix(prefix)


def _name_of_piece(world: SingleWorld, geom: int) -> tuple[str, object]:
    """Return the name of a victim, a false alarm or a piece of the arena, and a key of each of them."""
    part = world.engine.model.geom(geom).name
    if not part.startswith(VICTIM_PREFIX):
        return STATIC, part
    owner = int(np.asarray(world.scene.victims.owner)[int(part.removeprefix(VICTIM_PREFIX))])
    return (world.scene.arena.victims[owner].name if owner >= 0 else FALSE_ALARM), (VICTIM_PREFIX, owner)
