"""Layers that networks of all kinds are built from."""

from typing import Any

import flax.linen as nn
import jax

ROOT_TWO = 2.0**0.5
"""Scale of a hidden layer's initial weights."""


def dense(width: int, name: str, *, bias: bool = True) -> nn.Dense:
    """Return a hidden linear layer."""
    return nn.Dense(width, use_bias=bias, kernel_init=nn.initializers.orthogonal(ROOT_TWO), name=name)


def param(module: Any, name: str, init: Any, shape: tuple[int, ...]) -> jax.Array:  # noqa: ANN401
    """Return a parameter of a module that is being called."""
    return module.param(name, init, shape)  # which flax leaves without types


def with_team_terms(
    module: nn.Module, x: jax.Array, shared: jax.Array | None, robots: int, layer: nn.Dense
) -> jax.Array:
    """Return a first layer's sums, with those of shared numbers and a bias of each robot.

    Args:
        module: The module that is being called.
        x: The sums (steps, worlds, robots, width).
        shared: Numbers that the robots of a world share (steps, worlds, m); None: none.
        robots: Robots with a bias of their own; up to 1: none.
        layer: Layer of the shared numbers.
    """
    if shared is not None and shared.shape[-1]:
        # The same product for all robots of a world is computed once.
        x = x + layer(shared)[..., None, :]
    if robots > 1:
        x = x + param(module, "robot", nn.initializers.zeros, (robots, x.shape[-1]))
    return x
