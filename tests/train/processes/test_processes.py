"""Two processes with half of the worlds each learn what one with all of them learns."""

import json
import sys
import time

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.train.runs import CONFIG, PATIENCE, PROGRAM, array_checksums, lines, started
from usarmjx.base.errors import UsageError
from usarmjx.train.learning.checkpoint import read_policy
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.launch import ProcessInfo, check_parent, process_info, spawn

SPAWN = """
import sys
from usarmjx.train.learning.launch import spawn
sys.exit(spawn(2, [sys.executable, *sys.argv[1:]]))
"""

# Gradients are summed in another order: single precision differs by some 1e-7 of them in an update, and
# Adam divides by their size; over the 160 updates of the run that grew to 1e-6 of what is written down.
LOSSES = 2e-3
WEIGHTS = 2e-3
SAME_EPISODES = 0.05
"""A robot that arrives by a hair may do so a step later: score and lengths are means of some 50 episodes."""


@pytest.fixture(scope="module")
def two(cache, tmp_path_factory):
    """Folder of a run of two processes, each with half of the worlds."""
    folder = tmp_path_factory.mktemp("two") / "run"
    with started([sys.executable, "-c", SPAWN, *PROGRAM, str(folder)], cache) as process:
        output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, output
    return folder


@pytest.mark.thorough
def test_two_processes_collect_what_one_collects(reference, two):
    """Before anything is learned it is the same, to the bit: worlds and noise know only their world's number.

    Means over the worlds are of whole numbers, or of the same numbers added up in two parts.
    """
    one, other = lines(reference)[0], lines(two)[0]
    for name in ("agent_steps", "episodes", "score", "length", "timeouts", "bad", "end/success"):
        assert one[name] == other[name]
    assert_allclose(one["return"], other["return"], rtol=1e-6)


@pytest.mark.thorough
def test_two_processes_have_the_learning_curve_of_one(reference, two):
    for one, other in zip(lines(reference), lines(two), strict=True):
        assert one.keys() == other.keys()
        for name in one:
            if name.startswith("loss/"):
                assert_allclose(other[name], one[name], atol=LOSSES, rtol=LOSSES, err_msg=name)
            else:
                assert_allclose(other[name], one[name], rtol=SAME_EPISODES, err_msg=name, atol=0.02)
    assert lines(two)[-1]["score"] > 0.8


@pytest.mark.thorough
def test_two_processes_end_with_the_weights_of_one(reference, two):
    import jax

    one, other = (jax.tree.leaves(read_policy(folder, "last")[1]) for folder in (reference, two))
    for weights, same in zip(one, other, strict=True):
        assert_allclose(same, weights, atol=WEIGHTS)
    assert any(np.abs(weights).max() > 0.1 for weights in one)


@pytest.mark.thorough
def test_each_process_has_its_own_worlds_in_the_checkpoint(two):
    """And both have the same train state."""
    folder = two / "checkpoints" / "00000010"
    part = {file.stem: array_checksums(file) for file in folder.glob("*_[01].npz")}
    assert part["learner_0"] == part["learner_1"]
    sizes = [{name: size for name, (_, size) in part[f"worlds_{i}"].items()} for i in (0, 1)]
    assert sizes[0] == sizes[1]
    assert part["worlds_0"] != part["worlds_1"]
    assert json.loads((folder / "meta.json").read_text())["processes"] == 2


def test_numbers_of_processes_that_the_worlds_cannot_be_shared_out_to_are_refused():
    CONFIG.check_processes(2)
    with pytest.raises(UsageError, match="3 processes cannot share: set shuffle_blocks to a multiple of 3"):
        CONFIG.check_processes(3)
    Config(num_worlds=96, num_minibatches=4, shuffle_blocks=3).check_processes(3)


@pytest.mark.parametrize(
    ("environment", "info"),
    [
        ({}, None),
        ({"SLURM_NTASKS": "1", "SLURM_PROCID": "0"}, None),
        ({"SLURM_NTASKS": "4", "SLURM_PROCID": "3", "SLURM_LOCALID": "1"}, ProcessInfo(4, 3, 1)),
        ({"OMPI_COMM_WORLD_SIZE": "2", "OMPI_COMM_WORLD_RANK": "1"}, ProcessInfo(2, 1, 1)),
        (
            {"WORLD_SIZE": "8", "RANK": "5", "LOCAL_RANK": "1", "MASTER_ADDR": "h", "MASTER_PORT": "9"},
            ProcessInfo(8, 5, 1, "h:9"),
        ),
        (
            {"USARMJX_PROCESSES": "2", "USARMJX_PROCESS": "0", "USARMJX_COORDINATOR": "127.0.0.1:1"},
            ProcessInfo(2, 0, 0, "127.0.0.1:1"),
        ),
    ],
)
def test_launchers_are_understood(environment, info):
    assert process_info(environment) == info


def test_torchrun_without_an_address_is_refused():
    with pytest.raises(UsageError, match="MASTER_ADDR"):
        process_info({"WORLD_SIZE": "2", "RANK": "0"})


def test_a_process_that_fails_ends_the_others_and_its_exit_code_is_returned():
    """Else they would wait for it for ever."""
    code = "import os, sys, time; sys.exit(7) if os.environ['USARMJX_PROCESS'] == '1' else time.sleep(300)"
    assert spawn(2, [sys.executable, "-c", code]) == 7
    assert spawn(2, [sys.executable, "-c", "pass"]) == 0


def test_a_process_whose_parent_is_gone_ends(monkeypatch):
    check_parent()
    monkeypatch.setenv("USARMJX_PARENT", "1")
    with pytest.raises(SystemExit, match="is gone"):
        check_parent()


LOST = """
from usarmjx.base.errors import UsageError
from usarmjx.train.learning.processes import ProcessGroup, distributed_run
with distributed_run() as info:
    group = ProcessGroup()
    group.barrier("here")
    assert group.everywhere(True)
    assert not group.everywhere(info.index == 0), "what is false in one is not true everywhere"
    if info.index == 1:
        raise UsageError("this one is lost")
    group.barrier("there")
"""


def test_a_process_that_fails_does_not_wait_for_the_others(cache):
    """JAX would have it wait for five minutes for the one that waits for it."""
    began = time.monotonic()
    with started([sys.executable, "-c", SPAWN, "-c", LOST], cache) as process:
        output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode  # of the one that was lost, or of the one that lost it
    assert "usarmjx: this one is lost" in output
    assert time.monotonic() - began < 240
