"""Faults of the physics that stay where they arise: a control step that puts back only the robots concerned.

A robot goes bad when a number of its state or inputs is no number any more, or when its chassis is faster
than it can be. Then the control step is made again from where it began, with the robots of that contact
island back at poses known to be free: whoever does not touch them moves as if they had been there.

MuJoCo solves islands apart (unless `mjDSBL_ISLAND` is set), but decides for all at once whether to start from
the last accelerations. Where others turn that decision, a robot's way differs by what the solver leaves
unsolved; with `mjDSBL_WARMSTART` not by a bit.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.engines.c.batch import INTEGRATION_STATE
from usarmjx.engines.c.placement import REACH, free_pose
from usarmjx.models.compile.layout import RobotIndex

REACHES = (REACH, 3 * REACH, 9 * REACH)
"""How far from its home a robot is put while somebody else stands there [m]."""
FAR = 1000.0
"""Where robots wait until it is their turn to be put back, and how far from each other [m]."""


@dataclass(frozen=True)
class RecoveryResult:
    """What a control step has put back; false if nothing.

    Attributes:
        robots: Slots of robots.
        others: Names of the bodies of loose objects and doors.
    """

    robots: frozenset[int] = frozenset()
    others: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        """Return whether something was put back."""
        return bool(self.robots or self.others)


def bad_robots(
    data: mujoco.MjData, indices: Mapping[int, RobotIndex], limits: Mapping[int, float]
) -> frozenset[int]:
    """Return the slots of robots whose state or inputs are not finite or whose chassis is too fast.

    Args:
        data: The world.
        indices: The robots, by slot.
        limits: Up to which speed a robot is sound [m/s].
    """
    bad = _fast_robots(data, indices, limits)
    if not _is_finite(*_everything(data)):
        bad |= {slot for slot, index in indices.items() if not _is_finite(*_own(data, index))}
    return bad


def _fast_robots(
    data: mujoco.MjData, indices: Mapping[int, RobotIndex], limits: Mapping[int, float]
) -> frozenset[int]:
    """Return the slots of robots whose chassis is too fast; arguments are those of `bad_robots`."""
    if not indices:
        return frozenset()
    dof = np.array([index.root_dofadr for index in indices.values()])[:, None] + np.arange(3)
    with np.errstate(invalid="ignore", over="ignore"):
        speed = np.linalg.norm(data.qvel[dof], axis=-1)
        # Negated, as what is no number compares false.
        fast = ~(speed <= np.array([limits[slot] for slot in indices]))
    return frozenset(slot for slot, is_fast in zip(indices, fast.tolist(), strict=True) if is_fast)


def step_and_recover(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    substeps: int,
    indices: Mapping[int, RobotIndex],
    limits: Mapping[int, float],
    homes: Mapping[int, Array],
    floor: float,
) -> RecoveryResult:
    """Make one control step; robots that go bad, and those that touch them, are put back and stand still.

    Loose objects and doors that go bad are put where the model has them. What was put back has heard nothing
    of its inputs in this step: its actuators hold its joints where the model has them.

    Args:
        model: The world; `mjDSBL_AUTORESET` must be set, or MuJoCo resets all by itself.
        data: Its state, with the inputs of the control step.
        substeps: Steps of MuJoCo.
        indices: The robots, by slot.
        limits: Up to which speed a robot is sound [m/s].
        homes: Position and orientation (7,) to which each robot is put back, or near to which, if somebody
            else is there.
        floor: No part of a robot is put lower than this [m].
    """
    before = _saved(model, data)
    mujoco.mj_step(model, data, nstep=substeps)
    if _is_finite(*_everything(data)) and not _fast_robots(data, indices, limits):
        return RecoveryResult()
    recovery = _Recovery(model, data, indices, limits)
    gone: set[int] = set()
    while True:
        mujoco.mj_setState(model, data, before, INTEGRATION_STATE)
        bad = recovery.step(substeps)
        if not bad:
            break
        # Should they go bad again where they were put, everything goes back.
        found = bad - gone or set(range(model.ntree)) - gone
        mujoco.mj_setState(model, data, before, INTEGRATION_STATE)
        if not found:
            break
        recovery.put_back(found, homes, floor)
        gone |= found
        before = _saved(model, data)
    return recovery.report(gone)


def put_all_back(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    indices: Mapping[int, RobotIndex],
    homes: Mapping[int, Array],
    floor: float,
) -> None:
    """Put robots, loose objects and doors where they belong, at rest; arguments are `step_and_recover`'s."""
    recovery = _Recovery(model, data, indices, {})
    recovery.put_back(set(range(model.ntree)), homes, floor)
    mujoco.mj_kinematics(model, data)


class _Recovery:
    """Kinematic trees of a world: what is in which, which are bad, which touch."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        indices: Mapping[int, RobotIndex],
        limits: Mapping[int, float],
    ) -> None:
        self._model, self._data, self._indices, self._limits = model, data, indices, limits
        self._slots = {int(model.body_treeid[index.body_ids[0]]): slot for slot, index in indices.items()}
        widths = np.diff(np.append(model.jnt_qposadr, model.nq))
        self._qpos_tree = np.repeat(model.body_treeid[model.jnt_bodyid], widths)

    def step(self, substeps: int) -> set[int]:
        """Step until something goes bad; return the robots' trees of its islands, and the other bad ones."""
        bad = self._bad()
        if bad:
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_collision(self._model, self._data)
            return self._concerned(bad)
        for _ in range(substeps):
            mujoco.mj_step(self._model, self._data)
            bad = self._bad()
            if bad:  # contacts are still those from which the step was computed
                return self._concerned(bad)
        return set()

    def _bad(self) -> set[int]:
        model, data = self._model, self._data
        robots = bad_robots(data, self._indices, self._limits)
        bad = {tree for tree, slot in self._slots.items() if slot in robots}
        for values, trees in ((data.qpos, self._qpos_tree), (data.qvel, model.dof_treeid)):
            bad |= set(trees[~(np.abs(values) <= mujoco.mjMAXVAL)].tolist())
        return bad

    def _concerned(self, bad: set[int]) -> set[int]:
        """Return the bad trees and the robots that touch them, directly or through others."""
        trees = self._model.body_treeid[self._model.geom_bodyid[self._data.contact.geom]].reshape(-1, 2)
        pairs = trees[(trees >= 0).all(-1)]
        island = np.isin(np.arange(self._model.ntree), list(bad))
        count = 0
        while count != island.sum():
            count = island.sum()
            island[pairs[island[pairs].any(-1)]] = True
        return bad | {tree for tree in self._slots if island[tree]}

    def put_back(self, trees: set[int], homes: Mapping[int, Array], floor: float) -> None:
        """Put trees where they belong, at rest."""
        model, data = self._model, self._data
        of_qpos, of_dof = np.isin(self._qpos_tree, list(trees)), np.isin(model.dof_treeid, list(trees))
        data.qpos[of_qpos] = model.qpos0[of_qpos]
        data.qvel[of_dof] = data.qacc_warmstart[of_dof] = 0.0
        data.xfrc_applied[np.isin(model.body_treeid, list(trees))] = 0.0
        robots = sorted(self._slots[tree] for tree in trees if tree in self._slots)
        for k, slot in enumerate(robots):
            index = self._indices[slot]
            data.act[list(index.actadr)] = data.ctrl[list(index.actuator_ids)] = 0.0
            data.ctrl[list(index.hold_actuator_ids)] = 1.0
            data.qpos[index.root_qposadr : index.root_qposadr + 3] = (FAR, k * FAR, FAR)
        for slot in robots:
            start = self._indices[slot].root_qposadr
            data.qpos[start : start + 7] = self._free_home(slot, np.asarray(homes[slot], float), floor)

    def _free_home(self, slot: int, home: np.ndarray, floor: float) -> np.ndarray:
        for reach in REACHES:
            index, pos, quat = self._indices[slot], home[:3], home[3:]
            pose = free_pose(self._model, self._data, index, pos, quat, floor, reach)
            if pose is not None:
                return np.concatenate(pose)
        return home

    def report(self, trees: set[int]) -> RecoveryResult:
        """Return what these trees are."""
        roots = {tree: int(np.argmax(self._model.body_treeid == tree)) for tree in trees - self._slots.keys()}
        return RecoveryResult(
            robots=frozenset(self._slots[tree] for tree in trees if tree in self._slots),
            others=tuple(self._model.body(roots[tree]).name for tree in sorted(roots)),
        )


def _saved(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    state = np.empty(mujoco.mj_stateSize(model, INTEGRATION_STATE))
    mujoco.mj_getState(model, data, state, INTEGRATION_STATE)
    return state


def _is_finite(*arrays: np.ndarray) -> bool:
    """Return whether all numbers are what MuJoCo takes for numbers."""
    return all(np.abs(values).max(initial=0.0) <= mujoco.mjMAXVAL for values in arrays)


def _everything(data: mujoco.MjData) -> tuple[np.ndarray, ...]:
    """Return the state and the inputs of a world."""
    return data.qpos, data.qvel, data.act, data.ctrl, data.xfrc_applied


def _own(data: mujoco.MjData, index: RobotIndex) -> tuple[np.ndarray, ...]:
    """Return the state and the inputs of a robot."""
    q, v = index.root_qposadr, index.root_dofadr
    return (
        data.qpos[[*range(q, q + 7), *index.qposadr]],
        data.qvel[[*range(v, v + 6), *index.dofadr]],
        data.act[list(index.actadr)],
        data.ctrl[[*index.actuator_ids, *index.hold_actuator_ids]],
        data.xfrc_applied[list(index.body_ids)],
    )
