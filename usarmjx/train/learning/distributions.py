"""Distributions that robots draw choices from, and vectors that they send with some of these."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import jax.numpy as jnp

from usarmjx.base.errors import extra
from usarmjx.train.envs.layout import ActionVector

if TYPE_CHECKING:
    from brax.training.distribution import NormalTanhDistribution

Distribution: TypeAlias = "NormalTanhDistribution | ChoiceDistribution | MixedDistribution"
"""Family of distributions of actions."""
# Finite: where no choice is there, infinities would make all shares NaN.
INVALID = -1e9
"""Logit of a choice that is not there."""
# A density grows without bound as its deviation goes to 0, and with it the ratio of PPO.
MIN_STD = 0.01
"""Least deviation of an action before it is squashed."""


def normal_tanh(size: int) -> "NormalTanhDistribution":
    """Return the family of normal distributions of some numbers, each squashed to -1 to 1."""
    with extra("train"):
        from brax.training.distribution import NormalTanhDistribution
    return NormalTanhDistribution(size, min_std=MIN_STD)


def mode_action(logits: jax.Array) -> jax.Array:
    """Return the mode of `normal_tanh` (..., size), of its parameters (..., 2 size)."""
    # As in Brax: the squashed mode of the normal distribution, not the mode of the squashed one.
    return jnp.tanh(jnp.split(logits, 2, axis=-1)[0])


def mask_logits(logits: jax.Array, seen: jax.Array) -> jax.Array:
    """Return logits (..., choices) without those choices that observations (..., n) say are not there.

    The last numbers of an observation say that, see `AgentGroup.discrete`.
    """
    # Marks are 0 or 1, stored as floats.
    return jnp.where(seen[..., -logits.shape[-1] :] > 0.5, logits, INVALID)


@dataclass(frozen=True)
class ChoiceDistribution:
    """Categorical distribution over choices; its parameters are logits, a sample is 1 at one choice, else 0.

    Attributes:
        choices: Number of them.
    """

    choices: int

    def masked(self, logits: jax.Array, seen: jax.Array) -> jax.Array:
        """Return logits as observations (..., n) allow, see `mask_logits`."""
        return mask_logits(logits, seen)

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
        # A sum of products with 0: `INVALID` is finite, so none of them is NaN.
        return (jax.nn.log_softmax(logits) * choice).sum(-1)

    def entropy(self, logits: jax.Array, key: jax.Array) -> jax.Array:
        """Return the entropy [nat] (...); the key is not needed."""
        del key
        share = jax.nn.softmax(logits)
        # A share that underflows to 0 adds nothing, which is the limit of x log x.
        return -(share * jnp.where(share > 0, jax.nn.log_softmax(logits), 0.0)).sum(-1)


@dataclass(frozen=True)
class MixedDistribution:
    """A choice and a vector, which counts where one of the last choices is taken.

    Its parameters are the logits of the choices, then those of `normal_tanh`: means, and deviations before
    the softplus. A sample is that of the choice, then the vector before it is squashed.

    Attributes:
        choices: Number of choices.
        vector: Size of the vector, and the number of choices that it counts with.
    """

    choices: int
    vector: ActionVector

    @property
    def choice(self) -> ChoiceDistribution:
        """The distribution of the choice."""
        return ChoiceDistribution(self.choices)

    @property
    def numbers(self) -> "NormalTanhDistribution":
        """The distribution of the vector."""
        return normal_tanh(self.vector.size)

    def split(self, both: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the parts of the choice and of the vector, of parameters, samples or actions (..., n)."""
        return both[..., : self.choices], both[..., self.choices :]

    def vector_share(self, shares: jax.Array) -> jax.Array:
        """Return the sum over the choices that the vector counts with (...), of shares (..., choices)."""
        return shares[..., -self.vector.choices :].sum(-1)

    def masked(self, parameters: jax.Array, seen: jax.Array) -> jax.Array:
        """Return parameters as observations (..., n) allow, see `mask_logits`."""
        logits, numbers = self.split(parameters)
        return jnp.concatenate([mask_logits(logits, seen), numbers], -1)

    def sample_no_postprocessing(self, parameters: jax.Array, key: jax.Array) -> jax.Array:
        """Return a drawn choice and vector (..., choices + size)."""
        logits, numbers = self.split(parameters)
        choosing, drawing = jax.random.split(key)
        choice = self.choice.sample_no_postprocessing(logits, choosing)
        # Brax leaves its types open.
        vector: Any = self.numbers.sample_no_postprocessing(numbers, drawing)
        return jnp.concatenate([choice, vector], -1)

    def postprocess(self, sample: jax.Array) -> jax.Array:
        """Return the action for a sample: the choice, and the squashed vector."""
        choice, vector = self.split(sample)
        return jnp.concatenate([choice, jnp.tanh(vector)], -1)

    def mode(self, parameters: jax.Array) -> jax.Array:
        """Return the most probable choice and vector (..., choices + size)."""
        logits, numbers = self.split(parameters)
        return jnp.concatenate([self.choice.mode(logits), mode_action(numbers)], -1)

    def log_prob(self, parameters: jax.Array, sample: jax.Array) -> jax.Array:
        """Return the logarithm of the probability of a choice, and of the vector where it counts (...)."""
        (logits, numbers), (choice, vector) = self.split(parameters), self.split(sample)
        density: Any = self.numbers.log_prob(numbers, vector)
        # A vector that is not sent has no effect: its density must not move the ratio of PPO.
        return self.choice.log_prob(logits, choice) + self.vector_share(choice) * density

    def entropy(self, parameters: jax.Array, key: jax.Array) -> jax.Array:
        """Return the entropy [nat] (...): of the choice, and of the vector by its probability to count.

        That of the vector is an estimate, from a vector that is drawn.
        """
        logits, numbers = self.split(parameters)
        of_vector: Any = self.numbers.entropy(numbers, key)
        counts = self.vector_share(jax.nn.softmax(logits))
        return self.choice.entropy(logits, key) + counts * of_vector


def choice_distribution(choices: int, vector: ActionVector) -> ChoiceDistribution | MixedDistribution:
    """Return the family of distributions of a robot that chooses, and sends a vector if it has a size."""
    return MixedDistribution(choices, vector) if vector.size else ChoiceDistribution(choices)
