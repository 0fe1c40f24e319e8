"""Steps in time with the clock, and the two lines about a time when they were not."""

import re

import pytest

from usarmjx.server.runtime.loop import MAX_LAG, RECOVERY, Pace

PERIOD = 0.02  # s
ROUNDING = 1e-9  # s: sums of thousands of periods in double precision


class Stage:
    """A clock that only goes on when a step or a pause takes its time."""

    def __init__(self, factor=1.0):
        self.now = 1000.0
        self.pace = Pace(PERIOD, factor, self.now)

    def run(self, seconds, cost):
        """Make steps of so much for so long; return how many."""
        steps, end = 0, self.now + seconds
        while self.now < end - ROUNDING:
            self.now += cost
            self.now += self.pace.pause(self.now)
            steps += 1
        return steps


@pytest.fixture
def lines(caplog):
    return lambda: [
        record.getMessage() for record in caplog.records if record.name == "usarmjx.server.runtime.loop"
    ]


@pytest.mark.parametrize("factor", [0.5, 1.0, 4.0])
def test_quick_steps_keep_the_clock_and_the_log_silent(factor, lines):
    stage = Stage(factor)
    assert stage.run(10.0, cost=0.001) == pytest.approx(10.0 * factor / PERIOD, abs=1)
    assert lines() == []


def test_as_fast_as_it_can_never_waits(lines):
    stage = Stage(factor=0.0)
    assert stage.run(1.0, cost=0.005) == pytest.approx(200, abs=1)
    assert lines() == []


def test_a_short_delay_is_caught_up_without_a_word(lines):
    stage = Stage()
    stage.run(1.0, cost=0.001)
    stage.now += MAX_LAG - PERIOD
    assert stage.run(2.0, cost=0.001) == pytest.approx((2.0 + MAX_LAG) / PERIOD, abs=2)
    assert lines() == []


def test_a_long_lag_is_two_lines_with_the_total_in_the_second(lines):
    """60 s at half the speed: half of the time is lost."""
    stage = Stage()
    stage.run(60.0, cost=2 * PERIOD)
    assert len(lines()) == 1
    assert re.match(r"0\.5\d s behind the clock", lines()[0])
    steps = stage.run(RECOVERY + 2.0, cost=0.001)
    assert len(lines()) == 2
    lost = float(re.search(r"no longer behind the clock: ([\d.]+) s lost in [\d.]+ s", lines()[1])[1])
    assert lost == pytest.approx(30.0, abs=MAX_LAG + PERIOD)  # the rest was caught up
    assert steps * PERIOD == pytest.approx(RECOVERY + 2.0, abs=MAX_LAG + 2 * PERIOD)
    stage.run(10.0, cost=0.001)
    assert len(lines()) == 2


def test_a_slight_overload_is_one_lag_not_many(lines):
    """At 0.9 of the clock's speed the limit is reached every 5 s."""
    stage = Stage()
    stage.run(60.0, cost=PERIOD / 0.9)
    assert len(lines()) == 1


def test_each_lag_counts_its_own_loss(lines):
    stage = Stage()
    for seconds in (10.0, 20.0):
        stage.run(seconds, cost=2 * PERIOD)
        stage.run(RECOVERY + 2.0, cost=0.001)
    lost = [float(found[1]) for line in lines() if (found := re.search(r": ([\d.]+) s lost", line))]
    assert lost == pytest.approx([5.0, 10.0], abs=MAX_LAG + PERIOD)


def test_a_lag_that_lasts_to_the_end_is_accounted_for(lines):
    stage = Stage()
    stage.pace.finish(stage.now)
    assert lines() == []
    stage.run(10.0, cost=2 * PERIOD)
    stage.pace.finish(stage.now)
    assert len(lines()) == 2
    assert re.search(r"([\d.]+) s lost in 9", lines()[1])
