"""Scores in lanes: repetitions in a time, as the test methods for response robots count them."""

from dataclasses import dataclass

from usarmjx.bench.trials.driver import Trial
from usarmjx.models.arenas.lanes import MobilityLane
from usarmjx.models.spec.robot import RobotSpec

MOST_FAULTS = 3
"""After so many a test is over."""


@dataclass(frozen=True)
class LaneScore:
    """What a robot did in a lane.

    Attributes:
        lane: The lane.
        robot: Name of its class.
        seconds: Simulated time that counted [s].
        repetitions: Traverses with the whole robot from one end to the other; there and back in lanes where
            that is one.
        faults: In words why traverses did not count; after each the robot is put back to its start.
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
    lane: MobilityLane, robot: RobotSpec, minutes: float = 5.0, share: float = 1.0, most: int | None = None
) -> LaneScore:
    """Drive a robot to and fro in a lane and return its score.

    Args:
        lane: The lane.
        robot: The robot's class.
        minutes: How long [min].
        share: Share of its top speed.
        most: Repetitions after which the test is over; None: only time ends it.

    Raises:
        UsageError: The class does not drive on the ground.
    """
    trial, starts = Trial(lane.arena, robot, share), lane.arena.starts
    left, done, faults, at = 60.0 * minutes, 0, [], 0
    legs = 2 if lane.round_trip else 1
    while left > 0 and len(faults) < MOST_FAULTS and (most is None or done // legs < most):
        ride = trial.follow(lane.way(back=bool(at)), left)
        left -= ride.seconds
        if not ride.fault:
            done, at = done + 1, 1 - at
            continue
        if left <= 0:
            break
        faults.append(ride.fault)
        done -= done % legs
        at = 0 if lane.round_trip else at
        trial.put_back(starts[at])
    seconds = 60.0 * minutes - max(left, 0.0)
    return LaneScore(lane, robot.name, seconds, done // legs, tuple(faults))
