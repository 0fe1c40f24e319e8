"""Servos that stand for the actuators of an MJCF file."""

from collections.abc import Collection, Mapping
from typing import Any

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.models.compile.physics import Physics
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
