"""Lines of progress: when they come, and the time that is left, by a clock of the test's own."""

import types

import pytest

from usarmjx.sweeps.progress import SweepProgress

COMPILING, STEP, STEPS = 100.0, 1.0, 100
"""Time of a compilation and of a step [s], and steps of a batch."""


@pytest.fixture
def clock(monkeypatch):
    """The time, as the progress reads it [s]."""
    now = [0.0]
    monkeypatch.setattr("usarmjx.sweeps.progress.time.monotonic", lambda: now[0])
    return now


def stream_to(said):
    return types.SimpleNamespace(write=said.append, flush=lambda: None, isatty=lambda: False)


def play(progress, clock, group, compiles=True, until=STEPS):
    """Play a batch of ten cells up to a step."""
    progress.begin(group)
    clock[0] += COMPILING if compiles else 0.0
    for step in range(1, until + 1):
        clock[0] += STEP
        progress.within(10, step / STEPS)


def test_progress_is_one_line_now_and_then(clock):
    said = []
    progress = SweepProgress(100, stream_to(said))
    progress.begin("a")
    for second in range(1, 31):
        clock[0] = float(second)
        progress.within(10, second / 300)
    assert said == [
        "usarmjx: 0 of 100 cells, 10 s, about 50 min left\n",
        "usarmjx: 0 of 100 cells, 20 s, about 50 min left\n",
        "usarmjx: 0 of 100 cells, 30 s, about 50 min left\n",
    ], "every 10 s where there is no terminal"
    progress.add(5, 5, "a")
    assert progress.line(10, 300.0).startswith("usarmjx: 10 of 100 cells, 5 failed, 5 min, about ")


def test_no_time_is_said_before_a_step_that_does_not_compile(clock):
    progress = SweepProgress(40)
    play(progress, clock, "a", until=1)
    assert progress.line(10 / STEPS, clock[0]) == "usarmjx: 0 of 40 cells, 2 min"


def test_the_first_estimate_has_the_compilations_to_come(clock):
    """Four batches of 100 steps of 1 s in two groups: 98 + 300 s to play, and 100 s to compile."""
    progress = SweepProgress(40, compilations=2)
    play(progress, clock, "a", until=2)
    left = (98 + 300) * STEP + COMPILING
    expected = f"usarmjx: 0 of 40 cells, 2 min, about {round(left / 60)} min left with 1 compilation"
    assert progress.line(20 / STEPS, clock[0]) == expected
    progress.add(10, 0, "a", COMPILING)
    assert " left with 1 compilation" in progress.line(10, clock[0])


def test_the_last_estimate_has_none(clock):
    progress = SweepProgress(20, compilations=2)
    for group in ("a", "b"):
        play(progress, clock, group)
        progress.add(10, 0, group, COMPILING)
    assert progress.line(20, clock[0]) == "usarmjx: 20 of 20 cells, 7 min, about 0 s left"
    assert clock[0] == 2 * (COMPILING + STEPS * STEP)


def test_workers_share_what_is_left(clock):
    """Two workers have played a batch each in 200 s, half of it compilation; two more groups are left."""
    progress = SweepProgress(40, compilations=4, workers=2)
    clock[0] = COMPILING + STEPS * STEP
    for group in ("a", "b"):
        progress.add(10, 0, group, COMPILING)
    assert progress.line(20, clock[0]).endswith(", about 3 min left with 2 compilations")
    progress.add(0, 3)  # broken cells cost nothing, and count for no rate
    assert progress.line(23, clock[0]).endswith(", 3 failed, 3 min, about 3 min left with 2 compilations")
