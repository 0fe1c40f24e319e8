"""Work that other processes do comes back in order, and what they cannot do is done here."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from usarmjx.base.worker_processes import WorkerProcesses, spread, use_workers

BIG = 200_000
"""Bytes: more than a pipe holds."""


def square(number):
    print("this is no answer")
    return number * number, os.getpid()


def repeat(text):
    return text * BIG


def end_unless(pid):
    """End the process, unless it is one."""
    if os.getpid() != pid:
        os._exit(3)
    return "here"


def refuse(number):
    raise ValueError(f"no {number}")


def runs(pid):
    """Whether a process runs; one that has ended may wait for someone to ask how."""
    stat = Path(f"/proc/{pid}/stat")
    try:
        return stat.read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture(scope="module")
def workers():
    return WorkerProcesses(2)


def test_results_are_in_the_items_order_and_made_elsewhere(workers):
    found = workers.map(square, range(7))
    assert [one for one, _ in found] == [n * n for n in range(7)]
    makers = [pid for _, pid in found]
    assert len(set(makers)) == 2
    assert os.getpid() not in makers
    assert [pid for _, pid in workers.map(square, range(3))] == makers[:3]  # they go on
    assert workers.map(square, []) == []


def test_what_is_sent_may_be_larger_than_a_pipe(workers):
    assert workers.map(repeat, ["ab", "c", "d"]) == [text * BIG for text in ("ab", "c", "d")]


def test_what_one_of_them_cannot_do_is_done_here(workers):
    assert workers.map(lambda n: n + 1, range(4)) == [1, 2, 3, 4]  # not to be pickled
    with pytest.raises(ValueError, match="no 0"):
        workers.map(refuse, range(3))
    assert workers.map(repeat, ["x"]) == ["x" * BIG]


def test_a_worker_that_has_ended_is_done_without():
    workers = WorkerProcesses(2)
    assert workers.map(end_unless, [os.getpid()] * 3) == ["here"] * 3
    assert [one for one, _ in workers.map(square, range(3))] == [0, 1, 4]


def test_without_any_all_is_done_here():
    assert WorkerProcesses(0).map(square, [3]) == [(9, os.getpid())]
    assert spread(square, [3]) == [(9, os.getpid())]


def test_spread_uses_those_of_its_thread_for_as_long_as_it_is_told(workers):
    with use_workers(workers):
        assert os.getpid() not in {pid for _, pid in spread(square, range(4))}
    assert {pid for _, pid in spread(square, range(4))} == {os.getpid()}


def test_they_end_with_the_process_that_began_them_and_run_no_script_again(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "print('begun', flush=True)\n"
        "import os\n"
        "from usarmjx.base.worker_processes import WorkerProcesses\n"
        "print(*WorkerProcesses(1).map(abs, [-4]), flush=True)\n"
        "workers = WorkerProcesses(1, ['usarmjx.base.files'])\n"
        "print(workers._processes[0].pid, flush=True)\n"
        "os._exit(0)\n"  # no finalizer runs
    )
    out = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=120, check=True
    )
    begun, result, pid = out.stdout.split()
    assert (begun, result) == ("begun", "4")
    until = time.monotonic() + 60
    while runs(int(pid)):
        assert time.monotonic() < until, f"process {pid} still runs"
        time.sleep(0.1)
