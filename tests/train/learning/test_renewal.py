"""Arenas that are trained on give way to others: which, when, and that a run that goes on meets the same."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import usarmjx
from tests.train.runs import check_goes_on
from usarmjx.base.errors import SpecError, UsageError
from usarmjx.models.compile.reachability import footprint_of
from usarmjx.models.robots import ROBOTS
from usarmjx.train.envs.recipe import held_out
from usarmjx.train.learning import learner
from usarmjx.train.learning.checkpoint import Checkpoints, read_part
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import ArenaStream, Trainer
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.trainer import train
from usarmjx.train.mapping.maps import reachable_squares
from usarmjx.train.tasks.buildings import Buildings

ARENAS = Buildings(count=2, levels=(0.5, 1.0), size=(4, 3), renewable=True)
STEPS = 3
"""Actions of an episode and of a rollout: each world meets another arena in every iteration."""
CONFIG = Config(
    total_steps=5 * STEPS * 4 * 2,  # five iterations of four worlds of two robots
    num_worlds=4, rollout_length=STEPS, num_minibatches=2, num_epochs=1,
    hidden_sizes=(4,), critic_hidden_sizes=(4,), arena_refresh_interval=2,
    checkpoint_interval=1, keep_checkpoints=10,
)  # fmt: skip


@pytest.fixture(scope="module")
def env():
    return usarmjx.make("explore-v1", 4, "c", count=2, repeat=1, arena=ARENAS, episode_steps=STEPS)


@pytest.fixture(scope="module")
def trained(env, tmp_path_factory):
    """Folder of a run."""
    folder = tmp_path_factory.mktemp("renewal") / "run"
    train(env, CONFIG, folder, progress=False)
    return folder


def same_names(arenas):
    return {arena.name for arena in arenas}


def test_the_arenas_of_a_generation_are_always_the_same_and_nobody_else_s():
    generations = [[arena.name for arena in ARENAS.renewed(number)] for number in (1, 2, 1)]
    assert generations[0] == generations[2]
    first = same_names(ARENAS.arenas())
    assert len({*first, *generations[0], *generations[1]}) == 12
    assert held_out(ARENAS.renewed(1)) is None
    assert not ARENAS.of_split("test").renewable


def test_what_does_not_fit_is_passed_over(env):
    taken = env.scene.arenas.check_fits
    first = ARENAS.renewed(1, taken)
    refused = first[2].name

    def check(arena):
        if arena.name == refused:
            raise SpecError("no room")

    others = ARENAS.renewed(1, check)
    assert [one.name == other.name for one, other in zip(first, others, strict=True)] == [1, 1, 0, 1]

    def never(arena):
        raise SpecError("no room")

    with pytest.raises(UsageError, match=r"50 generated arenas could not take the place of others: no room"):
        ARENAS.renewed(1, never)


def test_worlds_have_the_later_arenas_at_their_next_reset(env):
    """With what the task knows of them, and without another compilation."""
    library = env.redrawn_arenas(3)
    specs = ARENAS.renewed(3)
    state = env.at_level(env.reset(), 1.0, library)
    before = env._restart_some._cache_size()
    told = tuple(np.zeros((4, len(group.agents), group.action_size), np.float32) for group in env.groups)
    for _ in range(STEPS):
        state = env.step(state, told)
    assert env._restart_some._cache_size() == before
    size, grid = footprint_of(ROBOTS.get("P2AT")), env.task.arena_grid(env.scene)
    for world in range(4):
        spec = env.batch.arena_of(state.batch, world)
        assert spec in specs
        own = jax.tree.map(lambda rows, n=world: np.asarray(rows[n]), state.batch.worlds.arena_state)
        shown = own.pos[own.pos[:, 2] > -100.0]
        assert sorted(map(tuple, shown.round(4))) == sorted(
            tuple(np.float32(shape.at).round(4)) for shape in spec.shapes
        )
        assert_array_equal(own.notes["reachable"], reachable_squares(spec, grid, size))
        assert_array_equal(state.memory.reachable[world], own.notes["reachable"])


def test_arenas_that_are_not_renewable_stay(env):
    other = usarmjx.make("explore-v1", 4, "c", count=2, arena=replace(ARENAS, renewable=False))
    with pytest.raises(UsageError, match="explore-v1 cannot be replaced"):
        other.redrawn_arenas(1)
    for stream in (ArenaStream(other, 2, 6), ArenaStream(env, 0, 6)):
        assert not any(stream.is_refresh(iteration) for iteration in range(5))
        assert stream.arenas(4) is None


def test_a_stream_begins_with_the_first_arenas_and_goes_on(env):
    stream = ArenaStream(env, 2, 6)
    assert [stream.is_refresh(iteration) for iteration in range(6)] == [
        False,
        False,
        True,
        False,
        True,
        False,
    ]
    assert stream.arenas(1) is None
    assert_array_equal(stream.arenas(4).pos, env.redrawn_arenas(2).pos)
    assert_array_equal(ArenaStream(env, 2, 6).arenas(5).pos, env.redrawn_arenas(2).pos)


def test_other_processes_generate_the_same_arenas(env, monkeypatch):
    expected = env.redrawn_arenas(2)
    stream = ArenaStream(env, 2, 6, workers=2)

    def nobody(arena, number, seed):
        raise AssertionError("generated here")

    monkeypatch.setattr(Buildings, "arena", nobody)
    for one, other in zip(jax.tree.leaves(stream.arenas(4)), jax.tree.leaves(expected), strict=True):
        assert_array_equal(one, other)


@pytest.mark.parametrize(("workers", "asked"), [(0, {1}), (1, {1, 2})])
def test_processes_are_asked_for_two_generations_ahead(env, workers, asked):
    stream = ArenaStream(env, 2, 8, workers)
    assert stream.arenas(0) is None
    assert set(stream._requests) == asked
    for made in stream._requests.values():
        made.result()


@pytest.mark.parametrize(
    ("cores", "processes", "workers"), [(2, 1, 0), (7, 1, 0), (8, 1, 4), (16, 1, 6), (64, 8, 4)]
)
def test_there_are_workers_where_cores_are_left_for_them(monkeypatch, cores, processes, workers):
    monkeypatch.setattr(learner, "cores", lambda: cores)
    assert learner.workers_for(processes) == workers


def test_no_arenas_are_generated_that_no_iteration_would_meet(env, monkeypatch):
    asked = []
    monkeypatch.setattr(env, "redrawn_arenas", asked.append)
    stream = ArenaStream(env, 2, 5)
    for iteration in range(5):
        stream.arenas(iteration)
    stream._pool.shutdown()
    assert asked == [1, 2]


@pytest.mark.thorough
def test_a_run_trains_on_each_generation_for_its_iterations(env, trained):
    _, template = Trainer(env, CONFIG, ProcessGroup()).start()
    expected = [env.scene.arenas.states, env.redrawn_arenas(1), env.redrawn_arenas(2)]
    for iteration, path in enumerate(Checkpoints(trained).all()):
        state = read_part(path, "worlds", template).env_state
        assert_array_equal(state.batch.arenas.serial, expected[iteration // 2].serial)
        assert_array_equal(state.batch.arenas.pos, expected[iteration // 2].pos)


@pytest.mark.thorough
def test_a_run_goes_on_with_the_arenas_of_its_iteration(env, trained, tmp_path):
    """Left after three of five iterations, it ends as if it had not been."""
    check_goes_on(env, CONFIG, trained, tmp_path / "run", 3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda arena: replace(arena, shapes=arena.shapes * 3), "more Shapes of a form"),
        (lambda arena: replace(arena, starts=arena.starts[:1]), "1 of .* start poses"),
        (lambda arena: replace(arena, extent=((0.0, 9.0), (0.0, 3.6))), "reaches beyond"),
        (
            lambda arena: replace(
                arena, shapes=tuple(replace(one, size=(9.0, 0.1, 0.1)) for one in arena.shapes)
            ),
            "longer boxes",
        ),
    ],
)
def test_what_the_model_has_no_room_for_is_said(env, change, words):
    arena = ARENAS.renewed(1)[0]
    env.scene.arenas.check_fits(arena)
    with pytest.raises(SpecError, match=f"arena {arena.name} .*{words}"):
        env.scene.arenas.check_fits(change(arena))
