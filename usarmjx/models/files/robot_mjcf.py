"""MJCF files as robots, today's form of manual 14.4.1: a model made with other tools, and its actuators."""

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.models.compile.physics import Physics
from usarmjx.models.files.mjcf_solids import Pose, mat_of
from usarmjx.models.files.reader_process import try_model
from usarmjx.models.files.robot_source import MimicJoint, RobotSource, SensorOnLink, left_out, place_of
from usarmjx.models.files.urdf import LIGHT_INERTIA, LIGHT_NOTE, LIGHT_SHARE, MIN_MASS
from usarmjx.models.files.xml_file import check_model_size, drop_sizes
from usarmjx.models.types.robot import Motor

DEFAULT_STIFFNESS_RATIO = 20.0
"""Stiffness over damping of a motor without stiffness [1/s] (a P2AT's)."""
STIFFNESS, DAMPING = 667.0, 33.0
"""Gains over inertia of a motor without gains [1/s2], [1/s] (a P2AT's)."""
MAX_STIFFNESS, MAX_DAMPING = 0.1, 0.5
"""Bounds of kp dt2 / I and kv dt / I, the change of a joint's error in a step: servos are integrated
explicitly."""
DEFAULT_TRAVEL = np.pi
"""Error at which a position servo without a force limit has its full torque [rad] (chosen)."""
DYNAMICS: Any = mujoco.mjtDyn  # its stubs lack some
FILTERS: tuple[Any, ...] = (DYNAMICS.mjDYN_FILTER, DYNAMICS.mjDYN_FILTEREXACT)
"""Dynamics of actuators that follow their control with a lag, which our servos have not."""
CAMERA_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
"""Our camera's axes (x ahead, y left, z up) in MuJoCo's (looks along -z, x right, y up), as columns."""
INERTIAL = (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO)
"""Types of MuJoCo's sensors that an IMU stands for."""
TRANSMISSIONS: Any = mujoco.mjtTrn  # its stubs lack some
MUJOCO: Any = mujoco
UNNAMED = "MuJoCo Model"
"""MuJoCo's name of a model without one."""


def motors_of(
    model: mujoco.MjModel, given: Mapping[str, Motor], max_speed: float, skip: Collection[int] = ()
) -> dict[int, Motor]:
    """Return the motors of joints, by joint id.

    Args:
        model: The compiled file.
        given: Motors by joint, which replace those of the file.
        max_speed: Highest speed of motors whose actuator does not limit it [rad/s or m/s].
        skip: Actuators that are no motors.

    Raises:
        SpecError: An actuator of a kind that servos cannot stand for, two of them at one joint, or a motor
            for a joint that does not exist.
    """
    names = [model.joint(i).name for i in range(model.njnt)]
    unknown = sorted(set(given) - set(names))
    if unknown:
        raise SpecError(f"motors for {', '.join(unknown)}, but joints are {', '.join(filter(None, names))}")
    found: dict[int, Motor] = {}
    for actuator in range(model.nu):
        if actuator in skip:
            continue
        if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT:
            raise SpecError(
                f"{_name(model, actuator)} does not drive a joint; motors do, or four or more rotors on sites"
            )
        joint = int(model.actuator_trnid[actuator, 0])
        if joint in found:
            raise SpecError(f"{_name(model, actuator)} is the second one of joint {names[joint]}; one can be")
        found[joint] = _motor(model, actuator, joint, max_speed)
    return found | {names.index(name): motor for name, motor in given.items()}


def _name(model: mujoco.MjModel, actuator: int) -> str:
    return f"actuator {model.actuator(actuator).name or f'number {actuator}'}"


def _motor(model: mujoco.MjModel, actuator: int, joint: int, max_speed: float) -> Motor:
    """Return the servo equivalent to an actuator."""
    # A negative gear turns the sense of the control, which our servos take in the joint's own.
    gear = abs(float(model.actuator_gear[actuator, 0]))
    # biasprm is (0, -kp, -kv); a gear scales both force and position, so the joint sees its square.
    bias = -model.actuator_biasprm[actuator, 1:3] * gear**2
    kind = _kind(model, actuator, *bias)
    dof = model.jnt_dofadr[joint]
    # MuJoCo's estimate at the initial pose, with all that the joint carries.
    inertia = 1.0 / float(model.dof_invweight0[dof])
    # Beside a spring the damper belongs to that, see `BodyTree._spring`.
    drag = 0.0 if np.any(model.jnt_stiffness[joint]) else float(model.dof_damping[dof])
    stiffness, damping = float(bias[0]), float(bias[1]) + drag
    if kind == "velocity":
        stiffness = DEFAULT_STIFFNESS_RATIO * float(bias[1])
    if kind == "motor":
        stiffness, damping = STIFFNESS * inertia, DAMPING * inertia + drag
    limited = bool(model.actuator_ctrllimited[actuator])
    most = float(np.abs(model.actuator_ctrlrange[actuator]).max()) if limited else np.inf
    limited_speed = kind in ("velocity", "intvelocity") and np.isfinite(most)
    # The file wins: the default holds only where it states no speed.
    speed = most / gear if limited_speed else max_speed
    torque = _torque(model, actuator, joint, gear)
    if not np.isfinite(torque):
        pull = float(model.actuator_gainprm[actuator, 0]) * gear * most
        usual = {"velocity": float(bias[1]) * speed, "motor": pull}
        torque = usual.get(kind, stiffness * DEFAULT_TRAVEL)
    if not np.isfinite(torque):
        raise SpecError(f"{_name(model, actuator)} has no limit; give it a ctrlrange or a forcerange")
    return Motor(
        max_speed=speed,
        torque=torque,
        stiffness=stiffness,
        damping=damping,
        armature=float(model.dof_armature[dof]) + _stabilizing_armature(stiffness, damping, inertia),
    )


def _stabilizing_armature(stiffness: float, damping: float, inertia: float) -> float:
    """Return the armature that a joint needs for its gains at our time step [kg m2 or kg]."""
    step = Physics().timestep
    return max(0.0, max(stiffness * step**2 / MAX_STIFFNESS, damping * step / MAX_DAMPING) - inertia)


def motor_with_limits(inertia: float, torque: float, speed: float, load: float = 0.0) -> Motor:
    """Return the servo of a joint without gains.

    Args:
        inertia: Inertia that the joint moves [kg m2 or kg].
        torque: Largest torque or force [N m or N].
        speed: Highest speed [rad/s or m/s].
        load: Inertia that it moves beside while its wheel rolls, the robot's share of each wheel [kg m2].
    """
    stiffness, damping = STIFFNESS * (inertia + load), DAMPING * (inertia + load)
    return Motor(
        max_speed=speed,
        torque=torque,
        stiffness=stiffness,
        damping=damping,
        armature=_stabilizing_armature(stiffness, damping, inertia),
    )


def _kind(model: mujoco.MjModel, actuator: int, stiffness: float, damping: float) -> str:
    """Return the name of MuJoCo's shortcut for an actuator."""
    dynamics, gain, bias = (
        getattr(model, f"actuator_{name}type")[actuator] for name in ("dyn", "gain", "bias")
    )
    fixed = gain == mujoco.mjtGain.mjGAIN_FIXED
    affine = bias == mujoco.mjtBias.mjBIAS_AFFINE
    # A bias of zeros acts as none.
    idle = affine and not np.any(model.actuator_biasprm[actuator])
    if fixed and affine and dynamics == mujoco.mjtDyn.mjDYN_INTEGRATOR and stiffness > 0:
        return "intvelocity"
    if fixed and (dynamics == mujoco.mjtDyn.mjDYN_NONE or any(dynamics == lag for lag in FILTERS)):
        if affine and stiffness > 0:
            return "position"
        if affine and stiffness == 0 and damping > 0:
            return "velocity"
        if bias == mujoco.mjtBias.mjBIAS_NONE or idle:
            return "motor"
    raise SpecError(
        f"{_name(model, actuator)} is of a kind that has no servo; "
        "those of position, velocity, intvelocity and motor have one"
    )


def _torque(model: mujoco.MjModel, actuator: int, joint: int, gear: float) -> float:
    """Return the smallest limit of an actuator's force on its joint [N m or N]; infinite without any."""
    limits = [np.inf]
    if model.actuator_forcelimited[actuator]:
        limits.append(float(np.abs(model.actuator_forcerange[actuator]).max()) * gear)
    if model.jnt_actfrclimited[joint]:
        limits.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
    return min(limits)


def read_mjcf_robot(path: Path) -> RobotSource:
    """Return an MJCF file's robot: the first body under the world and all below it.

    Raises:
        SpecError: An unreadable file, or content that a robot cannot have; names it.
    """
    check_model_size(path)
    # In the other process first: a file that crashes MuJoCo must not end this one.
    if wrong := try_model(path):
        raise SpecError(f"{path}: does not read: {wrong}")
    try:
        return _source(path)
    except UnicodeDecodeError as error:
        raise SpecError(f"{path}: does not read: a name in it is no UTF-8 ({error.reason})") from error


def _source(path: Path) -> RobotSource:
    """Return the content of a file that MuJoCo reads."""
    spec = mujoco.MjSpec.from_file(str(path))
    drop_sizes(spec)
    root = spec.worldbody.first_body()
    if root is None:
        raise SpecError(f"{path}: no body under the world: nothing can be the chassis")
    root.name = root.name or "chassis of the file"
    name = "" if spec.modelname == UNNAMED else spec.modelname
    source = RobotSource(path=path, name=name, spec=spec, root=root.name)
    _note_contact_figures(path, spec, source)
    _free_chassis(root, source)
    _read_constraints(spec, source)
    _name_fixed_bodies(spec)
    _read_cameras(spec, source)
    _read_inertial_sensors(spec, source)
    _note_left_out(path, spec, source)
    return source


def _free_chassis(root: Any, source: RobotSource) -> None:  # noqa: ANN401
    """Replace the joints that hold the chassis on the world by a free one."""
    held = [joint for joint in root.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
    if held:
        names = [joint.name for joint in held]
        said = left_out(source.path, "joints between the world and the chassis, which is free,", held)
        # First their actuators, which would not compile without them.
        _delete(
            source.spec, [one for one in source.spec.actuators if one.target in names], source, "actuators"
        )
        for joint in held:
            source.spec.delete(joint)
        source.notes.append(said)
    if not root.joints:
        _weigh_chassis(root, source)
        root.add_freejoint()


def _weigh_chassis(root: Any, source: RobotSource) -> None:  # noqa: ANN401
    """Give a chassis without mass, which the file holds on the world, the little that MuJoCo needs."""
    model = source.spec.compile()
    own = model.body(source.root).id
    # Bodies without a joint between them are one to MuJoCo: mass anywhere in it is enough.
    rigid = model.body_weldid == model.body_weldid[own]
    below = np.array([body >= own and model.body_rootid[body] == own for body in range(model.nbody)])
    if model.body_mass[rigid & below].sum() > 0:
        return
    root.explicitinertial = True
    root.mass = max(LIGHT_SHARE * float(model.body_subtreemass[own]), MIN_MASS)
    root.inertia = [LIGHT_INERTIA] * 3
    source.notes.append(f"{place_of(source.path, root.info)}: body {source.root!r} has no mass: {LIGHT_NOTE}")


def _read_constraints(spec: Any, source: RobotSource) -> None:  # noqa: ANN401
    """Turn linear couplings of two joints into joints that follow another; leave out other constraints."""
    others: list[Any] = []
    names = {joint.name for joint in spec.joints}
    for equality in spec.equalities:
        terms = np.array(equality.data[:5], float)
        if (
            equality.type == mujoco.mjtEq.mjEQ_JOINT
            and equality.active
            and equality.name2
            and {equality.name1, equality.name2} <= names
            and equality.name1 not in source.mimics
            # A polynomial of a higher degree is no gear.
            and not terms[2:].any()
        ):
            source.mimics[equality.name1] = MimicJoint(
                leader=equality.name2, ratio=float(terms[1]), offset=float(terms[0])
            )
        else:
            others.append(equality)
    actuators = [one for one in spec.actuators if one.trntype == TRANSMISSIONS.mjTRN_TENDON]
    actuators += [one for one in spec.actuators if one.target in source.mimics]
    sensors = [one for one in spec.sensors if one.objtype == MUJOCO.mjtObj.mjOBJ_TENDON]
    _delete(spec, actuators, source, "actuators of tendons or of joints that follow another")
    _delete(spec, sensors, source, "sensors of tendons")
    _delete(spec, others, source, "equality constraints (closed chains are open)")
    _delete(spec, [*spec.tendons], source, "tendons")


def _delete(spec: Any, found: list[Any], source: RobotSource, kind: str) -> None:  # noqa: ANN401
    """Delete elements from a description; a note names them."""
    if found:
        source.notes.append(left_out(source.path, kind, found))
        for one in found:
            spec.delete(one)


def _note_contact_figures(path: Path, spec: Any, source: RobotSource) -> None:  # noqa: ANN401
    """Note solids with contact parameters of their own: all robots have those of their surfaces."""
    usual = mujoco.MjSpec().worldbody.add_geom()
    keys = ("friction", "solref", "solimp", "margin", "gap", "condim", "priority")

    def has_own(geom: Any) -> bool:  # noqa: ANN401 - mujoco.MjsGeom
        return any(not np.array_equal(getattr(geom, key), getattr(usual, key)) for key in keys)

    touching = [geom for geom in spec.geoms if geom.contype or geom.conaffinity]
    if own := [geom for geom in touching if has_own(geom)]:
        source.notes.append(left_out(path, "solids' friction and contact parameters", own))


def _name_fixed_bodies(spec: mujoco.MjSpec) -> None:
    """Name the bodies without joint and name: sensors refer to bodies by name, parts take a joint's."""
    for number, body in enumerate(spec.bodies):
        if not body.name and not body.joints:
            body.name = f"body {number} of the file"


def _read_cameras(spec: mujoco.MjSpec, source: RobotSource) -> None:
    """Add the cameras that are fixed to bodies of the robot."""
    for number, camera in enumerate(spec.cameras):
        if camera.parent == spec.worldbody or camera.mode != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
            continue
        field = float(np.radians(camera.fovy)) * 4 / 3  # pictures are 4 wide and 3 high
        field = float(np.clip(field, 0.02, np.radians(179)))
        source.sensors.append(
            SensorOnLink(
                kind="Camera",
                name=source.free_name(camera.name or f"Camera{number + 1}"),
                body=camera.parent.name,
                pose=Pose(np.array(camera.pos), mat_of(np.array(camera.quat)) @ CAMERA_AXES),
                options=(("CameraDefFov", field), ("CameraMinFov", field), ("CameraMaxFov", field)),
            )
        )


def _read_inertial_sensors(spec: mujoco.MjSpec, source: RobotSource) -> None:
    """Add an IMU for each site with an accelerometer or a gyro; other sensors become notes."""
    sites = {site.name: site for site in spec.sites}
    used: set[str] = set()
    others: list[Any] = []
    for sensor in spec.sensors:
        site = sites.get(sensor.objname) if sensor.type in INERTIAL else None
        if site is None:
            others.append(sensor)
        elif sensor.objname not in used:
            used.add(sensor.objname)
            source.sensors.append(
                SensorOnLink(
                    kind="IMU",
                    name=source.free_name(sensor.objname),
                    body=site.parent.name,
                    pose=Pose(np.array(site.pos), mat_of(np.array(site.quat))),
                )
            )
    if others:
        source.notes.append(left_out(source.path, "sensors", others))


def _note_left_out(path: Path, spec: mujoco.MjSpec, source: RobotSource) -> None:
    """Add a note for each kind of content that robots do not have."""
    some: Callable[[object], bool] = lambda value: bool(np.any(np.asarray(value, float)))  # noqa: E731
    used = {one.objname for one in spec.sensors if one.type in INERTIAL}
    used |= {one.target for one in spec.actuators}
    kinds = {
        "bodies beside the robot": [body for body in spec.worldbody.bodies if body.name != source.root],
        "fixed solids of the world": list(spec.worldbody.geoms),
        "sites": [one for one in spec.sites if one.parent != spec.worldbody and one.name not in used],
        "keyframes": list(spec.keys),
        "contact pairs": list(spec.pairs),
        "contact exclusions (parts of a robot never touch each other)": list(spec.excludes),
        "friction losses of joints": [joint for joint in spec.joints if some(joint.frictionloss)],
        "lags of actuators": [one for one in spec.actuators if one.dyntype in FILTERS],
        "gravity compensations": [body for body in spec.bodies if some(body.gravcomp)],
        "lights": list(spec.lights),
    }
    for kind, found in kinds.items():
        if found:
            source.notes.append(left_out(path, kind, found))
