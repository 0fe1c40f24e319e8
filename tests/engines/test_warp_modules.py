"""Modules of Warp's kernels, found before a step and loaded side by side; oracle: those that it launches."""

from dataclasses import replace
from functools import partial
from threading import Event, Thread
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import pytest
from typer.testing import CliRunner

pytest.importorskip("warp", reason="needs warp-lang")

import warp

from tests.engines.test_block import MECHANISM
from usarmjx.base import warp_modules
from usarmjx.base.warp_functions import once_loaded
from usarmjx.base.warp_modules import (
    WarpModule,
    block_sizes_of_gpus,
    compile_for,
    load_side_by_side,
    modules_of,
    wait_for_modules,
)
from usarmjx.cli.app import app
from usarmjx.engines.base import Inputs
from usarmjx.engines.block.solver import CLASSES
from usarmjx.engines.mjx_warp import LaunchReplay, WarpEngine
from usarmjx.models.compile.physics import Physics

pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="a GPU has launched others by now")
WORLDS = 2


@warp.kernel(module="unique")
def add_one(numbers: warp.array(dtype=float)):
    numbers[warp.tid()] += 1.0


@warp.func
def much(x: float):
    return warp.sin(x) * warp.cos(x) + warp.exp(x) - warp.sqrt(warp.abs(x)) * warp.log(warp.abs(x) + 1.0)


@warp.kernel(module="unique")
def add_much(numbers: warp.array(dtype=float)):
    numbers[warp.tid()] += much(numbers[warp.tid()])


def launch(data, *kernels):
    for kernel in kernels:
        warp.launch(kernel, dim=len(data), inputs=[data], device="cpu")


def engine_of(cone, physics):
    spec = mujoco.MjSpec.from_string(MECHANISM.format(cone=cone, condim=4))
    for name, value in (("max_contact_points", 16), ("max_geom_pairs", 16)):
        spec.add_numeric(name=name, size=1, data=[value])
    return WarpEngine(spec, physics, WORLDS)


def test_modules_of_launches_are_listed_longest_first_and_nothing_is_launched():
    data = warp.zeros(3, dtype=float, device="cpu")
    found = modules_of(lambda: launch(data, add_one, add_much, add_one))
    assert [one.module for one in found] == [add_much.module, add_one.module]
    assert {one.block_dim for one in found} == {1}, "a CPU has blocks of one thread"
    assert data.numpy().tolist() == [0.0] * 3
    launch(data, add_one)
    assert data.numpy().tolist() == [1.0] * 3


def test_a_kernel_that_is_asked_for_a_block_size_is_not_loaded():
    """On a GPU that needs the loaded kernel; MuJoCo Warp asks three of its kernels."""
    size, usual = [], warp.get_suggested_block_size

    def run():
        size.append(warp.get_suggested_block_size(add_much, warp.get_device("cpu")))

    (found,) = modules_of(run)
    assert found == (add_much.module, add_much.module.options["block_dim"])
    assert size == [(found.block_dim, 1)]
    assert warp.get_suggested_block_size is usual


def test_launches_of_other_threads_go_on():
    data, inside, done = warp.zeros(3, dtype=float, device="cpu"), Event(), Event()

    def other():
        inside.wait(60)
        launch(data, add_one)
        done.set()

    thread = Thread(target=other)
    thread.start()

    def run():
        inside.set()
        assert done.wait(60)

    assert modules_of(run) == []
    thread.join()
    assert data.numpy().tolist() == [1.0] * 3


def test_a_callback_of_xla_waits_for_the_modules():
    modules = modules_of(lambda: launch(warp.zeros(3, dtype=float, device="cpu"), add_one, add_much))
    for one in modules:
        one.module.unload()
    load_side_by_side(modules, warp.get_device("cpu"))
    registered, gate = Event(), Event()
    slow = SimpleNamespace(execs=(), load=lambda device, block_dim: gate.wait(60))
    load_side_by_side([modules[0]._replace(module=slow)], warp.get_device("cpu"))
    callback = once_loaded(lambda: [(None, 1) in one.module.execs for one in modules], registered)
    callback()  # as XLA does when it registers one: tracing goes on while modules are compiled
    registered.set()
    gate.set()
    assert callback() == [True, True]


def test_a_module_that_fails_is_left_to_its_first_launch():
    class Bad:
        execs = ()

        def load(self, device, block_dim):
            raise RuntimeError("cannot compile")

    (good,) = modules_of(lambda: launch(warp.zeros(3, dtype=float, device="cpu"), add_one))
    good.module.unload()
    load_side_by_side([good._replace(module=Bad()), good], warp.get_device("cpu"))
    wait_for_modules()
    assert (None, 1) in good.module.execs


def test_all_threads_wait_for_a_module_that_is_being_loaded():
    class Slow:
        execs = ()
        loaded = Event()

        def load(self, device, block_dim):
            assert self.loaded.wait(60)

    load_side_by_side([WarpModule(Slow(), 1)], warp.get_device("cpu"))
    threads = [Thread(target=wait_for_modules) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(0.2)
        assert thread.is_alive()
    Slow.loaded.set()
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()


@pytest.mark.parametrize(
    ("physics", "cone"),
    [
        (Physics(), "pyramidal"),
        (replace(Physics(), solver="Newton"), "elliptic"),
        (replace(Physics(), solver="block"), "elliptic"),
    ],
    ids=["CG", "Newton", "block"],
)
def test_a_step_launches_kernels_of_no_other_modules(physics, cone, monkeypatch):
    """The step's own callback is the oracle: it has XLA's arrays of all worlds, and launches nothing here."""
    engine, launched = engine_of(cone, physics), []

    def record(self, model, data, count):
        del count
        launched.append(modules_of(partial(self.function, model, data)))

    monkeypatch.setattr(LaunchReplay, "run", record)
    inputs = Inputs(
        ctrl=jnp.zeros((WORLDS, engine.model.nu)),
        act=jnp.zeros((WORLDS, 0)),
        xfrc_applied=jnp.zeros((WORLDS, engine.model.nbody, 6)),
        pinned=jnp.zeros((WORLDS, engine.model.nq), bool),
        pinned_dof=jnp.zeros((WORLDS, engine.model.nv), bool),
        qpos=jnp.zeros((WORLDS, engine.model.nq)),
    )
    jax.block_until_ready(jax.jit(engine.advance)(engine.start(), inputs))
    assert len(launched) == 1
    assert len(launched[0]) > 10
    assert set(engine.modules_of_step()) == set(launched[0])


def test_what_is_compiled_for_a_gpu_elsewhere_is_what_a_gpu_looks_for(tmp_path, monkeypatch):
    """Oracle: Warp's compilation, which a load begins with and which has nothing to do then."""
    data = warp.zeros(3, dtype=float, device="cpu")

    def run():
        launch(data, add_one)
        warp.launch(add_much, dim=3, inputs=[data], device="cpu", block_dim=64)

    def compiles(kernel, size, architecture):
        options = kernel.module.resolve_options(warp.config, block_dim=size)
        options |= {"block_dim": size}
        return kernel.module._compile(output_arch=architecture, use_ptx=False, options=options)

    monkeypatch.setattr(warp.config, "kernel_cache_dir", str(tmp_path))
    with block_sizes_of_gpus():
        found = modules_of(run)
    assert set(found) == {WarpModule(add_one.module, 1), WarpModule(add_much.module, 64)}
    compile_for(found, [80, 90])
    usual = 256  # of launches that ask for no size, on a GPU
    for kernel, size in ((add_one, usual), (add_much, 64)):
        assert [compiles(kernel, size, known) for known in (80, 90)] == [False, False]
    assert compiles(add_one, usual, 75), "a GPU of another architecture"
    assert compiles(add_much, 128, 90), "blocks of another size"


def test_kernels_of_a_served_batch_are_compiled_with_the_block_sizes_of_a_gpu(monkeypatch):
    asked = []
    monkeypatch.setattr(warp_modules, "compile_for", lambda *given: asked.append(given))
    result = CliRunner().invoke(app, ["kernels", "--roster", "P2AT:1", "80", "90"])
    assert result.exit_code == 0, result.stderr
    ((modules, architectures),) = asked
    assert architectures == [80, 90]
    names = {one.module.name.partition("__")[0] for one in modules}
    assert {"ccd_kernel_builder", "newton_kernel", "islands_kernel"} <= names
    sizes = sorted(one.block_dim for one in modules if "newton_kernel" in one.module.name)
    assert sizes == sorted(one.block for one in CLASSES)
    assert f"{len(modules)} modules" in result.stderr


@pytest.mark.parametrize("architecture", ["51", "999", "-1"])
def test_architectures_that_warp_cannot_compile_for_are_refused_in_a_line(architecture):
    result = CliRunner().invoke(app, ["kernels", "90", "--", architecture])
    assert (result.exit_code, result.stdout) == (2, "")
    assert f"compute capability {architecture}: Warp compiles for 75, 80," in result.stderr
