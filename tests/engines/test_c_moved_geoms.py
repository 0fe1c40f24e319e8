"""Geoms that move in C MuJoCo: contacts are those that are found by comparing each geom with each."""

import mujoco
import numpy as np
import pytest

from usarmjx.engines.base import GeomPoses
from usarmjx.engines.c.batch import CEngine, MovedBody
from usarmjx.train.envs.recipe import GeneratedArenas
from usarmjx.train.make import make

SIDE = 1.0  # m: so far from the middle lies one box, more as much farther as gives each as much room


def model_of(boxes, balls):
    """Boxes on a body that stands still, whose inertial frame is another one, and balls among them."""
    spec = mujoco.MjSpec()
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
    body = spec.worldbody.add_body(name="arena", mocap=True)
    for number in range(boxes):
        body.add_geom(name=f"box{number}", type=mujoco.mjtGeom.mjGEOM_BOX, **laid_out(number))
    for number in range(balls):
        ball = spec.worldbody.add_body(name=f"ball{number}")
        ball.add_freejoint()
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.3, 0, 0])
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.1, 0.5, 0], pos=[0.2, 0, 0])
    model = spec.compile()
    ids = [model.geom(f"box{number}").id for number in range(boxes)]
    assert np.abs(model.body_ipos[1]).max() > 0.2
    assert np.abs(model.body_iquat[1, 1:]).max() > 0.1
    model.geom_sameframe[ids] = 0
    return model, ids


def laid_out(number):
    return {"size": [0.1, 0.2, 0.4], "pos": [0.3 + number, 1.0, 0.5 * number], "euler": [20.0, 30.0, 40.0]}


def contacts(model, data, compare_all):
    flag = int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    model.opt.disableflags = model.opt.disableflags & ~flag | flag * compare_all
    mujoco.mj_forward(model, data)
    found = zip(
        data.contact.geom.tolist(), data.contact.pos.tolist(), data.contact.dist.tolist(), strict=True
    )
    return sorted(found)


def side(boxes):
    return SIDE * boxes ** (1 / 3)


def scattered(rng, boxes, within):
    quat = rng.normal(size=(boxes, 4))
    return (
        rng.uniform(-within, within, (boxes, 3)),
        quat / np.linalg.norm(quat, axis=1, keepdims=True),
        rng.uniform(0.02, 1.0, (boxes, 3)),
    )


@pytest.mark.parametrize("boxes", [1, 2, 3, 7, 64, 100])
def test_the_same_contacts_are_found_as_without_a_tree(boxes):
    """Bit for bit, in three worlds by turns, after few and after many have moved.

    Their order is another one where a body has several geoms that each meet several.
    """
    rng, within = np.random.default_rng(boxes), side(boxes)
    model, ids = model_of(boxes, 12)
    body, data = MovedBody(model, ids), mujoco.MjData(model)
    places, found = {world: scattered(rng, boxes, within) for world in range(3)}, 0
    for turn in range(24):
        world = turn % 3
        if turn % 2:
            places[world] = scattered(rng, boxes, within)
        else:
            few = rng.choice(boxes, max(1, boxes // 8), replace=False)
            for now, new in zip(places[world], scattered(rng, len(few), within), strict=True):
                now[few] = new
        body.move(model, *places[world], world)
        for ball in range(12):
            data.qpos[7 * ball : 7 * ball + 3] = rng.uniform(-within, within, 3)
            data.qpos[7 * ball + 3 : 7 * ball + 7] = scattered(rng, 1, within)[1]
        found_all = contacts(model, data, compare_all=True)
        assert contacts(model, data, compare_all=False) == found_all
        # The order is that of geoms, whatever the tree was before: who resumes a run goes on bit for bit.
        order, anew = data.contact.geom.tolist(), model.__copy__()
        MovedBody(anew, ids).move(anew, *places[world])
        mujoco.mj_forward(anew, data)
        assert data.contact.geom.tolist() == order
        found += data.ncon
    assert found > 24


@pytest.mark.parametrize("boxes", [1, 7, 64])
def test_boxes_around_a_path_find_the_same_contacts(boxes):
    """Bit for bit and in the same order at each pose of three paths, each of which has one tree."""
    rng, within = np.random.default_rng(boxes), side(boxes)
    model, ids = model_of(boxes, 12)
    body, data, found = MovedBody(model, ids), mujoco.MjData(model), 0
    size = model.geom_size[ids]
    for _ in range(3):
        pos, quat, _ = scattered(rng, boxes, within)
        steps = np.linspace(0.0, 1.0, 8)[:, None, None]
        path = GeomPoses(pos=pos + 0.4 * steps, quat=np.broadcast_to(quat, (8, boxes, 4)))
        trees = []
        for step in (3, 0, 7, 5):
            body.move_along(model, path.pos[step], path.quat[step], path)
            trees.append(model.bvh_aabb.copy())
            for ball in range(12):
                data.qpos[7 * ball : 7 * ball + 3] = rng.uniform(-within, within, 3)
            found_all = contacts(model, data, compare_all=True)
            assert contacts(model, data, compare_all=False) == found_all
            order, anew = data.contact.geom.tolist(), model.__copy__()
            MovedBody(anew, ids).move(anew, path.pos[step], path.quat[step], size)
            mujoco.mj_forward(anew, data)
            assert data.contact.geom.tolist() == order
            found += data.ncon
        assert all((tree == trees[0]).all() for tree in trees)
    assert found > 12
    # Without a path the boxes are those of the poses alone.
    exact = model.__copy__()
    MovedBody(exact, ids).move(exact, path.pos[0], path.quat[0])
    body.move(model, path.pos[0], path.quat[0])
    assert np.sort(model.bvh_aabb, axis=0) == pytest.approx(np.sort(exact.bvh_aabb, axis=0), abs=1e-12)


def test_every_node_holds_its_children_and_every_leaf_its_geom():
    model, ids = model_of(37, 1)
    pos, quat, size = scattered(np.random.default_rng(0), 37, side(37))
    MovedBody(model, ids).move(model, pos, quat, size)
    number = model.geom_bodyid[ids[0]]
    nodes = slice(model.body_bvhadr[number], model.body_bvhadr[number] + model.body_bvhnum[number])
    children, leaves, boxes = model.bvh_child[nodes], model.bvh_nodeid[nodes], model.bvh_aabb[nodes]
    assert sorted(leaves[leaves >= 0]) == ids
    assert ((leaves < 0) == (children >= 0).all(axis=1)).all()
    low, high = boxes[:, :3] - boxes[:, 3:], boxes[:, :3] + boxes[:, 3:]
    for node, (one, other) in enumerate(children):
        if one >= 0:
            assert low[node] == pytest.approx(np.minimum(low[one], low[other]))
            assert high[node] == pytest.approx(np.maximum(high[one], high[other]))
            continue
        geom = ids.index(leaves[node])
        mat = np.zeros(9)
        mujoco.mju_quat2Mat(mat, quat[geom])
        corners = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * size[geom]
        frame = np.zeros(9)
        mujoco.mju_quat2Mat(frame, model.body_iquat[number])
        reached = (pos[geom] + corners @ mat.reshape(3, 3).T - model.body_ipos[number]) @ frame.reshape(3, 3)
        assert low[node] == pytest.approx(reached.min(axis=0))
        assert high[node] == pytest.approx(reached.max(axis=0))


@pytest.mark.thorough
def test_worlds_with_arenas_of_their_own_go_as_without_a_tree(monkeypatch):
    """Bit for bit over episodes, with more worlds than threads and other arenas after each reset."""
    arenas = GeneratedArenas(kind="maze", count=3, levels=(0.0, 1.0), size=(3, 3))

    def positions():
        env = make("wander", worlds=5, engine="c", arena=arenas, episode_steps=12)
        state, rng, seen = env.reset(0), np.random.default_rng(0), []
        for _ in range(30):
            actions = tuple(
                rng.uniform(-1, 1, (5, len(group.agents), group.action_size)).astype(np.float32)
                for group in env.groups
            )
            state = env.step(state, actions)
            seen.append(np.asarray(state.batch.physics.qpos).copy())
        return env.batch.engine, np.array(seen)

    engine, found = positions()
    assert isinstance(engine, CEngine)
    assert not engine.model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    compiled = CEngine.compile

    def without(self, spec):
        model = compiled(self, spec)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
        return model

    monkeypatch.setattr(CEngine, "compile", without)
    np.testing.assert_array_equal(positions()[1], found)
