"""The examples of several clients: two that meet, with a server of their own, and a mission, a short one."""

import math
import re
import subprocess
import sys

import pytest

from tests.arenas import FLAT
from tests.scripts import EXAMPLES, load
from tests.server.peers import serving
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.server.worlds.dynamic_world import DynamicWorld

load("own_server")  # where the mission finds it
mission = load("mission")
CLEAR = (4.0,) * 181  # a scan with nothing near
FOV = math.pi


def test_two_clients_meet_and_are_recorded(tmp_path):
    record = tmp_path / "meeting.mcap"
    command = [sys.executable, str(EXAMPLES / "two_clients.py"), "--record", str(record)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    heard = re.search(r"Bob hears her ([\d.]+) m before him; Ann hears ([\d.]+) m", done.stdout)
    near, other = (float(distance) for distance in heard.groups())
    assert 0.4 < near <= 0.8
    assert other == pytest.approx(near, abs=0.25), "of the same gap; the one reports a moment later"
    assert float(re.search(r"hears her ([\d.]+) m away", done.stdout)[1]) >= 1.6
    assert record.read_bytes()[:8] == record.read_bytes()[-8:] == b"\x89MCAP0\r\n", "it is whole"


@pytest.mark.thorough
def test_a_server_that_does_not_start_is_one_line_and_exit_code_1(tmp_path):
    taken = tmp_path / "taken.mcap"
    taken.touch()
    command = [sys.executable, str(EXAMPLES / "two_clients.py"), "--record", str(taken)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "two_clients: the server has not started"


def test_a_short_mission_is_driven_and_misses_no_report():
    world = DynamicWorld(FLAT, Physics(), 1, max_robots=4)
    world.prepare(ROBOTS.get("P2AT"))
    with serving(world) as (port, _):
        logs = mission.explore(port, 4.0, ("P2AT", "P2AT"))
    assert [log.name for log in logs] == ["P2AT_1", "P2AT_2"]
    for log in logs:
        assert (log.missed, log.stuck) == (0, 0)
        assert log.reports >= 20
        assert 0.5 < log.driven < 0.4 * 5.0
        assert len(log.cells) >= 2
    said = mission.account(logs, 4.0, 2.0)
    assert "P2AT_2" in said
    assert "4 simulated s in 2 s" in said


@pytest.fixture
def explorer():
    """An explorer without a connection, as big as a P2AT, at rest in the middle."""
    made = object.__new__(mission.Explorer)
    made.log, made.length, made.width, made.scanner = mission.Log("E"), 0.52, 0.5, 0.14
    made.turning, made.now, made.pose = 0, 10.0, (0.0, 0.0, 0.0)
    made.turns_since = made.backs_until = made.there_since = -1.0
    made.anchor = (math.nan,) * 3
    return made


def wall(distance):
    """A scan of a wall straight ahead, from right to left."""
    angles = [FOV / 2 - i * FOV / 180 for i in range(181)]
    return tuple(min(4.0, distance / max(math.cos(a), 1e-6)) for a in angles)


def test_it_drives_where_there_is_room_and_turns_before_a_wall(explorer):
    assert explorer.decide(CLEAR, FOV) == pytest.approx((mission.CRUISE, 0.0), abs=0.02)
    assert explorer.decide(wall(0.4), FOV)[0] == 0.0
    assert abs(explorer.decide(wall(0.7), FOV)[1]) == mission.TURN, "on, until there is room enough"
    assert explorer.decide(wall(3.0), FOV)[0] == mission.CRUISE


def test_more_room_on_the_right_turns_it_clockwise(explorer):
    """Wire axes: y is right, and the first beam looks there."""
    right = (4.0,) * 90 + (0.5,) * 91
    assert explorer.decide(right, FOV)[1] > 0.0
    explorer.turning = 0
    assert explorer.decide(right[::-1], FOV)[1] < 0.0


def test_it_backs_off_where_it_does_not_get_on(explorer):
    explorer.decide(CLEAR, FOV)
    explorer.now += mission.STUCK_AFTER + 0.1
    assert explorer.decide(CLEAR, FOV)[0] == mission.BACK
    assert explorer.log.stuck == 1
    explorer.now += mission.BACK_OFF + 0.1
    assert explorer.decide(CLEAR, FOV)[0] == mission.CRUISE, "and tries again"


def test_parts_seen_near_each_other_are_of_one_victim():
    one = mission.Log("A", victims=[(1.0, 2.0), (1.2, 2.2), (5.0, 5.0)])
    other = mission.Log("B", victims=[(1.1, 2.1)])
    (place,) = mission.victims_of([one, other])
    assert place == pytest.approx((1.1, 2.1))
