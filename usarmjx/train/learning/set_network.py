"""Networks of robots that choose, over a set of choices: one function for all, and attention between them.

A policy's choice does not depend on the order of choices of a kind or on that of other robots, and it has the
same weights for any number of them.
"""

import math

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.train.envs.layout import ObservationLayout, Span
from usarmjx.train.learning.layers import ROOT_TWO, dense, param, with_team_terms
from usarmjx.train.policies.set_forward import FILTERS, MASKED, heads_of


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
    """

    layers: tuple[int, ...]
    outputs: int
    layout: ObservationLayout
    chooses: bool
    sees: bool = False
    scale: float = 1.0
    robots: int = 0
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
            own = own + dense(width, "view", bias=False)(self._view(seen))
        kinds = param(self, "kinds", nn.initializers.normal(0.1), (max(layout.kinds) + 1, width))
        choices = dense(width, "choices")(choices) + kinds[np.array(layout.kinds)]
        x = nn.elu(jnp.concatenate([own[..., None, :], dense(width, "others")(others), choices], -2))
        there = presence_of(layout, seen)
        for i, size in enumerate(self.layers[1:], start=1):
            x = nn.elu(dense(size, f"layer_{i}")(x) + self._gather(x, there, i, size))
        first = 1 + layout.others[0]
        init = nn.initializers.orthogonal(self.scale)
        head = nn.Dense(1 if self.chooses else self.outputs, kernel_init=init, name="head")
        return (head(x[..., first:, :])[..., 0] if self.chooses else head(x[..., 0, :])), carry

    def _gather(self, x: jax.Array, there: jax.Array, i: int, size: int) -> jax.Array:
        """Return attention over all tokens plus a term of the robot's own one (..., tokens, size)."""
        heads = heads_of(size)

        def split(name: str) -> jax.Array:
            found = dense(size, f"{name}_{i}", bias=False)(x).reshape(*x.shape[:-1], heads, -1)
            return jnp.swapaxes(found, -2, -3)

        query, key, value = split("query"), split("key"), split("value")  # (..., heads, tokens, n)
        scores = query @ jnp.swapaxes(key, -1, -2) / math.sqrt(size // heads)
        scores = jnp.where(there[..., None, None, :], scores, MASKED)
        found = jnp.swapaxes(jax.nn.softmax(scores) @ value, -2, -3)
        common = dense(size, f"common_{i}", bias=False)(x[..., :1, :])
        return found.reshape(*x.shape[:-1], size) + common

    def _view(self, seen: jax.Array) -> jax.Array:
        """Return the features of the picture, by convolutions (..., n)."""
        span, (levels, width, channels) = self.layout.picture_span, self.layout.picture
        x = seen[..., span.first : span.end].reshape(-1, levels, width, width, channels)
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
        common = spread.mean(0) + own.var(0)
        mean = mean.at[there].set(jnp.tile(own.mean(0), span.rows))
        square = square.at[there].set(jnp.tile(common, span.rows))
    std = jnp.sqrt(square)
    same = layout.as_they_are
    return jnp.where(same, 0.0, mean), jnp.where(same, 1.0, std)


def _rows(seen: jax.Array, span: Span) -> jax.Array:
    """Return the numbers of things (..., rows, numbers)."""
    return seen[..., span.first : span.end].reshape(*seen.shape[:-1], span.rows, span.numbers)
