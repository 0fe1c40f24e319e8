"""Robots of a class report together, so that their sensors are read at once; teams take turns."""

import pytest

from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots.reporter import MAX_TEAM, first_report_time
from usarmjx.server.worlds.robot import Robot
from usarmjx.sim.control import idle_command

PERIOD = 0.02
TIMER = 0.2


def joined(names):
    """Robots that join one control step after the other, and when each joined."""
    robots, times = [], []
    for step, name in enumerate(names):
        spec, now = ROBOTS.get(name), PERIOD * step
        robot = Robot(step, f"R{step}", suite_of(spec), idle_command(spec), now)
        robots.append(robot)
        for other in robots[:-1]:
            while other.next_report <= now + 1e-6:
                other.next_report += spec.msg_timer
        robot.next_report = first_report_time(robot, robots, now, PERIOD)
        times.append((now, robot.next_report))
    return robots, times


def phases(robots):
    """In which control step of a message timer each reports."""
    return [round(robot.next_report / PERIOD) % round(TIMER / PERIOD) for robot in robots]


def test_who_is_alone_reports_after_its_timer():
    robots, _ = joined(["P2AT"])
    assert robots[0].next_report == pytest.approx(TIMER)


def test_the_first_report_comes_within_the_timer_and_after_the_present_step():
    _, times = joined(["P2AT", "P2DX", "Zerg"] * 9)
    assert all(PERIOD - 1e-6 < first - now < TIMER + 1e-6 for now, first in times)


def test_robots_of_a_class_report_in_teams_and_the_teams_in_turn():
    robots, _ = joined(["P2AT", "P2DX"] * (2 * MAX_TEAM))
    found = dict(zip(robots, phases(robots), strict=True))
    teams = {(robot.spec.name, found[robot]) for robot in robots}
    assert len(teams) == 4
    assert len({phase for _, phase in teams}) == 4
    sizes = [sum((robot.spec.name, found[robot]) == team for robot in robots) for team in teams]
    assert sizes == [MAX_TEAM] * 4
