"""What cannot be written is one line, and what was there before is whole."""

import errno
import os
import resource
from contextlib import contextmanager
from pathlib import Path

import pytest

from usarmjx.base.errors import UsageError, WriteError
from usarmjx.base.files import AppendedFile, atomic_write, disk_error, writing


@contextmanager
def largest_file(size):
    """No file may grow beyond this, as on a disk that is full; the system's own refusal."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def write(path, text):
    with atomic_write(path) as fresh:
        fresh.write_text(text)


def test_what_was_there_stays_whole_when_the_rest_does_not_fit(tmp_path):
    path = tmp_path / "deep" / "figures.json"
    write(path, "first")
    with largest_file(100), pytest.raises(WriteError) as caught:
        write(path, "second" * 100)
    assert str(caught.value) == f"cannot write {path}: File too large"
    assert path.read_text() == "first"
    write(path, "second" * 100)
    assert path.read_text() == "second" * 100
    assert [file.name for file in path.parent.iterdir()] == ["figures.json"]


def test_a_write_that_is_broken_off_leaves_nothing(tmp_path):
    def write_half():
        with atomic_write(tmp_path / "new.txt") as fresh:
            fresh.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert not list(tmp_path.iterdir())


def test_writers_with_one_process_id_do_not_tear_a_file(tmp_path, monkeypatch):
    """As in containers that share a folder: their partial files have other names, and the last one counts."""
    monkeypatch.setattr(os, "getpid", lambda: 7)
    path = tmp_path / "cell.json"
    with atomic_write(path) as first, atomic_write(path) as second:
        assert first != second
        first.write_text("first" * 1000)
        second.write_text("second")
    assert path.read_text() == "first" * 1000, "the outer one ends last"
    assert [file.name for file in tmp_path.iterdir()] == ["cell.json"]


def test_a_partial_file_of_another_writer_is_not_written_to(tmp_path, monkeypatch):
    names = iter(["taken", "taken", "free"])
    monkeypatch.setattr("usarmjx.base.files.secrets.token_hex", lambda size: next(names))
    with atomic_write(tmp_path / "cell.json") as first, atomic_write(tmp_path / "cell.json") as second:
        assert ("taken" in first.name, "free" in second.name) == (True, True)


def test_the_new_file_has_its_ending_while_it_is_written(tmp_path):
    """By which some libraries choose its format; whoever looks for such files does not see it."""
    with atomic_write(tmp_path / "plan.png") as fresh:
        assert (fresh.suffix, fresh.name[0], fresh.parent) == (".png", ".", tmp_path)
        fresh.touch()


def test_a_full_device_is_written_to_as_it_is():
    """And is still a device afterwards."""
    with pytest.raises(WriteError, match=r"^cannot write /dev/full: No space left on device$"):
        write(Path("/dev/full"), "too much")
    assert not Path("/dev/full").is_file()


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real").write_text("first")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write(tmp_path / "link", "second")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "second"


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EACCES])
def test_the_reason_is_in_the_systems_words(tmp_path, monkeypatch, number):
    def refuse(*_, **__):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "mkdir", refuse)
    with pytest.raises(WriteError) as caught:
        write(tmp_path / "new" / "file", "text")
    assert str(caught.value) == f"cannot write {tmp_path / 'new' / 'file'}: {os.strerror(number)}"


def test_what_is_no_fault_of_the_disk_is_none(tmp_path):
    assert disk_error(ValueError("no")) is None
    assert disk_error(FileNotFoundError(errno.ENOENT, "gone")) is None
    above = RuntimeError("saving failed")
    above.__cause__ = OSError(errno.EROFS, "whatever")
    assert disk_error(above) == "Read-only file system"
    with pytest.raises(UsageError, match="no disk"), writing(tmp_path):
        raise UsageError("it was no disk")


def test_a_line_that_does_not_fit_is_not_half_there(tmp_path):
    file = AppendedFile(tmp_path / "lines")
    file.append(b"first\n")
    with largest_file(10), pytest.raises(WriteError, match="File too large"):
        file.append(b"second\n")
    assert (tmp_path / "lines").read_bytes() == b"first\n"
    assert file.waiting == 1
    file.append(b"third\n")
    file.close()
    assert (tmp_path / "lines").read_bytes() == b"first\nsecond\nthird\n"
    assert file.waiting == 0
