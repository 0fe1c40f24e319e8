"""Where a robot that joins a running world can stand: the free pose nearest to the one that was asked for.

A robot that starts inside a wall or another robot is thrown out by the solver, or tears the physics apart.
Poses are tried on a copy of the model in which only this robot touches anything.
"""

import math
from functools import cache

import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.models.compile.kinematic_tree import lowest_point
from usarmjx.models.compile.layout import RobotIndex

MAX_DEPTH = 0.005
"""How deep a robot may start in a solid of the arena [m]: resting contact, and heights that the wire rounds
to 1 cm. It may not start at any depth in what moves: robots, loose objects, doors."""
REACH = 1.0
"""How far a free pose may be from the one that was asked for [m]."""
RINGS = 10
"""Distances up to `REACH` that are tried on the plane."""
MAX_RAISE, RAISE = 0.3, 0.1
"""How far a robot is raised onto a ramp or a step at most, and in what steps [m]."""
HALVINGS = 5
"""How often the last step of a raise is halved, so that robots are put down and not dropped."""
MAX_DROP = 1.0
"""From how high a robot may not drop onto what moves, as onto one that was told the same pose [m]."""


def free_pose(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    index: RobotIndex,
    pos: Array,
    quat: Array,
    floor: float,
    reach: float = REACH,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the free pose of a robot nearest to the one asked for, which is returned bit for bit if free.

    The robot is raised onto the floor first, and keeps its orientation and its joints. To stand on ramps and
    steps it may be raised further.

    Args:
        model: The world; the robot is part of it.
        data: Where everything is; nothing in it changes. The robot may be anywhere.
        index: The robot.
        pos: Where its chassis' origin shall be [m] (3,).
        quat: Its orientation (4,).
        floor: No part of the robot may be lower than this [m].
        reach: How far from there it may be put [m]; 0: there or not at all.

    Returns:
        Position [m] (3,) and orientation (4,); None: nothing is free within reach.
    """
    probe = _Probe(model, data, index, quat)
    start = np.array(pos, float)
    start[2] += max(0.0, floor - probe.lowest_point(start))
    probe.restrict_contacts(start, reach)
    for offset in map(np.array, _offsets(reach)):
        if probe.is_free(start + offset) and not probe.drops_on_moving(start + offset):
            return start + probe.lowered(start, offset), np.array(quat, float)
    return None


@cache
def _offsets(reach: float) -> list[tuple[float, float, float]]:
    """Return by how much a pose is moved, the least first: rings on the plane, each raised step by step."""
    if not reach:
        return [(0.0, 0.0, 0.0)]
    spacing = reach / RINGS
    flat: dict[tuple[float, float], None] = {(0.0, 0.0): None}  # in order, each once
    for ring in range(1, RINGS + 1):
        count = max(8, round(2 * math.pi * ring))
        for k in range(count):
            angle = 2 * math.pi * k / count
            flat[ring * spacing * math.cos(angle), ring * spacing * math.sin(angle)] = None
    raises = [RAISE * k for k in range(round(MAX_RAISE / RAISE) + 1)]
    every = [(x, y, raised) for x, y in flat for raised in raises]
    # Rounded, as rings and their outermost distance count as one whatever sine and cosine make of them.
    within = [offset for offset in every if round(math.hypot(*offset), 9) <= reach]
    return sorted(within, key=lambda offset: round(math.hypot(*offset), 9))


class _Probe:
    """A copy of a world in which one robot is put here and there, to see what it touches."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, index: RobotIndex, quat: Array) -> None:
        self._model, self._data = model.__copy__(), mujoco.MjData(model)
        self._own = np.isin(model.geom_bodyid, index.body_ids)
        self._moving = (model.body_treeid[model.geom_bodyid] >= 0) & ~self._own
        self._root = index.root_qposadr
        self._data.qpos[:] = data.qpos
        self._data.mocap_pos[:], self._data.mocap_quat[:] = data.mocap_pos, data.mocap_quat
        self._data.qpos[self._root + 3 : self._root + 7] = quat

    def _put(self, pos: np.ndarray) -> None:
        self._data.qpos[self._root : self._root + 3] = pos
        mujoco.mj_kinematics(self._model, self._data)

    def lowest_point(self, pos: np.ndarray) -> float:
        """Return the height of the robot's lowest point with its origin there [m]."""
        self._put(pos)
        return lowest_point(self._model, self._data, self._own)

    def restrict_contacts(self, pos: np.ndarray, reach: float) -> None:
        """Let only the robot touch, and only what it can touch with its origin within reach of there [m]."""
        self._put(pos)
        model, own = self._model, self._own
        radius = np.where(model.geom_rbound > 0, model.geom_rbound, np.inf)  # planes have none
        away = np.linalg.norm(self._data.geom_xpos - pos, axis=-1)
        furthest = max(reach, MAX_DROP + MAX_RAISE) + (away + radius)[own].max()
        near = ~own & (away - radius <= furthest)
        # A geom of the robot has contype alone and the others conaffinity alone, each both of theirs: whoever
        # touched the robot still does, and nobody else anybody.
        contype, conaffinity = model.geom_contype.copy(), model.geom_conaffinity.copy()
        model.geom_contype[:] = np.where(own, contype | conaffinity << 16, 0)
        model.geom_conaffinity[:] = np.where(near, conaffinity | contype << 16, 0)
        for bits, of_body in (
            (model.geom_contype, model.body_contype),
            (model.geom_conaffinity, model.body_conaffinity),
        ):
            of_body[:] = 0
            np.bitwise_or.at(of_body, model.geom_bodyid, bits)

    def _touches(self, pos: np.ndarray) -> tuple[bool, bool]:
        """Return whether the robot with its origin there is in something fixed, and in what moves."""
        self._put(pos)
        mujoco.mj_collision(self._model, self._data)
        if not self._data.ncon:
            return False, False
        depth, moving = -self._data.contact.dist, self._moving[self._data.contact.geom].any(-1)
        return bool((depth[~moving] > MAX_DEPTH).any()), bool((depth[moving] > 0).any())

    def is_free(self, pos: np.ndarray) -> bool:
        """Return whether the robot touches nothing with its origin there, but rests at most."""
        return not any(self._touches(pos))

    def drops_on_moving(self, pos: np.ndarray) -> bool:
        """Return whether what the robot would soon land on, let go there, is something that moves."""
        for k in range(1, round(MAX_DROP / RAISE) + 1):
            fixed, moving = self._touches(pos - (0.0, 0.0, k * RAISE))
            if fixed or moving:
                return not fixed
        return False

    def lowered(self, start: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return an offset that is free with the robot raised no further than it need be [m] (3,)."""
        free, step = offset, np.array([0.0, 0.0, RAISE])
        for _ in range(HALVINGS if offset[2] else 0):
            step = step / 2
            free = free - step if self.is_free(start + free - step) else free
        return free
