"""Other processes and Ray: all is done, once, also when workers are lost."""

import builtins
import os
import sys

import pytest

from usarmjx.base.errors import UsageError
from usarmjx.sweeps.workers import TRIES, Workers, gpus

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
        4: (None, f"its worker was lost {TRIES} times"),
        5: ("end", None),
    }


def test_workers_are_other_processes():
    ids = [
        value
        for _, value, _ in Workers(place="processes", count=2).run(work, ["__import__('os').getpid()"] * 2)
    ]
    assert os.getpid() not in ids


def test_gpus_are_those_that_may_be_used(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "0,3")
    assert gpus() == 2
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "-1")
    assert gpus() == 0
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert gpus() == 0


def test_without_ray_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError, match=r"needs Ray: pip install usarmjx\[sweep\]"):
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
