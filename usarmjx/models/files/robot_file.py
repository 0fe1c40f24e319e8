"""Robots from files of other tools: MJCF, URDF, xacro."""

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from usarmjx.base.errors import ArenaFileError, SpecError, quoted
from usarmjx.base.registry import is_name
from usarmjx.base.settings.files import read_bytes
from usarmjx.models.compile.kinematic_tree import chassis_heights, with_measurements
from usarmjx.models.drives import Ackermann, Drive, SkidSteer
from usarmjx.models.files.gazebo_sensors import read_gazebo_elements
from usarmjx.models.files.mjcf_solids import usarsim_angles, usarsim_vector
from usarmjx.models.files.reader_process import expand_xacro, try_model
from usarmjx.models.files.resources import Resources, mesh_pieces
from usarmjx.models.files.robot_drive import (
    DEFAULT_SPIN,
    MIN_ROTORS,
    BodyTree,
    borne_inertias,
    find_drive,
    rolling_parts,
    rotor_drive,
    wheel_torque,
    with_firm_wheels,
)
from usarmjx.models.files.robot_mjcf import DEFAULT_TRAVEL, motor_with_limits, motors_of, read_mjcf_robot
from usarmjx.models.files.robot_source import JointLimit, RobotSource, listed, plain_name
from usarmjx.models.files.sdf_tree import SDF_ROOTS, sdf_as_urdf
from usarmjx.models.files.urdf import mend_urdf, read_urdf, read_urdf_robot
from usarmjx.models.files.xml_file import root_tag
from usarmjx.models.types.robot import CHASSIS, Motor, Mount, Part, RobotSpec, options

logger = logging.getLogger(__name__)

VELOCITY_MODE = 1
"""Control mode of joints with a speed (`JointControl`)."""
RESERVED_NAMES = ("chassis", "root")
"""Names in use in the composed model."""
CASTER_GAP = 0.01
"""Height above the ground within which a fixed solid beside wheels is a caster [m]."""
DRAG_GAP = 0.002
"""Height above the ground within which any other fixed solid beside wheels would drag [m]."""
MAX_PACKAGES = 50
"""Largest number of packages that a xacro file names."""
OUTERMOST = options(LeftTire="", RightTire="")
"""Settings of odometry that takes the outermost wheels."""


@dataclass(frozen=True, kw_only=True)
class LoadedRobot:
    """A robot from a file.

    Attributes:
        robot: The robot.
        notes: Content of the file that is left out or mended, in words, with file and line.
    """

    robot: RobotSpec
    notes: tuple[str, ...]


def load_robot(  # noqa: PLR0913 - options of its own, one each
    path: str | Path,
    *,
    name: str = "",
    drive: Drive | None = None,
    motors: Mapping[str, Motor] | None = None,
    packages: Iterable[str | Path] = (),
    arguments: Mapping[str, str] | None = None,
    pieces: int | None = None,
    max_speed: float = DEFAULT_SPIN,
    **fields: Any,  # noqa: ANN401 - those of RobotSpec
) -> LoadedRobot:
    """Return the robot of an MJCF, URDF or xacro file, whose x axis points to the head and z up.

    The root link, or the first body under the world, is the chassis. Every body with one hinge or slide is a
    part with that joint's name. Mass, centre and inertia are the file's; a solid without them weighs nothing.
    A mesh on a hinge that turns without end and that is round about it becomes a cylinder, any other its
    convex hull. A plugin of the file states the drive; else wheels on both sides make one, or thrusters on
    sites. Sensors of the file become mounts.

    Args:
        path: The file.
        name: Class name; empty: the file's name for it.
        drive: Drive, with the file's joint names; None: the file's.
        motors: Motors of joints, which replace those of the file.
        packages: Folders in which packages and models are searched first.
        arguments: Arguments of a xacro file.
        pieces: Largest number of convex pieces into which coacd cuts a mesh of URDF, xacro or SDF that is not
            on a wheel; None: the number of `--pieces`, else 1, its hull.
        max_speed: Highest speed of motors for which the file states none [rad/s or m/s].
        fields: Other fields of RobotSpec, which replace those of the file.

    Raises:
        SpecError: An unreadable file, or content that a robot cannot have; names it.
    """
    resources = Resources(folders=tuple(Path(folder) for folder in packages))
    source = open_robot_file(Path(path), resources, arguments or {}, mesh_pieces(pieces))
    try:
        return _Builder(source, drive, motors or {}, max_speed).build(name, fields)
    except SpecError as error:
        # Most errors name the file and the line already.
        if str(path) in str(error):
            raise
        raise SpecError(f"{path}: {error}") from error


def robot_from_mjcf(
    path: str | Path,
    *,
    name: str,
    drive: Drive,
    motors: Mapping[str, Motor] | None = None,
    max_speed: float = DEFAULT_SPIN,
    **fields: Any,  # noqa: ANN401 - those of RobotSpec
) -> RobotSpec:
    """Return a robot class from a file with a drive of one's own; see `load_robot`.

    Entries of the file that the robot lacks are logged as warnings. Sensors and cameras come from `fields`.

    Raises:
        SpecError: An unreadable file, or content that a robot cannot have; names it.
    """
    own: dict[str, Any] = {"sensors": (), "cameras": (), **fields}
    loaded = load_robot(path, name=name, drive=drive, motors=motors, max_speed=max_speed, **own)
    for note in loaded.notes:
        logger.warning("%s", note)
    return loaded.robot


def open_robot_file(
    path: Path, resources: Resources, arguments: Mapping[str, str], pieces: int = 1
) -> RobotSource:
    """Return the content of a robot's file.

    Raises:
        SpecError: An unreadable file, or content that a robot cannot have; names it.
    """
    data = read_bytes(path, refusal=ArenaFileError)
    tag = root_tag(data)
    # Many xacro files end in .urdf.
    if path.suffix.lower() == ".xacro" or (tag == "robot" and (b"<xacro:" in data or b"$(" in data)):
        data = _expanded(path, resources, arguments)
        tag = root_tag(data)
    notes: list[str] = []
    if tag == "robot":
        root = read_urdf(path, data)
    elif tag in SDF_ROOTS:
        root, notes = sdf_as_urdf(path, resources)
    else:
        return read_mjcf_robot(path)
    mended = mend_urdf(root)
    source = read_urdf_robot(root, path, resources, pieces)
    # In the order of the work: mending comes before reading.
    source.notes[:0] = [*mended, *notes]
    read_gazebo_elements(root, source, {body.name for body in source.spec.bodies})
    try:
        text = source.spec.to_xml()
    except Exception as error:  # MuJoCo raises errors of its own
        raise SpecError(f"{path}: does not compile: {quoted(error)}") from error
    # In another process: some content ends the process instead of raising.
    if wrong := try_model(path, text):
        raise SpecError(f"{path}: does not compile: {wrong}")
    return source


def _expanded(path: Path, resources: Resources, arguments: Mapping[str, str]) -> bytes:
    """Return the XML of a xacro file; folders of packages are found as it names them."""
    folders: dict[str, str] = {}
    # xacro tells one missing package at a time: expand again until it finds all.
    for _ in range(MAX_PACKAGES):
        found = expand_xacro(path, folders, arguments)
        if isinstance(found, bytes):
            return found
        folder = next(resources.packages(found, path), None)
        if folder is None:
            raise SpecError(f"{path}: no folder {found!r} is above it, in --packages, or in ROS_PACKAGE_PATH")
        folders[found] = str(folder)
    raise SpecError(f"{path}: names more than {MAX_PACKAGES} packages")


class _Builder:
    """Builder of a robot class of a file's content.

    Args:
        source: The content.
        drive: Drive; None: the file's.
        motors: Motors that replace those of the file, by joint.
        max_speed: Highest speed of motors for which the file states none [rad/s or m/s].
    """

    def __init__(
        self, source: RobotSource, drive: Drive | None, motors: Mapping[str, Motor], max_speed: float
    ) -> None:
        self._source, self._given, self._max_speed = source, motors, max_speed
        self._drive = drive
        if not source.root:
            raise SpecError(f"{source.path}: its first link has no name")
        try:
            self._model = source.spec.compile()
        except ValueError as error:
            raise SpecError(f"{source.path}: does not compile: {quoted(error)}") from error
        root = self._model.body(source.root).id
        self._tree = BodyTree(self._model, source.spec, root, source.path, frozenset(source.slippery))

    def build(self, name: str, fields: Mapping[str, Any]) -> LoadedRobot:
        """Return the robot, with some fields replaced."""
        tree, source = self._tree, self._source
        rotors = [i for i in range(self._model.nu) if self._is_on_site(i)]
        flies = self._drive is None and len(rotors) >= MIN_ROTORS
        servos = motors_of(self._model, self._given, self._max_speed, skip=rotors if flies else ())
        # After motors of the file, whose speeds bound the drive's; before those that only its wheels need.
        drive = self._find_drive(servos)
        urdf_motors = self._stated_motors(drive)
        # Actuators of the file override motors made of its limits.
        servos = urdf_motors | servos
        rolling = {aim.joint for aim in drive.joint_controls if aim.mode == VELOCITY_MODE}
        wheels = rolling | self._passive_wheels()
        parts = tuple(tree.part(owner, servos.get(tree.joint_of(owner)), wheels) for owner in tree.owners[1:])
        # A drive of the caller's own comes with the signs of its wheels.
        if self._drive is None:
            parts = _rolling_ahead(tree, parts, rolling)
        parts = self._geared(parts)
        taken = [part.name for part in parts if part.name in (*RESERVED_NAMES, CHASSIS)]
        if taken:
            raise SpecError(
                f"{source.path}: a joint is called {', '.join(taken)}: rename it, that name is taken"
            )
        shapes, inertia = tree.solids(tree.owners[0], "hull")
        looks = tree.looks(tree.owners[0])
        if not (shapes or any(part.shapes for part in parts)):
            raise SpecError(f"{source.path}: has no solid: nothing of it touches the ground")
        robot = RobotSpec(
            name=_class_name(name, source),
            # `with_measurements` fills these in below.
            dimensions=(0.0, 0.0, 0.0),
            mass=0.0,
            origin_height=0.0,
            chassis=shapes,
            inertia=inertia,
            looks=looks,
            parts=parts,
            drive=drive,
            sources=(("all", "file"),),
        )
        robot = replace(robot, **self._mounts(drive))
        try:
            # Before casters, which are found by the origin's height above the ground.
            robot = with_measurements(robot)
        except SpecError:
            raise
        except ValueError as error:
            raise SpecError(f"{source.path}: makes no robot: {quoted(error)}") from error
        if wheels and not flies:
            robot = with_firm_wheels(_with_casters(robot, source), wheels)
        if flies:
            root, size = tree.owners[0], np.array(robot.dimensions)
            # After measuring: drag areas need the robot's box.
            robot = replace(robot, drive=rotor_drive(self._model, root, rotors, size))
        torques = [part.motor.torque for part in robot.wheels if part.motor is not None]
        robot = replace(robot, max_torque=max(torques, default=robot.max_torque))
        given = {**fields}
        if "sensors" in given:
            given["sensors"] = tuple(map(_with_own_wheels, given["sensors"]))
        return LoadedRobot(robot=replace(robot, **given), notes=tuple(dict.fromkeys(source.notes)))

    def _is_on_site(self, actuator: int) -> bool:
        return self._model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_SITE

    def _find_drive(self, servos: Mapping[int, Motor]) -> Drive:
        if self._drive is not None:
            return self._drive
        names = {joint: self._model.joint(joint).name for joint in servos}
        speeds = {names[joint]: motor.max_speed for joint, motor in servos.items()}
        for joint, limit in self._source.limits.items():
            if np.isfinite(limit.speed):
                speeds.setdefault(joint, limit.speed)
        driven = {*names.values(), *(self._source.motors or ())} or None
        drive = find_drive(self._tree, self._source, speeds, driven)
        rolling = {aim.joint for aim in drive.joint_controls if aim.mode == VELOCITY_MODE}
        owners = [owner for owner in self._tree.owners[1:] if self._tree.name(owner) in rolling]
        if gripping := [self._tree.name(owner) for owner in owners if self._tree.grip(owner)]:
            self._source.notes.append(
                f"{self._source.path}: driven wheels {listed(gripping)} have no friction: here they grip"
            )
        return drive

    def _passive_wheels(self) -> set[str]:
        """Return parts that roll, driven or not: they turn without end, are round and reach the ground."""
        return {part.joint for part in rolling_parts(self._tree) if part.rolls}

    def _stated_motors(self, drive: Drive) -> dict[int, Motor]:
        """Return motors of joints for which the file has limits but no actuator, by joint id."""
        tree, source, model = self._tree, self._source, self._model
        aims = {aim.joint for aim in drive.joint_controls}
        wheels = max(1, sum(aim.mode == VELOCITY_MODE for aim in drive.joint_controls))
        radius = drive.radius if isinstance(drive, SkidSteer | Ackermann) else 0.0
        weight = float(model.body_subtreemass[tree.owners[0]])
        borne = borne_inertias(tree)
        found: dict[int, Motor] = {}
        for owner in tree.owners[1:]:
            joint, name = tree.joint_of(owner), tree.name(owner)
            limit = source.limits.get(name, JointLimit())
            free, limited = tree.turns_freely(owner), tree.is_limited(owner)
            wanted = name in aims or (
                name not in source.mimics
                and name in source.limits
                and (name in source.motors if source.motors is not None else limited)
            )
            if not wanted:
                continue
            # The inverse weight of a joint counts the inertia of all that hangs on it.
            inertia = 1.0 / float(model.dof_invweight0[model.jnt_dofadr[joint]])
            speed = limit.speed if np.isfinite(limit.speed) else self._max_speed
            rolls = free and radius > 0 and name in aims
            # A driven wheel has to move its share of the robot, not only itself.
            load = weight * radius**2 / wheels if rolls else borne.get(owner, 0.0)
            motor = motor_with_limits(inertia, limit.effort, speed, load)
            if not np.isfinite(motor.torque):
                usual = motor.stiffness * DEFAULT_TRAVEL
                motor = replace(motor, torque=wheel_torque(weight, radius, wheels) if rolls else usual)
            found[joint] = motor
        return found

    def _geared(self, parts: tuple[Part, ...]) -> tuple[Part, ...]:
        """Return parts with the joints that follow others geared to them."""
        mimics, names = self._source.mimics, {part.name: part for part in parts}
        done: list[Part] = []
        for part in parts:
            mimic = mimics.get(part.name)
            if mimic is None:
                done.append(part)
                continue
            if mimic.leader not in names or mimic.leader == part.name:
                raise SpecError(
                    f"{self._source.path}: joint {part.name!r} follows {mimic.leader!r}, which is no joint "
                    f"that moves; known: {listed([*names], 20)}"
                )
            done.append(
                replace(
                    part,
                    geared=mimic.leader,
                    gear_ratio=mimic.ratio,
                    gear_offset=mimic.offset,
                    # The leader moves it: a motor of its own would pull against that.
                    motor=None,
                    is_wheel=False,
                )
            )
        return tuple(done)

    def _mounts(self, drive: Drive) -> dict[str, Any]:
        """Return sensors and cameras of the file, and pose sensors that it lacks."""
        mounts: dict[bool, list[Mount]] = {False: [], True: []}
        for one in self._source.sensors:
            place = self._tree.locate(self._model.body(one.body).id)
            if place is None:
                self._source.notes.append(
                    f"{self._source.path}: {one.kind} {one.name} is on no part: left out"
                )
                continue
            # Bodies that are fixed to others are no parts: their pose in the part counts.
            parent, frame = place
            pose = frame.then(one.pose)
            mounts[one.kind == "Camera"].append(
                Mount(
                    kind=one.kind,
                    name=one.name,
                    at=usarsim_vector(pose.pos),
                    direction=usarsim_angles(pose.mat),
                    parent=parent,
                    options=one.options,
                )
            )
        kinds = {mount.kind for mount in mounts[False]}
        usual = [Mount(kind=kind, name=kind) for kind in ("INS", "GroundTruth") if kind not in kinds]
        if isinstance(drive, SkidSteer | Ackermann) and "Odometry" not in kinds:
            usual.insert(0, Mount(kind="Odometry", name="Odometry", options=OUTERMOST))
        return {"sensors": (*mounts[False], *usual), "cameras": tuple(mounts[True])}


def _with_own_wheels(mount: Mount) -> Mount:
    """Return a mount; odometry that names no wheels takes the outermost, as the defaults are a P2AT's."""
    return mount if mount.kind != "Odometry" or mount.all_options else replace(mount, options=OUTERMOST)


def _class_name(name: str, source: RobotSource) -> str:
    """Return a class name that the wire takes: the given one, else the file's."""
    found = name or plain_name(source.name or source.path.stem)
    if not is_name(found):
        raise SpecError(f"{source.path}: {found!r} is no name of a robot: one word of ASCII letters")
    return found


def _rolling_ahead(tree: BodyTree, parts: tuple[Part, ...], rolling: set[str]) -> tuple[Part, ...]:
    """Return parts whose driven wheels roll ahead at positive speed."""
    data = mujoco.MjData(tree.model)
    mujoco.mj_kinematics(tree.model, data)
    left = data.xmat[tree.owners[0]].reshape(3, 3)[:, 1]
    axes = {tree.name(owner): data.xaxis[tree.joint_of(owner)] for owner in tree.owners[1:]}
    return tuple(
        replace(part, axis=_opposite(part.axis))
        if part.name in rolling and axes[part.name] @ left < 0
        else part
        for part in parts
    )


def _opposite(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = axis
    # Not -x: of 0.0 that makes -0.0.
    return (0.0 - x, 0.0 - y, 0.0 - z)


def _with_casters(robot: RobotSpec, source: RobotSource) -> RobotSpec:
    """Return a robot on wheels whose fixed solids that reach the ground slide on it."""
    ground = robot.origin_height
    heights = chassis_heights(robot)
    round_ones, others = set[int](), list[int]()
    for i, (shape, height) in enumerate(zip(robot.chassis, heights, strict=True)):
        if shape.surface != "hull":
            continue
        reach = shape.size[0] if shape.size else 0.0
        if shape.kind in ("sphere", "ellipsoid", "capsule", "cylinder"):
            # z points down here: the lowest point has the largest one.
            if shape.at[2] + reach > ground - CASTER_GAP:
                round_ones.add(i)
        elif height < DRAG_GAP:
            others.append(i)
    if others:
        source.notes.append(
            f"{source.path}: {len(others)} of the chassis' solids that are not round reach the ground beside "
            "its wheels: they slide on it"
        )
    slide = round_ones | {*others}
    chassis = tuple(
        replace(shape, surface="caster") if i in slide else shape for i, shape in enumerate(robot.chassis)
    )
    return replace(robot, chassis=chassis)
