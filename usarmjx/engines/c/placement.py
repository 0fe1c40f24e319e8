"""Free poses for robots that join a running world: the nearest one to the requested pose.

A robot that starts inside a wall or another robot is thrown out by the solver, or makes the physics diverge.
Poses are tested on a copy of the model in which only this robot collides.
"""

import math
from functools import cache

import mujoco
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.models.compile.compose import RobotIndex
from usarmjx.models.compile.kinematic_tree import lowest_point

MAX_PENETRATION = 0.005
"""Largest initial penetration of an arena solid [m]: resting contact, and heights that the wire rounds to 1
cm. No penetration of movable bodies (robots, loose objects, doors) is allowed."""
SEARCH_RADIUS = 1.0
"""Search radius around the requested pose [m]."""
SEARCH_RINGS = 10
"""Number of search rings on the plane within `SEARCH_RADIUS`."""
MAX_RAISE, RAISE_STEP = 0.3, 0.1
"""Largest raise of a robot onto a ramp or step, and its increment [m]."""
HALVINGS = 5
"""Bisections of the last raise, so that robots are set down instead of dropped."""
MAX_DROP = 1.0
"""Height from which a robot must not drop onto a movable body, such as a robot at the same requested pose
[m]."""


def free_pose(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    index: RobotIndex,
    pos: Array,
    quat: Array,
    floor: float,
    reach: float = SEARCH_RADIUS,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the free pose of a robot nearest to the requested one, which is returned bit for bit if free.

    The robot is first raised onto the floor, and keeps its orientation and joints. It may be raised further
    onto ramps and steps.

    Args:
        model: The world; the robot is part of it.
        data: State of the world; not changed. The robot's own position is irrelevant.
        index: The robot.
        pos: Requested position of the chassis origin [m] (3,).
        quat: Its orientation (4,).
        floor: Lowest height of any part of the robot [m].
        reach: Search radius [m]; 0: only the requested pose.

    Returns:
        Position [m] (3,) and orientation (4,); None: no free pose within reach.
    """
    probe = _Probe(model, data, index, quat)
    start = np.array(pos, float)
    # Only ever raised: a pose above the floor is what the caller asked for.
    start[2] += max(0.0, floor - probe.lowest_point(start))
    probe.restrict_contacts(start, reach)
    for offset in map(np.array, _offsets(reach)):
        if probe.is_free(start + offset) and not probe.lands_on_moving(start + offset):
            return start + probe.lowered(start, offset), np.array(quat, float)
    return None


def deepest_contact(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> float:
    """Return how deep a body is in others [m]; 0 if it touches none.

    Args:
        model: The world.
        data: State of the world; not changed.
        body: Number of the body.
    """
    probe = mujoco.MjData(model)
    probe.qpos[:], probe.mocap_pos[:], probe.mocap_quat[:] = data.qpos, data.mocap_pos, data.mocap_quat
    mujoco.mj_kinematics(model, probe)
    mujoco.mj_collision(model, probe)
    if not probe.ncon:
        return 0.0
    of_body = (model.geom_bodyid[probe.contact.geom] == body).any(-1)
    return float(-probe.contact.dist[of_body].min(initial=0.0))


@cache
def _offsets(reach: float) -> list[tuple[float, float, float]]:
    """Return the offsets to try, nearest first: rings on the plane, each with all raises."""
    if not reach:
        return [(0.0, 0.0, 0.0)]
    spacing = reach / SEARCH_RINGS
    # A dictionary, as a set in order.
    flat: dict[tuple[float, float], None] = {(0.0, 0.0): None}
    for ring in range(1, SEARCH_RINGS + 1):
        # As far apart along a ring as the rings are.
        count = max(8, round(2 * math.pi * ring))
        for k in range(count):
            angle = 2 * math.pi * k / count
            flat[ring * spacing * math.cos(angle), ring * spacing * math.sin(angle)] = None
    raises = [RAISE_STEP * k for k in range(round(MAX_RAISE / RAISE_STEP) + 1)]
    every = [(x, y, raised) for x, y in flat for raised in raises]
    # Rounded, so that offsets of a ring tie despite rounding of sine and cosine, and the last ring counts.
    within = [offset for offset in every if round(math.hypot(*offset), 9) <= reach]
    return sorted(within, key=lambda offset: round(math.hypot(*offset), 9))


class _Probe:
    """Copy of a world in which one robot is moved to test for contacts."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, index: RobotIndex, quat: Array) -> None:
        # A copy, as the masks of its geoms are changed below.
        self._model, self._data = model.__copy__(), mujoco.MjData(model)
        self._is_own = np.isin(model.geom_bodyid, index.body_ids)
        self._moving = (model.body_treeid[model.geom_bodyid] >= 0) & ~self._is_own
        self._root = index.root_qposadr
        # Its own data: contacts of the probe must not reach the next step's warm start.
        self._data.qpos[:] = data.qpos
        # Mocap bodies have no qpos.
        self._data.mocap_pos[:], self._data.mocap_quat[:] = data.mocap_pos, data.mocap_quat
        self._data.qpos[self._root + 3 : self._root + 7] = quat

    def _put(self, pos: np.ndarray) -> None:
        self._data.qpos[self._root : self._root + 3] = pos
        mujoco.mj_kinematics(self._model, self._data)

    def lowest_point(self, pos: np.ndarray) -> float:
        """Return the height of the robot's lowest point with its origin at `pos` [m]."""
        self._put(pos)
        return lowest_point(self._model, self._data, self._is_own)

    def restrict_contacts(self, pos: np.ndarray, reach: float) -> None:
        """Let only the robot collide, and only with geoms that it can reach from `pos` [m]."""
        self._put(pos)
        model, own = self._model, self._is_own
        radius = np.where(model.geom_rbound > 0, model.geom_rbound, np.inf)  # planes have none
        away = np.linalg.norm(self._data.geom_xpos - pos, axis=-1)
        # Everything that any probe can touch: other geoms are left out of all collision tests.
        furthest = max(reach, MAX_DROP + MAX_RAISE) + (away + radius)[own].max()
        near = ~own & (away - radius <= furthest)
        # Robot geoms get only contype and the others only conaffinity, each the union of both bit sets (in
        # separate halves): every pair with the robot still collides, and no other pair does.
        contype, conaffinity = model.geom_contype.copy(), model.geom_conaffinity.copy()
        model.geom_contype[:] = np.where(own, contype | conaffinity << 16, 0)
        model.geom_conaffinity[:] = np.where(near, conaffinity | contype << 16, 0)
        # MuJoCo tests the bodies' masks first, which the compiler made from the geoms'.
        for bits, of_body in (
            (model.geom_contype, model.body_contype),
            (model.geom_conaffinity, model.body_conaffinity),
        ):
            of_body[:] = 0
            np.bitwise_or.at(of_body, model.geom_bodyid, bits)

    def _touches(self, pos: np.ndarray) -> tuple[bool, bool]:
        """Return whether the robot with its origin at `pos` penetrates a fixed and a movable body."""
        self._put(pos)
        mujoco.mj_collision(self._model, self._data)
        if not self._data.ncon:
            return False, False
        depth, moving = -self._data.contact.dist, self._moving[self._data.contact.geom].any(-1)
        return bool((depth[~moving] > MAX_PENETRATION).any()), bool((depth[moving] > 0).any())

    def is_free(self, pos: np.ndarray) -> bool:
        """Return whether the robot with its origin at `pos` has at most resting contacts."""
        return not any(self._touches(pos))

    def lands_on_moving(self, pos: np.ndarray) -> bool:
        """Return whether the robot, released at `pos`, would land on a movable body."""
        for k in range(1, round(MAX_DROP / RAISE_STEP) + 1):
            fixed, moving = self._touches(pos - (0.0, 0.0, k * RAISE_STEP))
            if fixed or moving:
                # Fixed ground at the same height carries it, whatever else it touches there.
                return not fixed
        return False

    def lowered(self, start: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return a free offset with the smallest raise [m] (3,)."""
        free, step = offset, np.array([0.0, 0.0, RAISE_STEP])
        for _ in range(HALVINGS if offset[2] else 0):
            step = step / 2
            # Bisection: each half is taken if the robot is still free there.
            free = free - step if self.is_free(start + free - step) else free
        return free
