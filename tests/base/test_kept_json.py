"""Kept JSON files whose content has changed are not believed; other JSON is read within limits."""

import json
import math

import pytest

from usarmjx.base.errors import SpecError
from usarmjx.base.settings import json_file
from usarmjx.base.settings.json_file import (
    NotWholeError,
    kept_text,
    parse_json,
    read_json,
    read_json_lines,
    read_kept,
)

CONTENT = {"key": "1f", "rows": [1, 2.5e-3, None, True], "by": {"a": "é"}}


@pytest.fixture
def file(tmp_path):
    (tmp_path / "kept.json").write_text(kept_text(CONTENT))
    return tmp_path / "kept.json"


def test_each_flipped_bit_is_refused_or_changes_nothing(file):
    whole = file.read_bytes()
    assert read_kept(file) == CONTENT
    refused = 0
    for bit in range(8 * len(whole)):
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        file.write_bytes(changed)
        try:
            assert read_kept(file) == CONTENT
        except SpecError as error:
            refused += str(error).startswith(f"{file}:") and "\n" not in str(error)
    assert refused > 0.97 * 8 * len(whole)  # others change a blank to no blank


def test_each_cut_is_refused(file):
    whole = file.read_bytes()
    for length in range(len(whole) - 1):  # the last byte is the end of the line
        file.write_bytes(whole[:length])
        with pytest.raises(SpecError):
            read_kept(file)


def test_a_content_may_be_formatted_anew_and_have_numbers_that_are_none(file):
    content = {**CONTENT, "rows": (math.nan, math.inf), 3: "number"}
    file.write_text(json.dumps(json.loads(kept_text(content)), indent=4, sort_keys=True))
    assert read_kept(file)["3"] == "number"


def test_without_a_checksum_only_earlier_files_are_read(file):
    file.write_text(json.dumps(CONTENT))
    assert read_kept(file, needs_checksum=False) == CONTENT
    with pytest.raises(NotWholeError, match="is not whole"):
        read_kept(file)
    file.write_text("[1]")
    with pytest.raises(NotWholeError, match="is no mapping"):
        read_kept(file)


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        (b'{"a": 1,\n "b": }', r"^x\.json:2: is no JSON: Expecting value, column 7$"),
        (b"", r"^x\.json:1: is no JSON: Expecting value, column 1$"),
        (b"\xff\xfe{}", r"^x\.json: is no JSON: 'utf-8' codec can't decode"),
        (b"[" * 200_000, r"^x\.json: is nested too deeply$"),
        (b'{"a": ' + b"9" * 5000 + b"}", r"^x\.json: is no JSON: a number of 5000 characters; at most 100$"),
        (b"[NaN]", r"^x\.json: is no JSON: NaN is no number$"),
        (b"[-Infinity]", r"^x\.json: is no JSON: -Infinity is no number$"),
    ],
)
def test_what_is_no_json_is_a_line_that_names_the_place(text, refusal):
    with pytest.raises(SpecError, match=refusal):
        parse_json(text, "x.json", finite=True)


def test_files_have_limits(tmp_path, monkeypatch):
    file = tmp_path / "x.json"
    with pytest.raises(SpecError, match="cannot be read: No such file"):
        read_json(file)
    file.write_text("[1]")
    assert read_json(file) == [1]
    with pytest.raises(SpecError, match="3 bytes are too many; at most 2"):
        read_json(file, most=2)


def test_lines_name_their_numbers(tmp_path):
    file = tmp_path / "x.jsonl"
    file.write_text('{"a": 1}\n\n{"a": 2}\n{"a": ')
    assert read_json_lines(file, cut=True) == [(f"{file}:1", {"a": 1}), (f"{file}:3", {"a": 2})]
    with pytest.raises(SpecError, match=rf"^{file}:4: is no JSON"):
        read_json_lines(file)
    file.write_text('{"a": 1}\n[]\n')
    with pytest.raises(SpecError, match=rf"^{file}:2: is no mapping"):
        read_json_lines(file)
    assert json_file.MOST_LINES_BYTES > 16_000_000
