"""Drive a robot to a place with a trained policy, or with the one written by hand.

    python -m usarmjx export runs/x --out goal.npz
    python -m usarmjx serve --arena yellow &
    python examples/policy_drive.py goal.npz --to 6.0,1.9
    python examples/policy_drive.py --baseline --to 6.0,1.9

The policy is one of the task drive-to-goal, trained for the same class of robot. From the lines that the
server sends, this makes the observation that the policy was trained with; NumPy is all that it needs for
that. The baseline, which goes along walls that bar the way, needs JAX. Axes are the server's: x forward,
y right, yaw clockwise; the policy's are y left, yaw counter-clockwise.
"""

import argparse
import math
import sys
from typing import Any

import numpy as np

from usarmjx import UsageError
from usarmjx.client import ServerMessage, UsarsimClient
from usarmjx.train import NumpyPolicy

FAR = 10.0  # m: a goal farther away is seen at this distance
CLEAR = 5.0  # m: what is farther away than this looks alike
MOST = 24  # more ranges than this are seen in sectors, by the nearest thing in each
THERE = 0.5  # m
POSES, RANGES = ("INS", "GroundTruth"), ("Sonar", "RangeScanner", "IR")


def observation(pose, goal, ranges) -> np.ndarray:
    """Return what the task drive-to-goal shows a policy.

    Args:
        pose: x, y [m] and yaw [rad] in the server's axes.
        goal: x, y [m] likewise.
        ranges: Distances [m] in the order of the server's line; none for robots without such sensors.
    """
    east, left = goal[0] - pose[0], pose[1] - goal[1]
    distance, yaw = math.hypot(east, left), -pose[2]
    bearing = math.atan2(left, east) - yaw
    seen = [math.cos(bearing), math.sin(bearing), min(distance / FAR, 1.0), min(distance, 1.0)]
    if distance < 1e-6:
        seen[:2] = 0.0, 0.0
    values = np.asarray(ranges, np.float32)
    each = max(1, -(-len(values) // MOST))
    nearest = [values[i : i + each].min() for i in range(0, len(values), each)]
    return np.array([*seen, *np.clip(np.array(nearest) / CLEAR, 0.0, 1.0)], np.float32)


class Baseline:
    """The policy by hand of drive-to-goal, with what `PolicyDriver` asks of a policy.

    Args:
        robot: Its class.
        ranges: The type of sensor that tells what is around it.
    """

    def __init__(self, robot: str, ranges: str):
        import jax

        from usarmjx import ROBOTS, Physics
        from usarmjx.train.baselines import bug_action, initial_bug_carry
        from usarmjx.train.tasks import DriveToGoal, range_lines

        spec = ROBOTS.get(robot)
        self.period = DriveToGoal.repeat * Physics().period
        self.groups = [{"obs_size": 4 + len(range_lines(spec, (ranges,))[1])}]
        self.first = initial_bug_carry()
        self.decide = jax.jit(lambda seen, memory: bug_action(spec, (ranges,), memory, seen))
        self.decide(np.ones(self.groups[0]["obs_size"], np.float32), self.first)  # compiled before it drives

    def initial_carry(self, group: int):
        """Return what it remembers at first."""
        del group
        return self.first

    def act(self, group: int, seen, memory):
        """Return the action, and what it remembers after it."""
        del group
        memory, action = self.decide(seen, memory)
        return np.asarray(action), memory


class PolicyDriver:
    """Takes in messages and drives a skid-steered robot, whose actions are Left and Right.

    Args:
        robot: The connection; its robot exists.
        policy: The policy.
        group: Number of the policy's group of this class.
        goal: x, y [m] where to go, in the server's axes.
        pose: The type of sensor that tells where it is.
        ranges: The type of sensor that tells what is around it.
    """

    def __init__(
        self,
        robot: UsarsimClient,
        policy: NumpyPolicy | Baseline,
        group: int,
        goal,
        pose: str,
        ranges: str,
    ):
        self.robot, self.policy, self.group, self.goal = robot, policy, group, goal
        self.kinds, self.pose, self.ranges = (pose, ranges), None, None
        self.memory: Any = policy.initial_carry(group)
        self.needs_ranges = policy.groups[group]["obs_size"] > 4
        self.now, self.began, self.acted = 0.0, 0.0, -math.inf

    def take(self, message: ServerMessage) -> None:
        """Remember a reading, and the time: every report begins with a STA that tells it."""
        self.now = message.time() or self.now
        kind = message.value("Type") if message.kind == "SEN" else ""
        if kind == self.kinds[0]:
            self.pose = message.pose()
        elif kind == self.kinds[1] and self.needs_ranges:
            self.ranges = list(message.scan() or message.ranges().values())

    def distance(self) -> float:
        """Return how far it is to the goal, as the robot knows [m]."""
        if self.pose is None:
            return math.inf
        return math.hypot(self.goal[0] - self.pose[0], self.goal[1] - self.pose[1])

    def ready(self) -> bool:
        """Return whether all is known that the policy needs, and its last action has lasted long enough."""
        complete = self.pose is not None and (self.ranges is not None or not self.needs_ranges)
        return complete and self.now - self.acted >= self.policy.period - 0.011  # times have 2 decimals

    def act(self) -> None:
        """Let the policy decide, and command the wheels."""
        seen = observation(self.pose, self.goal, self.ranges or ())
        action, self.memory = self.policy.act(self.group, seen, self.memory)
        left, right = (100.0 * float(share) for share in action)
        self.robot.drive(left, right, normalized=True)
        self.acted, self.pose, self.ranges = self.now, None, None

    def run(self, seconds: float) -> bool:
        """Drive for so much simulated time at most [s]; return whether it is there."""
        there = False
        for message in self.robot:
            self.take(message)
            self.began = self.began or self.now
            there = self.distance() <= THERE
            if there or self.now - self.began > seconds:
                break
            if self.ready():
                self.act()
        self.robot.drive(0.0, 0.0)
        return there


def vector(text: str) -> tuple[float, ...]:
    """Return the numbers of `4.5,1.9`."""
    return tuple(float(number) for number in text.split(","))


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="Drive a robot to a place with a trained policy.")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("policy", nargs="?", help="file of `usarmjx export`")
    which.add_argument("--baseline", action="store_true", help="the policy by hand")
    parser.add_argument("--to", type=vector, required=True, help="goal as x,y; --to=-1,2 if x is below 0 [m]")
    parser.add_argument("--start", type=vector, default=(4.5, 1.9, 1.8), help="x,y,z to start at [m]")
    parser.add_argument("--robot", default="P2AT", help="its class; one with the DRIVE keys Left and Right")
    parser.add_argument("--name", default="Policy", help="its name")
    parser.add_argument("--pose", choices=POSES, default="INS", help="sensor that tells where it is")
    parser.add_argument(
        "--ranges", choices=RANGES, default=RANGES[0], help="sensor that tells what is around"
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="simulated time at most")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=3000)
    options = parser.parse_args()
    try:
        policy = Baseline(options.robot, options.ranges) if options.baseline else NumpyPolicy(options.policy)
        group = 0 if isinstance(policy, Baseline) else policy.group(options.robot)
        with UsarsimClient(options.host, options.port, timeout=60.0) as robot:
            robot.init(f"USARBot.{options.robot}", options.name, options.start)
            driver = PolicyDriver(robot, policy, group, options.to, options.pose, options.ranges)
            there = driver.run(options.seconds)
    except (OSError, UsageError) as error:
        print(f"policy_drive: {error}", file=sys.stderr)
        return 1
    print(f"{'there' if there else 'not there'} after {driver.now - driver.began:.1f} simulated s")
    return 0 if there else 1


if __name__ == "__main__":
    sys.exit(main())
