"""Joints that move as their servos do and carry no load: flippers, pan-tilts, steered wheels."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import set_rows
from usarmjx.models.spec.robot import HOLD_SUFFIX


@dataclass(frozen=True, eq=False)
class PlanarServos:
    """The servos of a model, see `models.build.compose`.

    Attributes:
        pull: Actuators that pull towards a target (n,).
        hold: Those that hold, likewise (n,).
        act: Where in act the targets are (n,).
        qpos: Where in qpos the joints are (n,).
        qvel: Where in qvel they are (n,).
        lag: By how much a joint trails its target at a speed: damping over stiffness [s] (n,).
        low: Lower ends of their ranges (n,).
        high: Upper ends (n,).
        geared: Pairs of joints of which the first does what the second does, in qpos and qvel (pairs, 2).
    """

    pull: np.ndarray
    hold: np.ndarray
    act: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    lag: np.ndarray
    low: np.ndarray
    high: np.ndarray
    geared_qpos: np.ndarray
    geared_qvel: np.ndarray


def servos_of(model: mujoco.MjModel) -> PlanarServos:
    """Return the servos of a model."""
    names = [model.actuator(i).name for i in range(model.nu)]
    holds = [i for i, name in enumerate(names) if name.endswith(HOLD_SUFFIX)]
    pulls = [names.index(names[i].removesuffix(HOLD_SUFFIX)) for i in holds]
    joints = model.actuator_trnid[pulls, 0].astype(int)
    gains = model.actuator_biasprm[holds], model.actuator_gainprm[holds]
    damping, stiffness = -gains[1][:, 2], -gains[1][:, 1]
    limited = model.jnt_limited[joints].astype(bool)
    gears = model.eq_type == mujoco.mjtEq.mjEQ_JOINT
    pairs = np.stack([model.eq_obj1id[gears], model.eq_obj2id[gears]], -1).astype(int).reshape(-1, 2)
    return PlanarServos(
        pull=np.array(pulls, int),
        hold=np.array(holds, int),
        act=model.actuator_actadr[pulls].astype(int),
        qpos=model.jnt_qposadr[joints].astype(int),
        qvel=model.jnt_dofadr[joints].astype(int),
        lag=damping / np.maximum(stiffness, 1e-9),
        low=np.where(limited, model.jnt_range[joints, 0], -np.inf),
        high=np.where(limited, model.jnt_range[joints, 1], np.inf),
        geared_qpos=model.jnt_qposadr[pairs].astype(int),
        geared_qvel=model.jnt_dofadr[pairs].astype(int),
    )


def move_joints(servos: PlanarServos, state: Any, ctrl: Array, act: Array, dt: float) -> Any:  # noqa: ANN401
    """Return the state of one world after its joints have gone after their targets for a time.

    The target moves at the speed of `ctrl`; the joint follows as a servo without load does, whose stiffness
    pulls as its damping holds back: exact for that. A joint told to exert a torque stays.

    Args:
        servos: The servos.
        state: A state with qpos (nq,), qvel (nv,) and act (na,).
        ctrl: Inputs (nu,).
        act: Activations at the beginning (na,).
        dt: Time [s].
    """
    speed, aim = ctrl[servos.pull], act[servos.act]
    before, lag = state.qpos[servos.qpos], jnp.maximum(jnp.asarray(servos.lag), 1e-4)
    behind = aim - before
    later = speed * lag + (behind - speed * lag) * jnp.exp(-dt / lag)
    after = jnp.clip(aim + speed * dt - later, servos.low, servos.high)
    held = ctrl[servos.hold] > 0
    after = jnp.where(held, after, before)
    rate = jnp.where(held, later / lag, 0.0)
    qpos, qvel = set_rows(state.qpos, (servos.qpos, after)), set_rows(state.qvel, (servos.qvel, rate))
    if len(servos.geared_qpos):
        first, second = servos.geared_qpos.T
        qpos = set_rows(qpos, (first, qpos[second]))
        first, second = servos.geared_qvel.T
        qvel = set_rows(qvel, (first, qvel[second]))
    return state.replace(qpos=qpos, qvel=qvel, act=set_rows(act, (servos.act, aim + speed * dt)))
