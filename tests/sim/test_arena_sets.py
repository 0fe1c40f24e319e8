"""Worlds of one batch with arenas of their own: the same arena compiled alone is the oracle."""

import math
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.lone import LoneWorld
from usarmjx.base.errors import SpecError
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.models.compile.arena_set import arena_index_of, arena_set
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import (
    ArenaSpec,
    Door,
    FalseAlarm,
    LooseObject,
    SegmentMotion,
    StartPose,
    Victim,
    Water,
)
from usarmjx.models.types.shapes import GLASS, Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

EXACT = Physics(iterations=100, ls_iterations=30)
"""A converged solver: engines and batches differ by rounding only."""
STEPS = 21
"""From the 23rd on a rear wheel lifts by some micrometres, and rounding decides when it touches again."""
BLOCK_STEPS = 16
"""Of solver `block`: in the 18th a wheel is so near to an edge that errors of 1e-5 m/s, which its last steps
leave, are 1e-3 m after it. C MuJoCo's poses, moved by 1e-5, spread as far."""
TOLERANCE = {"c": 1e-5, "jax": 5e-3, "warp": 1e-5}
"""Of poses [m] and quaternions after 0.42 s up a ramp; on `jax` with a contact function of our own."""
P2AT = ROBOTS.get("P2AT")
SEEING = replace(
    P2AT, cameras=(), sensors=(*P2AT.sensors[:2], *(m for m in P2AT.sensors if m.kind != "Sonar"))
)
"""Two of its sonars, and the others of its sensors, compile faster than all."""
BRICK = (Shape(kind="box", size=(0.1, 0.05, 0.04), mass=2.5, surface="loose"),)


def wall(x, y, half_x, half_y, yaw=0.0, **more):
    kinds = {"surface": "wall", **more}
    return Shape(kind="box", size=(half_x, half_y, 0.5), at=(x, y, 0.5), rotation=(0.0, 0.0, yaw), **kinds)


def victim(x, y, **more):
    wave = SegmentMotion(
        name="LeftArm", initial=(0.0, 0.0, 0.0), final=(0.0, 1.2, 0.0), rates=(0.0, 2.0, 0.0)
    )
    return Victim(name="one", at=(x, y, 0.12), segments=(wave,), **more)


def starts(*places):
    return tuple(StartPose(tag=f"S{i}", at=(x, y, 0.188), yaw=yaw) for i, (x, y, yaw) in enumerate(places))


def arena(name, shapes, places, **more):
    return ArenaSpec(
        name=name, shapes=tuple(shapes), starts=starts(*places), extent=((-5, 5), (-5, 5)), **more
    )


ARENAS = (
    arena(
        "corridor",
        [wall(0.9, 0, 0.03, 2.4), wall(-2, 0, 0.05, 1.0, 0.3), wall(0, 2, 1.5, 0.03, material=GLASS)],
        [(0, 0, 0.0), (0, 1.2, 0.5)],
        loose=(LooseObject(name="a", at=(0.75, 0.0, 0.05), shapes=BRICK),),
        victims=(victim(-1.0, -1.5),),
    ),
    arena(
        "ramp",
        [
            Shape(
                kind="box", size=(0.6, 0.6, 0.1), at=(0.8, 0, 0.0), rotation=(0, -0.2, 0), surface="ground"
            ),
            wall(0, -1.2, 2.0, 0.05),
            wall(2.2, 1, 0.05, 0.5),
            wall(-1.5, 1, 0.05, 0.5, 1.0),
        ],
        [(0.05, 0, 0.0), (0, 2.2, math.pi)],
        victims=(victim(2.5, -2.0), Victim(name="two", at=(3, 3, 0.12), posture="sitting")),
        false_alarms=(FalseAlarm(part="LeftLeg", at=(1.2, 2.2, 0.1)),),
    ),
    arena("empty", [], [(1, 1, 0.0), (-1, -1, 1.0), (0, 0, 0)]),
)


def drive(batch, steps=STEPS):
    state = batch.drive(batch.reset(), 0, {"Left": 3.0, "Right": 2.5})
    for _ in range(steps):
        state = batch.step(state)
    state, readings = batch.observe(state)
    return state, readings


@cache
def together(engine):
    """All arenas in one batch after some driving: (batch, state, readings)."""
    scene = build_scene(ARENAS, [SEEING, SEEING], EXACT, radio=RadioSettings())
    batch = Batch(scene, len(ARENAS), engine=engine)
    return batch, *drive(batch)


def alone(number):
    """One world by itself after the same, with the same noise as in a batch: (world, readings)."""
    lone = LoneWorld(build_scene(ARENAS[number], [SEEING, SEEING], EXACT, radio=RadioSettings()), number)
    lone.drive(0, {"Left": 3.0, "Right": 2.5})
    for _ in range(STEPS):
        lone.step()
    return lone, lone.observe()


@pytest.fixture(scope="module")
def solo():
    """Each arena compiled alone, on C MuJoCo and NumPy: the oracle."""
    return [alone(number) for number in range(len(ARENAS))]


@pytest.mark.every_run("c")
@pytest.mark.parametrize("engine", ["c", pytest.param("jax", marks=pytest.mark.slow), "warp"])
def test_each_world_has_its_own_arena_as_if_compiled_alone(engine, solo):
    """Rays end where the poses say, and a grazing one up to 20 times as far away."""
    batch, state, readings = together(engine)
    tolerance = TOLERANCE[engine]
    _, links = batch.links(state)
    for world, (lone, seen) in enumerate(solo):
        group, own = batch.scene.groups[0], lone.scene.groups[0]
        pos = np.asarray(batch.physics(state).qpos[world])[group.root_qposadr]
        expected = lone.physics.qpos[own.root_qposadr]
        np.testing.assert_allclose(pos, expected, atol=tolerance, err_msg=ARENAS[world].name)
        for here, there in zip(readings[0], seen[0], strict=True):
            np.testing.assert_allclose(here.value[world], there.value, atol=20 * tolerance)
        np.testing.assert_allclose(links.power[world], lone.links().power, atol=0.05)
        np.testing.assert_array_equal(links.walls[world], lone.links().walls)


def test_the_oracle_has_something_to_tell(solo):
    climbing, _ = solo[1]
    assert climbing.physics.qpos[climbing.scene.groups[0].root_qposadr[0, 2]] > 0.2625, (
        "its front wheels are on the ramp; it stands at 0.26"
    )
    scans = []
    for lone, seen in solo:
        place = lone.scene.groups[0].suite.index("RangeScanner")
        scans.append(seen[0][place].value[0])
    assert all(np.abs(scans[a] - scans[b]).max() > 0.5 for a, b in ((0, 1), (1, 2), (0, 2)))


def test_worlds_go_through_all_arenas_in_turn():
    batch = Batch(build_scene(ARENAS, ["P2AT"]), 2, engine="c", first=5)
    state = batch.reset()
    names = [[batch.arena_of(state, world).name for world in range(2)]]
    for _ in range(2):
        state = batch.reset_where(state, jnp.array([True, False]))
        names.append([batch.arena_of(state, world).name for world in range(2)])
        arena = jax.tree.map(lambda x: x[0], state.worlds.arena_state)
        wanted = arena_set(ARENAS).states
        turn = int(arena_index_of(np.array(5), int(state.worlds.episode[0]), 3))
        np.testing.assert_array_equal(arena.pos, wanted.pos[turn])
    assert {row[0] for row in names} == {one.name for one in ARENAS}
    assert len({row[1] for row in names}) == 1
    # Another set of arenas of the same shapes takes over at the next reset, and not before.
    before = np.asarray(state.worlds.arena_state.pos)
    state = state.replace(arenas=state.arenas.replace(pos=state.arenas.pos + 1))
    state = batch.reset_where(state, jnp.array([True, False]))
    turn = int(arena_index_of(np.array(5), int(state.worlds.episode[0]), 3))
    np.testing.assert_allclose(state.worlds.arena_state.pos[0], arena_set(ARENAS).states.pos[turn] + 1)
    np.testing.assert_array_equal(state.worlds.arena_state.pos[1], before[1])


def test_a_loose_object_that_an_arena_lacks_waits_out_of_the_way():
    batch, state, _ = together("c")
    pos = np.asarray(batch.physics(state).qpos)[:, batch.scene.loose_geoms.root_qposadr[0, :3]]
    assert pos[0, 2] < 0.1
    np.testing.assert_allclose(pos[1:, 2], 30.0, atol=0.01)  # it falls within a step, and is put back


@pytest.mark.every_run("planar-P2AT")
@pytest.mark.parametrize(("engine", "robot"), [("planar", "P2AT"), ("jax", "ComStation")])
def test_no_recompilation_when_arenas_change(engine, robot):
    """On `jax` of a robot that compiles in half the time of one on wheels."""
    batch = Batch(build_scene(ARENAS, [robot]), 2, engine=engine)
    state = batch.step(batch.reset())
    before = batch._step_program._cache_size()
    for _ in range(3):
        state = batch.step(batch.reset_where(state, jnp.ones(2, bool)))
    assert batch._step_program._cache_size() == before


DOOR = Door(name="d", at=(1, 1, 0))


@pytest.mark.parametrize(
    ("spoilt", "words"),
    [
        ([], "at least one arena"),
        ([replace(ARENAS[0], doors=(DOOR,))], "doors"),
        ([replace(ARENAS[0], waters=(Water(low=(0, 0, 0), high=(1, 1, 1)),))], "waters"),
        ([replace(ARENAS[0], shapes=(Shape(kind="sphere", size=(0.1,)),))], "kind sphere"),
        ([ARENAS[0], replace(ARENAS[1], floor=1.0)], "different floors"),
        ([replace(ARENAS[0], starts=())], "no start pose"),
    ],
)
def test_what_cannot_differ_between_worlds_is_refused_by_name(spoilt, words):
    with pytest.raises(SpecError, match=words):
        build_scene(spoilt, ["P2AT"])


def test_more_robots_than_the_smallest_arena_has_starts():
    with pytest.raises(SpecError, match="3 robots"):
        build_scene(ARENAS, ["P2AT"] * 3)


def test_solver_block_agrees_with_c_in_each_arena():
    scene = build_scene(ARENAS, [SEEING, SEEING], replace(EXACT, solver="block"))
    poses = {}
    for engine in ("c", "warp"):
        batch = Batch(scene, len(ARENAS), engine=engine)
        state, _ = drive(batch, BLOCK_STEPS)
        poses[engine] = np.asarray(batch.physics(state).qpos)[:, scene.groups[0].root_qposadr]
    np.testing.assert_allclose(poses["warp"], poses["c"], atol=TOLERANCE["warp"])
