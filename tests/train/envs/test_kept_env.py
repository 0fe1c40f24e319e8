"""An environment's programs are kept from one start to the next, and are those of its task and scene."""

import warnings
from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.train.envs.test_restart import bits
from usarmjx.base import program_cache
from usarmjx.base.compilation import PROGRAMS_FOLDER
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import DomainRandomization
from usarmjx.models.robots import ROBOTS
from usarmjx.train.envs.env import Env, env_program_cache
from usarmjx.train.envs.recipe import open_floor
from usarmjx.train.make import make_task
from usarmjx.train.tasks import TASKS
from usarmjx.train.tasks.drive_to_goal import DriveToGoal

LIGHT = {"ranges": (), "pose": "GroundTruth", "physics": Physics(timestep=0.01, substeps=5), "repeat": 4}
TASK = make_task("drive-to-goal", **LIGHT)


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setenv(PROGRAMS_FOLDER, str(tmp_path))
    monkeypatch.setattr(program_cache, "_sources", lambda: "as they are")
    return tmp_path


def digest(task, worlds=1, engine="c", first=0):
    return env_program_cache(task, task.scene(), worlds, engine, first).path("", "").name


def play(task):
    env = Env(task, 2, engine="c")
    state = env.reset(3)
    for _ in range(2):
        state = env.step(state, (np.full((2, 1, 2), 0.5, np.float32),))
    return bits(state.replace(batch=state.batch.replace(physics=None))), state.batch.physics.qpos


@pytest.mark.thorough
def test_the_second_start_traces_nothing_and_computes_the_same(kept, monkeypatch):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing of it is not kept
        first = play(TASK)

        def traced(*_):
            raise RuntimeError("it was traced")

        for name in ("start", "observe", "evaluate", "act"):
            monkeypatch.setattr(DriveToGoal, name, traced)
        jax.tree.map(np.testing.assert_array_equal, first, play(TASK))
        with pytest.raises(RuntimeError, match="it was traced"):
            _ = Env(replace(TASK, radius=0.6), 2, engine="c").groups
        monkeypatch.delenv(PROGRAMS_FOLDER)
        with pytest.raises(RuntimeError, match="it was traced"):
            _ = Env(TASK, 2, engine="c").groups


def test_each_part_of_an_environment_is_in_the_digest(kept):
    floor = open_floor(starts=8)
    moved = replace(floor, starts=(replace(floor.starts[0], yaw=0.1), *floor.starts[1:]))
    tasks = [
        TASK,
        *(replace(TASK, robot=robot) for robot in ("P2DX", replace(ROBOTS.get("P2AT"), battery_life=9.0))),
        *(replace(TASK, arena=arena) for arena in (floor, moved, (floor,), (floor, moved), "yellow")),
        replace(TASK, radius=0.6),
        replace(TASK, repeat=5),
        replace(TASK, shuffle=False),
        replace(TASK, physics="fast"),
        replace(TASK, vary=DomainRandomization(mass=(0.9, 1.1))),
        replace(TASK, vary=DomainRandomization(mass=(0.9, 1.2))),
    ]
    digests = [
        *map(digest, tasks),
        digest(TASK, worlds=2),
        digest(TASK, engine="planar"),
        digest(TASK, first=1),
    ]
    assert len(set(digests)) == len(digests)
    assert digest(TASK) == digests[0]


def test_a_robot_that_is_described_otherwise_under_its_name_is_another(kept):
    before, usual = digest(TASK), ROBOTS.get("P2AT")
    try:
        ROBOTS.replace("P2AT", replace(usual, battery_life=9.0))
        assert digest(TASK) != before
    finally:
        ROBOTS.replace("P2AT", usual)
    assert digest(TASK) == before


class Own(DriveToGoal):
    """A task from elsewhere, whose sources nobody looks at."""


def test_programs_of_own_tasks_are_not_kept(kept):
    assert env_program_cache(Own(**LIGHT), TASK.scene(), 1, "c", 0) is None


@pytest.mark.parametrize("name", TASKS.names())
def test_all_that_our_tasks_are_made_of_has_a_digest(kept, name):
    small = {"arena": open_floor(starts=16)} if name in ("wander", "drive-to-goal") else {}
    task = make_task(name, **small)
    assert env_program_cache(task, TASK.scene(), 1, "c", 0) is not None
