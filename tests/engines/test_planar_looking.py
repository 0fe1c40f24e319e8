"""What is around robots looked up by kernels of Warp, which run here on its CPU device, as by JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.engines.eager import EAGER
from tests.engines.test_planar_movable import WARD
from usarmjx.engines.planar import engine as planar
from usarmjx.engines.planar import looking, parting
from usarmjx.engines.planar.looking import (
    around_by_jax,
    around_on_warp,
    ground_by_jax,
    ground_on_warp,
    looked_up,
)
from usarmjx.engines.planar.neighbours import farthest_in_a_step, places_of
from usarmjx.models.build.compose import Physics
from usarmjx.models.spec.arena import ArenaSpec, StartPose
from usarmjx.models.spec.shapes import Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

pytest.importorskip("warp", reason="needs warp-lang")

WORLDS, STEPS = 4, 100
ROUNDING = 2e-5
"""Single precision of metres and of what a few turns make of them [m]."""
YARD = ArenaSpec(
    name="yard",
    starts=tuple(StartPose(tag=f"S{i}", at=(i % 8, i // 8, 0.188), yaw=i) for i in range(40)),
    extent=((-9, 9), (-9, 9)),
    shapes=tuple(
        Shape(
            kind=("box", "cylinder")[i % 2],
            size=(0.1, 0.2, 0.3),
            at=(i % 7 + 0.5, i // 7 + 0.5, 0.3),
            surface="wall",
        )
        for i in range(28)
    ),
)
SCENES = {
    "a victim's limbs among walls": (WARD, [EAGER] * 3),
    "doors, ramps, drums and loose boxes": ("yellow", ["P2AT"] * 5),
    "more robots than lanes, among boxes and drums": (YARD, [EAGER] * 40),
    "what flies over levels": ("yellow", ["AirRobot", "P2AT"]),
}


@pytest.fixture
def compared(monkeypatch):
    """What both found in each step, where worlds come to by JAX."""
    looks, grounds = [], []

    def keep(kept, *what):
        jax.debug.callback(lambda *them: kept.append(jax.tree.map(np.array, them)), *what, ordered=True)

    def around(solids, known, aims):
        holds = known.holds_for(
            places_of(aims.left, aims.limit.max(1)), farthest_in_a_step(aims.left, aims.there)
        )
        keep(looks, known, looked_up(solids, aims), around_on_warp(solids, known, aims), holds)
        return around_by_jax(solids, known, aims)

    def ground(solids, around, prints, aims):
        half = jnp.where(jnp.arange(aims.moves.shape[1]) % 2, 1e9, 0.0)[:, None]
        unknown = around.replace(room=around.room - half)  # to every other robot
        found = (ground_on_warp(solids, one, prints, aims) for one in (around, unknown))
        keep(grounds, ground_by_jax(solids, around, prints, aims), *found)
        return ground_by_jax(solids, around, prints, aims)

    monkeypatch.setattr(planar, "around_robots", around)
    monkeypatch.setattr(planar, "ground_below", ground)
    return looks, grounds


def driven(arena, robots):
    """Worlds of robots told anything every second."""
    physics = (
        Physics(timestep=0.02, substeps=1) if "AirRobot" in robots else Physics(timestep=0.05, substeps=1)
    )
    batch, rng = Batch(build_scene(arena, robots, physics), WORLDS, engine="planar"), np.random.default_rng(3)
    state = batch.reset()
    for step in range(STEPS):
        if step % 20 == 0:
            for slot, group in enumerate(batch.scene.groups):
                shape, most = (WORLDS, len(group.slots)), group.robot.drive.full_scale
                told = {
                    name: rng.uniform(-0.3 * top, top, shape).astype(np.float32) for name, top in most.items()
                }
                state = batch.drive(state, slot, told)
        state = batch.step(state)
    jax.block_until_ready(state)
    jax.effects_barrier()
    return batch.physics(state).qpos, state.physics


def of_robots(around):
    """All that is known of each robot (worlds, robots, numbers), by what it is."""
    rows = {"at": around.at, "room": around.room, "left out": around.left_out[..., None]}
    for name, numbers in (("near", around.near_numbers), ("under", around.under_numbers)):
        rows[name] = np.moveaxis(numbers, -1, 1).reshape(*around.at.shape[:2], -1)
    return rows


@pytest.mark.parametrize("scene", SCENES)
def test_robots_look_around_as_by_jax_and_only_those_that_need_it(scene, compared):
    driven(*SCENES[scene])
    looks, shares = compared[0], []
    assert len(looks) == STEPS
    for known, anew, found, holds in looks:
        before, truth, after = (of_robots(one) for one in (known, anew, found))
        went_on = (
            (before["at"] == after["at"]).all(-1)
            & holds
            & (known.scene.geoms == found.scene.geoms).all((1, 2))[:, None]
        )
        shares.append(went_on.mean())
        for name, rows in after.items():
            kept = np.zeros_like(rows) if name == "left out" else before[name]
            np.testing.assert_array_equal(rows[went_on], kept[went_on])
            np.testing.assert_allclose(rows[~went_on], truth[name][~went_on], atol=ROUNDING)
        assert not (went_on & ~holds).any()
        for part in ("loose", "geoms"):
            then, now = getattr(known.scene, part), getattr(anew.scene, part)
            record = getattr(found.scene, part)
            all_looked = ~went_on.any(1)
            np.testing.assert_array_equal(record[all_looked], now[all_looked])
            assert ((record == then) | (record == now)).all()
    assert 0.3 < np.mean(shares) < 0.999, "many go on by what they know, not all"


@pytest.mark.parametrize("scene", SCENES)
def test_the_ground_is_found_as_by_jax_by_what_is_known_or_under_all_solids(scene, compared):
    driven(*SCENES[scene])
    by_jax, *by_warp = (np.stack(each) for each in zip(*compared[1], strict=True))
    for found in by_warp:  # but for who stands on an edge, to the last bit
        assert (np.abs(found - by_jax) > ROUNDING).mean() < 1e-3


@pytest.mark.parametrize("scene", list(SCENES)[:2])
def test_an_engine_goes_the_same_way_with_them(scene, monkeypatch):
    by_jax, _ = driven(*SCENES[scene])
    for module in (looking, parting):
        monkeypatch.setattr(module, "warp_in_use", lambda: True)
    by_warp, physics = driven(*SCENES[scene])
    off = np.abs(np.asarray(by_warp) - by_jax).max(-1)
    assert (off > 1e-3).mean() < 0.3, "rounding, over a hundred steps; in few worlds it decides who gives way"
    assert np.median(off) < 1e-4
    assert not np.asarray(physics.left_out).any()
