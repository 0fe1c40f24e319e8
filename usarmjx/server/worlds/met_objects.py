"""Objects that the rays of a sensor meet in a world of C MuJoCo, by name."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.engines import PhysicsState
from usarmjx.engines.c.world import CWorld
from usarmjx.models.compile.compose import DOOR_PREFIX, LOOSE_PREFIX, VICTIM_PREFIX, RobotIndex
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sensors.suite import query_of
from usarmjx.sim.ray_geometry import moved_geom_poses, victims_of
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import World, clock_of, sense_self

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


class ObjectNames(NamedTuple):
    """Names of what is in a world of C MuJoCo.

    Attributes:
        robots: Names of the robots, by slot.
        bodies: Their indices in the model, by slot.
        arena: The arena, with the names of its victims.
        owners: The victim that each box of victims belongs to; negative: a false alarm.
    """

    robots: Mapping[int, str]
    bodies: Mapping[int, RobotIndex]
    arena: ArenaSpec
    owners: np.ndarray


def met_objects(engine: CWorld, geoms: np.ndarray, names: ObjectNames) -> list[MetObject]:
    """Return the objects that beams meet, each once, in the order of the beams.

    Args:
        engine: The world.
        geoms: The geom that each beam meets, -1 for none (beams,).
        names: Names of what is there.
    """
    data, model = engine.data, engine.model
    robots = {int(body): slot for slot, index in names.bodies.items() for body in index.body_ids}
    found = dict[object, MetObject]()
    for geom in geoms[geoms >= 0].tolist():
        body = int(model.geom_bodyid[geom])
        if body in robots:
            name = names.robots[robots[body]]
            # A robot is met by any of its bodies and reported as one: by its chassis.
            body = int(names.bodies[robots[body]].body_ids[0])
        else:
            name = _name_of_body(model.body(body).name)
        if name:
            key, pose = body, (data.xpos[body], data.xmat[body])
        else:
            name, key = _name_of_piece(model.geom(geom).name, names)
            pose = data.geom_xpos[geom], data.geom_xmat[geom]
        # Copies: MuJoCo's arrays change with the next step.
        found.setdefault(key, MetObject(name, pose[0].copy(), pose[1].reshape(3, 3).copy()))
    return list(found.values())


def _name_of_body(body: str) -> str:
    """Return the name of a loose object or a door; empty: the body is neither."""
    prefix = next((one for one in (LOOSE_PREFIX, DOOR_PREFIX) if body.startswith(one)), None)
    return "" if prefix is None else body.removeprefix(prefix)


def _name_of_piece(part: str, names: ObjectNames) -> tuple[str, object]:
    """Return the name of a victim, a false alarm or a piece of the arena, and a key of each of them."""
    if not part.startswith(VICTIM_PREFIX):
        return STATIC, part
    owner = int(names.owners[int(part.removeprefix(VICTIM_PREFIX))])
    return (names.arena.victims[owner].name if owner >= 0 else FALSE_ALARM), (VICTIM_PREFIX, owner)


class ObjectFinder:
    """Finds what the beams of robots' object sensors meet in a world of any engine, by rays of C MuJoCo.

    Args:
        scene: The scene.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        # A copy of the description: compiling changes it.
        self._engine = CWorld(scene.spec.copy(), scene.arena, scene.physics.substeps, scene.moved_geoms)
        self._robots = {slot: index for slot, (_, index) in enumerate(scene.robots)}

    @numpy_backend()
    def find(
        self,
        world: World,
        physics: PhysicsState,
        sensor: tuple[int, int],
        robots: Mapping[int, str],
        arena: ArenaSpec,
    ) -> list[MetObject]:
        """Return the objects that the beams of a sensor meet now; parked robots are none.

        Args:
            world: The world, without an axis over worlds.
            physics: Its physics.
            sensor: Slot of the robot, and index of the sensor among the robot's.
            robots: Names of robots, by slot; others have the name of their class.
            arena: The world's arena.
        """
        scene, (slot, index) = self._scene, sensor
        group, member = scene.group_of(slot)
        own = scene.groups[group].suite.sensors[index]
        # Positions alone: rays depend on no velocity.
        self._engine.data.qpos[:] = physics.qpos
        moved = moved_geom_poses(scene, world.arena_state, clock_of(scene, world))
        caster = self._engine.caster(self._robots, moved)
        # Parked robots stand far away, but a beam of infinite length may meet them.
        parked = [
            caster.geoms_of(int(other))
            for one, state in zip(scene.groups, world.groups, strict=True)
            for other, active in zip(one.slots, np.asarray(state.active), strict=True)
            if not active
        ]
        bodies = sense_self(scene, world, physics, scene.groups[group]).bodies
        origin, along = own.rays(jax.tree.map(lambda rows: rows[member], bodies))
        # C MuJoCo casts rays in double precision only.
        rays = np.asarray(origin, np.float64), np.asarray(along, np.float64)
        query = query_of(own, np.int32(slot))
        distance, _, geoms = caster.hit_geoms(*rays, query, np.concatenate([caster.geoms_of(slot), *parked]))
        owners = np.asarray(victims_of(scene, world.arena_state).owner)
        names = {i: robots.get(i, robot.name) for i, (robot, _) in enumerate(scene.robots)}
        met = np.where(distance <= query.max_distance, geoms, -1)
        return met_objects(self._engine, met, ObjectNames(names, self._robots, arena, owners))
