"""Parts of a sweep, as jobs of an array play them: each cell is in one, and the page's script does it."""

import os
import re

import pytest
from typer.testing import CliRunner

import dev
from tests.sweeps.conftest import write
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.sweeps import run
from usarmjx.sweeps.run import parse_part, prepare
from usarmjx.sweeps.spec import load_spec
from usarmjx.sweeps.store import read_sweep

SCRIPT = re.search(
    r"^usarmjx (sweep run walls.*)$", (dev.ROOT / "docs/sweeps.md").read_text(encoding="utf-8"), re.MULTILINE
).group(1)


@pytest.mark.parametrize("count", [1, 5, 13])
def test_each_cell_is_in_one_part_whatever_is_there(whole, tmp_path, rows, count, monkeypatch):
    monkeypatch.setattr(run, "forget_resolved", lambda: None)  # no file changes meanwhile
    spec = load_spec(write(tmp_path, list=rows))
    parts = [prepare(spec, tmp_path / "out", part=(number + 1, count)) for number in range(count)]
    keys = [key for one in parts for key, _ in one.cells]
    assert keys == list(parts[0].keys), "in their order, each once"
    sizes = [len(one.cells) for one in parts]
    assert max(sizes) - min(sizes) <= 1
    assert {one.keys for one in parts} == {parts[0].keys}, "all write the same sweep"
    there = prepare(spec, whole[0], part=(1, count))
    assert (len(there.cells), there.known) == (0, sizes[0])


def test_the_array_of_the_page_plays_all(tmp_path, monkeypatch):
    write(tmp_path, name="walls", product={"arena.level": [0.1, 0.9]})
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLURM_ARRAY_TASK_COUNT", "2")
    for number in (1, 2):
        monkeypatch.setenv("SLURM_ARRAY_TASK_ID", str(number))
        result = CliRunner().invoke(app, os.path.expandvars(SCRIPT).split())
        assert result.exit_code == 0, result.output
        assert len(read_sweep(tmp_path / "sweeps/walls").finished) == number


@pytest.mark.parametrize("text", ["2", "0/3", "4/3", "a/b", "1/0", "-1/2", "1/2/3"])
def test_what_is_no_part_is_refused(text):
    with pytest.raises(UsageError, match="expected a number and a count as 2/10"):
        parse_part(text)
