"""Robots kept apart by one kernel of Warp, which runs here on its CPU device: as JAX keeps them apart."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.engines.crowds import as_the_engine_has_it, crowd, flat
from tests.engines.eager import EAGER, drive, poses
from tests.engines.gpu_threads import COMPILER, run_as_on_a_gpu
from tests.engines.test_planar_contact import PEN
from usarmjx.engines.planar import engine
from usarmjx.engines.planar.engine import separate_on_warp, separate_robots
from usarmjx.engines.planar.footprints import OVERLAP_TOLERANCE, separate_footprints
from usarmjx.engines.planar.proposed_motion import pack_motion
from usarmjx.models.compile.physics import Physics
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

pytest.importorskip("warp", reason="needs warp-lang")
from usarmjx.engines.planar import warp_separation
from usarmjx.engines.planar.warp_separation import MAX_ROBOTS, WARP_LANES, lanes_for

ROUNDING = 2e-5
"""Single precision through up to six pushes, which a lever may make ten times as large [m, rad]."""


def both(case, *, discs=True):
    """What JAX and Warp make of a crowd."""
    by_jax = jax.jit(partial(separate_footprints, discs=discs))(*case.values())
    return by_jax, jax.jit(on_warp)(*case.values())


def on_warp(before, after, near, moves, stacked):
    case = {"before": before, "after": after, "near": near, "moves": moves, "stacked": stacked}
    return separate_on_warp(*as_the_engine_has_it(case))


@pytest.mark.every_run("24-3", "24-40", "3-150")
@pytest.mark.parametrize(("worlds", "robots"), [(24, 1), (24, 3), (24, 4), (24, 16), (24, 40), (3, 150)])
def test_a_crowd_is_kept_apart_as_by_jax(worlds, robots):
    """Among boxes and discs, beside those that do not move, over and under each other."""
    case = crowd(worlds, robots, seed=robots)
    (kept, touched), (found, felt) = both(case)
    np.testing.assert_allclose(found.pos, kept.pos, atol=ROUNDING)
    np.testing.assert_allclose(found.yaw, kept.yaw, atol=ROUNDING)
    np.testing.assert_array_equal(felt, touched)
    displacement = np.abs(np.asarray(kept.pos - case["after"].pos)).max(-1) > OVERLAP_TOLERANCE
    assert displacement.mean() > 0.15, "there was something to do"
    assert not displacement[0].any(), "and a world in which there was nothing"
    np.testing.assert_array_equal(found.pos[0], case["after"].pos[0])


@pytest.mark.parametrize("stacked", [True, False])
def test_so_is_one_among_boxes_only_and_one_in_which_nobody_flies(stacked):
    case = flat(crowd(24, 4, seed=7)) | ({} if stacked else {"stacked": None})
    (kept, touched), (found, felt) = both(case, discs=False)
    np.testing.assert_allclose(found.pos, kept.pos, atol=ROUNDING)
    np.testing.assert_array_equal(felt, touched)


def test_a_world_is_the_same_alone_as_among_others():
    case = crowd(6, 5, seed=3)
    apart = jax.jit(on_warp)
    whole, _ = apart(*case.values())
    pick = {
        name: jax.tree.map(lambda part: part[2:3], case[name])
        for name in ("before", "after", "moves", "stacked")
    }
    pick["near"] = jax.tree.map(lambda part: part[..., 2:3], case["near"])
    alone, _ = apart(*(pick[name] for name in case))
    np.testing.assert_array_equal(alone.pos[0], whole.pos[2])
    np.testing.assert_array_equal(alone.yaw[0], whole.yaw[2])


def test_its_slope_is_that_of_jax():
    """Of where robots come to by where they would go, where they were, and where solids are: both ways."""
    case = crowd(5, 3, seed=5)
    weight = jnp.asarray(np.random.default_rng(0).normal(size=case["after"].pos.shape), jnp.float32)

    def total(apart, before, after, near):
        kept, _ = apart(before, after, near, case["moves"], case["stacked"])
        return (kept.pos * weight).sum() + kept.yaw.sum()

    given = case["before"], case["after"], case["near"]
    by_jax, by_warp = (partial(total, apart) for apart in (partial(separate_footprints, discs=True), on_warp))
    slopes = [jax.jit(jax.grad(one, argnums=(0, 1, 2)))(*given) for one in (by_jax, by_warp)]
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-5), *slopes)
    assert np.abs(slopes[0][1].pos).max() > 0.1
    _, rate = jax.jit(partial(jax.jvp, by_warp))(given, jax.tree.map(jnp.ones_like, given))
    assert float(rate) == pytest.approx(
        sum(float(part.sum()) for part in jax.tree.leaves(slopes[1])), rel=1e-4
    )


def test_it_is_in_use_where_warp_is_and_worlds_are_not_too_large(monkeypatch):
    def text(robots):
        case = crowd(2, robots)
        return jax.jit(lambda *given: separate_robots(*given)).lower(*as_the_engine_has_it(case)).as_text()

    assert "keep_robots_apart" not in text(2)
    monkeypatch.setattr(engine, "warp_in_use", lambda: True)
    assert text(2).count("stablehlo.custom_call @") == 1
    assert "keep_robots_apart" in text(2)
    assert "keep_robots_apart" not in text(MAX_ROBOTS + 1)


def test_a_world_has_as_many_lanes_as_robots_or_the_next_power_of_two():
    lanes = {1: 1, 2: 2, 3: 4, 4: 4, 9: 16, 16: 16, 33: WARP_LANES, 128: WARP_LANES}
    assert {robots: lanes_for(robots) for robots in lanes} == lanes
    blocks = {129: 128, 256: 128, 257: 256, MAX_ROBOTS: 512}
    assert {robots: lanes_for(robots) for robots in blocks} == blocks, "a block of its own above WARP_ROBOTS"


@pytest.mark.skipif(not COMPILER, reason="needs a compiler of C++")
def test_the_threads_of_a_block_do_together_what_one_does():
    robots, worlds = 150, 2
    proposed, neighbors = as_the_engine_has_it(crowd(worlds, robots, seed=robots))
    solids, over = np.asarray(neighbors.packed_obstacles), np.asarray(proposed.stacked, np.int32)
    found, felt = jax.jit(separate_on_warp)(proposed, neighbors)
    known = np.asarray(pack_motion(proposed)), solids.ravel(), over.ravel(), worlds, solids.shape[2], 1
    args = [*known, np.zeros(worlds * robots * 4, np.float32)]
    code, kernel = warp_separation._code(robots), warp_separation.separation_kernel(robots)
    block = warp_separation.block_threads_for(robots)
    together = run_as_on_a_gpu(code, kernel, args, worlds * lanes_for(robots), block)[-1]
    kept = together.reshape(worlds, robots, 4)
    np.testing.assert_allclose(kept[..., :2], found.pos, atol=ROUNDING)
    np.testing.assert_allclose(kept[..., 2], found.yaw, atol=ROUNDING)
    np.testing.assert_array_equal(kept[..., 3] > 0, felt)
    assert np.asarray(felt)[1].mean() > 0.15, "there was something to do"


@pytest.mark.thorough
def test_an_engine_goes_the_same_way_with_it(monkeypatch):
    """Four robots among walls and a disc, told the same for 3 s, in two worlds of which one goes astern."""
    scene, found = build_scene(PEN, [EAGER] * 4, Physics(timestep=0.05, substeps=1)), []
    for on in (False, True):
        monkeypatch.setattr(engine, "warp_in_use", lambda on=on: on)
        batch = Batch(scene, 2, engine="planar")
        speeds = jnp.array([[3.0, 2.0, 3.0, 3.0], [-3.0, -2.0, 2.0, 3.0]])
        state = drive(batch, speeds, 0.8 * speeds, 60)
        found.append((poses(batch, state), np.asarray(state.physics.touched)))
    (there, touched), (here, felt) = found
    np.testing.assert_allclose(here, there, atol=1e-3)  # rounding, over sixty steps of contacts
    np.testing.assert_array_equal(felt, touched)
    assert touched.any()
