"""Joint trajectories of ROS: JointTrajectory in, positions of joints at a time out."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.models.compile.kinematic_tree import KinematicTree
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.definitions import RosMessage, json_object

MOST_POINTS = 10_000
"""Most points of a trajectory."""


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Positions of joints over time.

    Attributes:
        joints: Their names on the robot.
        times: Times of the points since the start, rising [s] (points,).
        positions: Positions at the points [rad or m] (points, joints).
        velocities: Velocities there [rad/s or m/s] (points, joints); None: positions change linearly.
        start: Time of the start [s]; 0: at once.
    """

    joints: tuple[str, ...]
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None = None
    start: float = 0.0


@dataclass(eq=False)
class TrajectoryRun:
    """A trajectory that a robot follows.

    Attributes:
        trajectory: The trajectory.
        start: Simulated time of its start [s].
        before: Positions at the start [rad or m] (joints,).
    """

    trajectory: JointTrajectory
    start: float
    before: np.ndarray = field(repr=False)

    def is_over(self, now: float) -> bool:
        """Return whether its last point has passed at a time [s]."""
        return now - self.start >= self.trajectory.times[-1]

    def at(self, now: float) -> dict[str, float]:
        """Return the joints' positions at a time [s], by their names.

        Between two points they follow a line, or the cubic with the velocities of both points.
        """
        path = self.trajectory
        times = np.concatenate(([0.0], path.times))
        knots = np.concatenate((self.before[None], path.positions))
        time = min(max(now - self.start, 0.0), float(times[-1]))
        after = min(max(int(np.searchsorted(times, time, side="right")), 1), len(times) - 1)
        span = float(times[after] - times[after - 1])
        share = (time - float(times[after - 1])) / span if span > 0.0 else 1.0
        low, high = knots[after - 1], knots[after]
        values = low + share * (high - low)
        if path.velocities is not None and span > 0.0:
            # Hermite's cubic; the joints stand still before the first point.
            speeds = np.concatenate((np.zeros_like(self.before)[None], path.velocities))
            bend_low = speeds[after - 1] * span - (high - low)
            bend_high = (high - low) - speeds[after] * span
            values = values + share * (1 - share) * ((1 - share) * bend_low + share * bend_high)
        return dict(zip(path.joints, values.tolist(), strict=True))


def read_trajectory(message: object, plan: KinematicTree) -> JointTrajectory | None:
    """Return the trajectory of a message for a robot; None for one without points, which stops the robot.

    Raises:
        UsageError: It is no trajectory, or not one for this robot.
    """
    whole = json_object(message)
    if whole is None:
        raise UsageError("a trajectory_msgs/JointTrajectory has joint_names and points")
    points = _list(whole, "points")
    if not points:
        return None
    joints = tuple(_joint(name, plan) for name in _list(whole, "joint_names"))
    if not joints:
        raise UsageError("joint_names of a trajectory_msgs/JointTrajectory is empty")
    if len(set(joints)) < len(joints):
        raise UsageError("joint_names of a trajectory_msgs/JointTrajectory names a joint twice")
    if len(points) > MOST_POINTS:
        raise UsageError(f"a trajectory has at most {MOST_POINTS} points, not {len(points)}")
    read = [json_object(point) or {} for point in points]
    times = np.array([_seconds(point.get("time_from_start")) for point in read])
    if times[0] < 0.0 or (np.diff(times) <= 0.0).any():
        raise UsageError("time_from_start of a trajectory's points must rise, from 0 on")
    positions = np.array([_numbers(point, "positions", len(joints)) for point in read])
    has_speeds = all(point.get("velocities") for point in read)
    speeds = np.array([_numbers(point, "velocities", len(joints)) for point in read]) if has_speeds else None
    header = json_object(whole.get("header")) or {}
    return JointTrajectory(joints, times, positions, speeds, _seconds(header.get("stamp")))


def _joint(name: object, plan: KinematicTree) -> str:
    index = plan.joint_index(name) if isinstance(name, str) else None
    if index is None:
        raise UsageError(
            f"{plan.robot.name} has no joint {clip(str(name))}; it has: {', '.join(plan.parts[1:])}"
        )
    return plan.parts[1 + index]


def _list(message: RosMessage, key: str) -> Sequence[Any]:
    values = message.get(key, [])
    if not isinstance(values, list):
        raise UsageError(f"{key} of a trajectory_msgs/JointTrajectory is no list")
    return cast(list[Any], values)


def _numbers(point: Mapping[str, Any], key: str, count: int) -> list[float]:
    values = point.get(key, [])
    items = cast(list[Any], values) if isinstance(values, list) else []
    if len(items) != count or not all(type(one) in (int, float) and math.isfinite(one) for one in items):
        raise UsageError(f"{key} of a trajectory's point are {count} finite numbers, one for each joint")
    return [float(one) for one in items]


def _seconds(time: object) -> float:
    """Return a time or duration of either version [s]; 0 without one."""
    parts = json_object(time) or {}
    whole, rest = parts.get("sec", parts.get("secs", 0)), parts.get("nanosec", parts.get("nsecs", 0))
    if type(whole) is not int or type(rest) is not int:
        raise UsageError("a time has whole numbers sec and nanosec")
    return whole + rest * 1e-9
