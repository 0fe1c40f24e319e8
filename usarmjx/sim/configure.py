"""Robots as ini files configure them, put in force for this process (manual 12.1.2, 14.4.2)."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.registry import Registry
from usarmjx.models.compile.compose import RobotIndex, add_robot, chassis_shapes, index_robot, remove_robot
from usarmjx.models.compile.parts import joint_names, parts_of
from usarmjx.models.effecters import EFFECTERS
from usarmjx.models.ini.parse import UU_PER_METRE, IniFile
from usarmjx.models.ini.robots import LoadedRobots, build_robots, read_files
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.base import SENSORS
from usarmjx.sensors.cameras.mounts import CameraSettings, overload
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.scene import parking_position, prefix_of
from usarmjx.sim.single_world import SingleWorld


def update_robot_spec(world: SingleWorld, slot: int, robot: RobotSpec) -> None:
    """Give a robot another description; its pose, motion and commands stay.

    Args:
        world: The world.
        slot: The robot.
        robot: The description: the same parts, sensors, cameras and effecters, with other figures.

    Raises:
        UsageError: It has other parts or sensors than the robot, or a setting that is wrong.
        SpecError: MuJoCo cannot build it, or settings do not go together. Nothing has changed after either.
    """
    before = world.roster[slot].spec
    if _names(robot) != _names(before):
        raise UsageError(f"a running {before.name} keeps its parts and its load")
    suite_of(robot)  # raises what is wrong with a setting
    # Sensors and drives alone are not in the model: nothing has to be compiled.
    if _solids(robot) == _solids(before):
        world.replace_robot(slot, robot)
        return
    present = before
    try:
        _rebuild(world, slot, before, robot)
        present = robot
    finally:
        world.replace_robot(slot, present)


def _names(robot: RobotSpec) -> object:
    mounts = (robot.sensors, robot.cameras, robot.effecters)
    names = [[(mount.kind, mount.name, mount.parent) for mount in some] for some in mounts]
    return joint_names(robot), [part.motor is None for part in parts_of(robot)], robot.drive.keys, names


def _solids(robot: RobotSpec) -> object:
    """Return the parts of a class that are in the model, and a little more."""
    return chassis_shapes(robot), parts_of(robot)


def _rebuild(world: SingleWorld, slot: int, before: RobotSpec, after: RobotSpec) -> None:
    """Build a robot's solids and motors anew where it is."""
    engine, prefix = world.engine, prefix_of(slot)
    parking = parking_position(world.scene.arena, slot)

    def build(robot: RobotSpec, spec: mujoco.MjSpec) -> None:
        # The undo may run after a failure in the middle, when the robot is gone already.
        if spec.body(f"{prefix}chassis") is not None:
            remove_robot(spec, prefix)
        add_robot(spec, robot, prefix, parking)

    def state_rows(robot: RobotSpec) -> list[tuple[np.ndarray, list[int]]]:
        """Return the robot's arrays in the engine's state, with its indices in them."""
        index, data = index_robot(engine.model, robot, prefix), engine.data
        dofs, actuators = _dofs(index), [*index.actuator_ids, *index.hold_actuator_ids]
        free = [*range(index.root_qposadr, index.root_qposadr + 7), *index.qposadr]
        return [
            (data.qpos, free),
            (data.qvel, dofs),
            # The solver starts from the last accelerations: without them the robot's next step would differ.
            (data.qacc_warmstart, dofs),
            (data.act, list(index.actadr)),
            (data.ctrl, actuators),
        ]

    # The robot is removed and added: recompile keeps the state of others only.
    values = [array[indices].copy() for array, indices in state_rows(before)]
    present = before
    try:
        engine.edit(lambda spec: build(after, spec), lambda spec: build(before, spec))
        present = after
    except ValueError as error:  # of MuJoCo
        raise SpecError(f"a {before.name} cannot be built so: {error}") from error
    # After a fault as well: `edit` has undone the change, and the values fit the model of before.
    finally:
        for (array, indices), value in zip(state_rows(present), values, strict=True):
            array[indices] = value
        # Rays and cameras read poses before the next step computes them.
        mujoco.mj_kinematics(engine.model, engine.data)


def _dofs(index: RobotIndex) -> list[int]:
    return [*range(index.root_dofadr, index.root_dofadr + 6), *index.dofadr]


def settings_by_kind() -> dict[str, type]:
    """Return the settings of every type of sensor, effecter and camera: dataclasses, by type."""
    items = [*SENSORS, *EFFECTERS]
    return {"Camera": CameraSettings} | {kind: item.settings_class for kind, item in items}


@dataclass
class ActiveFiles:
    """The ini files that are in force, so that further ones come after them as if read together.

    Attributes:
        files: All of them, in order.
        robots: The robots that were there when the last one came, as they are with the files, by name.
        originals: Those of them that the files change, as they would be without; None: there would be none.
        warnings: Warnings that were given about the files.
    """

    files: tuple[IniFile, ...] = ()
    robots: Mapping[str, RobotSpec] = field(default_factory=dict[str, RobotSpec])
    originals: Mapping[str, RobotSpec | None] = field(default_factory=dict[str, RobotSpec | None])
    warnings: frozenset[str] = frozenset()

    def are_intact_in(self, robots: Registry[RobotSpec]) -> bool:
        """Return whether all robots are still those that the files made."""
        return all(name in robots and robots.get(name) is robot for name, robot in self.robots.items())

    def without(self, robots: Registry[RobotSpec]) -> Registry[RobotSpec]:
        """Return the robots as they would be without the files."""
        others = robots.copy()
        for name, robot in self.originals.items():
            if robot is None:
                others.discard(name)
            else:
                others.replace(name, robot)
        return others


# A list, so that functions replace its item without a global statement.
_active_files = [ActiveFiles()]


def configure(paths: Iterable[str | Path], uu_per_metre: float = UU_PER_METRE) -> LoadedRobots:
    """Load ini files and put the robot classes that they change or define into `ROBOTS`.

    Robots that are there already stay as they are; call it before the first scene or world. A second call's
    files come after those of the first, as if all were read together, unless another has replaced one of the
    robots in `ROBOTS` since: then they come on top of what is there.

    Args:
        paths: USARBot.ini and USARMisPkg.ini files; a later one overrides.
        uu_per_metre: Length of a metre in Unreal units.

    Returns:
        The robots that were loaded, with a warning more for each that carries more than its payload, if it
        has a section or did not carry too much before.

    Raises:
        SpecError: A file or value that is wrong, or a robot that cannot be built; nothing has changed then.
    """
    before = _active_files[0] if _active_files[0].are_intact_in(ROBOTS) else ActiveFiles()
    # From the robots without any file, so that files that came earlier are not applied twice.
    stock, files = before.without(ROBOTS), (*before.files, *read_files(paths, uu_per_metre))
    loaded = build_robots(files, stock, settings_by_kind())
    warnings = [*loaded.warnings, *_check(loaded, stock, ", ".join(file.path for file in files))]
    new = {robot.name.lower(): robot for robot in loaded.robots}
    restored = (robot for name, robot in before.originals.items() if robot is not None and name not in new)
    changed = tuple(robot for robot in (*loaded.robots, *restored) if ROBOTS.find(robot.name) != robot)
    fresh = tuple(text for text in warnings if text not in before.warnings)
    loaded = replace(loaded, robots=changed, warnings=fresh)
    # Last: everything that can fail has been tried on copies.
    loaded.apply(ROBOTS)
    _active_files[0] = ActiveFiles(
        files=files,
        robots=dict(ROBOTS),
        originals={name: stock.find(name) for name in new},
        warnings=before.warnings | frozenset(warnings),
    )
    return loaded


def _check(loaded: LoadedRobots, stock: Registry[RobotSpec], files: str) -> list[str]:
    """Return warnings about robots that carry too much.

    Raises:
        SpecError: A robot whose sensors cannot be built.
    """
    places, warnings = dict(loaded.source_lines), list[str]()
    for robot in loaded.robots:
        try:
            suite_of(robot)
        except UsageError as error:
            raise SpecError(f"{places.get(robot.name, files)}: robot {robot.name}: {error}") from error
        # Stock robots that were too heavy before are no fault of the files.
        mine = robot.name in places or not (robot.name in stock and overload(stock.get(robot.name)))
        if mine and (problem := overload(robot)):
            warnings.append(f"{places.get(robot.name, files)}: {problem}")
    return warnings
