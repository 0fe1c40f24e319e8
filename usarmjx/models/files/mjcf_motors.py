"""Motors of joints from the actuators of an MJCF file."""

from collections.abc import Mapping

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.models.build.compose import Physics
from usarmjx.models.spec.robot import Motor

DEFAULT_STIFFNESS_RATIO = 20.0
"""Stiffness over damping of a motor that has no stiffness of its own [1/s] (a P2AT's)."""
STIFFNESS, DAMPING = 667.0, 33.0
"""Gains over inertia of one that has neither [1/s2], [1/s] (a P2AT's)."""
MAX_STIFFNESS, MAX_DAMPING = 0.1, 0.5
"""What a step may turn a joint's error into: kp dt2 / I and kv dt / I; servos are explicit in it."""
USUAL_TRAVEL = np.pi
"""Error at which a position servo without a force limit has its full torque [rad] (chosen)."""


def motors_of(model: mujoco.MjModel, given: Mapping[str, Motor], max_speed: float) -> dict[int, Motor]:
    """Return the motors of joints, by joint id.

    Args:
        model: The compiled file.
        given: Motors by joint, which replace those of the file.
        max_speed: Of motors whose actuator does not limit it [rad/s or m/s].

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
    """Return the servo that does what an actuator does."""
    gear = abs(float(model.actuator_gear[actuator, 0]))
    bias = -model.actuator_biasprm[actuator, 1:3] * gear**2
    kind = _kind(model, actuator, *bias)
    dof = model.jnt_dofadr[joint]
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
        torque = usual.get(kind, stiffness * USUAL_TRAVEL)
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
    """Return which of MuJoCo's shortcuts an actuator is."""
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
    """Return the least limit of an actuator's force on its joint [N m or N]; infinite without any."""
    limits = [np.inf]
    if model.actuator_forcelimited[actuator]:
        limits.append(float(np.abs(model.actuator_forcerange[actuator]).max()) * gear)
    if model.jnt_actfrclimited[joint]:
        limits.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
    return min(limits)
