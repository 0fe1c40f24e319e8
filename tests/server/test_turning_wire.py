"""Turns of a P2AT, heard by a client: the data sheet's rate, and the odometry's error."""

import math
import re

import pytest

from tests.arenas import FLAT
from tests.server.peers import say
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.worlds.dynamic_world import DynamicWorld

SHEET_SLIP = 1.22
"""Manual 12.1.1: 0.7 m/s and 140 degrees a second make 0.573 m; the captured WheelSeparation is 0.4712 m."""


def run(world, client, steps):
    """Step the world, and report whenever a report is due."""
    for _ in range(steps):
        world.step()
        if client.due():
            world.observe([client.robot])
            client.report()


def headings(client):
    """Heading by odometry and true heading [rad], of the last report."""
    lines = client.session.data_to_send().decode()
    poses = re.findall(r"\{Name Odometry\} \{Pose [^,]+,[^,]+,([^}]+)\}", lines)
    truths = re.findall(r"\{Type GroundTruth\}.*?\{Orientation [^,]+,[^,]+,([^}]+)\}", lines)
    return float(poses[-1]), float(truths[-1])


def turned(world, client, seconds):
    """Changes of both headings while the robot turns on, from its last report on [rad]."""
    last, sums = headings(client), [0.0, 0.0]
    for _ in range(round(seconds / 0.2)):
        run(world, client, 10)
        now = headings(client)
        for i in range(2):
            sums[i] += math.remainder(now[i] - last[i], math.tau)
        last = now
    return sums


@pytest.mark.parametrize(
    ("drive", "spin"),
    [("{Left 100} {Right -100} {Normalized true}", 5.385), ("{Left 1} {Right -1}", 1.0)],
)
def test_a_p2at_turns_and_its_odometry_errs_as_its_data_sheet_says(drive, spin):
    world = DynamicWorld(FLAT, max_robots=1)
    client = Client(world, "peer")
    say(client, "INIT {ClassName USARBot.P2AT} {Name R} {Location 0,0,-0.3}")
    run(world, client, 50)
    say(client, f"DRIVE {drive}")
    run(world, client, 50)
    seconds = 6.0
    odometry, truth = turned(world, client, seconds)
    rate = 2 * spin * 0.13 / (0.4712 * SHEET_SLIP)
    assert truth / seconds == pytest.approx(rate, rel=0.1)
    assert odometry / truth == pytest.approx(SHEET_SLIP, rel=0.05)
