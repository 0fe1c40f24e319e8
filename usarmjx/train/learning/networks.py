"""Policies and critics: one of each for every group of robots, shared by the robots of the group.

A robot that chooses has a network over the set of its choices: the choice does not depend on the order of
choices of a kind or of other robots, and the weights are the same for any number of them. Running means and
deviations shift and scale what it observes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax import custom_batching

from usarmjx.base.compilation import unroll_on_gpu
from usarmjx.base.errors import UsageError, extra
from usarmjx.base.warp_functions import warp_in_use
from usarmjx.train.envs.env import AgentGroup
from usarmjx.train.envs.layout import ObservationLayout, Span
from usarmjx.train.envs.task import Policy
from usarmjx.train.learning.distributions import (
    ChoiceDistribution,
    Distribution,
    MixedDistribution,
    choice_distribution,
    mode_action,
    normal_tanh,
)
from usarmjx.train.policies.set_forward import FILTERS, MASKED, heads_of

MAX_NORMALISED = 10.0
"""Normalised observations are cut to +- this many deviations."""
MIN_DEVIATION = 1e-2
"""Least deviation by which a quantity is divided: one that hardly changes is not blown up."""


class Count(struct.PyTreeNode, kw_only=True):
    """Number of values, in halves: JAX has no integers of 64 bits by default.

    Attributes:
        hi: Multiples of 2^32 ().
        lo: The rest ().
    """

    hi: jax.Array
    lo: jax.Array

    def __int__(self) -> int:
        """Return the number."""
        return (int(self.hi) << 32) + int(self.lo)


class RunningStatistics(struct.PyTreeNode, kw_only=True):
    """Brax's running statistics, field by field, because importing Brax imports MJX and Warp, too.

    That takes two seconds of a start, and only tracing needs it.

    Attributes:
        mean: Mean so far (...).
        std: Deviation so far (...).
        count: Number of values.
        summed_variance: Sum of the squared differences from the mean (...).
        std_eps: Constant that Brax adds to variances ().
    """

    mean: jax.Array
    std: jax.Array
    count: Count
    summed_variance: jax.Array
    std_eps: jax.Array


class Statistics(struct.PyTreeNode, kw_only=True):
    """Mean and deviation of a quantity so far.

    Attributes:
        running: Statistics that Brax continues.
    """

    running: RunningStatistics

    @property
    def mean(self) -> jax.Array:
        """Return the mean (*shape)."""
        return self.running.mean

    @property
    def std(self) -> jax.Array:
        """Return the deviation (*shape), at least `MIN_DEVIATION`."""
        return self.running.std


def init_statistics(*shape: int) -> Statistics:
    """Return statistics of nothing yet: mean 0, deviation 1."""
    zeros, zero = jnp.zeros(shape), jnp.uint32(0)
    return Statistics(
        running=RunningStatistics(
            mean=zeros,
            # 1, as observations are divided by it before the first update.
            std=jnp.ones(shape),
            count=Count(hi=zero, lo=zero),
            summed_variance=zeros,
            std_eps=jnp.float32(0.0),
        )
    )


def update_statistics(statistics: Statistics, values: jax.Array, valid: jax.Array, axis: str) -> Statistics:
    """Include values (..., *shape) where valid (...), of all processes along a mesh axis."""
    with extra("train"):
        from brax.training.acme import running_statistics
    before, library = statistics.running, cast(Any, running_statistics)
    # Brax's functions want a state of its own class; only its fields are kept here.
    fresh = library.init_state(before.mean)
    state = fresh.replace(
        mean=before.mean,
        std=before.std,
        count=fresh.count.replace(hi=before.count.hi, lo=before.count.lo),
        summed_variance=before.summed_variance,
        std_eps=before.std_eps,
    )
    mask = valid.reshape(*valid.shape, *[1] * (values.ndim - valid.ndim))
    weights = valid.astype(jnp.float32)
    updated = library.update(
        state,
        # A weight of 0 does not help: 0 times NaN is NaN.
        jnp.where(mask & jnp.isfinite(values), values, statistics.mean),
        weights=weights,
        std_min_value=MIN_DEVIATION,
        pmap_axis_name=axis,
    )
    after = before.replace(
        mean=updated.mean,
        std=updated.std,
        count=Count(hi=updated.count.hi, lo=updated.count.lo),
        summed_variance=updated.summed_variance,
    )
    any_valid = jax.lax.psum(weights.sum(), axis) > 0  # none at all would be a division by zero
    return Statistics(running=jax.tree.map(lambda one, old: jnp.where(any_valid, one, old), after, before))


def normalise(mean: jax.Array, std: jax.Array, values: jax.Array) -> jax.Array:
    """Return values shifted and scaled, never beyond `MAX_NORMALISED`; what is not finite counts as usual."""
    return jnp.clip(
        (jnp.where(jnp.isfinite(values), values, mean) - mean) / std, -MAX_NORMALISED, MAX_NORMALISED
    )


ROOT_TWO = 2.0**0.5
"""Scale of a hidden layer's initial weights."""
_one_by_one = cast(Any, custom_batching).sequential_vmap
"""Function that is mapped over seeds in a loop; jax leaves its types open."""
Residuals: TypeAlias = tuple[jax.Array, ...]
"""Arguments of `recur` and its result."""
GPU_STEPS = 8
"""Steps in one round of a loop over them on a GPU."""


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


class SetNetwork(nn.Module):
    """A layer for each kind of thing, rounds of attention, and a linear layer.

    Called as `networks.Network` is; it has no memory.

    Attributes:
        layers: Widths: of the first layer, then of each round.
        outputs: Numbers that come out: one for each choice, or those of the robot itself.
        layout: Parts of the observations.
        chooses: Whether a number for each choice comes out.
        sees: Whether it looks at the picture.
        scale: Scale of the last layer's initial weights.
        robots: Robots with a bias of their own, as in a critic; 0: all are alike.
        numbers: Outputs behind those of the choices, of the robot itself; they are among `outputs`.
    """

    layers: tuple[int, ...]
    outputs: int
    layout: ObservationLayout
    chooses: bool
    sees: bool = False
    scale: float = 1.0
    robots: int = 0
    numbers: int = 0
    memory: int = 0

    @nn.compact
    def __call__(
        self, seen: jax.Array, shared: jax.Array | None, carry: jax.Array, is_first: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """As `networks.Network`: outputs (steps, worlds, robots, outputs), and the carry as it was."""
        del is_first
        layout, width = self.layout, self.layers[0]
        others, choices = (_rows(seen, span) for span in layout.sets)
        own = dense(width, "own")(_rows(seen, layout.own_span)[..., 0, :])
        own = with_team_terms(self, own, shared, self.robots, dense(width, "shared", bias=False))
        if self.sees:
            # Without a bias: it is added to a layer that has one.
            own = own + dense(width, "view", bias=False)(self._view(seen))
        kinds = param(self, "kinds", nn.initializers.normal(0.1), (max(layout.kinds) + 1, width))
        choices = dense(width, "choices")(choices) + kinds[np.array(layout.kinds)]
        # Tokens in this order: the robot, the others, the choices; `presence_of` and the head rely on it.
        x = nn.elu(jnp.concatenate([own[..., None, :], dense(width, "others")(others), choices], -2))
        there = presence_of(layout, seen)
        for i, size in enumerate(self.layers[1:], start=1):
            x = nn.elu(dense(size, f"layer_{i}")(x) + self._gather(x, there, i, size))
        first = 1 + layout.others[0]
        init = nn.initializers.orthogonal(self.scale)
        # One row of weights for all choices: it fits any number of them, in any order.
        head = nn.Dense(1 if self.chooses else self.outputs, kernel_init=init, name="head")
        out = head(x[..., first:, :])[..., 0] if self.chooses else head(x[..., 0, :])
        if self.numbers:
            vector = nn.Dense(self.numbers, kernel_init=init, name="vector")
            out = jnp.concatenate([out, vector(x[..., 0, :])], -1)
        return out, carry

    def _gather(self, x: jax.Array, there: jax.Array, i: int, size: int) -> jax.Array:
        """Return attention over all tokens plus a term of the robot's own one (..., tokens, size)."""
        heads = heads_of(size)

        def split(name: str) -> jax.Array:
            found = dense(size, f"{name}_{i}", bias=False)(x).reshape(*x.shape[:-1], heads, -1)
            return jnp.swapaxes(found, -2, -3)

        query, key, value = split("query"), split("key"), split("value")  # (..., heads, tokens, n)
        # Divided by the root of a head's width, as in Vaswani et al., "Attention is all you need" (2017).
        scores = query @ jnp.swapaxes(key, -1, -2) / math.sqrt(size // heads)
        # The robot's own token always exists, so no row is masked as a whole.
        scores = jnp.where(there[..., None, None, :], scores, MASKED)
        found = jnp.swapaxes(jax.nn.softmax(scores) @ value, -2, -3)
        common = dense(size, f"common_{i}", bias=False)(x[..., :1, :])
        return found.reshape(*x.shape[:-1], size) + common

    def _view(self, seen: jax.Array) -> jax.Array:
        """Return the features of the picture, by convolutions (..., n)."""
        span, (levels, width, channels) = self.layout.picture_span, self.layout.picture
        x = seen[..., span.first : span.end].reshape(-1, levels, width, width, channels)
        # Convolutions of flax want one axis of channels, the last: levels become channels.
        x = jnp.moveaxis(x, 1, 3).reshape(-1, width, width, levels * channels)
        for i, filters in enumerate(FILTERS):
            init = nn.initializers.orthogonal(ROOT_TWO)
            layer = nn.Conv(filters, (3, 3), 2, padding=((1, 1), (1, 1)), kernel_init=init, name=f"conv_{i}")
            x = nn.elu(layer(x))
        return x.reshape(*seen.shape[:-1], -1)


def presence_of(layout: ObservationLayout, seen: jax.Array) -> jax.Array:
    """Return which tokens exist (..., tokens); marks of the observations are neither shifted nor scaled."""
    others = _rows(seen, layout.others_span)[..., 0] > 0.5
    choices = _rows(seen, layout.mask_span)[..., 0] > 0.5
    return jnp.concatenate([jnp.ones((*seen.shape[:-1], 1), bool), others, choices], -1)


def shared_scale(layout: ObservationLayout, mean: jax.Array, std: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return a mean and a deviation of observations (size,), equal for all members of a set.

    Marks of presence and pictures are neither shifted nor scaled.
    """
    mean, square = jnp.asarray(mean), jnp.asarray(std) ** 2
    for span in layout.sets:
        there = slice(span.first, span.end)
        own, spread = (one[there].reshape(span.rows, span.numbers) for one in (mean, square))
        # Variance of a mixture: mean of the variances plus variance of the means.
        common = spread.mean(0) + own.var(0)
        mean = mean.at[there].set(jnp.tile(own.mean(0), span.rows))
        square = square.at[there].set(jnp.tile(common, span.rows))
    std = jnp.sqrt(square)
    same = layout.as_they_are
    return jnp.where(same, 0.0, mean), jnp.where(same, 1.0, std)


def _rows(seen: jax.Array, span: Span) -> jax.Array:
    """Return the numbers of things (..., rows, numbers)."""
    return seen[..., span.first : span.end].reshape(*seen.shape[:-1], span.rows, span.numbers)


def recur(
    gates: jax.Array, weights: jax.Array, bias: jax.Array, carry: jax.Array, is_first: jax.Array
) -> jax.Array:
    """Return the carry after each step (steps, worlds, robots, memory).

    It has a gradient of its own, and so cannot be differentiated in forward mode.

    Args:
        gates: Inputs of the reset, update and new gates, in this order (steps, worlds, robots, 3 memory).
        weights: From the carry to the gates (memory, 3 memory).
        bias: Bias of the new gate's product (memory,).
        carry: That before the first step (worlds, robots, memory).
        is_first: Whether the carry is reset before the step (steps, worlds), or that of each robot (steps,
            worlds, robots).
    """
    if is_first.ndim < gates.ndim - 1:
        return _recur(gates, weights, bias, carry, is_first)
    steps, *robots = is_first.shape
    # Each robot as a world of its own.
    rows = gates.reshape(steps, -1, 1, gates.shape[-1]), carry.reshape(-1, 1, carry.shape[-1])
    after = _recur(rows[0], weights, bias, rows[1], is_first.reshape(steps, -1))
    return after.reshape(steps, *robots, -1)


def _recur_sequentially(
    gates: jax.Array, weights: jax.Array, bias: jax.Array, carry: jax.Array, is_first: jax.Array
) -> jax.Array:
    if _on_warp(gates, carry):
        from usarmjx.train.learning.warp_gru import recur_on_warp

        return _one_by_one(recur_on_warp)(gates, weights, bias, carry, is_first)

    def step(carry: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        gates, is_first = now
        before = _reset(is_first, carry)
        reset, update, new = jnp.split(gates, 3, axis=-1)
        own_reset, own_update, own_new = jnp.split(before @ weights, 3, axis=-1)
        update = jax.nn.sigmoid(update + own_update)
        # The variant of cuDNN and PyTorch: the reset gate scales the product, not the carry before it.
        new = jnp.tanh(new + jax.nn.sigmoid(reset + own_reset) * (own_new + bias))
        after = (1.0 - update) * new + update * before
        return after, after

    return jax.lax.scan(step, carry, (gates, is_first), unroll=unroll_on_gpu(GPU_STEPS))[1]


def _on_warp(gates: jax.Array, carry: jax.Array) -> bool:
    """Return whether a kernel of Warp runs the sequence; XLA fuses a single step with what is around it."""
    if len(gates) < 2 or not warp_in_use():
        return False
    from usarmjx.train.learning.warp_gru import fits

    return fits(carry.shape[-1], gates.dtype)


def _reset(where: jax.Array, carry: jax.Array) -> jax.Array:
    return jnp.where(where[..., None, None], 0.0, carry)


def _forward(*inputs: jax.Array) -> tuple[jax.Array, Residuals]:
    after = _recur_sequentially(*inputs)
    return after, (*inputs, after)


def _gradients_sequentially(
    gradients: jax.Array, own: jax.Array, update: jax.Array, weights: jax.Array, is_first: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return gradients by the first carry and by that after each step; see `gradients_on_warp`."""
    if _on_warp(gradients, update):
        from usarmjx.train.learning.warp_gru import gradients_on_warp

        return _one_by_one(gradients_on_warp)(gradients, own, update, weights, is_first)

    def step(next_gradient: jax.Array, now: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
        gradient, own, update, is_first = now
        # The output's gradient and what flows back from the next step meet in the carry.
        gradient = gradient + next_gradient
        # No gradient crosses the start of an episode, where the carry is set to 0.
        return _reset(is_first, (jnp.tile(gradient, 3) * own) @ weights.T + gradient * update), gradient

    return jax.lax.scan(
        step,
        jnp.zeros_like(update[0]),
        (gradients, own, update, is_first),
        reverse=True,
        unroll=unroll_on_gpu(GPU_STEPS),
    )


def _backward(residuals: Residuals, gradients: jax.Array) -> tuple[Any, ...]:
    """Return the gradient by what `recur` was given, from that by what came out."""
    gates, weights, bias, carry, is_first, after = residuals
    before = _reset(is_first, jnp.concatenate([carry[None], after[:-1]]))
    own, new, update = _step_derivatives(gates, before, before @ weights, bias)
    start, gradients = _gradients_sequentially(gradients, own, update, weights, is_first)
    # Products with weights are made once over all steps; the gradient of a scan makes them in each.
    by_own = jnp.tile(gradients, 3) * own
    by_reset, by_update, by_new = jnp.split(by_own, 3, axis=-1)
    return (
        jnp.concatenate([by_reset, by_update, gradients * new], axis=-1),
        jnp.tensordot(before, by_own, ((0, 1, 2), (0, 1, 2))),
        by_new.sum((0, 1, 2)),
        start,
        # is_first is boolean, and has no gradient.
        None,
    )


def _step_derivatives(
    gates: jax.Array, before: jax.Array, own: jax.Array, bias: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the derivatives of the carry after each step, number by number.

    By the three parts of own (..., 3 memory), by the new gate's input (..., memory), and by
    the carry before it, own left as it is (..., memory).
    """
    own_reset, own_update, own_new = jnp.split(own, 3, axis=-1)
    reset, update, new = jnp.split(gates, 3, axis=-1)
    reset, update = jax.nn.sigmoid(reset + own_reset), jax.nn.sigmoid(update + own_update)
    own_new = own_new + bias
    new = jnp.tanh(new + reset * own_new)
    by_new = (1.0 - update) * (1.0 - new * new)
    by_reset = by_new * own_new * reset * (1.0 - reset)
    by_update = (before - new) * update * (1.0 - update)
    return jnp.concatenate([by_reset, by_update, by_new * reset], axis=-1), by_new, update


_recur = cast(Any, jax.custom_vjp)(_recur_sequentially)  # jax leaves its types open


_recur.defvjp(_forward, _backward)


Params: TypeAlias = Any
"""A tree of weights, as flax nests them."""
POLICY_HEAD_SCALE = 0.01
"""Scale of the policy's last layer at the start: the first actions are about 0, with a deviation of 0.7."""


class Network(nn.Module):
    """Hidden layers, a GRU behind them if there is memory, and a linear layer.

    Attributes:
        layers: Widths of the hidden layers.
        memory: Units of the GRU; 0: none.
        outputs: Numbers that come out.
        scale: Scale of the last layer's initial weights.
        robots: Robots with a bias of their own, as in a critic; 0: all are alike.
    """

    layers: tuple[int, ...]
    memory: int
    outputs: int
    scale: float = 1.0
    robots: int = 0

    @nn.compact
    def __call__(
        self, seen: jax.Array, shared: jax.Array | None, carry: jax.Array, is_first: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Return the outputs for a sequence of steps, and the carry after it.

        Args:
            seen: Observations of each robot (steps, worlds, robots, n).
            shared: Numbers that the robots of a world share (steps, worlds, m); None: none.
            carry: That before the first step (worlds, robots, memory).
            is_first: Whether the carry is reset before the step (steps, worlds).
        """
        # The layer of shared numbers has no bias: it is added to a layer that has one.
        x, common = dense(self.layers[0], "layer_0")(seen), nn.Dense(self.layers[0], False, name="shared")
        x = nn.elu(with_team_terms(self, x, shared, self.robots, common))
        for i, width in enumerate(self.layers[1:], start=1):
            x = nn.elu(dense(width, f"layer_{i}")(x))
        if self.memory:
            x, carry = self._recur(x, carry, is_first)
        init = nn.initializers.orthogonal(self.scale)
        return nn.Dense(self.outputs, kernel_init=init, name="head")(x), carry

    def _recur(self, x: jax.Array, carry: jax.Array, is_first: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Run the GRU: only the part that needs its own past is done step by step."""
        gates = nn.Dense(3 * self.memory, name="gates")(x)
        # Orthogonal as in flax's own GRU, but one matrix for all gates: each gate's part shrinks the carry.
        weights = param(self, "recurrent", nn.initializers.orthogonal(), (self.memory, 3 * self.memory))
        bias = param(self, "recurrent_bias", nn.initializers.zeros, (self.memory,))
        x = recur(gates, weights, bias, carry, is_first)
        return x, x[-1]


AnyNetwork: TypeAlias = Network | SetNetwork


def apply_network(
    network: AnyNetwork,
    params: Params,
    seen: jax.Array,
    shared: jax.Array | None,
    carry: jax.Array,
    is_first: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Return the outputs with these parameters, and the carry; see `Network.__call__`."""
    module: Any = network  # flax types neither arguments nor results
    return module.apply(params, seen, shared, carry, is_first)


class PolicyParams(struct.PyTreeNode, kw_only=True):
    """All that a policy is, besides its shape.

    Attributes:
        weights: Per group a tree of weights.
        mean: Running mean of the observations, per group (obs_size,).
        std: Their deviation, per group (obs_size,).
    """

    weights: tuple[Params, ...]
    mean: tuple[jax.Array, ...]
    std: tuple[jax.Array, ...]


@dataclass(frozen=True)
class LearnedPolicy:
    """Policy from observations and a carry to actions.

    Attributes:
        groups: The agents.
        layers: Widths of the hidden layers.
        memory: Units of memory of each robot; 0: none.
        kind: Kind of the networks, see `Config.network`.
    """

    groups: tuple[AgentGroup, ...]
    layers: tuple[int, ...]
    memory: int = 0
    kind: str = "mlp"

    def check(self) -> None:
        """Refuse observations that networks of this kind cannot read.

        Raises:
            UsageError: Says what is missing.
        """
        for group in self.groups if self.kind != "mlp" else ():
            layout = group.layout
            if layout is None or not group.discrete:
                raise UsageError(f"network is {self.kind}, but {group.name} chooses of no set: use mlp")
            if problem := layout.misfit(group.obs_size, group.choices):
                raise UsageError(f"network is {self.kind}, but of {group.name} {problem}")
            if self.kind == "cnn" and not layout.picture_size.size:
                raise UsageError(
                    f"network is cnn, but {group.name} sees no picture: set observed=map, or network=set"
                )

    def layout(self, group: int) -> ObservationLayout | None:
        """Return the layout that a group's network reads; None: it takes all numbers alike."""
        return None if self.kind == "mlp" else self.groups[group].layout

    def network(self, group: int) -> AnyNetwork:
        """Return the network of a group."""
        outputs, layout = self.groups[group].outputs, self.layout(group)
        if layout is None:
            return Network(self.layers, self.memory, outputs, scale=POLICY_HEAD_SCALE)
        # A mean and a deviation for each number of the vector.
        sees, numbers = self.kind == "cnn", 2 * self.groups[group].vector.size
        return SetNetwork(
            self.layers, outputs, layout, chooses=True, sees=sees, scale=POLICY_HEAD_SCALE, numbers=numbers
        )

    def scale(self, group: int, mean: jax.Array, std: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return mean and deviation that a group's observations are shifted and scaled by (obs_size,)."""
        layout = self.layout(group)
        return (mean, std) if layout is None else shared_scale(layout, mean, std)

    def normalised(self, group: int, mean: jax.Array, std: jax.Array, seen: jax.Array) -> jax.Array:
        """Return a group's observations (..., obs_size) shifted and scaled."""
        return normalise(*self.scale(group, mean, std), seen)

    def distribution(self, group: int) -> Distribution:
        """Return the family of distributions that a group's actions are drawn from."""
        return self._chosen(group) or normal_tanh(self.groups[group].action_size)

    def _chosen(self, group: int) -> ChoiceDistribution | MixedDistribution | None:
        """Return the family of a group's distributions, if its robots choose."""
        own = self.groups[group]
        return choice_distribution(own.choices, own.vector) if own.discrete else None

    def init(self, key: jax.Array) -> tuple[Params, ...]:
        """Return weights to begin with, per group."""
        return tuple(
            init_network(self.network(g), jax.random.fold_in(key, g), group, None)
            for g, group in enumerate(self.groups)
        )

    def initial_carry(self, worlds: int) -> tuple[jax.Array, ...]:
        """Return the carry at the start of an episode, per group (worlds, robots, memory)."""
        return tuple(jnp.zeros((worlds, len(group.agents), self.memory)) for group in self.groups)

    @staticmethod
    def reset_carry(carry: tuple[jax.Array, ...], done: jax.Array) -> tuple[jax.Array, ...]:
        """Return the carry, reset in worlds where the episode is over (worlds,)."""
        return tuple(jnp.where(done[:, None, None], 0.0, one) for one in carry)

    @staticmethod
    def reset_agents(carry: tuple[jax.Array, ...], keep: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        """Return the carry, kept of some agents only, per group (worlds, robots)."""
        return tuple(jnp.where(one[..., None], now, 0.0) for one, now in zip(keep, carry, strict=True))

    def distribution_params(
        self, params: PolicyParams, obs: Sequence[jax.Array], carry: Sequence[jax.Array]
    ) -> tuple[tuple[jax.Array, ...], tuple[jax.Array, ...]]:
        """Return parameters of the actions' distributions (worlds, robots, outputs), and the carry."""
        found: list[tuple[jax.Array, jax.Array]] = []
        for g, seen in enumerate(obs):
            x = self.normalised(g, params.mean[g], params.std[g], seen)[None]
            # The caller resets the carry between steps, so within this one-step sequence nothing begins.
            is_first = jnp.zeros((1, len(seen)), bool)
            out, after = apply_network(self.network(g), params.weights[g], x, None, carry[g], is_first)
            # Masks read the observations as they came: normalised, the marks would not be 0 or 1.
            found.append((self.masked(g, out[0], seen), after))
        return tuple(out for out, _ in found), tuple(after for _, after in found)

    def masked(self, group: int, logits: jax.Array, seen: jax.Array) -> jax.Array:
        """Return a group's parameters (..., outputs) as its observations (..., obs_size) allow."""
        chosen = self._chosen(group)
        return logits if chosen is None else chosen.masked(logits, seen)

    def act(
        self,
        params: PolicyParams,
        obs: Sequence[jax.Array],
        carry: Sequence[jax.Array],
        key: jax.Array | None = None,
        deterministic: bool = False,
    ) -> tuple[tuple[jax.Array, ...], tuple[jax.Array, ...]]:
        """Return actions and the carry after them.

        Args:
            params: Weights and statistics.
            obs: Per group (worlds, robots, obs_size).
            carry: That before them, per group (worlds, robots, memory).
            key: Key of the random numbers; worlds fold in their index. Not needed if deterministic.
            deterministic: Take the most probable actions instead of drawing them.

        Returns:
            Per group (worlds, robots, action_size), each number from -1 to 1, and the new carry.

        Raises:
            UsageError: Neither a key nor deterministic.
        """
        if key is None and not deterministic:
            raise UsageError("actions are drawn with a key: give one, or ask for deterministic ones")
        logits, carry = self.distribution_params(params, obs, carry)
        if key is None or deterministic:
            return tuple(self.mode(g, one) for g, one in enumerate(logits)), carry
        kinds = [self.distribution(g) for g in range(len(self.groups))]
        # A key for each world: its draws depend neither on the number of worlds nor on the process it is in.
        keys = fold_each(key, jnp.arange(len(obs[0])))
        raw = sample_actions(self, logits, keys)
        return tuple(kind.postprocess(action) for kind, action in zip(kinds, raw, strict=True)), carry

    def mode(self, group: int, logits: jax.Array) -> jax.Array:
        """Return the most probable actions of a group, of their distributions' parameters."""
        chosen = self._chosen(group)
        return mode_action(logits) if chosen is None else chosen.mode(logits)

    def as_policy(self, params: PolicyParams, deterministic: bool = True) -> Policy:
        """Return the policy with its parameters, as evaluation and adapters want it."""

        def act(
            carry: tuple[jax.Array, ...], obs: tuple[jax.Array, ...], key: jax.Array
        ) -> tuple[tuple[jax.Array, ...], tuple[jax.Array, ...]]:
            actions, carry = self.act(params, obs, carry, key, deterministic)
            return carry, actions

        return Policy(initial_carry=self.initial_carry, act=act)


def fold_each(key: jax.Array, numbers: jax.Array) -> jax.Array:
    """Return a key for each number (worlds,)."""
    return jax.vmap(partial(jax.random.fold_in, key))(numbers)


def sample_actions(
    policy: LearnedPolicy, logits: Sequence[jax.Array], keys: jax.Array
) -> tuple[jax.Array, ...]:
    """Draw actions, before they are squashed, with a key for each world (worlds,)."""
    return tuple(
        jax.vmap(policy.distribution(g).sample_no_postprocessing)(one, fold_all(keys, g))
        for g, one in enumerate(logits)
    )


def fold_all(keys: jax.Array, number: int) -> jax.Array:
    """Fold a number into each of several keys."""

    def fold(key: jax.Array) -> jax.Array:
        return jax.random.fold_in(key, number)

    return jax.vmap(fold)(keys)


def init_network(network: AnyNetwork, key: jax.Array, group: AgentGroup, shared: int | None) -> Params:
    """Return weights to begin with, for a group's observations and `shared` numbers besides."""
    robots, module = len(group.agents), cast(Any, network)  # flax types no arguments
    # Zeros will do: initial weights depend on the shapes of inputs only.
    return module.init(
        key,
        jnp.zeros((1, 1, robots, group.obs_size)),
        None if shared is None else jnp.zeros((1, 1, shared)),
        jnp.zeros((1, robots, network.memory)),
        jnp.zeros((1, 1), bool),
    )
