"""Broad phase of solver `block` beside MuJoCo Warp's and the contacts of C MuJoCo."""

from importlib import import_module
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from benchmarks.islands.rows import exact
from benchmarks.islands.states import StateMaker
from tests.engines.gpu_threads import COMPILER, run_struct_as_on_a_gpu
from usarmjx.engines.block import broad_phase
from usarmjx.engines.block.broad_phase import BroadPhase, make_table
from usarmjx.engines.planar.warp_solids import expand_macros
from usarmjx.models.compile.physics import Physics
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

DRIVER = "mujoco.mjx.third_party.mujoco_warp._src.collision_driver"
ROOM = 4000
"""Pairs of geoms of all worlds."""


def states(arena: str, roster: list[str], count: int) -> tuple[mujoco.MjModel, list[Any]]:
    """Return a model and states of all kinds, with the pairs of geoms between which C MuJoCo has contacts."""
    scene = build_scene(arena, roster, Physics(solver="block"))
    model = exact(scene.model)
    maker, rng, found = StateMaker(model, scene.arena, len(roster)), np.random.default_rng(3), []
    for kind in maker.kinds:
        for data in maker.trajectory(kind, rng, count):
            touching = {tuple(sorted(pair)) for pair in data.contact.geom.tolist()}
            found.append(SimpleNamespace(qpos=data.qpos.copy(), touching=touching))
    return model, found


def near_pairs(m: Any, d: Any, broad_phase: Any) -> list[set[tuple[int, int]]]:
    """Return the pairs of geoms that a broad phase lists in each world."""
    context = import_module(DRIVER).create_collision_context(ROOM)
    d.ncollision.zero_()
    broad_phase(m, d, context)
    count = int(d.ncollision.numpy()[0])
    assert count < ROOM
    pairs, world = (x.numpy()[:count] for x in (context.collision_pair, context.collision_worldid))
    listed = [[tuple(sorted(pair)) for pair in pairs[world == w].tolist()] for w in range(d.nworld)]
    assert all(len(one) == len(set(one)) for one in listed), "no pair twice"
    return [set(one) for one in listed]


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("arena", "roster"),
    [("yellow", ["P2AT", "Talon", "P2DX"]), ("soccer", ["Sedan", "QRIO"]), ("field", ["AirRobot", "Lisa"])],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_pairs_are_those_of_mujoco_warp_but_for_some_far_apart(arena: str, roster: list[str]):
    model, found = states(arena, roster, 3)
    mjw = import_module("mujoco.mjx.third_party.mujoco_warp")
    m, d = mjw.put_model(model), mjw.make_data(model, nworld=len(found), naconmax=ROOM, njmax=400)
    d.qpos.assign(np.array([one.qpos for one in found], np.float32))
    mjw.kinematics(m, d)
    own = (m.nxn_pairid_filtered.numpy() >= 0).any(1)
    table = make_table(model, m.nxn_geom_pair_filtered.numpy(), own)
    ours, theirs = (
        near_pairs(m, d, one) for one in (BroadPhase(table), import_module(DRIVER).nxn_broadphase)
    )
    assert sum(len(one.touching) for one in found) > 50
    data = mujoco.MjData(model)
    for one, mine, other in zip(found, ours, theirs, strict=True):
        assert one.touching <= mine <= other
        data.qpos[:] = one.qpos
        mujoco.mj_kinematics(model, data)
        for a, b in other - mine:
            assert mujoco.mj_geomDistance(model, data, a, b, 1.0, None) > 0.0
    tests = len(table.groups) * len(found)
    assert sum(map(len, ours)) >= 0.5 * sum(map(len, theirs))
    assert tests < 0.7 * len(own) * len(found)


def test_groups_whose_boxes_overlap_are_found_by_threads_of_a_gpu():
    """Pairs of geoms are the same with groups listed as on a GPU."""
    model, found = states("yellow", ["P2AT", "Talon"], 2)
    mjw = import_module("mujoco.mjx.third_party.mujoco_warp")
    m, d = mjw.put_model(model), mjw.make_data(model, nworld=len(found), naconmax=ROOM, njmax=400)
    d.qpos.assign(np.array([one.qpos for one in found], np.float32))
    mjw.kinematics(m, d)
    table = make_table(model, m.nxn_geom_pair_filtered.numpy(), (m.nxn_pairid_filtered.numpy() >= 0).any(1))
    right = near_pairs(m, d, BroadPhase(table))
    if COMPILER is None:
        pytest.skip("needs a C++ compiler")
    shapes = {name: getattr(m, f"geom_{name}").numpy() for name in ("aabb", "rbound", "margin", "gap")}
    poses = {"xpos": d.geom_xpos.numpy(), "xmat": d.geom_xmat.numpy()}
    lists = {"geoms": table.geoms, "first": table.first_geom, "both": table.groups}
    fields = {name: np.ascontiguousarray(value, np.int32) for name, value in lists.items()} | shapes | poses
    listed = np.full((d.nworld, len(table.groups)), -1, np.int32)
    fields |= {"boxes": np.zeros(1, np.float32), "listed": listed, "counts": np.zeros(d.nworld, np.int32)}
    words = {"HELD_GROUPS": 512, "THREADS": 32, "FAR": "1e6f", "SLACK": "1e-4f"}
    code = " ".join(f"const auto {name} = p.{name};" for name in fields) + expand_macros(
        broad_phase.NEAR_CODE.replace("return found;", "if (lane == 0) counts.data[world] = found;"), words
    )
    run_struct_as_on_a_gpu(code, fields, d.nworld * 32, 32)
    for world, count in enumerate(fields["counts"]):
        near = fields["listed"][world, :count]
        assert (fields["listed"][world, count:] == -1).all()
        assert len(set(near.tolist())) == count < len(table.groups)
        spans = [table.order[table.first_pair[k] : table.first_pair[k + 1]] for k in near]
        listed_geoms = m.nxn_geom_pair_filtered.numpy()[np.concatenate(spans)].tolist()
        assert right[world] <= {tuple(sorted(pair)) for pair in listed_geoms}


def test_a_pair_with_settings_of_its_own_is_always_tested():
    model = build_scene("yellow", ["P2AT"]).model
    pairs = np.array([[0, model.ngeom - 1], [1, model.ngeom - 1]])
    table = make_table(model, pairs, np.array([True, False]))
    assert table.groups.tolist()[0] == [-1, -1]
    assert table.order.tolist() == [0, 1]
    assert table.first_pair.tolist() == [0, 1, 2]


@pytest.mark.parametrize("room", [ROOM, 3])
def test_pairs_of_the_convex_collider_are_listed_kind_by_kind_behind_the_others(room: int):
    """Those beyond their room are among the others, and the list has the same pairs."""
    model, found = states("yellow", ["P2AT", "Talon", "P2DX"], 3)
    mjw = import_module("mujoco.mjx.third_party.mujoco_warp")
    m = mjw.put_model(model)
    d = mjw.make_data(model, nworld=len(found), naconmax=ROOM, naccdmax=room, njmax=400)
    d.qpos.assign(np.array([one.qpos for one in found], np.float32))
    mjw.kinematics(m, d)
    pairs = m.nxn_geom_pair_filtered.numpy()
    table = make_table(model, pairs, np.zeros(len(pairs), bool))
    context = import_module(DRIVER).create_collision_context(ROOM)
    d.ncollision.zero_()
    BroadPhase(table)(m, d, context)
    count = int(d.ncollision.numpy()[0])
    listed = context.collision_pair.numpy()[:count]
    world = context.collision_worldid.numpy()[:count]
    kinds = table.convex[tuple(np.sort(model.geom_type[listed], axis=1).T)]
    assert (np.diff(model.geom_type[listed], axis=1) >= 0).all(), "the lower type first"
    of_kind = [int((kinds == k).sum()) for k in range(kinds.max() + 1)]
    assert len(of_kind) > 1
    assert min(of_kind) > 3
    behind = [k for k, size in enumerate(of_kind) for _ in range(min(size, room))]
    assert kinds[count - len(behind) :].tolist() == behind
    if room == ROOM:
        assert (kinds[: count - len(behind)] == -1).all()
    every = near_pairs(m, d, BroadPhase(table))
    mine = [{tuple(sorted(pair)) for pair in listed[world == w].tolist()} for w in range(len(found))]
    assert mine == every


@pytest.mark.oracle
def test_robots_drive_on_the_engine_as_on_c():
    """The whole step of engine `warp`, within 1e-5 m or rad of C MuJoCo's Newton after 0.2 s."""
    ways = []
    for engine in ("c", "warp"):
        batch = Batch(build_scene("yellow", ["P2AT", "P2DX"], Physics(solver="block")), 1, engine=engine)
        state = batch.drive(batch.reset(0), 0, {"Left": 2.0, "Right": 1.0})
        start = np.asarray(batch.physics(state).qpos)
        for _ in range(4):
            state = batch.step(state)
        ways.append(np.asarray(batch.physics(state).qpos) - start)
    assert np.abs(ways[0]).max() > 0.02
    np.testing.assert_allclose(ways[1], ways[0], atol=1e-5)
