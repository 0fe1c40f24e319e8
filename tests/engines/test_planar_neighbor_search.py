"""What is around robots looked up by kernels of Warp, which run here on its CPU device, as by JAX."""

import re
import sys
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.engines.eager import EAGER
from tests.engines.gpu_threads import COMPILER, ptx_of, run_as_on_a_gpu
from tests.engines.test_planar_movable import WARD
from usarmjx.engines.planar import engine, neighbor_search
from usarmjx.engines.planar import engine as planar
from usarmjx.engines.planar.bodies import fixed_bodies
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.neighbor_lists import LIST_LENGTH, list_poses, max_displacement
from usarmjx.engines.planar.neighbor_search import (
    SceneSolids,
    ground_on_jax,
    ground_on_warp,
    invalid_neighbor_list,
    search_neighbors,
    update_neighbors_on_jax,
    update_neighbors_on_warp,
)
from usarmjx.engines.planar.proposed_motion import ProposedMotion, SolidPlacement, movable_solids
from usarmjx.engines.planar.solids import SolidGeoms, project_geoms
from usarmjx.models.compile.physics import Physics
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

pytest.importorskip("warp", reason="needs warp-lang")

from usarmjx.engines.planar import warp_neighbor_search, warp_separation, warp_solids

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


@lru_cache(maxsize=1)
def compared(scene):
    """Findings of both kernels in each step, around robots and below them, in the worlds that JAX stepped."""
    looks, grounds = [], []

    def keep(kept, *what):
        jax.debug.callback(lambda *them: kept.append(jax.tree.map(np.array, them)), *what, ordered=True)

    def around(solids, known, proposed):
        stays_valid = known.lists_stay_valid(
            list_poses(proposed.left, proposed.limit.max(1)), max_displacement(proposed.left, proposed.there)
        )
        anew, found = (
            search_neighbors(solids, proposed).packed,
            update_neighbors_on_warp(solids, known.packed, proposed),
        )
        keep(looks, known.packed, anew, found, stays_valid)
        return update_neighbors_on_jax(solids, known, proposed)

    def ground(solids, around, prints, proposed):
        half = jnp.where(jnp.arange(proposed.moves.shape[1]) % 2, 1e9, 0.0)[:, None]
        unknown = around.replace(room=around.room - half)  # to every other robot
        found = (ground_on_warp(solids, one.packed, prints, proposed) for one in (around, unknown))
        keep(grounds, ground_on_jax(solids, around, prints, proposed), *found)
        return ground_on_jax(solids, around, prints, proposed)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planar, "update_neighbors", around)
        patch.setattr(planar, "ground_below_robots", ground)
        driven(*SCENES[scene])
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
    rows = {"at": around.at, "room": around.room, "left out": around.omitted[..., None]}
    for name, numbers in (("near", around.packed_obstacles), ("under", around.packed_ground)):
        rows[name] = np.moveaxis(numbers, -1, 1).reshape(*around.at.shape[:2], -1)
    return rows


@pytest.mark.every_run("what flies over levels")
@pytest.mark.parametrize("scene", SCENES)
def test_robots_look_around_as_by_jax_and_only_those_that_need_it(scene):
    (looks, _), shares = compared(scene), []
    assert len(looks) == STEPS
    for known, anew, found, stays_valid in looks:
        before, truth, after = (of_robots(one) for one in (known, anew, found))
        went_on = (
            (before["at"] == after["at"]).all(-1)
            & stays_valid
            & (known.scene.geoms == found.scene.geoms).all((1, 2))[:, None]
        )
        shares.append(went_on.mean())
        for name, rows in after.items():
            kept = np.zeros_like(rows) if name == "left out" else before[name]
            np.testing.assert_array_equal(rows[went_on], kept[went_on])
            np.testing.assert_allclose(rows[~went_on], truth[name][~went_on], atol=ROUNDING)
        assert not (went_on & ~stays_valid).any()
        for part in ("loose", "geoms"):
            then, now = getattr(known.scene, part), getattr(anew.scene, part)
            record = getattr(found.scene, part)
            all_looked = ~went_on.any(1)
            np.testing.assert_array_equal(record[all_looked], now[all_looked])
            assert ((record == then) | (record == now)).all()
    assert 0.3 < np.mean(shares) < 0.999, "many go on by what they know, not all"


@pytest.mark.every_run("what flies over levels")
@pytest.mark.parametrize("scene", SCENES)
def test_the_ground_is_found_as_by_jax_by_what_is_known_or_under_all_solids(scene):
    _, grounds = compared(scene)
    by_jax, *by_warp = (np.stack(each) for each in zip(*grounds, strict=True))
    for found in by_warp:  # but for who stands on an edge, to the last bit
        assert (np.abs(found - by_jax) > ROUNDING).mean() < 1e-3


@pytest.mark.every_run("a victim's limbs among walls")
@pytest.mark.parametrize("scene", list(SCENES)[:2])
def test_an_engine_goes_the_same_way_with_them(scene, monkeypatch):
    by_jax, _ = driven(*SCENES[scene])
    for module in (neighbor_search, engine):
        monkeypatch.setattr(module, "warp_in_use", lambda: True)
    by_warp, physics = driven(*SCENES[scene])
    off = np.abs(np.asarray(by_warp) - by_jax).max(-1)
    assert (off > 1e-3).mean() < 0.3, "rounding, over a hundred steps; in few worlds it decides who gives way"
    assert np.median(off) < 1e-4
    assert not np.asarray(physics.omitted).any()


def test_they_are_in_use_where_warp_is_and_a_block_holds_the_solids(monkeypatch):
    arena, robots = SCENES["a victim's limbs among walls"]
    scene = build_scene(arena, robots, Physics(timestep=0.05, substeps=1))

    def kernels():
        batch = Batch(scene, 2, engine="planar")
        text = jax.jit(batch.step).lower(batch.reset()).as_text()
        return sorted(set(re.findall(r"@(look_around_robots|keep_robots_apart|ground_under_robots)", text)))

    assert kernels() == []
    for module in (neighbor_search, engine):
        monkeypatch.setattr(module, "warp_in_use", lambda: True)
    assert kernels() == ["ground_under_robots", "keep_robots_apart", "look_around_robots"]
    for capacities in ("SHARED_CAPACITIES", "GLOBAL_CAPACITIES"):
        monkeypatch.setattr(warp_neighbor_search, capacities, (2,))
    assert kernels() == ["keep_robots_apart"]


def test_large_teams_among_many_solids_have_wide_blocks():
    """Up to a warp for each robot, whose registers fit on a multiprocessor."""
    threads_for = warp_neighbor_search.threads_for
    narrow, wide = warp_neighbor_search.SHARED_CAPACITIES, warp_neighbor_search.GLOBAL_CAPACITIES
    assert [threads_for(robots, narrow[-1]) for robots in (1, 3, 1024)] == [32, 96, 128]
    assert [threads_for(robots, wide[0]) for robots in (1, 3, 1024)] == [32, 96, 512]
    assert warp_neighbor_search.scratch_numbers(4096, 512) == 4096 * (12 + 2 * 16)
    kernel = warp_neighbor_search.search_kernel(8, wide[0], 512)
    assert kernel.options["cuda_max_registers"] == 128


def plate(rise):
    """A robot on a tilted plate among twelve posts, and what is around it."""
    kinds = np.full(13, mujoco.mjtGeom.mjGEOM_BOX)
    turn = np.tile(np.eye(3), (13, 1, 1))
    turn[0] = [[np.cos(rise), 0.0, -np.sin(rise)], [0.0, 1.0, 0.0], [np.sin(rise), 0.0, np.cos(rise)]]
    pos = np.array([(0.0, 0.0, 0.0), *((np.cos(i) * 2, np.sin(i) * 2, 0.5) for i in range(12))])
    size = np.array([(1.5, 1.5, 0.05), *[(0.1, 0.1, 0.5)] * 12])
    static_solids = project_geoms(kinds, jnp.asarray(pos), jnp.asarray(turn), jnp.asarray(size))
    none = SolidGeoms(*(np.zeros(0, int) for _ in range(4)))
    model = mujoco.MjSpec().compile()
    fixed = fixed_bodies(model, set())
    return SceneSolids(
        model, fixed, none, movable_solids(model, fixed, none), static_solids, 0.0, LIST_LENGTH
    )


def test_their_slope_is_that_of_jax():
    """How much higher the ground is under a robot that stands further up a plate: its rise."""
    solids, one = plate(0.2), jnp.zeros((1, 1))
    here = Footprints(
        pos=jnp.array([[[0.1, 0.2]]]),
        yaw=one,
        half=jnp.full((1, 1, 2), 0.2),
        low=one,
        high=one + 0.3,
        step=one + 0.05,
        mass=one + 1.0,
    )
    scene = SolidPlacement(loose=jnp.zeros((1, 0)), geoms=jnp.zeros((1, 0, 10)))
    proposed = ProposedMotion(here, here, one == 0, None, jnp.ones((1, 4, 1)), scene, jnp.zeros((1, 0)), None)
    known = invalid_neighbor_list(solids, proposed).packed

    def height(look, find, x):
        there = proposed._replace(left=here.replace(pos=here.pos + x))
        return find(solids, look(solids, known, there), there.left, there).mean()

    ways = (update_neighbors_on_jax, ground_on_jax), (update_neighbors_on_warp, ground_on_warp)
    slopes = [float(jax.jit(jax.grad(partial(height, *way)))(0.0)) for way in ways]
    assert slopes == pytest.approx([np.tan(0.2)] * 2, abs=1e-5)
    rates = [float(jax.jit(partial(jax.jvp, partial(height, *way)))((0.0,), (1.0,))[1]) for way in ways]
    assert rates == pytest.approx([np.tan(0.2)] * 2, abs=1e-5)


@pytest.fixture
def launches(monkeypatch):
    """What the kernels were given, and made of it, in a drive on Warp."""
    kept: dict[str, list] = {"_search_kernel": [], "_ground_kernel": [], "_kernel": []}

    def recorded(name, make):
        def made(*which):
            def launch(*args, output_dims, launch_dims):
                out = make(*which)(*args, output_dims=output_dims, launch_dims=launch_dims)
                given = [None if hasattr(arg, "shape") else arg for arg in args]

                def keep(arrays, out):
                    rest = iter(arrays)
                    whole = [np.array(next(rest)) if arg is None else arg for arg in given]
                    kept[name].append((which, whole, [np.array(one) for one in out], launch_dims))

                arrays = [arg for arg in args if hasattr(arg, "shape")]
                jax.debug.callback(keep, arrays, out, ordered=True)
                return out

            return launch

        return made

    for module, name in (
        (neighbor_search, "_search_kernel"),
        (neighbor_search, "_ground_kernel"),
        (engine, "_kernel"),
    ):
        monkeypatch.setattr(module, name, recorded(name, getattr(module, name)))
        monkeypatch.setattr(module, "warp_in_use", lambda: True)
    return kept


@pytest.mark.every_run("a victim's limbs among walls")
@pytest.mark.skipif(not COMPILER, reason="needs a compiler of C++")
@pytest.mark.parametrize("scene", SCENES)
def test_the_threads_of_a_gpu_do_together_what_one_does(scene, launches):
    driven(*SCENES[scene])
    looked = [one for one in launches["_search_kernel"] if (one[1][10] != one[2][0]).any()]
    assert len(looked) > 1
    for which, args, found, dim in [*looked[:1], *looked[-2:], launches["_search_kernel"][-1]]:
        code, kernel = warp_neighbor_search._code(*which), warp_neighbor_search.search_kernel(*which)
        arrays = run_as_on_a_gpu(code, kernel, args, dim, which[-1])
        for mine, theirs in zip(arrays[-len(found) :], found, strict=True):
            np.testing.assert_allclose(mine, theirs, atol=ROUNDING)
    (most, _, _), args, found, _ = looked[0]
    # More warps than robots, too.
    places, threads = warp_neighbor_search.GLOBAL_CAPACITIES[0], warp_neighbor_search.WIDE_THREADS
    code, kernel = (
        warp_neighbor_search._code(most, places, threads),
        warp_neighbor_search.search_kernel(most, places, threads),
    )
    scratch = np.zeros(WORLDS * warp_neighbor_search.scratch_numbers(places, threads), np.float32)
    arrays = run_as_on_a_gpu(code, kernel, [*args[:-1], scratch], WORLDS * threads, threads)
    assert arrays[-1].any(), "solids are in global memory"
    for mine, theirs in zip(arrays[-len(found) : -1], found[:-1], strict=True):
        np.testing.assert_allclose(mine, theirs, atol=ROUNDING)
    _, args, (found,), dim = launches["_ground_kernel"][-1]
    code = warp_solids.scene_code(
        warp_neighbor_search.ROBOT_CODE, warp_neighbor_search.GROUND_CODE, warp_neighbor_search.MACROS
    )
    args = [*args, np.zeros_like(found)]
    room = args[11] = np.array(args[11])
    room.reshape(-1, 4)[::3] = -1.0  # to some robots it is not known
    ground = run_as_on_a_gpu(
        code, warp_neighbor_search.ground_under_robots, args, dim, warp_neighbor_search.THREADS
    )[-1]
    assert (np.abs(ground - found) > ROUNDING).mean() < 0.01, "but for who stands on an edge"
    (robots,), args, (found,), dim = launches["_kernel"][-1]
    code, kernel = warp_separation._code(robots), warp_separation.separation_kernel(robots)
    args = [*args, np.zeros_like(found)]
    apply_separation = run_as_on_a_gpu(code, kernel, args, dim, warp_separation.BLOCK_THREADS)[-1]
    np.testing.assert_allclose(apply_separation, found, atol=ROUNDING)


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp compiles for no GPU there")
@pytest.mark.parametrize("kernel", ["look", "look at the most", "look in global memory", "ground", "part"])
def test_they_compile_for_a_gpu(kernel, tmp_path):
    """A block has 48 KiB of shared memory."""
    capacities = warp_neighbor_search.SHARED_CAPACITIES
    largest, widest = warp_neighbor_search.GLOBAL_CAPACITIES[-1], warp_neighbor_search.WIDE_THREADS
    made = {
        "look": lambda: warp_neighbor_search.search_kernel(8, capacities[0]),
        "look at the most": lambda: warp_neighbor_search.search_kernel(12, capacities[-1]),
        "look in global memory": lambda: warp_neighbor_search.search_kernel(12, largest, widest),
        "ground": lambda: warp_neighbor_search.ground_under_robots,
        "part": lambda: warp_separation.separation_kernel(warp_separation.MAX_ROBOTS),
    }[kernel]()
    text = ptx_of(made.module, tmp_path)
    own = [
        int(size)
        for name, size in re.findall(r"\.shared .*? (\S+)\[(\d+)\];", text)
        if "get_smem_base" not in name
    ]
    assert sum(own) <= 48 * 1024
    assert text.count(".entry") >= 1
