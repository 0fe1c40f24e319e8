"""When robots report: those of a class in teams, whose sensors are read at once, and the teams in turn."""

from collections.abc import Iterable

from usarmjx.server.worlds.robot import Robot

TEAM = 8
"""So many robots of a class report together: more would make that control step a long one."""


def first_report(robot: Robot, others: Iterable[Robot], since: float, period: float) -> float:
    """Return when a new robot reports first [s]: within its msgTimer, and no sooner than in the next step.

    That is with most others of its class that have room in their team; if none have, when fewest others
    report; when it does not matter, after its msgTimer.

    Args:
        robot: The robot.
        others: The others in its world.
        since: Now [s].
        period: Length of a control step [s].
    """
    timer, there = robot.spec.msg_timer, [other for other in others if other is not robot]

    def merit(time: float) -> tuple[int, int]:
        together = [other for other in there if abs(other.next_report - time) < period / 2]
        team = sum(other.spec is robot.spec for other in together)
        return team if team < TEAM else 0, -len(together)

    return max((since + timer - step * period for step in range(max(1, round(timer / period)))), key=merit)
