"""Capture of a world on any engine as a drawing and frames, on NumPy."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, cast

import jax
import numpy as np

from usarmjx.base.backend import Array, numpy_backend
from usarmjx.base.clock import Clock, Time
from usarmjx.base.rotations import mat_from_quat, quat_from_mat
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.engines.base import PhysicsState
from usarmjx.models.compile.kinematic_tree import BodyPoses, forward_kinematics
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.compile.tags import tag_ids
from usarmjx.models.compile.victims import PADDING_OWNER, VictimTable, orientations, segment_poses
from usarmjx.models.drives.base import RobotState
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import OPAQUE
from usarmjx.sensors.base import Sensor
from usarmjx.sensors.cameras.mounts import Camera, cameras_of, headlight_of
from usarmjx.sensors.cameras.paint import ARENA_LABEL, FALSE_ALARM_LABEL, ROBOT_LABEL, VICTIM_LABEL
from usarmjx.sensors.cameras.shading import point_lights
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.sim.ray_geometry import (
    VisibleGeoms,
    drawn_limbs,
    moved_geom_poses,
    victims_of,
    visible_arena,
    visible_doors,
    visible_loose,
    visible_water,
)
from usarmjx.sim.scene import RobotGroup, Scene
from usarmjx.sim.world import GroupState, World, clock_of, robot_states
from usarmjx.view.drawing import (
    NOBODY,
    Drawing,
    DrawnBody,
    DrawnMount,
    DrawnRobot,
    DrawnShape,
    DrawnTag,
    Frame,
    RobotFrame,
    Setting,
)

FIXED_BODIES = {ARENA_LABEL: "arena", VICTIM_LABEL: "victims", FALSE_ALARM_LABEL: "false alarms"}
"""Names of the bodies that hold all fixed solids, by their labels."""
BONES = (VICTIM_LABEL, FALSE_ALARM_LABEL)
"""Labels of victims' solids: their limbs are drawn instead of the boxes that sensors hit."""
ROW_FIELDS = ("kind", "pos", "mat", "size", "owner", "material", "rgb", "label", "geom_index", "transparency")
"""Fields of `VisibleGeoms` with one row per geom."""
SHAPE_FIELDS = ("kind", "pos", "mat", "size", "rgb", "transparency", "material")
"""Fields of `DrawnShape`, which are fields of `VisibleGeoms`, too."""
FARTHEST = 1e5
"""Coordinate from which a geom counts as removed: absent solids are moved out of the arena [m]."""


class Capture:
    """Captures the worlds of a scene; its results share no memory with them.

    Args:
        scene: Their scene.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._num_fixed: dict[tuple[int, int], int] = {}

    def drawing(self, world: World, physics: PhysicsState, names: Mapping[int, str] | None = None) -> Drawing:
        """Return the constant part of a world's looks.

        Args:
            world: The world, without an axis over worlds; NumPy arrays.
            physics: Its physics.
            names: The robots' names by slot; None: those of the roster.
        """
        scene = self._scene
        arena = scene.arena_of(world.arena_state)
        lamps = point_lights(arena.lights, arena.floor)
        shapes, bodies, robots = dict[str, DrawnShape](), list[DrawnBody](), dict[int, DrawnRobot]()
        with numpy_backend():
            for name, row in self._arena_bodies(world, physics):
                label = int(np.asarray(row.label)[0])
                shape = _shape(row)
                # Bodies of one shape share its key: the page sends each mesh once.
                key = next((key for key, known in shapes.items() if _are_same(known, shape)), name)
                shapes.setdefault(key, shape)
                bodies.append(DrawnBody(name=name, shape=key, slot=NOBODY, label=label))
            for group in scene.groups:
                # By class: robots of a class share their meshes.
                shapes |= _robot_shapes(group)
                for slot in cast(list[int], group.slots.tolist()):
                    given = None if names is None else names.get(slot)
                    name = given or scene.roster[slot].name or f"{group.robot.name}{slot}"
                    robots[slot] = _drawn_robot(group, slot, name, len(bodies))
                    bodies += [
                        DrawnBody(
                            f"robot/{slot}/{part}", f"{group.robot.name}/{part}", slot, ROBOT_LABEL + slot
                        )
                        for part in group.plan.parts
                    ]
        return Drawing(
            arena=arena.name,
            floor=arena.floor,
            has_floor=arena.has_floor,
            extent=np.array(arena.extent, float),
            shapes=shapes,
            bodies=tuple(bodies),
            robots=robots,
            tags=tuple(
                DrawnTag(number=number, pos=np.add(tag.at, (0.0, 0.0, arena.floor)))
                for number, tag in zip(tag_ids(arena.tags), arena.tags, strict=True)
            ),
            lamps=np.asarray(lamps.pos),
            lamp_rgb=np.asarray(lamps.rgb),
            cutoff=(scene.radio or RadioSettings()).cutoff,
        )

    def frame(self, world: World, physics: PhysicsState) -> Frame:
        """Return the present frame of a world, with the last overlays, readings and links of its state.

        Args:
            world: The world, without an axis over worlds; NumPy arrays.
            physics: Its physics.
        """
        scene, robots, overlays = self._scene, dict[int, RobotFrame](), list[OverlayLines]()
        with numpy_backend():
            clock = clock_of(scene, world)
            arena_pos, arena_mat, arena_shown = self._arena_poses(world, physics)
            # Rows follow `Drawing.bodies`: the arena's bodies, then each group's robots with all their parts.
            pos, mat, shown = [arena_pos], [arena_mat], [arena_shown]
            for group, state in zip(scene.groups, world.groups, strict=True):
                body = robot_states(group, physics)
                bodies = forward_kinematics(group.plan, body)
                pos.append(np.asarray(bodies.pos).reshape(-1, 3))
                mat.append(np.asarray(bodies.mat).reshape(-1, 3, 3))
                shown.append(np.repeat(np.asarray(state.active), len(group.plan.parts)))
                for member in np.flatnonzero(np.asarray(state.active)).tolist():
                    robots[int(group.slots[member])] = _robot_frame(group, member, body, state, clock)
                    overlays += _overlays(group, member, state)
            # One call for all bodies: NumPy's time is that of its calls.
            turns = quat_from_mat(np.concatenate(mat))
        return Frame(
            # From the step counter in double precision: a float32 time loses milliseconds after a few hours.
            time=int(world.step) * scene.physics.period,
            pos=np.concatenate(pos).astype(np.float32),
            quat=np.asarray(turns, np.float32),
            shown=np.concatenate(shown),
            robots=robots,
            # Rows behind the count are empty places of the table.
            dropped_tags=np.array(world.tags.pos[: int(world.tags.count)]),
            overlays=tuple(overlays),
            links=world.links,
        )

    def _arena_bodies(self, world: World, physics: PhysicsState) -> Iterator[tuple[str, VisibleGeoms]]:
        """Yield the bodies that belong to no robot, in the order of `_arena_poses`, in each body's axes."""
        scene, fixed = self._scene, self._fixed(world)
        for label, name in FIXED_BODIES.items():
            if (np.asarray(fixed.label) == label).any():
                yield name, _picked(fixed, np.asarray(fixed.label) == label)
        if scene.arena.waters:
            yield "water", visible_water(scene)
        moving = self._moving(world)
        if moving.any():
            table = _victims(scene, world)
            boxes = np.flatnonzero(table.swing > 0)
            for geom, limb in zip(np.flatnonzero(moving), drawn_limbs(table, boxes), strict=True):
                yield f"limb/{geom}", limb
        loose = scene.loose_geoms
        row = visible_loose(scene, physics)
        # Shapes are in their body's axes: the body's pose comes with each frame.
        row = row._replace(pos=loose.local.pos, mat=loose.local.mat)
        for index, thing in enumerate(scene.arena.loose):
            yield f"loose/{thing.name}", _picked(row, np.asarray(loose.owner == index))
        row = _in_own_axes(visible_doors(scene, physics))
        for index, door in enumerate(scene.arena.doors):
            yield f"door/{door.name}", _picked(row, np.array([index]))

    def _fixed(self, world: World) -> VisibleGeoms:
        """Return all geoms of this world's arena that never move, at their poses."""
        clock = clock_of(self._scene, world)
        fixed, *data = visible_arena(self._scene, world.arena_state, clock)
        rows = [_picked(fixed, ~np.isin(fixed.label, BONES))]
        if data:
            # All worlds have as many geoms as the largest arena: those that this one lacks are far away.
            here = ~self._moving(world) & (np.abs(np.asarray(data[0].pos)) < FARTHEST).all(-1)
            rows.append(_picked(data[0], here & ~np.isin(data[0].label, BONES)))
        rows += _still_limbs(_victims(self._scene, world), clock, self._scene.arena.floor)
        return fixed._replace(
            **{
                field: np.concatenate([np.asarray(getattr(row, field)) for row in rows])
                for field in ROW_FIELDS
            }
        )

    def _num_fixed_bodies(self, world: World) -> int:
        """Return the number of bodies that never move; computed once in an episode."""
        which = int(world.number), int(world.episode)
        if which not in self._num_fixed:
            labels = {*np.asarray(self._fixed(world).label).tolist()}
            # One entry only: an earlier episode never comes back.
            self._num_fixed = {which: len(labels & {*FIXED_BODIES}) + bool(self._scene.arena.waters)}
        return self._num_fixed[which]

    def _moving(self, world: World) -> np.ndarray:
        """Return which of the arena's data geoms move: limbs of victims (geoms,)."""
        scene, state = self._scene, world.arena_state
        if scene.moved_geoms is None:
            return np.zeros(0, bool)
        if state is None:
            # Of a single arena only the boxes that move are data.
            return np.ones(len(scene.moving_victim_boxes), bool)
        # Data are the arena's solids, and the boxes of victims after them.
        return np.concatenate([np.zeros(len(state.pos), bool), np.asarray(state.victims.swing) > 0])

    def _arena_poses(self, world: World, physics: PhysicsState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the poses of the bodies that belong to no robot, and which of them are present."""
        scene, state = self._scene, world.arena_state
        still = self._num_fixed_bodies(world)
        pos, mat = [np.zeros((still, 3))], [np.tile(np.eye(3), (still, 1, 1))]
        moving = self._moving(world)
        if moving.any():
            here = moved_geom_poses(scene, state, clock_of(scene, world))
            assert here is not None
            # Victims' poses are heights above the floor, all others are heights in the world.
            pos.append(np.asarray(here.pos)[moving] + np.array([0.0, 0.0, scene.arena.floor]))
            mat.append(np.asarray(mat_from_quat(here.quat[moving])))
        loose = np.asarray(physics.qpos)[scene.loose_geoms.root_qposadr]
        doors = visible_doors(scene, physics)
        pos += [loose[:, :3], np.asarray(doors.pos)]
        mat += [np.asarray(mat_from_quat(loose[:, 3:])), np.asarray(doors.mat)]
        shown = np.ones(sum(len(one) for one in pos), bool)
        # Loose objects and doors are the last two parts of the poses.
        if state is not None and len(loose):
            first = sum(len(one) for one in pos[:-2])
            shown[first : first + len(loose)] = np.asarray(state.present)
        return np.concatenate(pos), np.concatenate(mat), shown


def _victims(scene: Scene, world: World) -> VictimTable:
    return jax.tree.map(np.asarray, victims_of(scene, world.arena_state))


def _still_limbs(table: VictimTable, time: Time, floor: float) -> list[VisibleGeoms]:
    """Return the drawn limbs of victims that never move, at their poses."""
    boxes = np.flatnonzero((table.swing == 0) & (table.owner != PADDING_OWNER))
    positions, turns = (np.asarray(x)[boxes] for x in segment_poses(table, time))
    found: list[VisibleGeoms] = []
    for limb, at, turn in zip(drawn_limbs(table, boxes), positions, orientations(turns), strict=True):
        # Rows are vectors, so the product with the transpose turns each of them.
        pos = at + (0.0, 0.0, floor) + np.asarray(limb.pos) @ np.asarray(turn).T
        found.append(limb._replace(pos=pos, mat=np.tile(turn, (len(limb.kind), 1, 1))))
    return found


def _picked(row: VisibleGeoms, which: np.ndarray) -> VisibleGeoms:
    """Return some geoms of a row, by index or mask."""
    return row._replace(**{field: np.asarray(getattr(row, field))[which] for field in ROW_FIELDS})


def _in_own_axes(row: VisibleGeoms) -> VisibleGeoms:
    """Return geoms that are one body each, in their body's axes."""
    n = len(row.kind)
    return row._replace(pos=np.zeros((n, 3), np.float32), mat=np.tile(np.eye(3, dtype=np.float32), (n, 1, 1)))


def _shape(row: VisibleGeoms) -> DrawnShape:
    return DrawnShape(**{field: np.array(getattr(row, field)) for field in SHAPE_FIELDS})


def _are_same(one: DrawnShape, other: DrawnShape) -> bool:
    return all(np.array_equal(getattr(one, field), getattr(other, field)) for field in SHAPE_FIELDS)


def _key(group: RobotGroup, part: str) -> str:
    return f"{group.robot.name}/{part}"


def _robot_shapes(group: RobotGroup) -> dict[str, DrawnShape]:
    """Return the shapes of a class's bodies, by its name and theirs."""
    drawn, shapes = group.plan.visuals.solids, dict[str, DrawnShape]()
    for index, part in enumerate(group.plan.parts):
        own = drawn.frame == index
        n = int(own.sum())
        shapes[_key(group, part)] = DrawnShape(
            kind=drawn.kind[own],
            pos=drawn.pos[own],
            mat=drawn.mat[own],
            size=drawn.size[own],
            rgb=drawn.rgb[own],
            # Robots' visuals are opaque, see `Part`.
            transparency=np.zeros(n, np.float32),
            material=np.full(n, OPAQUE, object),
        )
    return shapes


def _drawn_robot(group: RobotGroup, slot: int, name: str, body: int) -> DrawnRobot:
    robot = group.robot
    return DrawnRobot(
        slot=slot,
        name=name,
        robot=robot.name,
        body=body,
        num_bodies=len(group.plan.parts),
        dimensions=np.array(robot.dimensions),
        joints=joint_names(robot),
        sensors=tuple(_drawn_sensor(sensor, body) for sensor in group.suite.sensors),
        cameras=tuple(_drawn_camera(camera, body) for camera in cameras_of(robot)),
        battery_life=robot.battery_life,
        drive_keys=tuple(robot.drive.full_scale),
        headlight=_drawn_headlight(robot, body),
    )


def _drawn_sensor(sensor: Sensor, body: int) -> DrawnMount:
    n = len(sensor.plan.parts)
    # With all bodies at the origin, poses in the world are those on the bodies.
    rest = BodyPoses(pos=np.zeros((n, 3), np.float32), mat=np.tile(np.eye(3, dtype=np.float32), (n, 1, 1)))
    pos, mat = sensor.mount_poses(rest)
    return DrawnMount(
        kind=sensor.kind,
        names=tuple(mount.name for mount in sensor.mounts),
        body=body + sensor.bodies_of_mounts(),
        pos=np.array(pos),
        mat=np.array(mat),
        settings=tuple(_plain(asdict(settings)) for settings in sensor.settings),
    )


def _drawn_camera(camera: Camera, body: int) -> DrawnMount:
    return DrawnMount(
        kind=camera.mount.kind,
        names=(camera.mount.name,),
        body=np.array([body + camera.body]),
        pos=camera.pos[None],
        mat=camera.mat[None],
        settings=({"fov": camera.default_fov, "lens": camera.lens},),
    )


def _drawn_headlight(robot: RobotSpec, body: int) -> DrawnMount:
    light = headlight_of(robot)
    ahead = light.direction
    # The axis farthest from the light's: nearly parallel ones would give no direction across.
    left = np.cross(np.eye(3)[np.argmin(np.abs(ahead))], ahead)
    left /= np.linalg.norm(left)
    return DrawnMount(
        kind="Headlight",
        names=("Headlight",),
        body=np.array([body + light.body]),
        pos=light.pos[None],
        mat=np.column_stack([ahead, left, np.cross(ahead, left)])[None],
        settings=({},),
    )


def _plain(settings: Mapping[str, Any]) -> dict[str, Setting]:
    return {name: value for name, value in settings.items() if isinstance(value, bool | int | float | str)}


def _robot_frame(
    group: RobotGroup, member: int, body: RobotState, state: GroupState, clock: Clock
) -> RobotFrame:
    def own(values: Array) -> np.ndarray:
        # A copy: the world goes on in the same memory.
        return np.array(values[member])

    age = float(clock.since(state.battery_start[member]))
    return RobotFrame(
        pos=own(body.pos),
        quat=own(body.quat),
        linear=own(body.linear),
        angular=own(body.angular),
        joint_pos=own(body.joint_pos),
        # Water kills a battery however young it is.
        battery=0.0 if state.drowned[member] else max(0.0, group.robot.battery_life - age),
        light=bool(state.command.light[member]),
        drive=own(state.command.setpoint),
        readings=tuple(map(own, state.memory.last)),
        fovs=own(state.fov),
    )


def _overlays(group: RobotGroup, member: int, state: GroupState) -> list[OverlayLines]:
    drawn = [i for i, sensor in enumerate(group.suite.sensors) if sensor.has_overlay]
    own = [jax.tree.map(lambda x: np.array(x[member]), state.memory.own[i]) for i in drawn]
    return [group.suite.sensors[i].overlay(memory) for i, memory in zip(drawn, own, strict=True)]
