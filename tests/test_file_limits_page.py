"""The table of limits of files on the security page has the numbers that are in force."""

import re

import dev
from usarmjx.base.npz_file import NpzLimits
from usarmjx.base.settings import files, json_file, yaml_file
from usarmjx.models.files import meshes
from usarmjx.models.ini import parse
from usarmjx.models.roads import rndf
from usarmjx.recording import reader
from usarmjx.sweeps import spec, store
from usarmjx.train.learning import checkpoint
from usarmjx.train.policies import policy_file

MB = 1_000_000
PAGE = (dev.ROOT / "docs" / "security.md").read_text(encoding="utf-8")


def numbers(row):
    """The numbers of a row; a million is written as a word."""
    (text,) = re.findall(rf"^\| {re.escape(row)} \| (.*) \|$", PAGE, re.MULTILINE)
    words = re.findall(r"([\d,]*\d)(?: (MB|million)\b)?", text)
    return [int(number.replace(",", "")) * (MB if unit else 1) for number, unit in words]


def test_the_table_has_the_limits_in_force():
    assert numbers("YAML") == [files.MAX_FILE_BYTES, yaml_file.MAX_VALUES, yaml_file.MAX_DIGITS]
    assert numbers("JSON")[:2] == [files.MAX_FILE_BYTES, json_file.MOST_LINES_BYTES]
    assert numbers("JSON")[2:] == [store.MOST_CELL_BYTES, yaml_file.MAX_DIGITS]
    assert store.MOST_SWEEP_BYTES == store.MOST_CELL_BYTES
    assert numbers("sweep") == [spec.MAX_CELLS]
    assert numbers("policy")[:2] == [policy_file.MOST_BYTES, policy_file.USUAL_BYTES]
    assert numbers("policy")[2:] == [policy_file.MOST_ARRAYS]
    assert "a hundred times its own size" in PAGE
    assert policy_file.MOST_RATIO == 100
    assert numbers("checkpoint") == [checkpoint.MOST_ARRAYS, NpzLimits("checkpoint").usual]
    assert numbers("part of a recording") == [reader.MOST_BYTES // 2**20 * MB]
    assert numbers("OBJ, STL, COLLADA")[0] == meshes.MAX_MESH_BYTES
    assert numbers("ini")[0] == parse.MAX_INI_BYTES
    assert numbers("RNDF, MDF") == [rndf.MAX_ROAD_FILE_BYTES]
