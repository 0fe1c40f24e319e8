"""One trainer in a folder; the lock goes when its process does, however that ends."""

import os
import signal
import socket
import subprocess
import sys

import pytest

from tests.train.runs import ROOT, run
from usarmjx.base.errors import UsageError, WriteError
from usarmjx.train.learning import processes
from usarmjx.train.learning.processes import run_lock

HOLD = """
import sys
from pathlib import Path
from usarmjx.train.learning.processes import run_lock
with run_lock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_the_lock_of_a_killed_process_is_free(tmp_path):
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout.readline() == "held\n"
        with pytest.raises(UsageError) as caught, run_lock(tmp_path):
            pass
        who = f"process {process.pid} on {socket.gethostname()}"
        assert str(caught.value) == f"{who} trains in {tmp_path}: wait for its end, or choose another folder"
        process.send_signal(signal.SIGKILL)
    with run_lock(tmp_path):
        pass


def test_a_second_trainer_is_refused_also_when_the_first_has_written_nothing_yet(tmp_path):
    """`test_resume.py` has one that comes while the first one trains."""
    with run_lock(tmp_path), pytest.raises(UsageError, match=rf"^process {os.getpid()} on .* trains in .*"):
        run(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [processes.LOCK_FILE]


def test_where_nothing_can_be_locked_it_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(processes, "fcntl", None)
    with run_lock(tmp_path), run_lock(tmp_path):
        pass
    (told, _) = capsys.readouterr().err.splitlines()
    assert told == (
        "usarmjx: a second trainer in this folder would not be noticed, as it cannot be locked: "
        "this system has no fcntl"
    )


def test_a_folder_that_cannot_be_locked_because_it_cannot_be_written_to(tmp_path):
    (tmp_path / processes.LOCK_FILE).symlink_to("/dev/full")
    with pytest.raises(WriteError, match=r"trainer.lock: "), run_lock(tmp_path):
        pass
