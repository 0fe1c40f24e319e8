"""Distances swept from all sides on a CPU are those of a wave, bit for bit."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.train.mapping import sweeps
from usarmjx.train.mapping.wavefront import UNREACHABLE, distances, shortest_path, spread_distances

SHAPE, TEAMS, ROBOTS = (19, 13), 3, 4


def maps():
    """Mazes with starts of different worth and tolls, and squares that are asked for."""
    rng = np.random.default_rng(0)
    all_of = (TEAMS, ROBOTS, *SHAPE)
    open_ = rng.random(all_of) > 0.35
    start = np.where(rng.random(all_of) < 0.02, rng.uniform(0, 20, all_of), UNREACHABLE).astype(np.float32)
    start[0, 0] = UNREACHABLE  # no way begins anywhere
    toll = rng.choice([0.0, 6.0], all_of).astype(np.float32)
    until = np.stack([rng.integers(0, n, (TEAMS, ROBOTS)) for n in SHAPE], -1)
    return tuple(map(jnp.asarray, (start, open_, toll, until)))


def of_all(function):
    return jax.jit(jax.vmap(jax.vmap(function)))


def test_swept_distances_are_those_of_a_wave(monkeypatch):
    monkeypatch.setattr(sweeps, "MAPS_AT_A_TIME", 5)  # the last ones are not full
    start, open_, toll, _ = maps()
    swept = of_all(distances)(start, open_, toll)
    wave = of_all(partial(spread_distances, until=None))(start, open_, toll)
    np.testing.assert_array_equal(swept, wave)
    assert 0.1 < (np.asarray(swept) < UNREACHABLE).mean() < 0.9


@pytest.mark.parametrize("asked", [True, False])
def test_ways_are_the_same_if_one_square_is_asked_for(asked):
    start, open_, toll, until = maps()

    def way(start, open_, toll, square):
        far = distances(start, open_, toll, until=square if asked else None)
        return far[square[0], square[1]], shortest_path(far, square, 12)

    def wave_way(start, open_, toll, square):
        far = spread_distances(start, open_, toll, square)
        return far[square[0], square[1]], shortest_path(far, square, 12)

    swept, wave = of_all(way)(start, open_, toll, until), of_all(wave_way)(start, open_, toll, until)
    jax.tree.map(np.testing.assert_array_equal, swept, wave)
