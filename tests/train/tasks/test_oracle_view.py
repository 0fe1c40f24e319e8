"""A teacher that knows the building: what it sees of goals, and what a policy learns of it."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.tasks.test_goal_planner import CELL, observation
from usarmjx.base.errors import SpecError, UnknownNameError, UsageError
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.ppo import teacher_obs, teacher_of
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.train_state import policy_params
from usarmjx.train.make import make
from usarmjx.train.mapping.maps import FREE, MapGrid
from usarmjx.train.tasks import TASKS, Buildings
from usarmjx.train.tasks.goal_features import (
    FIRST_GOAL,
    FIRST_MATE,
    GOAL_NUMBERS,
    GOALS,
    MATE_NUMBERS,
    OBSERVED_MATES,
    chosen_goal,
)
from usarmjx.train.tasks.learned_vectors import joined_vectors
from usarmjx.train.tasks.oracle_view import oracle_obs, true_news, way_beyond

GRID = MapGrid(low=(0.0, 0.0), cell=CELL, shape=(40, 40))
HALL = np.zeros(GRID.shape, bool)
HALL[8:32] = True
LEFT, RIGHT = 3, 5
"""Frontiers in the squares (20, 15) and (20, 28)."""


def memory_of():
    """The hall is on somebody's map but for its last seven columns; the base has ten columns of it."""
    known = np.zeros((2, *GRID.shape), np.uint8)
    known[0, 8:32, :10] = known[1, 8:32, :33] = FREE
    position = np.zeros((2, GOALS, 2), np.float32)
    position[1, [LEFT, RIGHT]] = CELL * np.array([[20, 15], [20, 28]])
    return SimpleNamespace(
        belief=SimpleNamespace(squares=jnp.asarray(known)),
        reachable=jnp.asarray(HALL),
        extra=SimpleNamespace(goals=SimpleNamespace(position=jnp.asarray(position))),
    )


class HallTask:
    """Stand-in for a task, with the methods that the view calls; the robot is in slot 1."""

    news_kind, news_worth = FREE, 1.0
    message_floats = 0
    unfound = TASKS.get("explore-v3").unfound

    def arena_grid(self, scene):
        return GRID

    def per_group(self, scene, values):
        return (values[1:],)


SCENE = SimpleNamespace(groups=[SimpleNamespace(robot=SimpleNamespace(name="ComStation"), slots=[0])])


@pytest.mark.oracle
def test_frontiers_count_with_the_way_to_what_lies_beyond():
    task, memory = HallTask(), memory_of()
    beyond = np.asarray(way_beyond(task, SCENE, memory))[1]
    # Straight on to column 33, from the neighbour of the frontier that is next to it.
    assert beyond[[LEFT, RIGHT]].tolist() == pytest.approx([33 - 16, 33 - 29], abs=1e-3)
    news = 24 * (33 - 10)
    assert float(true_news(task, SCENE, memory)[1]) == news
    seen = observation(frontiers=((LEFT, 9.0), (RIGHT, 12.0)))
    assert chosen_goal(seen, CELL, report=False) == LEFT
    (known,) = oracle_obs(task, SCENE, memory, (jnp.asarray(seen[None]),))
    goals = np.asarray(known[0, FIRST_GOAL:])[: GOALS * GOAL_NUMBERS].reshape(GOALS, GOAL_NUMBERS)
    assert goals[[LEFT, RIGHT], 2].tolist() == pytest.approx([(9 + 17) / 100, (12 + 4) / 100], abs=1e-4)
    assert float(known[0, 5]) == pytest.approx(news / 1000)
    assert chosen_goal(known[0], CELL, report=False) == RIGHT


def test_vectors_of_others_move_no_number_that_the_oracle_knows_better():
    task, memory, seen = HallTask(), memory_of(), observation(frontiers=((LEFT, 9.0), (RIGHT, 12.0)))
    mate = np.zeros((OBSERVED_MATES, MATE_NUMBERS), np.float32)
    mate[0, 0] = 1.0
    seen[FIRST_MATE:FIRST_GOAL] = mate.ravel()
    (known,) = oracle_obs(task, SCENE, memory, (jnp.asarray(seen[None]),))
    task.message_floats = 3
    vectors = np.zeros((1, OBSERVED_MATES, 3 + 2), np.float32)
    vectors[0, 0] = (1.0, 0.25, -0.5, 0.5, 1.0)
    with_vectors = joined_vectors(seen[None], jnp.asarray(vectors))
    (found,) = oracle_obs(task, SCENE, memory, (with_vectors,))
    np.testing.assert_array_equal(found, joined_vectors(known, jnp.asarray(vectors)))


def test_teachers_are_checked():
    with pytest.raises(SpecError, match="teacher is oracle, but imitation_steps is 0"):
        Config(teacher="oracle")
    driving = SimpleNamespace(name="drive-to-goal", task=TASKS.get("drive-to-goal"))
    with pytest.raises(UsageError, match="teacher is oracle, which only tasks whose robots choose goals"):
        teacher_of(driving, "oracle")
    with pytest.raises(UnknownNameError, match="nobody is no folder of a run"):
        teacher_of(driving, "nobody")


@pytest.mark.thorough
def test_a_policy_agrees_more_with_the_oracle_after_it_imitated_it():
    small = Buildings(levels=(0.4,), count=2, size=(6, 5), together=True, spacing=1.2)
    env = make("explore-v3", worlds=8, engine="planar", physics="coarse", arena=small, count=2)
    step = 8 * 8 * 2
    config = Config(
        num_worlds=8,
        rollout_length=8,
        action_repeat=env.task.hold,
        num_minibatches=2,
        network="set",
        hidden_sizes=(16, 16),
        critic_hidden_sizes=(8, 8),
        learning_rate=3e-3,
        teacher="oracle",
        imitation_steps=40 * step,
        total_steps=40 * step,
    )
    trainer = Trainer(env, config, ProcessGroup())
    train_state, worlds = trainer.start()
    teacher, shares = teacher_of(env, "oracle"), list[float]()
    for iteration in range(40):
        train_state, worlds, known = trainer.iterate(train_state, worlds, iteration)
        assert np.isfinite(float(known["loss/imitation"]))
        state = worlds.env_state
        seen = teacher_obs(env, state.memory, state.obs, "oracle")
        _, (wanted,) = teacher.act((), seen, jax.random.key(0))
        (mine,), _ = trainer.networks.policy.act(
            policy_params(train_state), state.obs, worlds.policy_carry, deterministic=True
        )
        shares.append(float((mine.argmax(-1) == wanted.argmax(-1)).mean()))
    assert np.mean(shares[-8:]) > np.mean(shares[:2]) + 0.2, shares
