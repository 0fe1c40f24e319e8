"""A disk that is full or read-only during training: a line of it, nothing half written, and it goes on."""

import errno
import logging
import os
import re
import shutil
from contextlib import ExitStack

import jax
import pytest

from tests.base.test_files import largest_file
from tests.train.learning.test_training import on_the_board
from tests.train.runs import checksums, lines, run
from usarmjx.base.errors import WriteError
from usarmjx.train.learning.checkpoint import Checkpoints
from usarmjx.train.learning.processes import ProcessGroup


class Disk:
    """What becomes of the disk after some iterations of a run; and what was there to be found then."""

    def __init__(self, folder, monkeypatch):
        self.folder, self.monkeypatch = folder, monkeypatch
        self.full = ExitStack()
        self.found = {}

    def after(self, line):
        """Full after iterations 3 and 4, read-only after 6, and full again after 9."""
        iteration = line["iteration"]
        there = [path.name for path in (self.folder / "checkpoints").iterdir()]
        self.found[iteration] = (
            Checkpoints(self.folder).find().name,
            [n for n in there if not n.isdecimal()],
        )
        if iteration in (3, 9):
            self.full.enter_context(largest_file(1000))
        if iteration in (5, 7):
            self.full.close()
        if iteration == 6:
            patch = self.full.enter_context(self.monkeypatch.context())
            patch.setattr(os, "mkdir", read_only)


def read_only(*_, **__):
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def test_training_goes_on_and_what_is_there_is_whole(reference, tmp_path, monkeypatch, capsys):
    """To the bit, as if nothing had been; as is the earlier checkpoint while the disk is full."""
    folder = tmp_path / "run"
    disk = Disk(folder, monkeypatch)
    with disk.full, pytest.raises(WriteError) as caught:
        run(folder, watch=disk.after)
    assert re.fullmatch(
        rf"cannot write {folder}/checkpoints/00000010: File too large; the last checkpoint is missing: "
        "resume the run from the one before",
        str(caught.value),
    )
    last = {iteration: int(name) for iteration, (name, _) in disk.found.items()}
    assert last == {1: 1, 2: 2, 3: 3, 4: 3, 5: 3, 6: 6, 7: 6, 8: 8, 9: 9, 10: 9}
    assert [left for _, left in disk.found.values()] == [[]] * 10, "something half written is left"
    told = capsys.readouterr().err.splitlines()
    assert all(line.startswith("usarmjx: ") for line in told)
    for number, reason in ((4, "File too large"), (5, "File too large"), (7, "Read-only file system")):
        (line,) = [line for line in told if f"checkpoints/{number:08d}" in line]
        assert f": {reason}; training goes on" in line
    (_,) = [line for line in told if line.endswith("metrics.jsonl is written to again, and whole")]
    # Three checkpoints, and two files of the log: each when it begins, twice, and when it is over.
    assert len(told) == 3 + 6
    assert lines(folder) == lines(reference)[:9]
    assert checksums(folder) == checksums(reference, "9")
    assert {step for _, step in on_the_board(folder)} == set(range(2400, 24_000, 2400))


def test_a_folder_that_cannot_be_written_to_is_refused_before_anything_is_trained(
    reference, tmp_path, monkeypatch
):
    shutil.copytree(reference, tmp_path / "copy")
    too_large = r"^cannot write .*/copy/config.json: File too large$"
    with largest_file(100), pytest.raises(WriteError, match=too_large):
        run(tmp_path / "copy", resume=True)
    assert lines(tmp_path / "copy") == lines(reference)
    monkeypatch.setattr(os, "mkdir", read_only)
    with pytest.raises(WriteError, match=rf"^cannot write {tmp_path}/run: Read-only file system$"):
        run(tmp_path / "run")


class TwoProcesses(ProcessGroup):
    """The first of two, the other of which says what it is told to say."""

    def __init__(self, other):
        super().__init__()
        self.count, self.other = 2, other

    def everywhere(self, true):
        return true and self.other


def test_what_fails_in_one_process_has_failed_in_all(tmp_path):
    checkpoints = Checkpoints(tmp_path, TwoProcesses(other=False))
    with pytest.raises(WriteError, match=r"00000001: another process could not$"):
        checkpoints.save(1, {}, {}, {"score": None})
    assert not list((tmp_path / "checkpoints").iterdir())


def test_a_disk_that_fills_up_while_a_checkpoint_is_written(tmp_path, caplog):
    """Somewhere in the middle of an array."""
    checkpoints = Checkpoints(tmp_path)
    tree = {"some": jax.numpy.arange(10_000.0)}
    checkpoints.save(1, tree, tree, {"score": None, "agent_steps": 0})
    with (
        largest_file(1000),
        pytest.raises(WriteError, match=r"^cannot write .*/00000002: File too large$"),
    ):
        checkpoints.save(2, tree, tree, {"score": None, "agent_steps": 0})
    assert [path.name for path in (tmp_path / "checkpoints").iterdir()] == ["00000001"]
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]
