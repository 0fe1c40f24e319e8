"""Robots from MJCF and URDF files, today's form of manual 14.4.1: a geometric model made with other tools."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.models.compile.measure import with_measurements
from usarmjx.models.compile.physics import Physics
from usarmjx.models.drives import Drive
from usarmjx.models.files.mjcf_solids import (
    Inertia,
    Pose,
    agrees,
    combine_inertias,
    geom_inertia,
    inertia_box,
    mat_of,
    shape_of,
    usarsim_angles,
    usarsim_vector,
    volume,
)
from usarmjx.models.files.reader_process import try_model
from usarmjx.models.files.xml_size import check_model_size
from usarmjx.models.types.robot import CHASSIS, Motor, Part, RobotSpec, Spring
from usarmjx.models.types.shapes import Shape

DEFAULT_STIFFNESS_RATIO = 20.0
"""Stiffness over damping of a motor without stiffness [1/s] (a P2AT's)."""
STIFFNESS, DAMPING = 667.0, 33.0
"""Gains over inertia of a motor without gains [1/s2], [1/s] (a P2AT's)."""
MAX_STIFFNESS, MAX_DAMPING = 0.1, 0.5
"""Bounds of kp dt2 / I and kv dt / I, the change of a joint's error in a step: servos are integrated
explicitly."""
DEFAULT_TRAVEL = np.pi
"""Error at which a position servo without a force limit has its full torque [rad] (chosen)."""

DEFAULT_SPEED = 6.2832
"""Default of the highest speed of a joint [rad/s or m/s]: the wheel joint's in the UDK version."""

NO_STIFFNESS = 1e-9
"""Stiffness of a joint that has a damper alone: our springs need some [N m/rad]."""

VELOCITY_MODE = 1
"""Control mode of joints with a speed (`JointControl`)."""

RESERVED_NAMES = ("chassis", "root")
"""Names in use in the composed model."""

MESH, BOX = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_BOX


def motors_of(model: mujoco.MjModel, given: Mapping[str, Motor], max_speed: float) -> dict[int, Motor]:
    """Return the motors of joints, by joint id.

    Args:
        model: The compiled file.
        given: Motors by joint, which replace those of the file.
        max_speed: Highest speed of motors whose actuator does not limit it [rad/s or m/s].

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
        if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT:
            raise SpecError(f"{_name(model, actuator)} does not drive a joint; motors do")
        joint = int(model.actuator_trnid[actuator, 0])
        if joint in found:
            raise SpecError(f"{_name(model, actuator)} is the second one of joint {names[joint]}; one can be")
        found[joint] = _motor(model, actuator, joint, max_speed)
    return found | {names.index(name): motor for name, motor in given.items()}


def _name(model: mujoco.MjModel, actuator: int) -> str:
    return f"actuator {model.actuator(actuator).name or f'number {actuator}'}"


def _motor(model: mujoco.MjModel, actuator: int, joint: int, max_speed: float) -> Motor:
    """Return the servo equivalent to an actuator."""
    gear = abs(float(model.actuator_gear[actuator, 0]))
    # biasprm is (0, -kp, -kv); a gear scales both force and position, so the joint sees its square.
    bias = -model.actuator_biasprm[actuator, 1:3] * gear**2
    kind = _kind(model, actuator, *bias)
    dof = model.jnt_dofadr[joint]
    # MuJoCo's estimate at the initial pose, with all that the joint carries.
    inertia = 1.0 / float(model.dof_invweight0[dof])
    drag = 0.0 if np.any(model.jnt_stiffness[joint]) else float(model.dof_damping[dof])
    stiffness, damping = float(bias[0]), float(bias[1]) + drag
    if kind == "velocity":
        stiffness = DEFAULT_STIFFNESS_RATIO * float(bias[1])
    if kind == "motor":
        stiffness, damping = STIFFNESS * inertia, DAMPING * inertia + drag
    limited = bool(model.actuator_ctrllimited[actuator])
    most = float(np.abs(model.actuator_ctrlrange[actuator]).max()) if limited else np.inf
    speed = most / gear if kind in ("velocity", "intvelocity") else np.inf
    torque = _torque(model, actuator, joint, gear)
    if not np.isfinite(torque):
        pull = float(model.actuator_gainprm[actuator, 0]) * gear * most
        usual = {"velocity": float(bias[1]) * min(speed, max_speed), "motor": pull}
        torque = usual.get(kind, stiffness * DEFAULT_TRAVEL)
    if not np.isfinite(torque):
        raise SpecError(f"{_name(model, actuator)} has no limit; give it a ctrlrange or a forcerange")
    step = Physics().timestep
    needed = max(stiffness * step**2 / MAX_STIFFNESS, damping * step / MAX_DAMPING)
    return Motor(
        max_speed=min(speed, max_speed),
        torque=torque,
        stiffness=stiffness,
        damping=damping,
        armature=float(model.dof_armature[dof]) + max(0.0, needed - inertia),
    )


def _kind(model: mujoco.MjModel, actuator: int, stiffness: float, damping: float) -> str:
    """Return the name of MuJoCo's shortcut for an actuator."""
    dynamics, gain, bias = (
        getattr(model, f"actuator_{name}type")[actuator] for name in ("dyn", "gain", "bias")
    )
    fixed = gain == mujoco.mjtGain.mjGAIN_FIXED
    affine = bias == mujoco.mjtBias.mjBIAS_AFFINE
    if fixed and affine and dynamics == mujoco.mjtDyn.mjDYN_INTEGRATOR and stiffness > 0:
        return "intvelocity"
    if fixed and dynamics == mujoco.mjtDyn.mjDYN_NONE:
        if affine and stiffness > 0:
            return "position"
        if affine and stiffness == 0 and damping > 0:
            return "velocity"
        if bias == mujoco.mjtBias.mjBIAS_NONE:
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


def robot_from_mjcf(
    path: str | Path,
    *,
    name: str,
    drive: Drive,
    motors: Mapping[str, Motor] | None = None,
    max_speed: float = DEFAULT_SPEED,
    **fields: Any,  # noqa: ANN401 - those of RobotSpec
) -> RobotSpec:
    """Return a robot class from an MJCF or URDF file, whose x axis points to the head and z up.

    The first body under the world is the chassis; its free joint is dropped, other bodies under the world and
    fixed geoms are left out. Every body with one hinge or slide is a part with that joint's name, at the
    joint; bodies without joints belong to their parents' parts. Positions count from the file's initial pose.

    Boxes, spheres, capsules, cylinders and ellipsoids stay; a mesh becomes the box with its inertia. Geoms
    without contacts stay so; all others get our surfaces, with our friction: joints that the drive gives a
    velocity are wheels. On the engine `jax` only boxes may touch another robot's wheels. Mass, centre and
    inertia are the file's: on the geoms where these account for them, else on an added box without contacts,
    which sensors see.

    Actuators (position, velocity, intvelocity, motor) become servos with their gains and limits; a joint gets
    armature where its gains need it at our step of 5 ms. Springs and dampers of joints stay; friction losses,
    passive armature, sensors, sites and cameras of the file do not.

    Args:
        path: The file.
        name: Class name.
        drive: Its drive, with the file's joint names.
        motors: Motors of joints without an actuator (URDF has none), or replacements, by joint.
        max_speed: Highest speed of motors whose actuator does not limit it [rad/s or m/s].
        fields: Other fields of RobotSpec: sensors, cameras, packages, payload, ...; `dimensions`, `mass` and
            wheel measurements are measured unless given.

    Raises:
        SpecError: An unreadable file, or content that a robot cannot have; names it.
    """
    model, tree = _read_tree(Path(path))
    rolling = {aim.joint for aim in drive.joint_controls if aim.mode == VELOCITY_MODE}
    servos = motors_of(model, motors or {}, max_speed)
    parts = tuple(
        tree.part(owner, servos.get(int(model.body_jntadr[owner])), rolling) for owner in tree.owners[1:]
    )
    taken = [part.name for part in parts if part.name in (*RESERVED_NAMES, CHASSIS)]
    if taken:
        raise SpecError(f"{path}: a joint is called {', '.join(taken)}: rename it, that name is taken")
    robot = with_measurements(
        RobotSpec(
            name=name,
            dimensions=(0.0, 0.0, 0.0),
            mass=0.0,
            origin_height=0.0,
            chassis=tree.shapes(tree.owners[0], "hull"),
            parts=parts,
            drive=drive,
            sources=(("all", "chosen"),),
        )
    )
    return replace(robot, **fields)


def _read_tree(path: Path) -> tuple[mujoco.MjModel, "_BodyTree"]:
    """Return the compiled file and its bodies, sorted by part."""
    spec, root = _open(path)
    model = _compile(spec, path)
    boxes = spec.copy()
    for geom in boxes.geoms:
        if geom.type == MESH:
            geom.type = BOX  # MuJoCo then fits a box to the mesh
    fitted = _compile(boxes, path)
    return model, _BodyTree(model, fitted, spec, model.body(root).id)


def _open(path: Path) -> tuple[mujoco.MjSpec, str]:
    """Return the file's description with a free chassis, and the chassis' name."""
    check_model_size(path)
    if wrong := try_model(path):
        raise SpecError(f"{path}: does not read: {wrong}")
    spec = mujoco.MjSpec.from_file(str(path))
    for kind, found in (("equality constraint", spec.equalities), ("tendon", spec.tendons)):
        if found:
            raise SpecError(f"{path}: {kind} {found[0].name!r}: robots have parts with one joint each only")
    root = spec.worldbody.first_body()
    if root is None:
        raise SpecError(f"{path}: no body under the world: nothing can be the chassis")
    held = [joint for joint in root.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
    if held:
        names = ", ".join(joint.name for joint in held)
        raise SpecError(f"{path}: body {root.name!r}, the chassis, hangs on {names}; it must be free")
    if not root.joints:
        root.add_freejoint()
    root.name = root.name or "chassis of the file"
    return spec, root.name


def _compile(spec: mujoco.MjSpec, path: str | Path) -> mujoco.MjModel:
    try:
        return spec.compile()
    except ValueError as error:
        raise SpecError(f"{path}: does not compile: {error}") from error


class _BodyTree:
    """A compiled file, its bodies sorted by the part that they belong to.

    Args:
        model: The file.
        fitted: The same with boxes in place of meshes.
        spec: Its description, for densities.
        root: The chassis' body id.

    Attributes:
        owners: Bodies that are chassis and parts, parents first.
    """

    def __init__(self, model: mujoco.MjModel, fitted: mujoco.MjModel, spec: mujoco.MjSpec, root: int) -> None:
        self._model, self._fitted = model, fitted
        self._described = {geom.id: geom for geom in spec.geoms}
        self._owner = {root: root}
        self._frame = {root: Pose(np.zeros(3), np.eye(3))}  # of a body in the axes of its part
        for body in range(root + 1, model.nbody):
            self._enter(body)
        self.owners = [body for body, owner in self._owner.items() if body == owner]

    def _enter(self, body: int) -> None:
        model, parent = self._model, int(self._model.body_parentid[body])
        if parent not in self._owner:
            return  # under the world beside the chassis
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        allowed = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        if len(joints) > 1 or any(model.jnt_type[joint] not in allowed for joint in joints):
            names = ", ".join(model.joint(joint).name or f"number {joint}" for joint in joints)
            raise SpecError(
                f"body {model.body(body).name!r} has the joints {names}; a part has one hinge or slide"
            )
        if joints:
            self._owner[body] = body
            self._frame[body] = Pose(-model.jnt_pos[joints[0]], np.eye(3))
        else:
            self._owner[body] = self._owner[parent]
            self._frame[body] = self._frame[parent].compose(model.body_pos[body], model.body_quat[body])

    def _members(self, owner: int) -> list[int]:
        return [body for body, mine in self._owner.items() if mine == owner]

    def name(self, owner: int) -> str:
        """Return the name of a part: its joint's, else its body's."""
        model = self._model
        if self.owners[0] == owner:
            return CHASSIS
        name = model.joint(model.body_jntadr[owner]).name or model.body(owner).name
        if not name:
            raise SpecError(f"body number {owner} and its joint have no name: give the joint one")
        return name

    def part(self, owner: int, motor: Motor | None, rolling: set[str]) -> Part:
        """Return the part of a body with a joint."""
        model, joint = self._model, int(self._model.body_jntadr[owner])
        parent, name = int(model.body_parentid[owner]), self.name(owner)
        quat = model.body_quat[owner]
        at = self._frame[parent].compose(model.body_pos[owner] + mat_of(quat) @ model.jnt_pos[joint], quat)
        limits = None
        if model.jnt_limited[joint]:
            low, high = (model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]).tolist()
            limits = (low, high)
        hinge = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        return Part(
            name=name,
            parent=self.name(self._owner[parent]),
            at=usarsim_vector(at.pos),
            rotation=usarsim_angles(at.mat),
            axis=usarsim_vector(model.jnt_axis[joint]),
            joint="hinge" if hinge else "slide",
            motor=motor,
            limits=limits,
            spring=self._spring(joint, driven=motor is not None),
            shapes=self.shapes(owner, "wheel" if name in rolling else "hull"),
            is_wheel=name in rolling,
        )

    def _spring(self, joint: int, *, driven: bool) -> Spring | None:
        """Return a joint's spring and damper; without a spring the damper is part of the motor."""
        model, qposadr = self._model, self._model.jnt_qposadr[joint]
        stiffness = float(np.ravel(model.jnt_stiffness[joint])[0])
        damping = float(np.ravel(model.dof_damping[model.jnt_dofadr[joint]])[0])
        if stiffness == 0 and (damping == 0 or driven):
            return None
        rest = float(model.qpos_spring[qposadr] - model.qpos0[qposadr])
        return Spring(
            stiffness=stiffness or NO_STIFFNESS, damping=damping, load=-rest * (stiffness or NO_STIFFNESS)
        )

    def shapes(self, owner: int, surface: str) -> tuple[Shape, ...]:
        """Return the solids of a part; masses on them, or all on an added box."""
        model, fitted = self._model, self._fitted
        whole = combine_inertias([self._inertia(body) for body in self._members(owner)])
        if whole.mass <= 0:
            raise SpecError(
                f"{self.name(owner)} has no mass: give its body an inertial or its geoms a density"
            )
        geoms = [
            (geom, self._frame[body])
            for body in self._members(owner)
            for geom in range(
                fitted.body_geomadr[body], fitted.body_geomadr[body] + fitted.body_geomnum[body]
            )
        ]
        light = [shape_of(fitted, geom, frame, surface, 0.0) for geom, frame in geoms]
        masses = [self._mass(geom) for geom, _ in geoms]
        solids = [geom_inertia(fitted, *geom, mass) for geom, mass in zip(geoms, masses, strict=True)]
        meshes = any(model.geom_type[geom] == MESH for geom, _ in geoms)
        if solids and not meshes and agrees(combine_inertias(solids), whole):
            return tuple(replace(shape, mass=mass) for shape, mass in zip(light, masses, strict=True))
        return (*light, inertia_box(whole))

    def _mass(self, geom: int) -> float:
        """Return the mass that a geom would contribute to its body."""
        described = self._described[geom]
        if np.isfinite(described.mass):
            return float(described.mass)
        return described.density * volume(self._fitted, geom)

    def _inertia(self, body: int) -> Inertia:
        model, frame = self._model, self._frame[body]
        placed = frame.compose(model.body_ipos[body], model.body_iquat[body])
        tensor = placed.mat @ np.diag(model.body_inertia[body]) @ placed.mat.T
        return Inertia(float(model.body_mass[body]), placed.pos, tensor)
