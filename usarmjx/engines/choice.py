"""Which engine to use where."""

import importlib.util
from typing import Literal

import jax
import mujoco

from usarmjx.engines.base import Engine
from usarmjx.engines.c import CEngine
from usarmjx.engines.mjx import JaxEngine, WarpEngine
from usarmjx.models.compose import Physics
from usarmjx.registry import Registry

ENGINES: Registry[type[Engine]] = Registry("engine")
for _engine in (CEngine, JaxEngine, WarpEngine):
    ENGINES.add(_engine.name, _engine)


def choose_engine(name: str, purpose: Literal["serve", "train"]) -> str:
    """Resolve `auto`: warp on an NVIDIA GPU; else c to serve one world, jax to train on many.

    Raises:
        UnknownNameError: No such engine; lists those there are.
    """
    if name.lower() != "auto":
        return ENGINES.get(name).name
    gpu = any(device.platform == "gpu" for device in jax.devices())
    if gpu and importlib.util.find_spec("warp") is not None:
        return "warp"
    return "c" if purpose == "serve" else "jax"


def make_engine(name: str, spec: mujoco.MjSpec, physics: Physics, worlds: int) -> Engine:
    """Build an engine by name.

    Raises:
        UnknownNameError: No such engine.
        UnsupportedFeatureError: The model has a feature that the engine would ignore.
        EngineError: The engine cannot run here.
    """
    return ENGINES.get(name)(spec, physics, worlds)
