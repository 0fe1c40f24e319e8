"""Waves over maps on Warp, whose kernels run here on its CPU device: distances and ways are those of JAX."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.engines.gpu_threads import COMPILER, ptx_of, run_as_on_a_gpu
from tests.train.mapping.mazes import mazes
from tests.train.mapping.test_maps import labyrinth, shortest
from usarmjx.train.mapping import wavefront
from usarmjx.train.mapping.fast_sweeping import swept_distances
from usarmjx.train.mapping.wavefront import UNREACHABLE, distances, path_on_jax, spread_distances

pytest.importorskip("warp", reason="needs warp-lang")

from usarmjx.train.mapping import warp_waves
from usarmjx.train.mapping.warp_waves import (
    LARGE_ROOM,
    LARGE_THREADS,
    SMALL_ROOM,
    SMALL_THREADS,
    distances_on_warp,
    path_on_warp,
)

SHAPES = [(1, 1), (1, 9), (41, 33), (33, 48), (70, 100)]


def of_all(function):
    return jax.jit(jax.vmap(jax.vmap(function)))


def test_shapes_are_of_all_kinds():
    sizes = [rows * columns for rows, columns in SHAPES]
    assert sizes[2] < SMALL_ROOM < sizes[3] < LARGE_ROOM < sizes[4]


@pytest.mark.parametrize("shape", SHAPES)
def test_distances_on_warp_are_those_of_jax(shape):
    start, open_, toll, _ = mazes(shape)

    def on_warp(start, open_, toll):
        return distances_on_warp(start, jnp.where(open_, toll, jnp.inf), None)

    def swept(start, open_, toll):
        return swept_distances(start, jnp.where(open_, toll, jnp.inf), None)

    found = of_all(on_warp)(start, open_, toll)
    np.testing.assert_array_equal(found, of_all(swept)(start, open_, toll))
    wave = of_all(lambda *args: spread_distances(*args, None))(start, open_, toll)
    np.testing.assert_array_equal(found, wave)
    if shape[0] > 1:
        assert 0.1 < (np.asarray(found) < UNREACHABLE).mean() < 0.9


BOXES = {
    "a corner": (slice(0, 4), slice(0, 6)),
    "the last corner": (slice(-5, None), slice(-3, None)),
    "the middle": (slice(9, 20), slice(7, 13)),
    "a row": (slice(12, 13), slice(None)),
    "a square": (slice(3, 4), slice(5, 6)),
    "nothing": (slice(0, 0), slice(0, 0)),
}
"""Where squares are open."""


@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("shape", SHAPES[2:])
def test_what_is_open_in_a_part_of_a_map_is_found_from_all_around_it(shape, box):
    """Ways begin in squares beside it, too, and what cannot be entered stays as it was."""
    start, open_, toll, _ = mazes(shape)
    part = np.zeros(shape, bool)
    part[BOXES[box]] = True
    draw = np.random.default_rng(3)
    start = jnp.where(draw.random(start.shape) < 0.3, draw.uniform(0, 9, start.shape), start)
    enter = jnp.where(open_ & part, toll, jnp.inf)
    found = of_all(lambda start, enter: distances_on_warp(start, enter, None))(start, enter)
    swept = of_all(lambda start, enter: swept_distances(start, enter, None))(start, enter)
    np.testing.assert_array_equal(found, swept)
    assert ((np.asarray(found) < np.asarray(start)).any()) == (box != "nothing")


@pytest.mark.skipif(not COMPILER, reason="needs a compiler of C++")
@pytest.mark.parametrize(
    ("shape", "small"), [((19, 13), True), pytest.param((33, 48), False, marks=pytest.mark.thorough)]
)
def test_the_threads_of_a_gpu_sweep_together_as_one_does(shape, small):
    """Three maps: open all over, in a part of it, and nowhere."""
    start, open_, toll, until = (np.array(part)[1, :3] for part in mazes(shape))
    open_[1, :4], open_[1, :, 9:], open_[2] = False, False, False
    start[1, 5, 5] = 0.0
    enter = np.where(open_, toll, np.inf).astype(np.float32)
    found = jax.vmap(lambda *maps: distances_on_warp(*maps, None))(start, enter)
    room, threads = (SMALL_ROOM, SMALL_THREADS) if small else (LARGE_ROOM, LARGE_THREADS)
    code = warp_waves._sweeps_in(room, threads, holds_costs=small)
    kernel = warp_waves.sweep_small_maps if small else warp_waves.sweep_large_maps
    anywhere = np.full(until.size, -1, np.int32)
    args = [start.ravel(), enter.ravel(), anywhere, *shape, np.zeros(start.size, np.float32)]
    together = run_as_on_a_gpu(code, kernel, args, len(start) * threads, threads)[-1]
    np.testing.assert_array_equal(together.reshape(start.shape), found)
    changed = (np.asarray(found) < start).any((1, 2))
    assert changed.tolist() == [True, True, False]


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp compiles for no GPU there")
def test_they_compile_for_a_gpu(tmp_path):
    assert ".entry" in ptx_of(warp_waves, tmp_path)


@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.thorough), pytest.param(2, marks=pytest.mark.thorough)]
)
def test_distances_on_warp_are_those_of_dijkstra(seed):
    start, open_, toll = labyrinth(seed)
    found = distances_on_warp(start, np.where(open_, toll, np.inf), None)
    np.testing.assert_allclose(found, shortest(start, open_, toll), rtol=1e-5)


@pytest.mark.parametrize("asked", [True, False])
def test_ways_on_warp_are_those_of_jax(asked):
    """From all starts, from squares that no way leads to, from corners and walls."""
    mapped = mazes((19, 13))

    def way(start, open_, toll, square):
        enter = jnp.where(open_, toll, jnp.inf)
        far = distances_on_warp(start, enter, square if asked else None)
        return far[square[0], square[1]], path_on_warp(far, square, 12)

    def wave_way(start, open_, toll, square):
        far = spread_distances(start, open_, toll, None)
        return far[square[0], square[1]], path_on_jax(far, square, 12)

    found, wave = of_all(way)(*mapped), of_all(wave_way)(*mapped)
    jax.tree.map(np.testing.assert_array_equal, found, wave)
    assert len(np.unique(np.asarray(found[1]).reshape(-1, 24), axis=0)) > 5


def test_only_so_much_is_swept_as_is_asked_for():
    """What lies behind the square in a snake, which takes a turn for each bend, is not found out."""
    open_ = np.ones((21, 9), bool)
    open_[1::4, :-1] = open_[3::4, 1:] = False
    start = np.full(open_.shape, UNREACHABLE, np.float32)
    start[0, 0] = 0.0
    enter = np.where(open_, 0.0, np.inf)
    near = np.asarray(distances_on_warp(start, enter, np.array([2, 4])))
    whole = np.asarray(distances_on_warp(start, enter, None))
    assert near[2, 4] == whole[2, 4] < UNREACHABLE
    assert near[-1, -1] > whole[-1, -1]


def test_all_maps_are_one_launch():
    """Worlds of one arena, whose robots share a start."""
    start, open_, toll, until = mazes((19, 13))

    def one(start, open_, toll, square):
        return distances_on_warp(start, jnp.where(open_, toll, jnp.inf), square)

    inner = jax.vmap(one, in_axes=(None, 0, None, 0))
    run = jax.jit(jax.vmap(inner, in_axes=(0, 0, None, 0)))
    args = start[:, 1], open_, toll[0, 0], until
    assert run.lower(*args).as_text().count("stablehlo.custom_call @") == 1
    found = np.asarray(run(*args))
    for world, robot in np.ndindex(until.shape[:2]):
        alone = one(start[world, 1], open_[world, robot], toll[0, 0], until[world, robot])
        np.testing.assert_array_equal(found[world, robot], alone)


def test_waves_spread_on_warp_where_it_is_in_use(monkeypatch):
    monkeypatch.setattr(wavefront, "warp_in_use", lambda: True)
    start, open_, toll, until = (x[1, 0] for x in mazes((19, 13)))

    def way(start, open_, toll, square):
        return wavefront.shortest_path(distances(start, open_, toll, until=square), square, 5)

    text = jax.jit(way).lower(start, open_, toll, until).as_text()
    assert "sweep_small_maps" in text
    assert "walk_down" in text
    far = spread_distances(start, open_, toll, None)
    np.testing.assert_array_equal(jax.jit(way)(start, open_, toll, until), path_on_jax(far, until, 5))
