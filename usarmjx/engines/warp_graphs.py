"""Which CUDA graphs engine `warp` launches: of a physics step or of a control step, and on whose arrays.

MJX calls MuJoCo Warp once for each physics step, through XLA's interface for foreign functions: Python looks
whether a graph was captured for these arrays and launches it. MJX's own step is taken for a control step
here, with the kernels of several steps in the one call. That reaches into private names of MJX, of the one
version that `register_collision` checks.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from types import FunctionType, SimpleNamespace
from typing import Any

from jax.custom_batching import custom_vmap

from usarmjx.base.registry import Registry
from usarmjx.engines.cylinder_box import check_mjx_version


@dataclass(frozen=True)
class CapturedGraphs:
    """Which graphs are captured.

    Attributes:
        mode: Name of one of Warp's JaxCallableGraphMode. WARP captures a graph for each set of arrays that
            XLA hands over, WARP_STAGED one for all of them, which copies in and out, WARP_STAGED_EX copies
            before and after it. A CPU has no graphs.
        control_step: Whether a graph is of all physics steps of a control step.
    """

    mode: str = "WARP"
    control_step: bool = False


GRAPHS: Registry[CapturedGraphs] = Registry("kind of CUDA graphs")
for _mode, _suffix in (("WARP", ""), ("WARP_STAGED", "-staged"), ("WARP_STAGED_EX", "-staged-ex")):
    GRAPHS.add(f"step{_suffix}", CapturedGraphs(_mode))
    GRAPHS.add(f"control{_suffix}", CapturedGraphs(_mode, control_step=True))


def _with_globals(function: Callable[..., None], **changed: object) -> Callable[..., Any]:
    """Return a copy of a function that sees other things under some names of its module."""
    seen = {**function.__globals__, **changed}
    copied = FunctionType(function.__code__, seen, function.__name__)
    copied.__annotations__, copied.__module__ = function.__annotations__, function.__module__
    return copied


@cache
def step_several(count: int) -> Callable[[Any, Any], Any]:
    """Return `mjx.step` for MuJoCo Warp with so many physics steps in one call; map it over the worlds.

    Raises:
        EngineError: mujoco-mjx is of another version than the one whose private names these are.
    """
    check_mjx_version()
    forward, ffi = (import_module(f"mujoco.mjx.warp.{name}") for name in ("forward", "ffi"))

    def run_kernels(model: object, data: object) -> None:
        for _ in range(count):
            forward.mjwarp.step(model, data)

    shim = _with_globals(forward._step_shim.__wrapped__, mjwarp=SimpleNamespace(step=run_kernels))
    call = _with_globals(forward._step_jax_impl, _step_shim=ffi.format_args_for_warp(shim))
    step = custom_vmap(ffi.marshal_jax_warp_callable(call))

    @step.def_vmap
    @ffi.marshal_custom_vmap
    def step_worlds(axis_size: int, is_batched: tuple[Any, Any], model: Any, data: Any) -> tuple[Any, Any]:  # noqa: ANN401
        del axis_size
        return step(model, data), is_batched[1]

    return step
