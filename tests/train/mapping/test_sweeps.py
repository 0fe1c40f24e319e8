"""Distances swept from all sides on a CPU are those of a wave, bit for bit."""

from functools import partial

import jax
import numpy as np
import pytest

from tests.train.mapping.mazes import mazes
from usarmjx.train.mapping import fast_sweeping
from usarmjx.train.mapping.wavefront import UNREACHABLE, distances, shortest_path, spread_distances

SHAPE = (19, 13)


def of_all(function):
    return jax.jit(jax.vmap(jax.vmap(function)))


def test_swept_distances_are_those_of_a_wave(monkeypatch):
    monkeypatch.setattr(fast_sweeping, "MAPS_AT_A_TIME", 5)  # the last ones are not full
    start, open_, toll, _ = mazes(SHAPE)
    swept = of_all(distances)(start, open_, toll)
    wave = of_all(partial(spread_distances, until=None))(start, open_, toll)
    np.testing.assert_array_equal(swept, wave)
    assert 0.1 < (np.asarray(swept) < UNREACHABLE).mean() < 0.9


@pytest.mark.parametrize("asked", [True, False])
def test_ways_are_the_same_if_one_square_is_asked_for(asked):
    start, open_, toll, until = mazes(SHAPE)

    def way(start, open_, toll, square):
        far = distances(start, open_, toll, until=square if asked else None)
        return far[square[0], square[1]], shortest_path(far, square, 12)

    def wave_way(start, open_, toll, square):
        far = spread_distances(start, open_, toll, square)
        return far[square[0], square[1]], shortest_path(far, square, 12)

    swept, wave = of_all(way)(start, open_, toll, until), of_all(wave_way)(start, open_, toll, until)
    jax.tree.map(np.testing.assert_array_equal, swept, wave)
