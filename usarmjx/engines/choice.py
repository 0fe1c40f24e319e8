"""Which engine to use where. MJX is imported only when one of its engines is built."""

import importlib.util
from importlib import import_module
from typing import Any, Literal

import jax
import mujoco

from usarmjx.base.registry import Registry
from usarmjx.engines.base import Engine
from usarmjx.models.build.compose import Physics
from usarmjx.models.build.layout import RobotIndex
from usarmjx.models.build.moved import MovedGeoms
from usarmjx.models.build.variation import RandomizedBodies
from usarmjx.models.spec.robot import RobotSpec

ENGINES: Registry[tuple[str, str]] = Registry("engine")
"""Module and class of each engine."""
ENGINES.add("c", ("usarmjx.engines.c", "CEngine"))
ENGINES.add("jax", ("usarmjx.engines.mjx", "JaxEngine"))
ENGINES.add("planar", ("usarmjx.engines.planar.engine", "PlanarEngine"))
ENGINES.add("warp", ("usarmjx.engines.mjx_warp", "WarpEngine"))


def choose_engine(name: str, purpose: Literal["serve", "train", "batch"]) -> str:
    """Resolve `auto`: warp on an NVIDIA GPU; else c to serve one world, jax for a batch that is compiled.

    What trains or tries policies takes c on a CPU, and jax on what is neither.

    Raises:
        UnknownNameError: No such engine; lists those there are.
    """
    if name.lower() != "auto":
        ENGINES.get(name)
        return name.lower()
    kinds = {device.platform for device in jax.devices()}
    if "gpu" in kinds and importlib.util.find_spec("warp") is not None:
        return "warp"
    return "c" if purpose == "serve" or (purpose == "train" and kinds == {"cpu"}) else "jax"


def engine_class(name: str) -> type[Engine[Any]]:
    """Return the class of an engine.

    Raises:
        UnknownNameError: No such engine.
    """
    module, kind = ENGINES.get(name)
    return getattr(import_module(module), kind)


def make_engine(
    name: str,
    spec: mujoco.MjSpec,
    physics: Physics,
    worlds: int,
    moved_geoms: MovedGeoms | None = None,
    varied_bodies: RandomizedBodies | None = None,
    robots: tuple[tuple[RobotSpec, RobotIndex], ...] = (),
) -> Engine[Any]:
    """Build an engine by name; the other arguments are those of `Engine`, and the robots by slot.

    Raises:
        UnknownNameError: No such engine.
        UnsupportedFeatureError: The model has a feature that the engine would ignore.
        EngineError: The engine cannot run here.
    """
    engine = engine_class(name)
    more = {"robots": robots} if engine.needs_robots else {}
    return engine(spec, physics, worlds, moved_geoms, varied_bodies, **more)
