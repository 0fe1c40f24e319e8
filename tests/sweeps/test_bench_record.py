"""What a sweep took: its record, and the clock that tells compilation apart."""

import json
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.report.records import BenchRecord
from benchmarks.report.tables import sweep_table
from tests.benchmarks.records import faults
from tests.sweeps.conftest import write
from usarmjx.base.compilation import COMPILE_EVENT_PREFIX
from usarmjx.cli.app import app
from usarmjx.sweeps.play import CompileClock, compile_clock, covered
from usarmjx.sweeps.store import read_sweep

BROKEN = "def raises(env):\n    raise RuntimeError('no good today')\n"


def test_what_lies_in_another_span_counts_once():
    assert covered([]) == 0.0
    assert covered([(0.0, 4.0), (1.0, 2.0), (3.0, 5.0), (7.0, 8.5)]) == 5.0 + 1.5
    assert covered([(7.0, 8.0), (0.0, 1.0)]) == 2.0


def test_the_clock_hears_of_compilations_and_of_nothing_else(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("usarmjx.sweeps.play.time.monotonic", lambda: now[0])
    clock = CompileClock()
    clock.hear(f"{COMPILE_EVENT_PREFIX}jaxpr_trace_duration", 0.5)  # within the next
    clock.hear(f"{COMPILE_EVENT_PREFIX}backend_compile_duration", 3.0)
    clock.hear("/jax/checkpoint/write", 50.0)
    assert clock.taken() == 3.0
    assert clock.taken() == 0.0, "each is told once"


def test_jax_tells_the_clock():
    clock = compile_clock()
    clock.taken()
    begun = time.monotonic()
    program = jax.jit(lambda x: jnp.linalg.qr(x @ x.T + 41.5)[0].sum())
    jax.block_until_ready(program(jnp.ones((5, 7))))
    assert 0.0 < clock.taken() <= time.monotonic() - begun
    jax.block_until_ready(program(jnp.ones((5, 7))))
    assert clock.taken() == 0.0, "it is compiled already"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, rows):
    """A sweep of four cells of which two are broken, and its record."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "broken.py").write_text(BROKEN)
    policies = [rows[0], {**rows[0], "policy": f"{folder}/broken.py:raises"}]
    file = write(folder, list=policies, product={"arena.level": [0.1, 0.9], "seed": [0]})
    words = ["sweep", file, "--out", folder / "out", "--json", folder / "sweep.jsonl", "--note", "busy"]
    begun = time.perf_counter()
    done = CliRunner().invoke(app, list(map(str, words)))
    return folder, words, done, time.perf_counter() - begun


def test_the_record_says_what_was_played_and_how_long_it_took(recorded):
    folder, _, done, seconds = recorded
    assert done.exit_code == 1, "two cells fail"
    assert "2 cells in " in done.output
    (line,) = (folder / "sweep.jsonl").read_text().splitlines()
    record = json.loads(line)
    assert faults(record) == []
    assert (record["benchmark"], record["note"], record["case"]["engines"]) == ("sweep", "busy", ["c"])
    assert (record["cells"], record["failed"], record["known"], record["episodes"]) == (2, 2, 0, 4)
    assert (record["batches"], record["largest_batch"], record["compilations"]) == (2, 2, 2)
    common = record["case"]["settings"]
    assert (common["seed"], common["episodes"], common["arena.kind"]) == ("0", "2", "maze")
    assert "arena.level" not in common, "it differs"
    kept = read_sweep(folder / "out")
    assert record["agent_steps"] == sum(sum(one.steps) for one in kept.finished), "one robot drives"
    assert 0.0 < record["compile_s"] < record["wall_s"] < seconds
    assert record["compile_s"] == pytest.approx(sum(one.compile_seconds for one in kept.finished))
    assert record["rates"]["cells"]["rate"] == pytest.approx(2 / record["wall_s"])
    (score,) = record["scores"]
    assert score["score"] == np.mean([one.scores for one in kept.finished])
    assert (score["cells"], score["method"]) == (2, "Wilson")


def test_its_row_stands_in_the_table_of_sweeps(recorded):
    folder = recorded[0]
    record = json.loads((folder / "sweep.jsonl").read_text())
    text = sweep_table([BenchRecord("sweep.jsonl", record)])
    row = [cell.strip() for cell in text.splitlines()[2].split("|")[1:-1]]
    assert row[3:9] == ["small", "c", "2", "2", "2", "2"]
    assert row[-1].startswith("drive-to-goal, ")
    assert sweep_table([]) == "No record yet.\n"


def test_where_nothing_is_played_there_is_no_record(recorded):
    folder, words, *_ = recorded
    done = CliRunner().invoke(app, list(map(str, words)))
    assert done.exit_code == 2
    assert "no record: no cell was played to its end by this command" in done.output
    assert len((folder / "sweep.jsonl").read_text().splitlines()) == 1
