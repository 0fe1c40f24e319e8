"""Convex geoms against a box of 40 m on engine `warp`; oracle: C MuJoCo, in double precision."""

from importlib import import_module
from operator import itemgetter
from typing import Any

import jax
import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

import warp as wp

from usarmjx.engines import mjx_warp, warp_near_boxes
from usarmjx.models.compile.physics import Physics

pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="launches are on Warp's CPU device")
POSES = 64
HALF = np.array([20.0, 5.0, 0.1])
SCENE = """<mujoco><option><flag multiccd="disable"/></option><worldbody>
  <geom name="ramp" type="box" size="20 5 .1" quat="0.9914449 0 -0.1305262 0"/>
  <body><freejoint/><geom name="it" type="{kind}" size="{size}"/></body></worldbody></mujoco>"""
CASES = {
    "wheel": ("cylinder", ".11 .05"),
    "pipe": ("cylinder", ".02 .3"),
    "egg": ("ellipsoid", ".1 .06 .2"),
    "box": ("box", ".2 .15 .1"),
}


def support(kind: str, size: np.ndarray, direction: np.ndarray) -> float:
    """Return the extent of a geom in a direction of its own frame [m]."""
    if kind == "cylinder":
        return float(size[0] * np.hypot(*direction[:2]) + size[1] * abs(direction[2]))
    return float(np.abs(direction) @ size if kind == "box" else np.linalg.norm(direction * size))


def poses(model: mujoco.MjModel, kind: str, size: str, count: int = POSES) -> np.ndarray:
    """Poses in which a geom is up to a centimetre deep in the top face, every fourth one over an edge."""
    rng, found, half = np.random.default_rng(0), np.zeros((count, 7)), np.array(size.split(), float)
    ramp, own = np.zeros(9), np.zeros(9)
    mujoco.mju_quat2Mat(ramp, model.geom_quat[0])
    turn = ramp.reshape(3, 3)
    for k, pose in enumerate(found):
        x, y = rng.uniform(-0.99, 0.99, 2) * HALF[:2]
        if k % 4 == 0:
            x = np.sign(x) * (HALF[0] + rng.uniform(-0.05, 0.02))
        pose[3:] = rng.standard_normal(4)
        pose[3:] /= np.linalg.norm(pose[3:])
        mujoco.mju_quat2Mat(own, pose[3:])
        depth = rng.uniform(1e-4, 0.01)
        height = support(kind, half, -own.reshape(3, 3).T @ turn[:, 2]) - depth
        pose[:3] = turn @ np.array([x, y, HALF[2] + height])
    return found


def in_c(model: mujoco.MjModel, at: np.ndarray) -> list[list[tuple[float, np.ndarray]]]:
    """Distance and normal of the contacts of each pose."""
    data, found = mujoco.MjData(model), []
    for pose in at:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        found.append([(one.dist, one.frame[:3].copy()) for one in data.contact[: data.ncon]])
    return found


def on_warp(model: mujoco.MjModel, at: np.ndarray, collision: Any) -> list[list[tuple[float, np.ndarray]]]:
    """The same of a collision function of MuJoCo Warp."""
    mjw: Any = import_module("mujoco.mjx.third_party.mujoco_warp")
    count = len(at)
    m, d = mjw.put_model(model), mjw.make_data(model, nworld=count, naconmax=8 * count, njmax=64)
    d.qpos.assign(at.astype(np.float32))
    mjw.kinematics(m, d)
    collision(m, d)
    worlds, dist = d.contact.worldid.numpy()[: int(d.nacon.numpy()[0])], d.contact.dist.numpy()
    normals = d.contact.frame.numpy()[:, 0]
    return [[(dist[i], normals[i]) for i in np.flatnonzero(worlds == k)] for k in range(count)]


def worst(found: Any, expected: Any) -> tuple[int, float, float]:
    """Poses with another number of contacts; largest errors of distances [m] and normals of the others."""
    both = [(a, b) for a, b in zip(found, expected, strict=True) if len(a) == len(b)]
    deepest = itemgetter(0)
    pairs = [
        pair for a, b in both for pair in zip(sorted(a, key=deepest), sorted(b, key=deepest), strict=True)
    ]
    return (
        len(found) - len(both),
        max(abs(float(a[0]) - b[0]) for a, b in pairs),
        max(float(np.linalg.norm(a[1] - b[1])) for a, b in pairs),
    )


@pytest.mark.parametrize("case", CASES)
def test_contacts_with_a_large_box_are_those_of_double_precision(case):
    """Within 2 um, single precision of some metres; normals to 0.02, as far as the collider iterates."""
    model = mujoco.MjModel.from_xml_string(SCENE.format(kind=CASES[case][0], size=CASES[case][1]))
    at = poses(model, *CASES[case])
    others, dist, normal = worst(on_warp(model, at, mjx_warp._collision(None)), in_c(model, at))
    assert others == 0
    assert dist < 2e-6
    assert normal < 0.02


def standing(model: mujoco.MjModel, kind: str, size: str, count: int) -> np.ndarray:
    """Poses of a geom that stands on the top face, leans by 1e-6 and is up to 0.2 mm deep in it."""
    rng, found, half = np.random.default_rng(1), np.zeros((count, 7)), np.array(size.split(), float)
    ramp, own = np.zeros(9), np.zeros(9)
    mujoco.mju_quat2Mat(ramp, model.geom_quat[0])
    turn = ramp.reshape(3, 3)
    for pose in found:
        pose[3:], turned = model.geom_quat[0], np.zeros(4)
        upright, spin = (np.pi / 2 if kind == "cylinder" else 0.0), rng.uniform(-np.pi, np.pi)
        for axis, angle in ((0, upright), (2, spin), (0, 1e-6 * rng.standard_normal())):
            mujoco.mju_axisAngle2Quat(turned, np.eye(3)[axis], angle)
            mujoco.mju_mulQuat(pose[3:], pose[3:].copy(), turned)
        mujoco.mju_quat2Mat(own, pose[3:])
        height = support(kind, half, -own.reshape(3, 3).T @ turn[:, 2]) - rng.uniform(2e-6, 2e-4)
        pose[:3] = turn @ np.array([*rng.uniform(-0.02, 0.02, 2), HALF[2] + height])
    return found


@pytest.mark.parametrize(
    ("kind", "size"), [("cylinder", ".45 .13"), ("cylinder", ".125 .03"), ("box", ".2 .15 .1")]
)
def test_what_stands_on_a_large_box_keeps_its_contact_and_its_normal(kind, size):
    """A search that stalls in single precision begins anew, and a face replaces EPA where that fails.

    Of wide wheels 3 % lost their contact. Depths within 1 um and normals within 5e-5: the tolerance of C's
    collider, which leans by 2e-5 in one of these poses.
    """
    model = mujoco.MjModel.from_xml_string(SCENE.format(kind=kind, size=size))
    at = standing(model, kind, size, 10_000).astype(np.float32)
    found, expected = on_warp(model, at, mjx_warp._collision(None)), in_c(model, at)
    assert all(found)
    depth = [
        min(map(itemgetter(0), one)) - min(map(itemgetter(0), other))
        for one, other in zip(found, expected, strict=True)
    ]
    assert np.abs(depth).max() < 1e-6
    normals = [one[1] - other[0][1] for own, other in zip(found, expected, strict=True) for one in own]
    assert np.linalg.norm(normals, axis=-1).max() < 5e-5


def test_a_block_on_level_ground_keeps_its_four_contacts():
    """Searches of 0.2 % of them stall; faces have the depth, but not the contacts of a search that ends."""
    scene = SCENE.replace("0.9914449 0 -0.1305262 0", "1 0 0 0")
    model = mujoco.MjModel.from_xml_string(scene.format(kind="box", size=".1 .1 .1"))
    at = standing(model, "box", ".1 .1 .1", 40_000).astype(np.float32)
    assert {len(one) for one in on_warp(model, at, mjx_warp._collision(None))} == {4}


@pytest.mark.parametrize("case", CASES)
def test_a_geom_that_is_deep_in_a_large_box_keeps_its_contact(case):
    """Of 2,000 poses one to six had none, up to 9 mm deep; flat ones of boxes may have other numbers."""
    model = mujoco.MjModel.from_xml_string(SCENE.format(kind=CASES[case][0], size=CASES[case][1]))
    at = poses(model, *CASES[case], 2000).astype(np.float32)
    found, expected = on_warp(model, at, mjx_warp._collision(None)), in_c(model, at)
    assert [bool(one) for one in found] == [bool(one) for one in expected]


@pytest.mark.parametrize("radii", [3.9, 4.1, 12.0])
def test_a_geom_deep_in_a_box_leaves_it_by_the_face_that_it_does_in_double_precision(radii):
    """A cut is no face of the box: in a block of 10 m the way out is up, from 2.4 m below it, too."""
    scene = SCENE.replace("20 5 .1", "20 20 5").replace("0.9914449 0 -0.1305262 0", "1 0 0 0")
    model = mujoco.MjModel.from_xml_string(scene.format(kind=CASES["egg"][0], size=CASES["egg"][1]))
    rng, at = np.random.default_rng(0), np.zeros((POSES, 7))
    at[:, :2], at[:, 2] = rng.uniform(-14.0, 14.0, (POSES, 2)), 5.0 - radii * 0.2
    at[:, 3:] = rng.standard_normal((POSES, 4))
    at[:, 3:] /= np.linalg.norm(at[:, 3:], axis=-1, keepdims=True)
    others, dist, normal = worst(on_warp(model, at, mjx_warp._collision(None)), in_c(model, at))
    assert others == 0
    assert dist < 4e-6  # single precision of some metres: a number of 4 to 8 m is true to 0.5 um
    assert normal < 0.02


@wp.kernel
def cut(box: Any, kind: int, other: wp.vec3, radius: float, out: wp.array(dtype=wp.vec3)):
    near = warp_near_boxes.cut_box(box, kind, other, radius)
    out[0] = near.pos
    out[1] = near.size


@pytest.mark.parametrize(
    ("other", "radius", "pos", "size"),
    [
        # Half of the cut: 1 m, 5 radii and 0.5 m; its middle is at most 1 m from the other's.
        ((0.2, 0.1, 0.3), 0.1, (0.0, 0.0, 0.0), (2.0, 2.0, 0.1)),
        ((12.2, -3.0, 0.3), 0.1, (11.0, -2.0, 0.0), (2.0, 2.0, 0.1)),
        ((19.9, 0.0, 0.3), 0.1, (18.5, 0.0, 0.0), (1.5, 2.0, 0.1)),  # no farther than the box itself
        ((12.2, -3.0, 0.3), 4.0, (0.0, 0.0, 0.0), (20.0, 5.0, 0.1)),  # a geom for which the box is small
        ((12.2, -3.0, 0.3), -1.0, (0.0, 0.0, 0.0), (20.0, 5.0, 0.1)),  # a mesh
        ((12.2, -3.0, 0.0), 0.02, (0.0, 0.0, 0.0), (20.0, 5.0, 0.1)),  # five radii deep
        ((40.0, 0.0, 0.3), 0.1, (0.0, 0.0, 0.0), (20.0, 2.0, 0.1)),  # too far away to touch
    ],
)
def test_a_box_is_cut_around_the_other_geom(other, radius, pos, size):
    struct = import_module("mujoco.mjx.third_party.mujoco_warp._src.collision_core").Geom
    box, out = struct(), wp.zeros(2, dtype=wp.vec3, device="cpu")
    box.pos, box.rot, box.size = wp.vec3(), wp.mat33(*np.eye(3).ravel()), wp.vec3(*HALF)
    wp.launch(
        cut, dim=1, inputs=[box, int(mujoco.mjtGeom.mjGEOM_BOX), wp.vec3(*other), radius, out], device="cpu"
    )
    np.testing.assert_allclose(out.numpy(), [pos, size], atol=1e-5)


@pytest.mark.parametrize("solver", ["CG", "Newton", "block"])
def test_every_solver_has_this_collider(solver, monkeypatch):
    asked, builder = [], warp_near_boxes.near_collider.__wrapped__
    spec = mujoco.MjSpec.from_string(SCENE.format(kind="box", size=".2 .15 .1"))
    for name in ("max_contact_points", "max_geom_pairs"):
        spec.add_numeric(name=name, size=1, data=[16])
    engine = mjx_warp.WarpEngine(spec, Physics(solver=solver), 1)

    def note(*args: int) -> Any:
        asked.append(args)
        return builder(*args)

    monkeypatch.setattr("usarmjx.engines.block.branches.near_collider", note)
    assert engine.modules_of_step()
    assert len(asked) == 1
