"""Results of sweeps that are damaged, or stand in the place of others, are not believed."""

import json
import math
import shutil
from dataclasses import replace

import pytest

from usarmjx.base.errors import UsageError, WriteError
from usarmjx.base.settings import yaml_file
from usarmjx.sweeps.spec import load_spec
from usarmjx.sweeps.store import CellRecord, read_cell, read_sweep, write_cell, write_cells, write_sweep

RECORD = CellRecord(
    key="1f",
    settings={"task": "explore-v1"},
    engine="c",
    scores=(0.25,),
    steps=(10,),
    bad=(True,),
    metrics={"seen": (math.nan,)},
)


@pytest.fixture
def cell(tmp_path):
    write_cell(tmp_path, RECORD)
    return tmp_path / "cells" / "1f.json"


def test_no_flipped_bit_of_a_cell_changes_its_result(tmp_path, cell, caplog):
    whole, refused = cell.read_bytes(), 0
    expected = repr(RECORD)
    assert repr(read_cell(tmp_path, "1f")) == expected
    for bit in range(8 * len(whole)):
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        cell.write_bytes(changed)
        found = read_cell(tmp_path, "1f")
        assert found is None or repr(found) == expected
        refused += found is None
    assert refused == len(caplog.messages) > 7 * len(whole)
    assert all(line.endswith("the cell counts as not played") for line in caplog.messages)


def test_a_cell_that_was_copied_over_another_does_not_count(tmp_path, cell, caplog):
    shutil.copy(cell, tmp_path / "cells" / "2e.json")
    write_sweep(tmp_path, "mine", "", ("seed",), ("1f", "2e", "3d"))
    assert [record.key for record in read_sweep(tmp_path).records] == ["1f"]
    assert [line.split(": ", 1)[1] for line in caplog.messages] == [
        "is the result of another cell, 1f; the cell counts as not played"
    ]


def test_policies_of_earlier_results_have_their_names_of_now(tmp_path):
    for number, (earlier, name) in enumerate((("by-hand", "baseline"), ("shipped", "packaged"))):
        record = replace(RECORD, key=str(number), settings={"task": "explore-v1", "policy": earlier})
        write_cell(tmp_path, record)
        assert read_cell(tmp_path, str(number)).settings["policy"] == name


def test_results_of_earlier_versions_have_no_checksum(tmp_path, cell):
    content = json.loads(cell.read_text())
    del content["checksum"]
    cell.write_text(json.dumps(content))
    assert repr(read_cell(tmp_path, "1f")) == repr(RECORD)
    for damage in ({"scores": "x"}, {"scores": [1, 2]}, {"metrics": [1]}, {"steps": [10**400]}, {"new": 1}):
        cell.write_text(json.dumps({**content, **damage}))
        assert read_cell(tmp_path, "1f") is None


def test_a_damaged_list_of_cells_is_one_line(tmp_path):
    write_sweep(tmp_path, "mine", "", (), ("1f",))
    file = tmp_path / "sweep.json"
    whole = file.read_text()
    for text in (whole.replace("1f", "1e"), "", "[]", '{"format": 1}', "\udcff"):
        file.write_bytes(text.encode(errors="surrogateescape"))
        with pytest.raises(UsageError) as refused:
            read_sweep(tmp_path)
        assert str(refused.value).startswith(f"{file}:")
        assert "\n" not in str(refused.value)
    file.unlink()
    with pytest.raises(UsageError, match="holds no sweep"):
        read_sweep(tmp_path)


PRODUCT = "common: {task: explore-v1}\nproduct:\n" + "".join(
    f"  {key}: {list(range(1, 41))}\n" for key in ("seed", "episodes", "fields.a", "fields.b", "fields.c")
)
BOMB = "a: &a [1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 8)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        (PRODUCT, ": 102400000 cells, expected at most 1000000"),
        (
            "common: {task: explore-v1}\nabout: 2001-99-99\n",
            ":2: about: '2001-99-99' is no timestamp: month must be in 1..12",
        ),
        (
            "common: {task: explore-v1, seed: " + "9" * 5000 + "}\n",
            ":1: common.seed: a number of 5000 characters",
        ),
        (BOMB, "more than 5000 values in one file"),
    ],
)
def test_a_file_that_expands_too_far_is_refused_at_once_in_one_line(tmp_path, monkeypatch, text, refusal):
    monkeypatch.setattr(yaml_file, "MAX_VALUES", 5000)
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(UsageError) as refused:
        load_spec(file)
    assert str(refused.value).startswith(str(file))
    assert refusal in str(refused.value)
    assert "\n" not in str(refused.value)


def test_cells_of_two_clusters_are_merged_by_copying_them(tmp_path, caplog):
    """Each has played a part, and its folder names all cells."""
    for number, folder in enumerate(("one", "two")):
        write_sweep(tmp_path / folder, "mine", "", ("seed",), ("0", "1"))
        write_cell(tmp_path / folder, replace(RECORD, key=str(number)))
    shutil.copytree(tmp_path / "two" / "cells", tmp_path / "one" / "cells", dirs_exist_ok=True)
    assert [record.key for record in read_sweep(tmp_path / "one").records] == ["0", "1"]
    assert not caplog.messages


def test_cells_that_are_written_together_are_all_whole(tmp_path):
    records = [replace(RECORD, key=str(number), seconds=float(number)) for number in range(40)]
    write_cells(tmp_path, records)
    read = [read_cell(tmp_path, record.key) for record in records]
    assert list(map(repr, read)) == list(map(repr, records)), "by their texts, as one number is none"
    assert len(list((tmp_path / "cells").iterdir())) == 40, "no file is left half written"


def test_a_cell_that_cannot_be_written_stops_no_other(tmp_path):
    (tmp_path / "cells" / "7.json" / "in the way").mkdir(parents=True)
    records = [replace(RECORD, key=str(number)) for number in range(20)]
    with pytest.raises(WriteError, match=r"7\.json"):
        write_cells(tmp_path, records)
    assert [one.key for one in records if read_cell(tmp_path, one.key) is None] == ["7"]
