"""What only a GPU can show; skipped elsewhere."""

from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.arenas import COURSE
from tests.engines.crowds import as_the_engine_has_it, crowd
from tests.engines.eager import EAGER
from tests.engines.test_planar_contact import PEN
from tests.sim.test_arena_sets import ARENAS, BLOCK_STEPS, EXACT, TOLERANCE, drive
from tests.train.envs.test_steady import goal_env, live_bytes, used_after
from tests.train.mapping.mazes import mazes
from usarmjx.base.warp_functions import warp_in_use
from usarmjx.engines import choose_engine
from usarmjx.engines.mjx_warp import GRAPH_MODES
from usarmjx.engines.planar import engine as planar_engine
from usarmjx.engines.planar.engine import separate_robots
from usarmjx.engines.planar.footprints import separate_footprints
from usarmjx.engines.planar.neighbor_search import update_neighbors_on_jax, update_neighbors_on_warp
from usarmjx.models.compile.physics import Physics
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import RosterEntry, build_scene
from usarmjx.sim.world import sense
from usarmjx.train.make import make
from usarmjx.train.mapping.wavefront import distances, path_on_jax, shortest_path, spread_distances

pytestmark = pytest.mark.gpu

PARITY = 5e-3
"""As on the CPU (tests/engines/test_engines.py): single precision through contacts over 0.4 m [m]."""
WHEELS = 0.03
"""Of wheels: `PARITY` at the rim of one of 0.11 m would be 0.045 [rad]. Sums are atomic: two runs of the same
graph came 0.008 apart on an H100."""
SMALLEST = 256
"""What the least array takes on a GPU: a leak is at least as much for each action [bytes]."""
RAY = 1e-3
"""Ranges against C [m]; TensorFloat-32 anywhere in the chain would miss it by several mm at 10 m."""


def test_auto_takes_warp_for_everything():
    assert {choose_engine("auto", purpose) for purpose in ("serve", "train", "batch")} == {"warp"}


@pytest.mark.parametrize("solver", ["CG", "block"])
def test_warp_on_the_gpu_drives_as_c_mujoco_does(solver: Literal["CG", "block"]):
    scene = build_scene(COURSE, ["P2AT", "P2AT"], Physics(solver=solver))
    poses = {}
    for engine in ("warp", "c"):
        batch = Batch(scene, 64 if engine == "warp" else 1, engine=engine, seed=3)
        state = batch.drive(batch.reset(), 0, {"Left": 4.0, "Right": 4.0})
        for _ in range(50):
            state = batch.step(state)
        batch.check_overflow(state)
        poses[engine] = np.asarray(batch.physics(state).qpos)[:, scene.groups[0].root_qposadr[:, :3]]
    np.testing.assert_allclose(poses["warp"], np.broadcast_to(poses["c"], poses["warp"].shape), atol=PARITY)


@pytest.mark.parametrize("graph", GRAPH_MODES.names())
def test_every_kind_of_graph_computes_what_the_usual_one_does(graph):
    """For 0.4 s through contacts with the floor; sums are atomic, so not to the last bit."""
    scene = build_scene(COURSE, ["P2AT", "P2AT"])
    found = []
    for name in ("step", graph):
        batch = Batch(scene, 16, engine="warp", seed=3)
        batch.engine.select_graphs(name)
        begun = batch.drive(batch.reset(), 0, {"Left": 4.0, "Right": 3.0})
        state = jax.jit(lambda state, batch=batch: batch.run(state, 20))(begun)
        batch.check_overflow(state)
        found.append(np.asarray(batch.physics(state).qpos))
    displacement = found[0] - np.asarray(batch.physics(begun).qpos)
    assert abs(displacement[:, scene.groups[0].root_qposadr[:, :2]]).max(-1).min() > 0.05
    root = scene.groups[0].root_qposadr
    np.testing.assert_allclose(found[1][:, root], found[0][:, root], atol=PARITY)
    np.testing.assert_allclose(found[1], found[0], atol=WHEELS)


def used_on_the_gpu():
    """Bytes that JAX has in use on the GPU, that Warp has, and that JAX's arrays hold."""
    warp = pytest.importorskip("warp", reason="needs warp-lang")
    held = live_bytes()
    stats = jax.devices("gpu")[0].memory_stats()
    assert stats is not None
    return stats["bytes_in_use"], warp.get_mempool_used_mem_current(warp.get_cuda_device()), held


def assert_nothing_leaks(few, many, actions):
    """JAX frees when it gets round to it (14 kB more or less on an H100), Warp at once."""
    assert many[0] - few[0] < SMALLEST * actions
    assert many[1:] == few[1:]


def test_memory_is_flat_over_ten_thousand_actions_with_resets():
    env = goal_env(worlds=64)
    (few, many), state = used_after(env, (1000, 10_000), used_on_the_gpu)
    assert few[0] > 0
    assert_nothing_leaks(few, many, 9000)
    assert np.asarray(state.batch.worlds.episode).min() >= 10_000 // env.episode_steps - 1


def test_graphs_of_warp_take_no_more_memory_the_longer_it_runs():
    """A graph that was captured for other arrays at each call would show here."""
    env = make("drive-to-goal", worlds=64, engine="warp", ranges=(), pose="GroundTruth", episode_steps=40)
    (few, many), state = used_after(env, (50, 250), used_on_the_gpu)
    assert_nothing_leaks(few, many, 200)
    assert np.asarray(state.batch.worlds.episode).min() >= 250 // env.episode_steps - 1


def test_scans_on_the_gpu_are_full_single_precision():
    scene = build_scene("yellow", ["P2AT"])
    batch = Batch(scene, 8, engine="warp")
    state, readings = batch.observe(batch.reset())
    group = scene.groups[0]
    scan = np.asarray(readings[0][group.suite.index("RangeScanner")].value)[0, 0]
    data = mujoco.MjData(scene.model)
    data.qpos[:] = np.asarray(batch.physics(state).qpos[0])
    mujoco.mj_forward(scene.model, data)
    mount = group.robot.sensors[16]
    origin = data.qpos[group.root_qposadr[0, :3]] + np.array([mount.at[0], -mount.at[1], -mount.at[2]])
    for beam in range(0, 181, 20):
        angle = -np.pi / 2 + beam * np.pi / 180
        along = np.array([np.cos(angle), np.sin(angle), 0.0])
        own = group.indices[0].body_ids
        start, travelled = origin.copy(), 0.0
        geom = np.zeros(1, np.int32)
        while True:
            hit = mujoco.mj_ray(scene.model, data, start, along, None, 1, -1, geom)
            travelled += hit
            if geom[0] < 0 or scene.model.geom_bodyid[geom[0]] not in own:
                break
            start, travelled = start + along * (hit + 1e-6), travelled + 1e-6
        assert scan[beam] == pytest.approx(min(travelled, 20.0), abs=RAY)


def test_a_client_claims_a_robot_of_a_batch_on_the_gpu():
    from usarmjx.models.robots import ROBOTS
    from usarmjx.server.worlds.batch_world import BatchWorld

    scene = build_scene("yellow", [RosterEntry("P2AT", parked=True)] * 2)
    world = BatchWorld(Batch(scene, 16, engine="warp"), 3)
    robot = world.spawn(ROBOTS.get("P2AT"), "R1", (4.5, -1.9, -1.8), (0.0, 0.0, 0.0))
    target = robot.command.target.copy()
    target[:4] = 2.0
    world.set_command(robot, robot.command.replace(target=target))
    for _ in range(50):
        world.step()
    world.observe([robot])
    truth = robot.pending[robot.suite.index("GroundTruth")]
    assert truth[0] == pytest.approx(4.5 + 0.26 * 0.95, abs=0.03)
    assert len(jax.devices("gpu")) >= 1


def test_worlds_with_arenas_of_their_own_agree_with_c():
    """Three arenas in one batch of 64 worlds, in single precision, as in `test_arena_sets` on a CPU."""
    scene = build_scene(ARENAS, ["P2AT", "P2AT"], EXACT)
    poses, scans = {}, {}
    for engine in ("c", "warp"):
        batch = Batch(scene, 3 if engine == "c" else 64, engine=engine)
        state, readings = drive(batch, BLOCK_STEPS)
        batch.check_overflow(state)
        poses[engine] = np.asarray(batch.physics(state).qpos)[:, scene.groups[0].root_qposadr]
        place = scene.groups[0].suite.index("RangeScanner")
        scans[engine] = np.asarray(readings[0][place].value)
    turns = np.arange(64) % 3
    np.testing.assert_allclose(poses["warp"], poses["c"][turns], atol=TOLERANCE["warp"])
    np.testing.assert_allclose(scans["warp"], scans["c"][turns], atol=20 * TOLERANCE["warp"])


def test_a_world_of_planar_alone_does_bit_for_bit_what_it_does_among_others():
    """As on a CPU (tests/engines/test_planar_contact.py): pushed by walls and other robots for 10 s."""
    scene = build_scene(PEN, [EAGER] * 4, Physics(timestep=0.05, substeps=1))
    orders = np.random.default_rng(1).uniform(-5.0, 5.0, (20, 2, 4)).astype(np.float32)
    found = []
    for worlds, first in ((257, 0), (1, 256)):
        batch = Batch(scene, worlds, engine="planar", seed=5, first=first)
        run, state = jax.jit(lambda state, batch=batch: batch.run(state, 10)), batch.reset()
        touched = np.zeros(4, bool)
        for left, right in orders:
            state = run(batch.drive(state, 0, {"Left": left, "Right": right}))
            touched |= np.asarray(state.physics.touched)[-1]
        assert touched.all(), "all have met something"
        found.append([np.asarray(part)[-1] for part in (state.physics.qpos, state.physics.qvel)])
    for together, alone in zip(*found, strict=True):
        np.testing.assert_array_equal(alone, together)


@pytest.mark.parametrize("shape", [(1, 7), (41, 33), (33, 48), (70, 90)], ids=lambda x: f"{x[0]}x{x[1]}")
def test_waves_over_maps_are_those_of_jax_bit_for_bit(shape):
    """Maps of worlds and robots that a block of threads holds in shared memory, and one that is too large."""
    pytest.importorskip("warp", reason="needs warp-lang")
    assert warp_in_use()
    start, open_, toll, until = mazes(shape)

    def of_all(function):
        return jax.jit(jax.vmap(jax.vmap(function)))(start, open_, toll, until)

    def way(start, open_, toll, square):
        far = distances(start, open_, toll, until=square)
        return far[square[0], square[1]], shortest_path(far, square, 40)

    def wave_way(start, open_, toll, square):
        far = spread_distances(start, open_, toll, square)
        return far[square[0], square[1]], path_on_jax(far, square, 40)

    found = of_all(lambda start, open_, toll, _: distances(start, open_, toll))
    wave = of_all(lambda start, open_, toll, _: spread_distances(start, open_, toll, None))
    np.testing.assert_array_equal(found, wave)
    jax.tree.map(np.testing.assert_array_equal, of_all(way), of_all(wave_way))


def test_more_threads_than_a_row_of_blocks_has_are_all_launched():
    """Warp lays more than 2**24 out in rows; a bundle takes 32, an angle one. A wall by its closed form."""
    pytest.importorskip("warp", reason="needs warp-lang")
    from usarmjx.sensors.rays.incidence_warp import cosines_of_hits
    from usarmjx.sensors.rays.raycast import RayQuery, indexed_blocks, warp_hits
    from usarmjx.sensors.rays.targets import make_geoms

    casts, rays = 2**17, 144  # 2**24 * 1.25 bundles' threads at 5 bundles each, 1.125 of angles'
    wall = (jnp.asarray(x, jnp.float32)[None] for x in ((5.0, 0.0, 0.0), np.eye(3), (1.0, 50.0, 50.0)))
    seen = indexed_blocks(make_geoms(np.array([mujoco.mjtGeom.mjGEOM_BOX]), *wall, jnp.full(1, -1)))
    turn = jnp.linspace(-0.5, 0.5, rays)
    along = jnp.stack([jnp.cos(turn), jnp.sin(turn), jnp.zeros(rays)], -1)

    @jax.jit
    def cast(x):
        given = jnp.stack([x, 0.0 * x, 0.0 * x], -1)[None] + jnp.zeros((rays, 3)), along
        found = warp_hits(seen, given, RayQuery(bundle_size=32))
        return found.distance, found.geom_index, cosines_of_hits(seen, given, found)

    away = jnp.linspace(1.0, 3.0, casts)
    distance, geom, cosine = jax.jit(jax.vmap(cast))(4.0 - away)
    assert (np.asarray(geom) == 0).all()
    np.testing.assert_allclose(distance, away[:, None] / jnp.cos(turn), rtol=1e-5)
    np.testing.assert_allclose(cosine, jnp.broadcast_to(jnp.cos(turn), cosine.shape), atol=1e-5)


def test_sonars_and_tags_are_cast_on_warp_as_by_jax(monkeypatch):
    """Of P2ATs driven for 1 s in 32 worlds; but for one range in a thousand, of a ray along an edge."""
    from usarmjx.sensors.rays import raycast

    scene = build_scene("yellow", ["P2AT"] * 8, Physics.coarse())
    batch, suite = Batch(scene, 32, engine="planar"), scene.groups[0].suite
    state = batch.reset()
    for _ in range(20):
        speeds = np.random.default_rng(2).uniform(-3.0, 6.0, (2, 32, 8)).astype(np.float32)
        state = batch.step(batch.drive(state, 0, {"Left": speeds[0], "Right": speeds[1]}))

    def ranges():
        """Of sonars, and of the rays to tags up to the tag itself."""
        seen = jax.jit(jax.vmap(partial(sense, scene)))(state.worlds, batch.physics(state))[0]
        found = []
        for i in (suite.index("Sonar"), suite.index("RFID")):
            first = sum(suite.ray_counts[:i])
            mine = jax.tree.map(lambda x, f=first, i=i: x[..., f : f + suite.ray_counts[i]], seen.hits)
            if suite.sensors[i].least_cosines:
                heard = np.repeat(suite.sensors[i].least_cosines, suite.ray_counts[i] // 16)
                mine = jnp.where(mine.cosine >= heard, mine.distance, jnp.inf)
                found.append(np.asarray(mine.reshape(*mine.shape[:2], 16, -1).min(-1)))
            else:
                found.append(np.asarray(mine.distance))
        return found

    on_warp = ranges()
    monkeypatch.setattr(raycast, "warp_in_use", lambda: False)
    for warp, plain in zip(on_warp, ranges(), strict=True):
        assert np.isfinite(plain).mean() > 0.02
        assert (~np.isclose(warp, plain, atol=1e-4)).mean() < 1e-3


@pytest.mark.parametrize("robots", [1, 9, 40])
def test_crowds_are_kept_apart_on_warp_as_by_jax(robots):
    """Within 0.1 mm; but one robot in a thousand, that is as deep in two things and goes out of the other."""
    case = crowd(500, robots, seed=robots)
    kept, touched = jax.jit(partial(separate_footprints, discs=True))(*case.values())
    found, felt = jax.jit(separate_robots)(*as_the_engine_has_it(case))
    off = np.abs(np.asarray(found.pos - kept.pos)).max(-1)
    assert (off > 1e-4).mean() < 1e-3
    assert (np.asarray(felt) != np.asarray(touched)).mean() < 1e-3
    assert np.abs(np.asarray(kept.pos - case["after"].pos)).max(-1).mean() > 0.01


def test_what_is_around_robots_is_found_on_warp_as_by_jax(monkeypatch):
    """P2ATs driven for 5 s in 64 worlds; but for one number in a thousand, of solids as near as others."""
    batch = Batch(build_scene("yellow", ["P2AT"] * 8, Physics.coarse()), 64, engine="planar")
    found: list[tuple] = []

    def both(solids, known, proposed):
        by_jax, by_warp = (
            find(solids, known, proposed) for find in (update_neighbors_on_jax, update_neighbors_on_warp)
        )
        jax.debug.callback(
            lambda *them: found.append(jax.tree.map(np.array, them)), by_jax, by_warp, ordered=True
        )
        return by_jax

    monkeypatch.setattr(planar_engine, "update_neighbors", both)
    state = batch.reset()
    for step in range(100):
        if step % 20 == 0:
            speeds = np.random.default_rng(step).uniform(-3.0, 6.0, (2, 64, 8)).astype(np.float32)
            state = batch.drive(state, 0, {"Left": speeds[0], "Right": speeds[1]})
        state = batch.step(state)
    jax.block_until_ready(state)
    jax.effects_barrier()
    assert len(found) == 100
    assert (found[0][0].at != found[-1][0].at).any(), "they looked again"
    pairs = [pair for them in found for pair in zip(*map(jax.tree.leaves, them), strict=True)]
    assert np.concatenate([(np.abs(x - y) > 1e-4).ravel() for x, y in pairs]).mean() < 1e-3
