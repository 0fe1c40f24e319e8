"""Vectors that policies learn to send: numbers without a given meaning, and what robots observe of them.

A policy's numbers from -1 to 1 are sent in steps of 1/127, a byte each, behind the sender's pose. Of each
other robot that it observes, a robot observes the last vector: whether there is one, its age (1: 40 s), and
its numbers; zeros if none came, or none in that time.
"""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.comms.mail import Inboxes
from usarmjx.train.mapping.belief import ABSENT
from usarmjx.train.tasks.goal_features import (
    FIRST_GOAL,
    FIRST_MATE,
    MATE_AGE,
    MATE_NUMBERS,
    OBSERVED_MATES,
    Mates,
)

LEVELS = 127
"""Steps from 0 to 1: a number is a signed byte."""
NEVER = -1e6
"""Time of a vector that never came [s]."""


class VectorState(struct.PyTreeNode, kw_only=True):
    """Memory of vectors, whose numbers are whole, in steps.

    Attributes:
        sent: Vector that each robot sent last (robots, size).
        heard: The last one that each got from each other, row receiver, column sender (robots, robots, size).
        time: When that was sent [s] (robots, robots).
    """

    sent: jax.Array
    heard: jax.Array
    time: jax.Array


def no_vectors(robots: int, size: int) -> VectorState:
    """Return the state in which no vector was sent."""
    return VectorState(
        sent=jnp.zeros((robots, size)),
        heard=jnp.zeros((robots, robots, size)),
        time=jnp.full((robots, robots), NEVER),
    )


def quantised(numbers: Array) -> jax.Array:
    """Return numbers from -1 to 1 (...) in steps, as they are sent."""
    # Whole steps in the simulator, too: a receiver gets the same numbers over a wire of bytes.
    return jnp.round(LEVELS * jnp.clip(jnp.asarray(numbers), -1.0, 1.0))


def heard_vectors(state: VectorState, mail: Inboxes) -> VectorState:
    """Return the state after robots read their mail; of several vectors of one sender the last counts."""
    robots, size = state.sent.shape
    capacity = mail.sender.shape[-1]
    # A vector is the end of a letter, and ABSENT in letters of other kinds; see `messages.letters`.
    numbers = jnp.asarray(mail.payload)[..., -size:]
    there = mail.valid & (numbers[..., 0] != ABSENT)
    theirs = there[:, None] & (mail.sender[:, None] == np.arange(robots)[:, None])
    # Boxes hold the oldest first: the highest place is the last letter.
    last = jnp.max(jnp.where(theirs, np.arange(capacity), -1), -1, initial=-1)
    # Place 0 where no vector came: its contents are masked below.
    rows, place = np.arange(robots)[:, None], jnp.maximum(last, 0)
    return state.replace(
        heard=jnp.where((last >= 0)[..., None], numbers[rows, place], state.heard),
        time=jnp.where(last >= 0, jnp.asarray(mail.time)[rows, place], state.time),
    )


def vector_columns(size: int) -> int:
    """Return how many numbers a robot observes of another one's vector; 0: there are no vectors."""
    return size + 2 if size else 0


def vector_features(state: VectorState, mates: Mates, time: Array) -> jax.Array:
    """Return what robots observe of others' vectors (robots, mates, size + 2).

    Args:
        state: The state.
        mates: The others that they observe (robots, mates).
        time: The time [s] ().
    """
    rows = np.arange(len(state.sent))[:, None]
    age = (time - state.time[rows, mates.slot]) / MATE_AGE
    there = (mates.valid & (age < 1.0))[..., None]
    facts = [jnp.ones_like(age)[..., None], age[..., None], state.heard[rows, mates.slot] / LEVELS]
    return jnp.where(there, jnp.concatenate(facts, -1), 0.0)


def beside_mates(mates: jax.Array, vectors: jax.Array) -> jax.Array:
    """Return the numbers about others (..., OBSERVED_MATES * MATE_NUMBERS), each followed by its vector's.

    Args:
        mates: The numbers, see `goal_features.mate_features`.
        vectors: Those of the vectors (..., OBSERVED_MATES, columns).
    """
    rows = mates.reshape(*mates.shape[:-1], OBSERVED_MATES, MATE_NUMBERS)
    return jnp.concatenate([rows, vectors], -1).reshape(*mates.shape[:-1], -1)


def split_vectors(seen: Array, size: int) -> tuple[jax.Array, jax.Array]:
    """Return observations (..., n) as of robots without vectors, and what they show of vectors.

    Args:
        seen: The observations.
        size: Numbers of a vector, at least 1.

    Returns:
        The observations, and a row for each other robot (..., OBSERVED_MATES, size + 2).
    """
    seen, width = jnp.asarray(seen), MATE_NUMBERS + vector_columns(size)
    end = FIRST_MATE + OBSERVED_MATES * width
    rows = seen[..., FIRST_MATE:end].reshape(*seen.shape[:-1], OBSERVED_MATES, width)
    mates = rows[..., :MATE_NUMBERS].reshape(*seen.shape[:-1], -1)
    plain = jnp.concatenate([seen[..., :FIRST_MATE], mates, seen[..., end:]], -1)
    return plain, rows[..., MATE_NUMBERS:]


def joined_vectors(plain: Array, vectors: jax.Array) -> jax.Array:
    """Return observations of robots without vectors with those of the others that they still show.

    Args:
        plain: The observations (..., n).
        vectors: See `split_vectors`.
    """
    plain = jnp.asarray(plain)
    mates = plain[..., FIRST_MATE:FIRST_GOAL]
    # The first number of a row says whether there is another robot.
    there = mates[..., ::MATE_NUMBERS] > 0.5
    whole = beside_mates(mates, jnp.where(there[..., None], vectors, 0.0))
    return jnp.concatenate([plain[..., :FIRST_MATE], whole, plain[..., FIRST_GOAL:]], -1)


def without_vectors(seen: Array, size: int) -> jax.Array:
    """Return observations (..., n) with others' vectors hidden, as if none had come."""
    plain, vectors = split_vectors(seen, size)
    return joined_vectors(plain, jnp.zeros_like(vectors))
