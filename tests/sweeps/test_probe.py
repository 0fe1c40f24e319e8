"""The probe of a plan: what a few steps say of all batches, and what it leaves behind."""

from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from tests.sweeps.conftest import write
from usarmjx.cli.app import app
from usarmjx.sweeps import progress
from usarmjx.sweeps.play import BatchWork
from usarmjx.sweeps.progress import STEPS, SweepProbe, probe_works

FIRST, STEP = 3.0, 0.25


@pytest.fixture
def fake(monkeypatch):
    """Batches whose building takes FIRST and whose steps take STEP by a clock of their own."""
    clock, played = [0.0], []

    class Runner:
        def __init__(self, cells, size, engine):
            self.env = SimpleNamespace(worlds=size * cells[0].episodes)

        def run(self, chosen, tick):
            clock[0] += FIRST
            for number in range(1, 101):
                tick(number / 100)
                played.append(number)
                clock[0] += STEP

    monkeypatch.setattr(progress, "GroupRunner", Runner)
    monkeypatch.setattr(progress.time, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(
        progress,
        "resolved",
        lambda settings: SimpleNamespace(
            episodes=settings["episodes"],
            driver=SimpleNamespace(command=settings.get("command")),
            task=SimpleNamespace(episode_steps=100),
        ),
    )
    return played


def work(group, size, **settings):
    return BatchWork(
        group=group,
        cells=(("key", {"episodes": 5, **settings}),),
        kin=({"episodes": 5, **settings},),
        size=size,
        engine="c",
    )


def test_all_batches_take_what_their_worlds_and_groups_do(fake):
    """Two groups are compiled, and 20 + 20 + 10 worlds make 100 steps of 0.25 s for each 20."""
    found = probe_works([work("a", 2), work("a", 4), work("a", 4), work("b", 1, command="client")])
    assert len(fake) == STEPS
    assert (found.worlds, found.first, found.step) == (20, FIRST, STEP)
    assert found.seconds == FIRST + 100 * STEP * (10 + 20 + 20) / 20
    both = probe_works([work("a", 4), work("b", 2)])
    assert both.seconds == 2 * FIRST + 100 * STEP * (20 + 10) / 20
    assert probe_works([work("b", 1, command="client")]) is None


def test_a_batch_that_fills_the_memory_is_named():
    usual = {"worlds": 8, "first": 2.0, "step": 0.5, "seconds": 7200.0, "room": 10**10}
    fits, not_so = SweepProbe(used=10**9, **usual), SweepProbe(used=95 * 10**8, **usual)
    assert fits.as_text(2) == (
        "probe of 8 worlds: 2 s to build and compile, 500 ms a step, 1.0 of 10 GB of memory; "
        "about 60 min for all"
    )
    assert not_so.as_text().endswith("too large: set a smaller number of worlds in the file")


def test_the_command_plans_and_keeps_nothing(tmp_path):
    file = write(tmp_path, product={"arena.level": [0.1]})
    result = CliRunner().invoke(app, ["sweep", str(file), "--plan", "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert "1 cell in 1 batch of 1, 1 compilation" in result.stdout
    assert "probe of 2 worlds: " in result.stdout
    assert not (tmp_path / "out").exists()
    result = CliRunner().invoke(
        app, ["sweep", str(file), "--plan", "--no-probe", "--out", str(tmp_path / "out")]
    )
    assert "probe" not in result.stdout
