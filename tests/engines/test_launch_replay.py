"""Steps of engine `warp` on a CPU, replayed from recordings; oracle: the same launches, one by one."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

import warp

from tests.engines.test_block import MECHANISM
from usarmjx.engines import mjx_warp
from usarmjx.engines.base import Inputs
from usarmjx.engines.mjx_warp import MOST_RECORDINGS, LaunchReplay, WarpEngine
from usarmjx.models.compile.physics import Physics

WORLDS, STEPS = 2, 24
"""Worlds, and physics steps: the bodies fall to the floor meanwhile."""

pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="GPUs replay CUDA graphs")


@warp.kernel
def add_one(numbers: warp.array(dtype=float), times: int):
    k = warp.tid()
    numbers[k] += float(times)


@warp.kernel
def add_row(row: warp.array2d(dtype=float), numbers: warp.array2d(dtype=float)):
    i, j = warp.tid()
    numbers[i, j] += row[i, j]


@dataclass
class Numbers:
    """An array and what is added to it."""

    array: object
    step: int = 1


class Launches:
    """A function that launches a kernel, zeroes an array of its own, and counts its calls."""

    def __init__(self):
        self.calls = 0

    def __call__(self, model, data):
        del model
        self.calls += 1
        scratch = warp.empty_like(data.array)
        scratch.zero_()
        warp.launch(add_one, dim=len(data.array), inputs=[scratch, data.step])
        warp.launch(add_one, dim=len(data.array), inputs=[data.array, data.step])


def numbers(start=0.0, step=1):
    return Numbers(warp.full(3, start, dtype=float, device="cpu"), step)


def test_all_calls_but_the_first_are_replayed_from_one_recording():
    function, data = Launches(), numbers()
    replay = LaunchReplay(function)
    with warp.ScopedDevice("cpu"):
        replay.run((), data, 10)
        assert data.array.numpy().tolist() == [10.0] * 3
        assert function.calls == 2, "the first, and the recorded one"
        data.array.fill_(5.0)
        replay.run((), data, 7)
    assert data.array.numpy().tolist() == [12.0] * 3
    assert function.calls == 2


def test_single_calls_are_replayed_from_the_second_on():
    function, data = Launches(), numbers()
    replay = LaunchReplay(function)
    with warp.ScopedDevice("cpu"):
        for count in (1, 2, 3, 4):
            replay.run((), data, 1)
            assert data.array.numpy().tolist() == [count] * 3
    assert function.calls == 2


def test_other_arrays_of_one_shape_share_a_recording_and_other_numbers_have_their_own():
    function, one = Launches(), numbers()
    other, faster, longer = numbers(100.0), Numbers(one.array, 10), Numbers(warp.zeros(5, device="cpu"))
    replay = LaunchReplay(function)
    with warp.ScopedDevice("cpu"):
        replay.run((), one, 3)
        replay.run((), other, 3)
        assert function.calls == 2
        replay.run((), faster, 3)
        replay.run((), longer, 3)
    assert one.array.numpy().tolist() == [33.0] * 3
    assert other.array.numpy().tolist() == [103.0] * 3
    assert longer.array.numpy().tolist() == [3.0] * 5
    assert function.calls == 6


def test_only_the_last_recordings_are_kept():
    function = Launches()
    many = [Numbers(warp.zeros(size, device="cpu")) for size in range(1, MOST_RECORDINGS + 2)]
    replay = LaunchReplay(function)
    with warp.ScopedDevice("cpu"):
        for data in [*many, many[-1]]:
            replay.run((), data, 3)
        assert function.calls == 2 * len(many)
        replay.run((), many[0], 3)
    assert function.calls == 2 * len(many) + 2
    assert many[0].array.numpy().tolist() == [6.0]


def test_the_model_is_read_at_each_call_and_not_written():
    """Its fields may differ from call to call, and with a stride of 0 all worlds share one."""

    def function(model, data):
        warp.launch(add_row, dim=data.array.shape, inputs=[model[0], data.array])

    shared = warp.array(
        ptr=(row := warp.array([1.0, 2.0, 3.0], dtype=float, device="cpu")).ptr,
        dtype=float,
        shape=(2, 3),
        strides=(0, 4),
        device="cpu",
    )
    data, replay = Numbers(warp.zeros((2, 3), device="cpu")), LaunchReplay(function)
    with warp.ScopedDevice("cpu"):
        replay.run((shared, shared), data, 2)
        row.fill_(10.0)
        replay.run((shared, shared), data, 2)
    assert data.array.numpy().tolist() == [[22.0, 24.0, 26.0]] * 2
    assert row.numpy().tolist() == [10.0] * 3


def steps_of(physics, cone):
    """Engine states of all arrays after each of some control steps of two worlds."""
    spec = mujoco.MjSpec.from_string(MECHANISM.format(cone=cone, condim=4))
    for name, value in (("max_contact_points", 16), ("max_geom_pairs", 16)):
        spec.add_numeric(name=name, size=1, data=[value])
    engine = WarpEngine(spec, physics, WORLDS)
    model = engine.model
    inputs = Inputs(
        ctrl=jnp.array([[0.3], [-0.3]]),
        act=jnp.zeros((WORLDS, 0)),
        xfrc_applied=jnp.zeros((WORLDS, model.nbody, 6)),
        pinned=jnp.zeros((WORLDS, model.nq), bool),
        pinned_dof=jnp.zeros((WORLDS, model.nv), bool),
        qpos=jnp.zeros((WORLDS, model.nq)),
    )
    state, step, found = engine.start(), jax.jit(engine.advance), []
    for _ in range(STEPS // physics.substeps):
        state = step(state, inputs)
        found.append(jax.device_get(jax.tree.leaves(state)))
    assert engine.uncovered is None
    assert np.asarray(engine.solved(state).contacts).min() > 0
    return found


@pytest.mark.parametrize(
    ("physics", "cone"),
    [
        (Physics(), "pyramidal"),
        (replace(Physics(), substeps=1), "pyramidal"),
        (replace(Physics(), solver="Newton"), "elliptic"),
        (replace(Physics(), solver="block"), "elliptic"),
    ],
    ids=["CG", "one step a call", "Newton", "block"],
)
def test_replayed_steps_have_the_bits_of_plain_ones(physics, cone, monkeypatch):
    replayed, calls = steps_of(physics, cone), []

    def plain(self, model, data, count):
        calls.append(count)
        for _ in range(count):
            self.function(model, data)

    monkeypatch.setattr(LaunchReplay, "run", plain)
    launched = steps_of(physics, cone)
    assert calls == [physics.substeps] * (STEPS // physics.substeps), "the engine steps through it"
    for one, other in zip(replayed, launched, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("solver", ["CG", "block"])
def test_steps_as_on_a_gpu_have_the_bits_of_replayed_ones(solver, monkeypatch):
    """There Warp's callback launches all steps itself: from tracing on, this process says so to it."""
    physics = replace(Physics(), solver=solver)
    replayed, asked = steps_of(physics, "elliptic"), []

    def is_gpu():
        asked.append(True)
        return "gpu"

    def not_replayed(self, model, data, count):
        raise AssertionError("replayed")

    monkeypatch.setattr(LaunchReplay, "run", not_replayed)
    monkeypatch.setattr(mjx_warp, "jax", SimpleNamespace(**vars(jax) | {"default_backend": is_gpu}))
    launched = steps_of(physics, "elliptic")
    assert asked
    for one, other in zip(replayed, launched, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)
