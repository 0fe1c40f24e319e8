"""Cost of a sweep's cells against a loop that is written for one batch: `python -m benchmarks.sweep_cost`.

Both play the same episodes with the same compiled step of the environment. The sweep also plans, gives each
cell its policy, keeps a file for each cell and reads them all; the loop does none of this.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base import random
from usarmjx.sweeps.batch import GroupRunner
from usarmjx.sweeps.play import BatchWork, kept_runner, resolved
from usarmjx.sweeps.run import batches_of, play_prepared, prepare
from usarmjx.sweeps.spec import SweepSpec, read_spec
from usarmjx.sweeps.store import write_cells
from usarmjx.train.envs.membership import building_label

DRIVE, EXPLORE = "drive-to-goal", "explore-v1"
ARENAS: dict[str, dict[str, Any]] = {
    DRIVE: {"arena": {"kind": "maze", "size": [3, 3]}, "fields": {"ranges": []}},
    EXPLORE: {},
}
"""Further settings of the cells, by task."""


def sweep_of(task: str, episodes: int, engine: str) -> SweepSpec:
    """Return a sweep of sixty cells, three densities of walls and twenty seeds, that are one batch."""
    common = {"task": task, "episodes": episodes, "engine": engine, **ARENAS[task]}
    product = {"arena.level": [0.1, 0.5, 0.9], "seed": [*range(20)]}
    return read_spec({"common": common, "product": product, "worlds": 10**6})


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
    seeds = jnp.stack([random.key(cell.settings["seed"]) for cell in cells])
    keys = random.fold_in(seeds, jnp.arange(cells[0].episodes)).reshape(-1)
    known, make = env.scene.arenas, cells[0].driver.make
    assert known is not None  # as its arenas are generated
    assert make is not None  # as no client drives
    arenas = jax.tree.map(lambda one: jnp.asarray(one[rows]), known.states)
    state = env.reset_each(keys, arenas, None)
    policy = make(env, None)
    act = _jitted(runner, policy)
    carry, scores, over = policy.initial_carry(env.worlds), np.zeros(env.worlds), np.zeros(env.worlds, bool)
    while not over.all():
        carry, actions = act(carry, state.obs, seeds[0])
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


def measure(task: str, episodes: int, repeats: int, engine: str) -> dict[str, float]:
    """Return the medians of the times of both [s], and median, least and greatest ratio of a pair.

    The sweep's time is that of planning, playing, writing and reading its cells, compilation apart. Of it,
    `plan_s` and `keep_s` are measured apart. The loop is given the environment, and the arena of each world.
    """
    spec, times = sweep_of(task, episodes, engine), list[dict[str, float]]()
    for turn in range(repeats + 1):  # the first one compiles
        with tempfile.TemporaryDirectory() as name:
            folder, begun = Path(name), time.perf_counter()
            prepared = prepare(spec, folder)
            planned = time.perf_counter()
            found = play_prepared(spec, folder, prepared)
            swept = time.perf_counter()
            write_cells(folder, found.records)
            kept = time.perf_counter()
        (work,), runner = batches_of(prepared), kept_runner()
        assert runner is not None  # as it has just played
        rows = arena_rows(runner, work)
        middle = time.perf_counter()
        scores = play_loop(runner, work, rows)
        looped = time.perf_counter() - middle
        same = np.concatenate([record.scores for record in found.records])
        assert np.allclose(same, scores, atol=1e-3), "the episodes differ"
        if turn:
            row = {
                "sweep_s": swept - begun,
                "loop_s": looped,
                "plan_s": planned - begun,
                "keep_s": kept - swept,
            }
            times.append({**row, "ratio": row["sweep_s"] / looped})
    medians = {name: float(np.median([row[name] for row in times])) for name in times[0]}
    ratios = [row["ratio"] for row in times]
    per_cell = 1e3 * (medians["sweep_s"] - medians["loop_s"]) / len(found.records)
    return {
        "cells": len(found.records),
        "steps": max(max(record.steps) for record in found.records),
        **medians,
        "least_ratio": min(ratios),
        "greatest_ratio": max(ratios),
        "more_per_cell_ms": per_cell,
        "score": float(same.mean()),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", choices=tuple(ARENAS), default=DRIVE)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--engine", default="planar")
    given = parser.parse_args()
    for name, value in measure(given.task, given.episodes, given.repeats, given.engine).items():
        print(f"{name}: {value:.4g}")
