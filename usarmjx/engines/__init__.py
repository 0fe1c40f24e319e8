"""Physics behind one interface: `warp`, `jax` and `c` advance the same model."""

from usarmjx.engines.base import Engine, Inputs, PhysicsState
from usarmjx.engines.choice import ENGINES, choose_engine, make_engine

__all__ = ["ENGINES", "Engine", "Inputs", "PhysicsState", "choose_engine", "make_engine"]
