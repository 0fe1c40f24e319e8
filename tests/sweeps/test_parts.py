"""Parts of a sweep, as jobs of an array play them: each cell is in one, and the page's script does it."""

import os
import re

import pytest
from typer.testing import CliRunner

import dev
from tests.sweeps.conftest import write
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.sweeps.run import parse_part
from usarmjx.sweeps.store import read_sweep

SCRIPT = re.search(
    r"^usarmjx (sweep run walls.*)$", (dev.ROOT / "docs/sweeps.md").read_text(encoding="utf-8"), re.MULTILINE
).group(1)


@pytest.mark.thorough
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
