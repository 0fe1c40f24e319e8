"""Keys of results change with everything that a cell reads, and with nothing else."""

import re

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from tests.sweeps.conftest import weak
from tests.train.handmade import policy_file
from usarmjx.cli.app import app
from usarmjx.models.arenas import ARENAS
from usarmjx.sweeps import contents
from usarmjx.sweeps.contents import key_of, script_digest
from usarmjx.sweeps.run import prepare
from usarmjx.sweeps.spec import read_spec

MAP = """image: {name}.png
resolution: 0.1
origin: [0, 0, 0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.2
"""


def cell_of(**common):
    (cell,) = read_spec({"common": {"task": "drive-to-goal", "episodes": 2, **common}}).cells
    return {**cell, "engine": "c"}


def key(**common):
    return key_of(cell_of(**common))


def test_the_order_of_settings_and_the_name_of_a_method_are_no_part_of_a_key():
    cell = cell_of()
    assert key_of(dict(reversed(cell.items()))) == key_of(cell)
    assert key_of({**cell, "method": "mine"}) == key_of(cell)
    assert key_of({**cell, "seed": 1}) != key_of(cell)


def test_policies_have_one_key_under_their_earlier_names():
    for name, earlier in (("baseline", "by-hand"), ({"baseline": "convoy"}, {"by-hand": "convoy"})):
        assert cell_of(policy=earlier) == cell_of(policy=name)
        # Results are kept under the key of the earlier name.
        assert key_of({**cell_of(), "policy": earlier}) == key_of(cell_of(policy=name))


def test_a_script_and_what_it_imports_from_beside_it(tmp_path):
    file, beside, other = tmp_path / "own.py", tmp_path / "beside.py", tmp_path / "other.py"
    file.write_text("from beside import turn\n\ndef policy(env): ...\n")
    beside.write_text("turn = 1\n")
    other.write_text("unused = 1\n")
    before = script_digest(file)
    other.write_text("unused = 2\n")
    assert script_digest(file) == before
    beside.write_text("turn = 2\n")
    after = script_digest(file)
    assert after != before
    file.write_text("from beside import turn\n\ndef policy(env): return None\n")
    assert script_digest(file) not in (before, after)
    package = tmp_path / "pack"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "deep.py").write_text("from . import more\n")
    (package / "more.py").write_text("x = 1\n")
    file.write_text("import pack.deep\n")
    before = script_digest(file)
    (package / "more.py").write_text("x = 2\n")
    assert script_digest(file) != before


def test_a_policy_that_is_written_again_is_another_cell(tmp_path):
    file = policy_file(tmp_path / "mine.npz")
    before = key(policy=str(file), fields={"ranges": []})
    assert key(policy=str(file), fields={"ranges": []}) == before
    weak(file)
    assert key(policy=str(file), fields={"ranges": []}) != before


def test_a_changed_picture_of_a_map_is_another_cell(tmp_path):
    """The file that names the picture stays as it is."""
    picture = np.full((60, 60), 254, np.uint8)
    picture[:2] = picture[-2:] = picture[:, :2] = picture[:, -2:] = 0
    Image.fromarray(picture).save(tmp_path / "plan.png")
    (tmp_path / "plan.yaml").write_text(MAP.format(name="plan"))
    before = key(arena=str(tmp_path / "plan.yaml"))
    assert key(arena=str(tmp_path / "plan.yaml")) == before
    picture[20:24, 20:40] = 0
    Image.fromarray(picture).save(tmp_path / "plan.png")
    assert key(arena=str(tmp_path / "plan.yaml")) != before


def test_an_arena_that_a_script_registers_counts_by_what_it_is(monkeypatch):
    before = key(arena="yellow")
    changed = ARENAS.get("red")
    monkeypatch.setattr(contents, "find_arena", lambda name: changed)
    assert key(arena="yellow") != before


def test_versions_are_part_of_a_key(monkeypatch):
    before = key()
    monkeypatch.setattr(contents, "versions", lambda: {"jax": "0.0.1", "machine": "another"})
    other = key()
    assert other != before
    monkeypatch.setattr(contents, "versions", lambda: {"jax": "0.0.1", "machine": "a third"})
    assert key() == other, "machines of a cluster share their results"


@pytest.mark.parametrize(
    ("policy", "said"),
    [
        ("mine.py:f", "policy mine.py:f: cannot be imported: .*No such file"),
        ("lost.npz", "lost.npz is no folder of a run"),
    ],
)
def test_a_plan_says_what_is_missing(policy, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    spec = read_spec({"common": {"task": "explore-v1"}, "product": {"policy": [policy]}})
    prepared = prepare(spec, tmp_path / "out")
    assert not prepared.cells
    (record,) = prepared.broken
    assert re.search(said, record.failed)


def test_a_plan_with_a_missing_policy_fails(tmp_path):
    file = tmp_path / "x.yaml"
    file.write_text("common: {task: drive-to-goal, engine: c}\nproduct: {policy: [lost.npz, baseline]}\n")
    words = ["sweep", str(file), "--plan", "--no-probe", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1
    assert "fails: " in result.output
    assert "1 cell in 1 batch" in result.output, "the other one is planned"
