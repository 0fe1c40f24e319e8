"""Colours on Warp, whose kernels run here on its CPU device, against those on JAX, and as a GPU's threads."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.engines.gpu_threads import COMPILER, ptx_of, run_kernel_as_on_a_gpu
from tests.sensors.cameras.stages import NO_LAMPS, PLANE, solid, stage_of, wall
from usarmjx.base.errors import UsageError
from usarmjx.models.types.arena import Light
from usarmjx.models.types.shapes import texture_code, texture_names
from usarmjx.sensors.cameras.lenses import pinhole_rays
from usarmjx.sensors.cameras.paint import ROBOT_LABEL
from usarmjx.sensors.cameras.shading import Headlights, point_lights, shade
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE

pytest.importorskip("warp", reason="needs warp-lang")

from usarmjx.sensors.cameras import shading_warp
from usarmjx.sensors.cameras.shading_warp import shade_on_warp

ATOL = 1e-4  # of a colour from 0 to 1: the same arithmetic, differently contracted by the compilers
FLIPPED = 4  # pixels at the edge of a checker, joint, cell or shadow that may fall on its other side
DISTANCE = 1e-5  # m, as above
SIDE = 64  # pixels
NAMES = ["brick", "tiles", "wood", "concrete", "chart:7", "hazmat:2", "tag:3", "qr:4", "hazmat:5", ""]
LAMPS = point_lights(
    [Light(at=(1.0, y, 2.4), brightness=3.0, rgb=(1.0, 0.7 + 0.1 * y, 0.5)) for y in (-2.0, 1.5)], 0.0
)


def lights_of(on):
    """One carried by the robot of the room, which stands in its light, and one in a corner."""
    return Headlights(
        pos=np.array([[0.3, 0.0, 0.9], [0.0, 3.0, 0.8]], np.float32),
        direction=np.array([[1.0, 0.0, 0.0], [0.8, -0.6, 0.0]], np.float32),
        on=np.array([on, on]),
        label=np.array([ROBOT_LABEL, ROBOT_LABEL + 1]),
    )


def room(lamps, on, shift=0.0):
    """A row of textured boards on a floor, posts before them, a robot, a mirror and two panes."""
    boards = [
        wall((3.0 + 0.1 * (i % 3), -2.7 + 0.6 * i, 0.6 + shift), (0.05, 0.29, 0.5), (0.7, 0.6, 0.5))
        for i in range(len(NAMES))
    ]
    posts = [solid((2.0, y + shift, 0.4), (0.05, 0.1, 0.4), (0.2, 0.5, 0.3)) for y in (-1.2, 0.1, 1.3)]
    others = [
        solid((0, 0, 0), (0, 0, 1), (0.5, 0.5, 0.5), kind=PLANE),
        solid((0.6, 0.0, 0.8), (0.05, 0.2, 0.05), (0.3, 0.3, 0.8), label=ROBOT_LABEL, owner=0),
        solid((2.6, -2.2, 1.3), (0.02, 0.6, 0.4), (0.2, 0.2, 0.2), material="mirror"),
        solid((1.6, 1.0, 1.0), (0.01, 0.5, 0.4), (0.2, 0.6, 0.2), material="glass"),
        solid((1.4, 1.2, 0.9), (0.01, 0.3, 0.4), (0.6, 0.2, 0.2), material="glass"),
        *(solid((1.0 + 0.1 * i, -3.0, 0.1), (0.03, 0.03, 0.1), (0.9, 0.1, 0.1)) for i in range(30)),
    ]
    stage = stage_of(*boards, *posts, *others, sun=(-0.5, 0.3, 0.8), lamps=lamps, headlights=lights_of(on))
    code = np.zeros(len(stage.appearance.label), np.int32)
    # `stage_of` sorts by kind and material; the opaque boards are the first of the last block.
    first = sum(len(block.owner) for block in stage.geoms.blocks[:-1])
    assert stage.geoms.materials[-1] == "opaque"
    code[first : first + len(NAMES)] = [texture_code(name) for name in NAMES]
    appearance = stage.appearance.replace(texture=code, textures=texture_names(code))
    return stage.replace(appearance=appearance, gain=np.float32(1.7), exposure=np.float32(0.6))


def view(count=SIDE * SIDE):
    rays = pinhole_rays(SIDE, SIDE, jnp.float32(1.9))
    return jnp.broadcast_to(jnp.array([-0.6, 0.1, 1.0]), (count, 3)), jnp.asarray(rays.direction)[:count]


def assert_same(found, expected):
    flipped = (np.abs(np.asarray(found.rgb) - expected.rgb) > ATOL).any(-1)
    assert flipped.sum() <= FLIPPED
    np.testing.assert_array_equal(found.label, expected.label)
    np.testing.assert_allclose(found.distance, expected.distance, atol=DISTANCE, rtol=1e-6)


LIGHTS = {"sun": (NO_LAMPS, False), "lamps": (LAMPS, False), "headlights": (LAMPS, True)}


@pytest.mark.parametrize("lit_by", LIGHTS)
def test_colours_are_those_of_jax(lit_by):
    """All textures, floor, mirror, panes, shadows of sun, lamps and headlights."""
    stage, slot = room(*LIGHTS[lit_by]), jnp.int32(EXCLUDE_NONE)
    expected = jax.jit(shade)(stage, *view(), slot)
    assert_same(jax.jit(shade_on_warp)(stage, *view(), slot), expected)
    assert len(np.unique(np.asarray(expected.rgb).round(2), axis=0)) > 60
    others = [
        jax.jit(shade)(room(*other), *view(), slot).rgb for name, other in LIGHTS.items() if name != lit_by
    ]
    for rgb in others:
        assert (np.abs(rgb - expected.rgb) > 0.05).any(-1).mean() > 0.02, "the light matters"


def test_a_camera_passes_its_own_geoms_but_sees_them_in_the_mirror():
    stage = room(NO_LAMPS, False)
    for slot in (EXCLUDE_NONE, 0):
        expected = jax.jit(shade)(stage, *view(), jnp.int32(slot))
        assert_same(jax.jit(shade_on_warp)(stage, *view(), jnp.int32(slot)), expected)
        assert (np.asarray(expected.label) == ROBOT_LABEL).any() == (slot != 0)


def test_all_maps_make_one_launch():
    """Worlds that differ, and cameras of two robots in each: owners and rays of their own."""
    stages = [room(LAMPS, True, shift) for shift in (0.0, 0.05, 0.1)]
    stacked = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(one) for one in x]), *stages)
    start, along = view(256)
    starts = start + jnp.array([0.0, 0.3, 0.0]) * jnp.arange(2)[:, None, None]
    slots = jnp.array([EXCLUDE_NONE, 0])

    def of_world(stage):
        return jax.vmap(lambda start, slot: shade_on_warp(stage, start, along, slot))(starts, slots)

    run = jax.jit(jax.vmap(of_world))
    found = run(stacked)
    # Twice for mirrors and panes, which have a kernel of their own.
    assert run.lower(stacked).as_text().count("stablehlo.custom_call @") == 2
    for w, stage in enumerate(stages):
        for r in range(2):
            expected = jax.jit(shade)(stage, starts[r], along, slots[r])
            assert_same(jax.tree.map(lambda x, w=w, r=r: x[w, r], found), expected)


def test_without_mirrors_and_panes_there_is_one_kernel():
    stage = stage_of(wall((3.0, 0.0, 0.5), (0.1, 2.0, 1.0), (0.5, 0.5, 0.5)))
    run = jax.jit(shade_on_warp)
    assert run.lower(stage, *view(), jnp.int32(-2)).as_text().count("stablehlo.custom_call @") == 1
    assert_same(run(stage, *view(), jnp.int32(-2)), jax.jit(shade)(stage, *view(), jnp.int32(-2)))


def test_more_threads_than_can_be_numbered_are_refused():
    stage = stage_of(wall((3.0, 0.0, 0.5), (0.1, 2.0, 1.0), (0.5, 0.5, 0.5)))
    run = jax.vmap(lambda slot: shade_on_warp(stage, *view(), slot))
    with pytest.raises(UsageError, match=r"1,048,576 pictures of 4,096 rays .* at most 2,147,483,647"):
        jax.eval_shape(run, jax.ShapeDtypeStruct((2**20,), jnp.int32))


@pytest.mark.skipif(COMPILER is None or sys.platform != "linux", reason="needs a compiler of C++20")
@pytest.mark.parametrize("lit_by", [pytest.param("sun", marks=pytest.mark.thorough), "headlights"])
def test_the_lanes_of_a_gpu_see_together_what_one_does(lit_by, monkeypatch):
    """Bundles of 32 rays with one cone for all, votes and keys exchanged: the code of a GPU on threads."""
    stage, slot = room(*LIGHTS[lit_by]), jnp.int32(0)
    # Every other row about the middle: each is two bundles.
    start, along = (x.reshape(SIDE, SIDE, 3)[29:49:2].reshape(-1, 3) for x in view())
    expected = jax.jit(shade)(stage, start, along, slot)
    ran = []

    def kernel_of(name, outputs):
        def run(*args, output_dims, launch_dims):
            kinds = {"rgb": (3, np.float32), "distance": (1, np.float32)}
            kernel = getattr(shading_warp, name)
            labels = [known.label for known in kernel.adj.args[-outputs:]]
            shapes = [kinds.get(label, (1, np.int32)) for label in labels]
            empty = [np.full((output_dims, n), -9, kind).squeeze() for n, kind in shapes]
            args = [np.ascontiguousarray(x) if np.ndim(x) else int(x) for x in args]
            ran.append(name)
            return run_kernel_as_on_a_gpu(kernel, args, empty, launch_dims, shading_warp.BLOCK_DIM)

        return run

    monkeypatch.setattr(shading_warp, "_kernel", kernel_of)
    monkeypatch.setattr(shading_warp, "merge_vmaps", lambda run: run)
    assert_same(shade_on_warp(stage, start, along, slot), expected)
    assert ran == ["shade_rays", "shade_mirrors_and_panes"]


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp compiles for no GPU there")
def test_they_compile_for_a_gpu(tmp_path):
    assert ptx_of(shading_warp, tmp_path, arch=90).count(".entry") == 2
