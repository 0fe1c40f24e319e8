"""What squares cost, by Warp's kernel, which runs here on its CPU device: as JAX works it out."""

import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.train.mapping.maps import FREE, MARK, UNKNOWN, WALL, MapGrid
from usarmjx.train.mapping.planning import Mates, Seen, weigh_on_jax
from usarmjx.train.mapping.wavefront import UNREACHABLE

pytest.importorskip("warp", reason="needs warp-lang")
import warp as wp

from usarmjx.train.mapping import warp_squares

TEAMS, ROBOTS, MATES = 3, 4, 5
COST = 2e-4
"""Up to 100 squares, in single precision, with other roots and multiplications [squares]."""


def teams(shape, *, wants):
    """Grid, and what robots of some teams know of it, seen from random places."""
    rng = np.random.default_rng(1)
    grid = MapGrid(low=(-1.3, 2.0), cell=0.3, shape=shape)
    of_all = (TEAMS, ROBOTS, *shape)
    size = np.array(shape) * grid.cell

    def places(*axes):
        return np.array(grid.low) + rng.uniform(-0.2, 1.2, (*axes, 2)) * size

    squares = rng.choice([UNKNOWN, FREE, WALL, MARK], of_all, p=[0.1, 0.8, 0.05, 0.05]).astype(np.uint8)
    squares[0, 0] = UNKNOWN
    unseen = (rng.random(of_all) < 0.1) & (np.arange(ROBOTS) == 3)[:, None, None]
    seen = Seen(squares, unseen, rng.random(of_all) < 0.3)
    headers = rng.uniform(-1, 1, (TEAMS, ROBOTS, MATES, 6))
    headers[..., :2], headers[..., 3:5] = places(TEAMS, ROBOTS, MATES), places(TEAMS, ROBOTS, MATES)
    ages = rng.choice([0.1, 3.0, 100.0, np.inf], (TEAMS, ROBOTS, MATES))
    pose = np.concatenate([places(TEAMS, ROBOTS), rng.uniform(-4, 4, (TEAMS, ROBOTS, 1))], -1)
    # Two at the same distance: mirrored in the robot.
    headers[1, 1, 0, :2], ages[1, 1, 0] = pose[1, 1, :2], 0.1
    lower = rng.random((TEAMS, ROBOTS, MATES)) < 0.5
    wanted = np.where(rng.random(of_all) < 0.5, np.nan, rng.uniform(0, 40, of_all)) if wants else None
    known = (pose, seen, Mates(headers, ages, lower), wanted)
    return grid, jax.tree.map(lambda x: jnp.asarray(x, jnp.float32 if x.dtype == float else x.dtype), known)


@pytest.mark.parametrize("wants", [False, True])
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (41, 33)])
def test_squares_cost_on_warp_what_they_cost_on_jax(shape, wants):
    grid, known = teams(shape, wants=wants)

    def of_all(weigh):
        return jax.jit(jax.vmap(jax.vmap(partial(weigh, grid))))(*known)

    ends, enter = map(np.asarray, of_all(warp_squares.weigh_of_one))
    expected = [np.asarray(x) for x in of_all(weigh_on_jax)]
    np.testing.assert_allclose(ends, expected[0], atol=COST, rtol=1e-6)
    np.testing.assert_array_equal(enter, expected[1])
    if shape[0] > 1:
        assert 0.1 < (ends < UNREACHABLE).mean() < 0.9
        assert set(np.unique(enter)) == {0.0, 6.0, np.inf}


def test_one_map_is_weighed_as_among_others():
    grid, known = teams((33, 41), wants=True)
    all_of = jax.jit(jax.vmap(jax.vmap(partial(warp_squares.weigh_of_one, grid))))(*known)
    alone = warp_squares.weigh_of_one(grid, *jax.tree.map(lambda x: x[2, 1], known))
    for one, among in zip(alone, all_of, strict=True):
        np.testing.assert_array_equal(one, among[2, 1])


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp compiles for no GPU there")
def test_it_compiles_for_a_gpu(tmp_path):
    wp.compile_aot_module(warp_squares, arch=75, module_dir=tmp_path, use_ptx=True)
    assert list(tmp_path.glob("*.ptx"))
