"""Cost of a sweep's cells against a loop that is written for one batch: `python -m benchmarks.sweep_cost`.

Both play the same episodes with the same compiled step of the environment. The sweep also gives each cell its
policy, checks the episodes, and keeps a file for each cell; the loop does none of this.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base import random
from usarmjx.sweeps.batch import GroupRunner
from usarmjx.sweeps.play import BatchWork, kept_runner, play_batch, resolved
from usarmjx.sweeps.run import batches_of, prepare
from usarmjx.sweeps.spec import read_spec
from usarmjx.sweeps.store import write_cell
from usarmjx.train.envs.membership import building_label

SWEEP: dict[str, Any] = {
    "common": {
        "task": "drive-to-goal",
        "arena": {"kind": "maze", "size": [3, 3]},
        "fields": {"ranges": []},
    },
    "product": {"arena.level": [0.1, 0.5, 0.9], "seed": [*range(20)]},
}
"""Sixty cells of three densities of walls."""


def arena_rows(runner: GroupRunner, work: BatchWork) -> np.ndarray:
    """Return the place of each world's arena among those of the environment (worlds,)."""
    known = runner.env.scene.arenas
    assert known is not None  # as its arenas are generated
    places = {building_label(spec): place for place, spec in enumerate(known.arenas)}
    return np.array([places[label] for _, settings in work.cells for label in resolved(settings).buildings])


def play_loop(runner: GroupRunner, work: BatchWork, rows: np.ndarray) -> np.ndarray:
    """Return the scores of the episodes of a batch, played by a plain loop (worlds,).

    Args:
        runner: Has the environment.
        work: The batch.
        rows: See `arena_rows`.
    """
    env, cells = runner.env, [resolved(settings) for _, settings in work.cells]
    episodes = cells[0].episodes
    numbers = jnp.arange(episodes)
    keys = [jax.vmap(partial(jax.random.fold_in, random.key(c.settings["seed"])))(numbers) for c in cells]
    known, make = env.scene.arenas, cells[0].driver.make
    assert known is not None  # as its arenas are generated
    assert make is not None  # as no client drives
    arenas = jax.tree.map(lambda one: jnp.asarray(one[rows]), known.states)
    state = env.reset_each(jnp.concatenate(keys), arenas, None)
    policy = make(env, None)
    act = _jitted(runner, policy)
    carry, scores, over = policy.initial_carry(env.worlds), np.zeros(env.worlds), np.zeros(env.worlds, bool)
    while not over.all():
        carry, actions = act(carry, state.obs, keys[0][0])
        state = env.step(state, actions)
        done = np.asarray(state.done)
        if done.any():
            now = done & ~over
            scores[now] = np.asarray(state.final_score)[now]
            over |= done
    return scores


_JITTED: dict[int, Callable[..., Any]] = {}


def _jitted(runner: GroupRunner, policy: Any) -> Callable[..., Any]:  # noqa: ANN401 - a Policy
    return _JITTED.setdefault(id(runner), jax.jit(policy.act))


def measure(episodes: int, repeats: int, engine: str) -> dict[str, float]:
    """Return the shortest times of both [s], the number of cells, and the ratio of the times."""
    spec = read_spec({**SWEEP, "worlds": 10**6}, common={"episodes": episodes, "engine": engine})
    with tempfile.TemporaryDirectory() as folder:
        prepared = prepare(spec, Path(folder))
        (work,) = batches_of(prepared)
        swept, looped = [], []
        for turn in range(repeats + 1):  # the first one compiles
            begun = time.perf_counter()
            records = play_batch(work)
            for record in records:
                write_cell(Path(folder), record)
            ended = time.perf_counter()
            runner = kept_runner()
            assert runner is not None  # as it has just played
            rows = arena_rows(runner, work)
            middle = time.perf_counter()
            scores = play_loop(runner, work, rows)
            if turn:
                swept.append(ended - begun)
                looped.append(time.perf_counter() - middle)
        same = np.concatenate([record.scores for record in records])
    return {
        "cells": len(records),
        "sweep_s": min(swept),
        "loop_s": min(looped),
        "ratio": min(swept) / min(looped),
        "score_of_sweep": float(same.mean()),
        "score_of_loop": float(scores.mean()),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--engine", default="planar")
    given = parser.parse_args()
    for name, value in measure(given.episodes, given.repeats, given.engine).items():
        print(f"{name}: {value:.4g}")
