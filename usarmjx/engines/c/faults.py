"""Physics faults stay local: a control step that resets only the robots concerned.

A robot is faulty if a number of its state or inputs is not finite, or if its chassis is faster than it can
be. The control step is then repeated from its beginning, with the robots of that contact island reset to free
poses: robots outside the island move as if those had been there.

MuJoCo solves islands separately (unless `mjDSBL_ISLAND` is set), but decides for all at once whether to start
from the last accelerations. If others change that decision, a robot's motion differs by the solver's
residual; with `mjDSBL_WARMSTART` by no bit.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.engines.c.batch import INTEGRATION_STATE
from usarmjx.engines.c.placement import SEARCH_RADIUS, free_pose
from usarmjx.models.compile.compose import RobotIndex

SEARCH_RADII = (SEARCH_RADIUS, 3 * SEARCH_RADIUS, 9 * SEARCH_RADIUS)
"""Search radii for a free pose near an occupied home, in order [m]."""
PARKED_DISTANCE = 1000.0
"""Coordinate and spacing of robots that wait for their turn to be reset [m]."""

COMPONENT_SHARE = 0.57
"""A vector with no component above this share of a limit is shorter than it: less than the root of 1/3."""


@dataclass(frozen=True)
class RecoveryResult:
    """Objects that a control step has reset; false if there are none.

    Attributes:
        robots: Slots of robots.
        others: Body names of loose objects and doors.
    """

    robots: frozenset[int] = frozenset()
    others: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        """Return whether anything was reset."""
        return bool(self.robots or self.others)


def faulty_robots(
    data: mujoco.MjData, indices: Mapping[int, RobotIndex], limits: Mapping[int, float]
) -> frozenset[int]:
    """Return the slots of robots with non-finite state or inputs, or with too fast a chassis.

    Args:
        data: The world.
        indices: The robots, by slot.
        limits: Highest plausible speed of each robot [m/s].
    """
    bad = _fast_robots(data, indices, limits)
    if not _is_finite(*_state_and_inputs(data)):
        # Robot by robot only after the test of everything has failed, which is rare.
        bad |= {slot for slot, index in indices.items() if not _is_finite(*_robot_state(data, index))}
    return bad


def _fast_robots(
    data: mujoco.MjData, indices: Mapping[int, RobotIndex], limits: Mapping[int, float]
) -> frozenset[int]:
    """Return the slots of robots with too fast a chassis; arguments as for `faulty_robots`."""
    if not indices:
        return frozenset()
    velocity = data.qvel[_linear_dofs(tuple([index.root_dofadr for index in indices.values()]))]
    # No component is so large that a speed could reach the least of the limits: most steps end here.
    if np.abs(velocity).max() <= COMPONENT_SHARE * min(limits.values()):
        return frozenset()
    with np.errstate(invalid="ignore", over="ignore"):
        speed = np.sqrt(np.add.reduce(velocity * velocity, -1))
        # Negated, because NaN compares false.
        fast = ~(speed <= np.array([limits[slot] for slot in indices]))
    if not np.count_nonzero(fast):
        return frozenset()
    return frozenset(slot for slot, is_fast in zip(indices, fast.tolist(), strict=True) if is_fast)


@lru_cache(maxsize=64)
def _linear_dofs(firsts: tuple[int, ...]) -> np.ndarray:
    """Return the degrees of freedom of linear motion of bodies with those first ones (bodies, 3)."""
    return np.array(firsts)[:, None] + np.arange(3)


def step_and_recover(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    substeps: int,
    indices: Mapping[int, RobotIndex],
    limits: Mapping[int, float],
    homes: Mapping[int, Array],
) -> RecoveryResult:
    """Make one control step; faulty robots, and those that touch them, are reset and stand still.

    Faulty loose objects and doors are reset to the model's reference pose. A reset object ignores its inputs
    in this step: its actuators hold its joints at the reference pose.

    Args:
        model: The world; `mjDSBL_AUTORESET` must be set, or MuJoCo resets everything by itself.
        data: Its state, with the inputs of the control step.
        substeps: Physics steps.
        indices: The robots, by slot.
        limits: Highest plausible speed of each robot [m/s].
        homes: Home of each robot, its position, orientation and joints (7 + joints,); an occupied home is
            replaced by a near pose.
    """
    before = _saved(model, data)
    mujoco.mj_step(model, data, nstep=substeps)
    # The whole step at once first: substeps one by one are slower, and needed only to find what failed.
    if _is_finite(*_state_and_inputs(data)) and not _fast_robots(data, indices, limits):
        return RecoveryResult()
    recovery = _Recovery(model, data, indices, limits)
    gone: set[int] = set()
    while True:
        mujoco.mj_setState(model, data, before, INTEGRATION_STATE)
        bad = recovery.step(substeps)
        if not bad:
            break
        # A second fault of reset objects resets everything.
        found = bad - gone or set(range(model.ntree)) - gone
        mujoco.mj_setState(model, data, before, INTEGRATION_STATE)
        if not found:
            break
        recovery.reset_trees(found, homes)
        gone |= found
        # The next attempt begins with these trees reset.
        before = _saved(model, data)
    return recovery.report(gone)


def reset_all(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    indices: Mapping[int, RobotIndex],
    homes: Mapping[int, Array],
) -> None:
    """Reset robots, loose objects and doors to their homes, at rest; arguments as for `step_and_recover`."""
    recovery = _Recovery(model, data, indices, {})
    recovery.reset_trees(set(range(model.ntree)), homes)
    mujoco.mj_kinematics(model, data)


class _Recovery:
    """Kinematic trees of a world: their members, faults and contacts."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        indices: Mapping[int, RobotIndex],
        limits: Mapping[int, float],
    ) -> None:
        self._model, self._data, self._indices, self._limits = model, data, indices, limits
        self._slots = {int(model.body_treeid[index.body_ids[0]]): slot for slot, index in indices.items()}
        # Free joints have seven coordinates and six degrees of freedom: qpos needs a table of its own.
        widths = np.diff(np.append(model.jnt_qposadr, model.nq))
        self._qpos_tree = np.repeat(model.body_treeid[model.jnt_bodyid], widths)

    def step(self, substeps: int) -> set[int]:
        """Step until a fault; return the robots' trees of the faulty islands, and the other faulty trees."""
        # State and inputs may be bad before any substep: no step has computed contacts then.
        bad = self._bad()
        if bad:
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_collision(self._model, self._data)
            return self._affected_trees(bad)
        for _ in range(substeps):
            mujoco.mj_step(self._model, self._data)
            bad = self._bad()
            if bad:  # the contacts are still those of the faulty step
                return self._affected_trees(bad)
        return set()

    def _bad(self) -> set[int]:
        model, data = self._model, self._data
        robots = faulty_robots(data, self._indices, self._limits)
        bad = {tree for tree, slot in self._slots.items() if slot in robots}
        for values, trees in ((data.qpos, self._qpos_tree), (data.qvel, model.dof_treeid)):
            # Negated, because NaN compares false.
            bad |= set(trees[~(np.abs(values) <= mujoco.mjMAXVAL)].tolist())
        return bad

    def _affected_trees(self, bad: set[int]) -> set[int]:
        """Return the faulty trees and the robots that touch them, directly or through others."""
        trees = self._model.body_treeid[self._model.geom_bodyid[self._data.contact.geom]].reshape(-1, 2)
        # Fixed bodies (-1) join no islands.
        pairs = trees[(trees >= 0).all(-1)]
        island = np.isin(np.arange(self._model.ntree), list(bad))
        count = 0
        # Until nothing is added: contacts link robots in chains.
        while count != island.sum():
            count = island.sum()
            island[pairs[island[pairs].any(-1)]] = True
        return bad | {tree for tree in self._slots if island[tree]}

    def reset_trees(self, trees: set[int], homes: Mapping[int, Array]) -> None:
        """Reset trees to their homes, at rest."""
        model, data = self._model, self._data
        of_qpos, of_dof = np.isin(self._qpos_tree, list(trees)), np.isin(model.dof_treeid, list(trees))
        data.qpos[of_qpos] = model.qpos0[of_qpos]
        data.qvel[of_dof] = data.qacc_warmstart[of_dof] = 0.0
        data.xfrc_applied[np.isin(model.body_treeid, list(trees))] = 0.0
        robots = sorted(self._slots[tree] for tree in trees if tree in self._slots)
        for k, slot in enumerate(robots):
            index = self._indices[slot]
            # Pulling actuators off, holding ones on: the joints are held where they are put.
            data.act[list(index.actadr)] = data.ctrl[list(index.actuator_ids)] = 0.0
            data.ctrl[list(index.hold_actuator_ids)] = 1.0
            data.qpos[list(index.qposadr)] = homes[slot][7:]
            data.qpos[index.root_qposadr : index.root_qposadr + 3] = (
                PARKED_DISTANCE,
                k * PARKED_DISTANCE,
                PARKED_DISTANCE,
            )
        # Only after all are parked: a robot not yet reset would occupy the home of one that is.
        for slot in robots:
            start = self._indices[slot].root_qposadr
            data.qpos[start : start + 7] = self._free_home(slot, np.asarray(homes[slot], float))

    def _free_home(self, slot: int, home: np.ndarray) -> np.ndarray:
        no_floor = -np.inf  # it has stood there, a little below the floor, as contacts give way
        for reach in SEARCH_RADII:
            index, pos, quat = self._indices[slot], home[:3], home[3:7]
            pose = free_pose(self._model, self._data, index, pos, quat, no_floor, reach)
            if pose is not None:
                return np.concatenate(pose)
        # Nothing is free: an overlap that contacts push apart is better than a robot that is gone.
        return home[:7]

    def report(self, trees: set[int]) -> RecoveryResult:
        """Return the robots and bodies of these trees."""
        # The first body of a tree is its root.
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
    """Return whether all numbers are within MuJoCo's range of valid numbers."""
    # MuJoCo resets a world beyond it, so a larger number counts as a fault, too.
    most = mujoco.mjMAXVAL
    # The sum of squares is one quick call, and false if a number is not finite; most states end there.
    return all(
        np.vdot(values, values) <= most * most or np.abs(values).max(initial=0.0) <= most for values in arrays
    )


def _state_and_inputs(data: mujoco.MjData) -> tuple[np.ndarray, ...]:
    """Return state and inputs of a world."""
    return data.qpos, data.qvel, data.act, data.ctrl, data.xfrc_applied


def _robot_state(data: mujoco.MjData, index: RobotIndex) -> tuple[np.ndarray, ...]:
    """Return state and inputs of a robot."""
    q, v = index.root_qposadr, index.root_dofadr
    return (
        data.qpos[[*range(q, q + 7), *index.qposadr]],
        data.qvel[[*range(v, v + 6), *index.dofadr]],
        data.act[list(index.actadr)],
        data.ctrl[[*index.actuator_ids, *index.hold_actuator_ids]],
        data.xfrc_applied[list(index.body_ids)],
    )
