"""Distribution of choices, in the form of brax's distributions: one of several, of which some are valid."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

INVALID = -1e9
"""Logit of a choice that is not there."""


def mask_logits(logits: jax.Array, seen: jax.Array) -> jax.Array:
    """Return logits (..., choices) without those choices that observations (..., n) say are not there.

    The last numbers of an observation say that, see `AgentGroup.discrete`.
    """
    return jnp.where(seen[..., -logits.shape[-1] :] > 0.5, logits, INVALID)


@dataclass(frozen=True)
class ChoiceDistribution:
    """Categorical distribution over choices; its parameters are logits, a sample is 1 at one choice, else 0.

    Attributes:
        choices: Number of them.
    """

    choices: int

    def sample_no_postprocessing(self, logits: jax.Array, key: jax.Array) -> jax.Array:
        """Return a drawn choice (..., choices)."""
        return jax.nn.one_hot(jax.random.categorical(key, logits), self.choices)

    def postprocess(self, choice: jax.Array) -> jax.Array:
        """Return an action for a choice: itself."""
        return choice

    def mode(self, logits: jax.Array) -> jax.Array:
        """Return the most probable choice (..., choices)."""
        return jax.nn.one_hot(logits.argmax(-1), self.choices)

    def log_prob(self, logits: jax.Array, choice: jax.Array) -> jax.Array:
        """Return the logarithm of the probability of a choice (...)."""
        return (jax.nn.log_softmax(logits) * choice).sum(-1)

    def entropy(self, logits: jax.Array, key: jax.Array) -> jax.Array:
        """Return the entropy [nat] (...); the key is not needed."""
        del key
        share = jax.nn.softmax(logits)
        return -(share * jnp.where(share > 0, jax.nn.log_softmax(logits), 0.0)).sum(-1)
