"""Files of a run that are damaged: one line with file and line, and no number that nobody has measured."""

import io
import json
import zipfile

import numpy as np
import pytest

from tests.train.handmade import policy_file
from usarmjx.base.errors import UsageError
from usarmjx.base.settings.json_file import kept_text
from usarmjx.train.envs.env import AgentGroup
from usarmjx.train.learning.checkpoint import FORMAT, Checkpoints, read_part, write_part
from usarmjx.train.learning.config import RECORD_FILE, SET_FILE, Config, RunRecord, load_record, load_seeds
from usarmjx.train.learning.metrics import read_lines
from usarmjx.train.policies.policy_file import read_arrays

LINE = {"iteration": 1, "agent_steps": 1024, "steps_per_s": 86.4, "score": 0.0}


def refused(call, *given):
    """Return the line of a refusal."""
    with pytest.raises(UsageError) as caught:
        call(*given)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ((json.dumps(LINE) + "\n").encode("utf-16"), ":1: is no JSON: 'utf-8' codec"),
        (
            b'{"iteration": 1, "return": -0.84, "adient": 1.5}\n',
            ":1: agent_steps is nothing, expected a number",
        ),
        (b"[1]\n", ":1: is no mapping of names to values"),
        (b"[" * 100_000 + b"\n", ":1: is nested too deeply"),
        (json.dumps({**LINE, "score": "x"}).encode() + b"\n", ":1: score is 'x', expected a number or null"),
        (json.dumps({**LINE, "steps_per_s": 0}).encode() + b"\n", ":1: steps_per_s is 0, expected a number"),
    ],
)
def test_a_damaged_record_of_iterations_is_one_line(tmp_path, content, message):
    file = tmp_path / "metrics.jsonl"
    file.write_bytes(content)
    assert refused(read_lines, file).startswith(f"{file}{message}")


def test_what_is_whole_is_read_and_a_last_line_that_is_cut_left_out(tmp_path):
    file = tmp_path / "metrics.jsonl"
    assert read_lines(file) == []
    file.write_text(json.dumps(LINE) + "\n" + json.dumps({**LINE, "score": None}) + "\n" + '{"iter')
    assert [line["score"] for line in read_lines(file)] == [0.0, None]


def changed(content):
    """Yield a content with each of its bits flipped, one of each byte."""
    for place in range(len(content)):
        damaged = bytearray(content)
        damaged[place] ^= 1 << place % 8
        yield bytes(damaged)


def test_no_flipped_bit_changes_what_is_kept_of_a_checkpoint(tmp_path):
    folder = tmp_path / "checkpoints" / "00000003"
    folder.mkdir(parents=True)
    meta = {"format": FORMAT, "iteration": 3, "agent_steps": 1000, "score": 0.5}
    file = folder / "meta.json"
    file.write_text(kept_text(meta, indent=None))
    checkpoints = Checkpoints(tmp_path)
    assert checkpoints.meta(folder) == meta
    for content in changed(file.read_bytes()):
        file.write_bytes(content)
        try:
            found = checkpoints.meta(folder)
        except UsageError:
            continue
        assert {name: found[name] for name in meta} == meta  # where the checksum has lost its name
    file.write_text(json.dumps({**meta, "score": "best"}))
    assert "is broken: meta.json does not read" in refused(checkpoints.find, "best")


def test_no_flipped_bit_changes_the_arrays_of_a_checkpoint(tmp_path):
    """The ZIP file has a checksum of each array; what it has none of are names and times."""
    tree = {"weights": np.arange(3, dtype=np.float32)}
    write_part(tmp_path, "learner", tree)
    file = tmp_path / "learner_0.npz"
    for content in changed(file.read_bytes()):
        file.write_bytes(content)
        try:
            found = read_part(tmp_path, "learner", tree)
        except UsageError:
            continue
        np.testing.assert_array_equal(found["weights"], tree["weights"])


def test_no_flipped_bit_changes_a_policy(tmp_path):
    file = policy_file(tmp_path / "policy.npz")
    expected, arrays = read_arrays(file)
    with zipfile.ZipFile(file) as held:
        members = {one.filename: held.read(one) for one in held.infolist()}
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as held:  # few bytes: `about` and the smallest array
        for name in ("about.npy", min(members, key=lambda one: len(members[one]))):
            held.writestr(name, members[name])
    file.write_bytes(packed.getvalue())
    for number, content in enumerate(changed(packed.getvalue())):
        if number % 3:
            continue
        file.write_bytes(content)
        try:
            about, found = read_arrays(file)
        except UsageError:
            continue
        assert about == expected
        for name, array in found.items():
            np.testing.assert_array_equal(array, arrays[name])


def test_no_flipped_bit_changes_the_settings_of_a_run(tmp_path):
    group = AgentGroup("P2AT", ("p0",), 3, 2)
    record = RunRecord(
        task="wander",
        groups=(group,),
        privileged_size=0,
        episode_steps=100,
        period=0.2,
        processes=1,
        config=Config(),
    )
    record.save(tmp_path)
    file = tmp_path / RECORD_FILE
    assert load_record(tmp_path) == record
    for number, content in enumerate(changed(file.read_bytes())):
        if number % 4:  # each reading takes a millisecond
            continue
        file.write_bytes(content)
        try:
            assert load_record(tmp_path) == record
        except UsageError:
            continue
    file.write_text("[]")
    assert refused(load_record, tmp_path).startswith(f"{file}: is no mapping")


@pytest.mark.parametrize("seeds", ["[1e999]", "[1.5]", '"34"', "{}", "[null]"])
def test_seeds_that_are_none_are_one_line(tmp_path, seeds):
    file = tmp_path / SET_FILE
    file.write_text(kept_text({"format": 1, "seeds": json.loads(seeds)}).replace("Infinity", "1e999"))
    assert refused(load_seeds, tmp_path).startswith(f"{file}: seeds")
