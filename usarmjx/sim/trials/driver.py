"""One robot in an arena, driven along points by who knows where it is."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.arenas.lanes import MobilityLane
from usarmjx.models.drives.steering import drive_values
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import Position2D
from usarmjx.sim.control import CommandUpdate, idle_command, update_command
from usarmjx.sim.scene import build_scene, start_height
from usarmjx.sim.single_world import SingleWorld

Posture = Callable[[float], dict[str, float]]
"""From the pitch [rad], nose up positive, to angles of joints [rad]."""
FRONT, REAR = ("FRFlipper", "FLFlipper"), ("RRFlipper", "RLFlipper")
FRONT_RAISED_ANGLE = -0.6
"""Front flippers on level ground: tips up, to get onto what is ahead [rad]."""
MAX_PITCH = 0.6
"""Pitch from which on flippers do not move further [rad]."""


def crawl_posture(pitch: float) -> dict[str, float]:
    """Return flippers that are up ahead on level ground, flat in front and pressed down behind in a climb."""
    climb = min(max(pitch, 0.0), MAX_PITCH)
    return dict.fromkeys(FRONT, FRONT_RAISED_ANGLE + climb) | dict.fromkeys(REAR, -0.8 * climb)


def flipper_posture(robot: RobotSpec) -> Posture | None:
    """Return the function that sets a class's flippers; None: it has none."""
    return crawl_posture if {*FRONT, *REAR} <= {part.name for part in robot.parts} else None


ARRIVAL_DISTANCE = 0.25
"""Distance from a waypoint at which a robot has reached it [m]."""
STEERING_GAIN = 2.0
"""Steering for each radian that its heading is off."""
COMMAND_DURATION = 0.1
"""Duration of a command [s]."""
STUCK_TIMEOUT = 10.0
"""Time without progress after which a robot counts as stuck [s]."""
MIN_PROGRESS = 0.05
"""Nearer than this is nearer [m]."""
BACK_OFF_TIME = 1.5
"""Time for which a stuck robot drives back before it tries once more [s]."""
TIP_OVER_COS = math.cos(math.radians(80))
"""Least cosine of the tilt at which a robot is upright."""


@dataclass(frozen=True)
class DriveRun:
    """Result of a drive along a path.

    Attributes:
        reached: Points that it got to.
        seconds: Simulated time that it took [s].
        fault: "" if it got to all of them, else what stopped it.
    """

    reached: int
    seconds: float
    fault: str = ""


class Trial:
    """A robot alone in an arena.

    Args:
        arena: The arena.
        robot: Its class, which drives on the ground.
        share: Share of its top speed at which it is driven.

    Raises:
        UsageError: The class does not drive on the ground, or has no room at the first start pose.
    """

    def __init__(self, arena: ArenaSpec, robot: RobotSpec, share: float = 1.0) -> None:
        if robot.drive.steering not in ("SkidSteered", "AckermanSteered", "OmniDrive"):
            raise UsageError(f"a {robot.name} is not steered on the ground: no lane is for it")
        self._arena, self._robot, self._share = arena, robot, share
        self._posture = flipper_posture(robot)
        self._keys = robot.drive.full_scale
        self.world = SingleWorld(build_scene(arena, []), seats=1)
        self._period = self.world.scene.physics.period
        self._slot = self.world.add(robot, robot.name, [self._pose_at(arena.starts[0])])

    def _pose_at(self, start: StartPose) -> tuple[tuple[float, float, float], np.ndarray]:
        x, y, _ = start.at
        turned = np.array(quat_from_angles(0.0, 0.0, start.yaw))
        return (x, y, start_height(self._arena, start, self._robot)), turned

    def reset_to(self, start: StartPose) -> None:
        """Put the robot onto a start pose, at rest."""
        self.world.reset()
        pos, quat = self._pose_at(start)
        self.world.engine.place(self._index, np.array(pos), quat)

    @property
    def _index(self):  # noqa: ANN202 - a RobotIndex
        group, member = self.world.scene.group_of(self._slot)
        return self.world.scene.groups[group].indices[member]

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Return position [m] (3,) and orientation (3, 3) of the robot."""
        pose, mat = self.world.engine.pose(self._index), np.zeros(9)
        mujoco.mju_quat2Mat(mat, pose[3:])
        return pose[:3], mat.reshape(3, 3)

    def command(self, ahead: float, left: float, pitch: float = 0.0) -> None:
        """Tell the robot to drive, as shares of its speed, with its flippers as its pitch [rad] asks for."""
        scene = self.world.scene
        group, _ = scene.group_of(self._slot)
        drive = drive_values(self._keys, ahead, left, 0.0, self._share)
        update = CommandUpdate(drive=drive, joints=self._posture(pitch) if self._posture else {})
        with numpy_backend():
            robot_command = update_command(scene.groups[group].plan, idle_command(self._robot), update)
        self.world.edit(self._slot, command=robot_command)

    def advance(self, seconds: float) -> bool:
        """Let time pass; return whether the physics stayed sound."""
        # A list: on a generator `any` would stop stepping at the first fault.
        return not any([bool(self.world.step()) for _ in range(round(seconds / self._period))])

    def follow(
        self, path: Sequence[Position2D], seconds: float, arrival_distance: float = ARRIVAL_DISTANCE
    ) -> DriveRun:
        """Drive along points for a time at most [s]; the driver backs off once where it is stuck."""
        began, reached, retried = self.world.time, 0, False
        closest, progress_time = math.inf, began
        while reached < len(path):
            pos, mat = self.pose()
            now = self.world.time
            if mat[2, 2] < TIP_OVER_COS:
                return DriveRun(reached, now - began, f"turned over at {_format_position(pos)}")
            offset = np.subtract(path[reached], pos[:2])
            distance = float(np.linalg.norm(offset))
            if distance < arrival_distance:
                reached, closest, progress_time, retried = reached + 1, math.inf, now, False
                continue
            if distance < closest - MIN_PROGRESS:
                closest, progress_time = distance, now
            if now - began >= seconds:
                return DriveRun(reached, now - began, f"out of time at {_format_position(pos)}")
            if now - progress_time > STUCK_TIMEOUT:
                if retried:
                    return DriveRun(reached, now - began, f"stuck at {_format_position(pos)}")
                retried, progress_time = True, now
                self.command(-1.0, 0.0)
                self.advance(BACK_OFF_TIME)
                continue
            self._steer(offset, mat)
            if not self.advance(COMMAND_DURATION):
                return DriveRun(reached, self.world.time - began, f"was recovered at {_format_position(pos)}")
        return DriveRun(reached, self.world.time - began)

    def _steer(self, offset: np.ndarray, mat: np.ndarray) -> None:
        """Head for a point that lies `offset` [m] (2,), slower ahead the sharper the turn."""
        forward = mat[:2, 0]
        error = math.atan2(forward[0] * offset[1] - forward[1] * offset[0], float(forward @ offset))
        turn = max(-1.0, min(1.0, STEERING_GAIN * error))
        ahead = max(0.0, 1.0 - abs(turn) / 2) if abs(error) < math.pi / 3 else 0.0
        self.command(ahead, turn, math.asin(max(-1.0, min(1.0, float(mat[2, 0])))))

    def stop(self) -> None:
        """Let the robot come to rest."""
        self.command(0.0, 0.0)
        self.advance(0.5)


def _format_position(pos: np.ndarray) -> str:
    return f"{pos[0]:.2f}, {pos[1]:.2f}"


MAX_FAULTS = 3
"""Faults after which a test ends."""


@dataclass(frozen=True)
class LaneScore:
    """Result of a robot in a lane.

    Attributes:
        lane: The lane.
        robot: Name of its class.
        seconds: Simulated time that counted [s].
        repetitions: Traverses with the whole robot from one end to the other; there and back in lanes where
            that is one.
        faults: Reasons why traverses did not count; after each the robot starts again.
    """

    lane: MobilityLane
    robot: str
    seconds: float
    repetitions: int
    faults: tuple[str, ...] = ()

    @property
    def per_minute(self) -> float:
        """Repetitions per minute."""
        return 60.0 * self.repetitions / self.seconds if self.seconds else 0.0

    @property
    def metres_per_minute(self) -> float:
        """Length of lane in counted repetitions, per minute [m/min]."""
        return self.per_minute * self.lane.length * (2 if self.lane.round_trip else 1)

    def __str__(self) -> str:
        """Return the score as a line."""
        return (
            f"{self.lane.arena.name} ({self.lane.method}), {self.robot}: {self.repetitions} repetitions in "
            f"{self.seconds / 60:.1f} min, {self.per_minute:.2f}/min, {self.metres_per_minute:.2f} m/min, "
            f"{len(self.faults)} faults"
        )


def run_lane(
    lane: MobilityLane,
    robot: RobotSpec,
    minutes: float = 5.0,
    share: float = 1.0,
    max_repetitions: int | None = None,
) -> LaneScore:
    """Drive a robot to and fro in a lane and return its score.

    Args:
        lane: The lane.
        robot: The robot's class.
        minutes: Duration [min].
        share: Share of its top speed.
        max_repetitions: Repetitions after which the test is over; None: only time ends it.

    Raises:
        UsageError: The class does not drive on the ground.
    """
    trial, starts = Trial(lane.arena, robot, share), lane.arena.starts
    faults: list[str] = []
    remaining, traverses, end = 60.0 * minutes, 0, 0
    legs = 2 if lane.round_trip else 1
    while (
        remaining > 0
        and len(faults) < MAX_FAULTS
        and (max_repetitions is None or traverses // legs < max_repetitions)
    ):
        run = trial.follow(lane.way(back=bool(end)), remaining)
        remaining -= run.seconds
        if not run.fault:
            traverses, end = traverses + 1, 1 - end
            continue
        if remaining <= 0:
            break
        faults.append(run.fault)
        traverses -= traverses % legs
        end = 0 if lane.round_trip else end
        trial.reset_to(starts[end])
    seconds = 60.0 * minutes - max(remaining, 0.0)
    return LaneScore(lane, robot.name, seconds, traverses // legs, tuple(faults))
