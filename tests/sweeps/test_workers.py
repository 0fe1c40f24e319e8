"""Other processes and Ray: all is done, once, also when workers are lost."""

import builtins
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from usarmjx.base.errors import UsageError
from usarmjx.sweeps import workers
from usarmjx.sweeps.workers import TRIES, Workers, children, end_with_this_process, gpus

work = builtins.eval
"""What a worker can import without importing tests: a piece of work is an expression."""


def outcomes(workers, pieces):
    return {number: (value, why) for number, value, why in workers.run(work, pieces)}


def test_processes_do_everything_and_what_a_lost_worker_did_again(tmp_path):
    """The first to come to one piece is killed there, as by the system; another kills all who try it."""
    flag = tmp_path / "was-here"
    once = (
        f"(lambda os, p: 'late' if os.path.exists(p) else (open(p, 'w').close(), os.kill(os.getpid(), 9)))"
        f"(__import__('os'), {str(flag)!r})"
    )
    always = "__import__('os').kill(__import__('os').getpid(), 9)"
    pieces = ["1 + 1", once, "2 * 3", "1 / 0", always, "'end'"]
    found = {
        number: (value, why) for number, value, why in Workers(place="processes", count=1).run(work, pieces)
    }
    assert found == {
        0: (2, None),
        1: ("late", None),
        2: (6, None),
        3: (None, "division by zero"),
        4: (
            None,
            f"its worker was lost {TRIES} times, by SIGKILL, as the system does when memory runs out",
        ),
        5: ("end", None),
    }


def test_workers_are_other_processes():
    ids = [
        value
        for _, value, _ in Workers(place="processes", count=2).run(work, ["__import__('os').getpid()"] * 2)
    ]
    assert os.getpid() not in ids


def test_what_ends_its_worker_fails_alone():
    """Neighbours that were at work then are not even begun again."""
    bad, slow = "__import__('os')._exit(9)", "(__import__('time').sleep(0.5), __import__('os').getpid())[1]"
    found = outcomes(Workers(place="processes", count=2), [bad, slow, slow, slow])
    assert found.pop(0) == (None, f"its worker was lost {TRIES} times, with exit status 9")
    assert {why for _, why in found.values()} == {None}
    assert len(found) == 3


def test_an_idle_worker_that_is_killed_ends_nothing():
    """Between two pieces, as by the system for the memory of another."""
    done = Workers(place="processes", count=1).run(work, ["__import__('os').getpid()", "1 + 1", "2 + 2"])
    number, process, why = next(done)
    assert (number, why) == (0, None)
    (child,) = [one for one in multiprocessing.active_children() if one.pid == process]
    os.kill(process, signal.SIGKILL)
    child.join(60.0)
    assert child.exitcode == -signal.SIGKILL
    assert list(done) == [(1, 2, None), (2, 4, None)]


def test_what_a_worker_makes_of_odd_ends_is_a_line():
    pieces = ["__import__('sys').exit(3)", "lambda: 0", "1 + 1"]
    found = outcomes(Workers(place="processes", count=1), pieces)
    assert found[0] == (None, "SystemExit")
    assert "pickle" in found[1][1]
    assert found[2] == (2, None)


def test_a_worker_ends_with_its_parent(tmp_path):
    """The parent is killed, and cannot tell its worker to end."""
    said = tmp_path / "worker"
    piece = f"(open({str(said)!r}, 'w').write(str(__import__('os').getpid())), __import__('time').sleep(60))"
    code = (
        "import builtins; from usarmjx.sweeps.workers import Workers\n"
        f"list(Workers(place='processes', count=1).run(builtins.eval, [{piece!r}]))"
    )
    parent = subprocess.Popen([sys.executable, "-c", code])
    try:
        await_true(lambda: said.exists() and said.read_text())
    finally:
        parent.kill()
        parent.wait()
    await_true(lambda: not is_alive(int(said.read_text())))


def await_true(condition):
    for _ in range(600):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("it did not become true in 30 s")


def is_alive(process):
    try:
        return " Z " not in Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False


def test_what_ray_starts_ends_with_the_process_that_started_it():
    """A process in Ray's place: a child of a parent that is killed, and is not told to end."""
    code = (
        "import subprocess, sys; from usarmjx.sweeps.workers import children, end_with_this_process\n"
        "before = children(); child = subprocess.Popen(['sleep', '60'])\n"
        "guard = end_with_this_process(children() - before); print(child.pid, flush=True); sys.stdin.read()"
    )
    pipe = subprocess.PIPE
    parent = subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe)
    child = int(parent.stdout.readline())
    assert is_alive(child)
    parent.kill()
    parent.wait()
    await_true(lambda: not is_alive(child))
    assert end_with_this_process(children() - children()) is None


def test_no_worker_is_counted_without_a_piece(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,1,2")
    sizes = {
        (place, count, pieces): Workers(place=place, count=count).size(pieces)
        for place, count, pieces in (
            *(("here", None, 9), ("processes", None, 9), ("processes", None, 2), ("processes", 4, 9)),
            *(("processes", 4, 1), ("processes", 4, 0), ("ray", 8, 2)),
        )
    }
    assert list(sizes.values()) == [1, 3, 2, 4, 1, 1, 2]


def test_gpus_are_those_that_may_be_used(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,3")
    assert gpus() == 2
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "-1")
    assert gpus() == 0
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert gpus() == 0


def test_without_ray_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError, match=r"needs Ray: pip install .*\[sweep\]"):
        list(Workers(place="ray").run(work, ["1"]))


@pytest.mark.tools
def test_ray_does_everything_and_what_a_lost_worker_did_again(tmp_path):
    flag = tmp_path / "was-here"
    once = (
        f"(lambda os, p: 'late' if os.path.exists(p) else (open(p, 'w').close(), os._exit(1)))"
        f"(__import__('os'), {str(flag)!r})"
    )
    found = {
        n: (value, why) for n, value, why in Workers(place="ray", count=2).run(work, ["1 + 1", once, "1 / 0"])
    }
    assert found == {0: (2, None), 1: ("late", None), 2: (None, "division by zero")}


@pytest.mark.tools
def test_results_larger_than_the_object_store_of_ray_all_arrive(ray_head):
    with ray_head("--object-store-memory", str(80 * 2**20)) as address:
        workers = Workers(place="ray", count=2, address=address)
        assert outcomes(workers, ["(60 << 20) * b'1'"] * 4) == dict.fromkeys(
            range(4), (b"1" * (60 << 20), None)
        )


@pytest.mark.tools
def test_a_restarted_head_of_ray_is_joined_again_and_all_is_done_once(ray_head, monkeypatch, caplog):
    monkeypatch.setattr(workers, "SILENCE", 2.0)
    monkeypatch.setattr(workers, "ANSWER", 10.0)
    pieces = [f"(__import__('time').sleep(1), {number})[1]" for number in range(6)]
    with ExitStack() as stack:
        first = stack.enter_context(ExitStack())
        address = first.enter_context(ray_head())
        done = []
        for number, value, why in Workers(place="ray", count=1, address=address).run(work, pieces):
            done.append((number, value, why))
            if number == 1:
                first.close()
                stack.enter_context(ray_head())
    assert sorted(done) == [(number, number, None) for number in range(6)]
    assert caplog.messages == ["the cluster of Ray does not answer any more; connecting to it again"]


@pytest.mark.tools
def test_a_cluster_of_ray_that_does_not_come_back_ends_in_one_line(ray_head, monkeypatch):
    for name, seconds in {"SILENCE": 2.0, "ANSWER": 10.0}.items():
        monkeypatch.setattr(workers, name, seconds)
    with ray_head() as address:
        found = Workers(place="ray", count=1, address=address).run(work, ["1", "__import__('time').sleep(9)"])
        assert next(found) == (0, 1, None)
    monkeypatch.setattr(workers, "RETURN", 0.0)
    with pytest.raises(UsageError, match=f"Ray does not start at {address}: .*; finished cells are kept"):
        list(found)


@pytest.fixture
def ray_head():
    """Start the head of a cluster with some options, as a context; all heads have the same address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"

    @contextmanager
    def start(*options):
        command = [sys.executable, "-m", "ray.scripts.scripts", "start", "--head", "--block", "--num-cpus=2"]
        command += ["--include-dashboard=false", "--disable-usage-stats", f"--port={address.split(':')[1]}"]
        head = subprocess.Popen(
            [*command, *options], start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        try:
            assert any(b"Ray runtime started" in line for line in head.stdout), "it ended"
            yield address
        finally:
            os.killpg(head.pid, signal.SIGKILL)
            head.wait()

    return start
