"""Messages that robots choose: receivers, kind and contents within a budget of bytes.

A robot sends one message every `GoalTeam.hold` steps, half way between two choices of goals. Its budget for
that time is divided among the receivers. Messages are, in bytes:

- `pose`: position, yaw, last contact with the base: 16;
- `plan`: the pose, and the position where the robot goes: 24;
- `map`: the plan, and strips of its map, 5 each: the index of a strip, and 12 squares in a row of 2 bits;
- `victims`: as `map`, of marks only;
- `vector`, where a task has such: the pose, and numbers that the policy chooses, see `learned_vectors`: 16,
  and one for each number; one more where another kind has that size, as sizes tell kinds apart.

Of the strips those with most squares that the receivers may not know go first, those with marks before all.
Each robot remembers what every other one has of its map: what it has sent over links that held, and what
came from there.

Options: to send nothing; then each kind to all robots in range, to the base, and to each of the two nearest
robots. An option is described by: position of the receiver (x, y; 1: 12 m; 0 for all), its link as others
see it, receivers in range (1: 4), squares that they may not know (1: 1000), news that they may not have (1:
1000 squares), marks that they may not know (1: 4), bytes for each receiver (1: 1024, at most 1), and the kind
(4 numbers; all 0: `vector`, whose options are the last ones).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.base.errors import UsageError
from usarmjx.comms.mail import Inboxes
from usarmjx.train.mapping.belief import ABSENT, HEADER_SIZE, Belief
from usarmjx.train.mapping.maps import (
    SQUARES_PER_NUMBER,
    merge_numbers,
    pack,
    packed_free,
    packed_known,
    packed_marks,
    to_robot_frame,
)
from usarmjx.train.tasks.goal_features import FIRST_MASK, MATES, NEAR_SCALE, NEWS_SCALE, Mates
from usarmjx.train.tasks.learned_vectors import (
    LEVELS,
    VectorState,
    heard_vectors,
    joined_vectors,
    no_vectors,
    quantised,
    split_vectors,
)

KINDS = ("pose", "plan", "map", "victims")
POSE, PLAN, MAP, VICTIMS, VECTOR = range(len(KINDS) + 1)
RECEIVERS = 2 + MATES
"""Choices of receivers: all in range, the base, and the nearest robots."""
OPTIONS = 1 + RECEIVERS * len(KINDS)
"""Options of a message without vectors; the first is to send nothing."""
OPTION_NUMBERS = 12
"""Numbers that describe an option: as many as a goal's, so that both are rows of one table."""
POSE_BYTES, PLAN_BYTES, STRIP_BYTES = 16, 24, 5
MOST_STRIPS = 2**16
MARKED = SQUARES_PER_NUMBER + 1
"""Rank of a strip with marks, above that of any number of other squares."""
TEAM_SCALE, BYTES_SCALE, MARK_SCALE = 4.0, 1024.0, 4.0


class MessageState(struct.PyTreeNode, kw_only=True):
    """Memory of messages.

    Attributes:
        known: Packed maps that each robot believes each other one to have (robots, robots, numbers).
        unknown: Squares of each robot's map that each other one may not know (robots, robots).
        untold: News among them, as `GoalTeam.news` counts them (robots, robots).
        marks: Marks among them (robots, robots).
        chosen: Option that each robot chose last (robots,).
        receivers: Robots to which it went (robots, robots).
        strips: Strips of maps that were in it, packed; 0 elsewhere (robots, numbers).
        size: Size of it [bytes] (robots,).
        sent: Bytes sent since the episode began, each receiver counted [bytes] (robots,).
        vectors: Memory of vectors; empty: messages have none.
    """

    known: jax.Array
    unknown: jax.Array
    untold: jax.Array
    marks: jax.Array
    chosen: jax.Array
    receivers: jax.Array
    strips: jax.Array
    size: jax.Array
    sent: jax.Array
    vectors: VectorState | tuple[()] = ()

    @property
    def floats(self) -> int:
        """Numbers of a vector; 0: messages have none."""
        return self.vectors.sent.shape[-1] if isinstance(self.vectors, VectorState) else 0


class Choices(NamedTuple):
    """Options of all robots.

    Attributes:
        receivers: Robots in range that each choice of receivers means (robots, RECEIVERS, robots).
        room: Bytes for each of them (robots, RECEIVERS).
        valid: Options that can be chosen (robots, options).
    """

    receivers: jax.Array
    room: jax.Array
    valid: jax.Array


def option_count(floats: int) -> int:
    """Return the number of options, where vectors have some numbers; 0: there are none."""
    return OPTIONS + (RECEIVERS if floats else 0)


def vector_bytes(floats: int) -> int:
    """Return the size of a message with a vector of some numbers [bytes]."""
    size = POSE_BYTES + floats
    # A byte more where the size would be that of a message with strips: receivers know the kind by the size.
    return size + (size >= PLAN_BYTES and (size - PLAN_BYTES) % STRIP_BYTES == 0)


def no_messages(robots: int, numbers: int, floats: int = 0) -> MessageState:
    """Return the state of robots that know nothing of each other's maps.

    Args:
        robots: Number of robots.
        numbers: Size of a map when packed.
        floats: Numbers of a vector; 0: messages have none.

    Raises:
        UsageError: More strips than an index of two bytes names.
    """
    if numbers > MOST_STRIPS:
        raise UsageError(
            f"maps of {numbers} strips of {SQUARES_PER_NUMBER} squares, but messages name at most "
            f"{MOST_STRIPS}: set cell to a longer side"
        )
    pairs = jnp.zeros((robots, robots))
    return MessageState(
        known=jnp.zeros((robots, robots, numbers), jnp.int32),
        unknown=pairs,
        untold=pairs,
        marks=pairs,
        chosen=jnp.zeros(robots, jnp.int32),
        receivers=jnp.zeros((robots, robots), bool),
        strips=jnp.zeros((robots, numbers), jnp.int32),
        size=jnp.zeros(robots, jnp.int32),
        sent=jnp.zeros(robots),
        vectors=no_vectors(robots, floats) if floats else (),
    )


def packed_maps(squares: Array) -> jax.Array:
    """Return the robots' maps (robots, i, j) as their messages hold them, int32 (robots, numbers)."""
    return jax.vmap(pack)(squares).astype(jnp.int32)


def _count(bits: jax.Array) -> jax.Array:
    return jax.lax.population_count(bits)


def heard(state: MessageState, mail: Inboxes) -> MessageState:
    """Return the state after robots read their mail: who sends a map has it.

    Of several messages of one sender in a box the last counts here; a robot then believes too little of it,
    and may send a strip twice.
    """
    robots = len(state.chosen)
    capacity = mail.sender.shape[-1]
    there = mail.valid[:, None] & (mail.sender[:, None] == np.arange(robots)[:, None])
    last = jnp.max(jnp.where(there, np.arange(capacity), -1), -1, initial=-1)
    rows = np.arange(robots)[:, None]
    # Place 0 where there is no letter: its contents are masked below.
    came = jnp.asarray(mail.payload)[rows, jnp.maximum(last, 0), HEADER_SIZE:].astype(jnp.int32)
    # Behind the strips a letter may hold a vector.
    came = jnp.where((last >= 0)[..., None], came[..., : state.known.shape[-1]], 0)
    known = merge_numbers(state.known, came)
    if isinstance(state.vectors, VectorState):
        return state.replace(known=known, vectors=heard_vectors(state.vectors, mail))
    return state.replace(known=known)


def compared(state: MessageState, squares: Array, news: str, worth: float) -> MessageState:
    """Return the state with what others may not have of the robots' maps.

    Args:
        state: The state.
        squares: Their maps (robots, i, j).
        news: Squares that are news: `free` or `marks`.
        worth: Squares that a square of news counts as.
    """
    there, known = packed_maps(squares)[:, None], state.known
    # Counted in the packed form: one operation for 12 squares, and no map of a pair is ever unpacked.
    marks = _count(packed_marks(there) & ~packed_marks(known)).sum(-1)
    free = _count(packed_free(there) & ~packed_free(known)).sum(-1)
    # Bits that a merge would change: the number of squares that the other does not have.
    changed = merge_numbers(there, known) ^ known
    return state.replace(
        unknown=_count(packed_known(changed)).sum(-1).astype(jnp.float32),
        untold=worth * (marks if news == "marks" else free).astype(jnp.float32),
        marks=marks.astype(jnp.float32),
    )


def choices(state: MessageState, allowed: jax.Array, base: int, mates: Mates, budget: float) -> Choices:
    """Return the robots' options.

    Args:
        state: The state.
        allowed: Links over which they may send (robots, robots).
        base: Slot of the base.
        mates: The nearest robots (robots, MATES).
        budget: Bytes that a robot may send at once, each receiver counted; infinite: any number.
    """
    robots = len(allowed)
    near = (mates.slot[..., None] == np.arange(robots)) & mates.valid[..., None]
    at_base = jnp.broadcast_to(np.arange(robots) == base, (robots, 1, robots))
    everyone = jnp.ones((robots, 1, robots), bool)
    to = jnp.concatenate([everyone, at_base, near], 1) & allowed[:, None]
    count = to.sum(-1)
    # The same bytes go to each receiver, so all of them share the budget.
    room = jnp.where(count > 0, budget / jnp.maximum(count, 1), 0.0)
    strip = room >= PLAN_BYTES + STRIP_BYTES
    kinds = [
        room >= POSE_BYTES,
        room >= PLAN_BYTES,
        strip & (_most(to, state.unknown) > 0),
        strip & (_most(to, state.marks) > 0),
    ]
    valid = (jnp.stack(kinds, -1) & (count > 0)[..., None]).reshape(robots, -1)
    options = [jnp.ones((robots, 1), bool), valid]
    if state.floats:
        options.append((room >= vector_bytes(state.floats)) & (count > 0))
    return Choices(to, room, jnp.concatenate(options, -1))


def _most(to: jax.Array, values: jax.Array) -> jax.Array:
    """Return the most of values of pairs (robots, robots) over receivers (robots, n, robots): (robots, n)."""
    return jnp.where(to, values[:, None], 0.0).max(-1)


def option_features(
    state: MessageState, offered: Choices, belief: Belief, signals: jax.Array, base: int, mates: Mates
) -> jax.Array:
    """Return what robots observe of their options (robots, options * OPTION_NUMBERS).

    Args:
        state: The state.
        offered: Their options.
        belief: Their beliefs.
        signals: Links as they observe them (robots, robots).
        base: Slot of the base.
        mates: The nearest robots.
    """
    robots = len(signals)
    rows = np.arange(robots)[:, None]
    to = offered.receivers
    places = jnp.concatenate(
        [
            belief.pose[:, None, :2],
            jnp.broadcast_to(belief.pose[base, :2], (robots, 1, 2)),
            belief.mate_headers[rows, mates.slot, :2],
        ],
        1,
    )
    facts = [
        to_robot_frame(belief.pose[:, None], places) / NEAR_SCALE,
        _most(to, jnp.asarray(signals, jnp.float32))[..., None],
        (to.sum(-1) / TEAM_SCALE)[..., None],
        (_most(to, state.unknown) / NEWS_SCALE)[..., None],
        (_most(to, state.untold) / NEWS_SCALE)[..., None],
        (_most(to, state.marks) / MARK_SCALE)[..., None],
        jnp.minimum(offered.room / BYTES_SCALE, 1.0)[..., None],
    ]
    whole = jnp.concatenate(facts, -1)
    # Receivers outside, kinds inside: the order of `option`.
    each = jnp.repeat(whole, len(KINDS), axis=1)
    kind = jnp.broadcast_to(jnp.tile(jnp.eye(len(KINDS)), (RECEIVERS, 1)), (robots, OPTIONS - 1, len(KINDS)))
    described = jnp.concatenate([each, kind], -1)
    rows = [jnp.zeros((robots, 1, OPTION_NUMBERS)), described]
    if state.floats:
        rows.append(jnp.concatenate([whole, jnp.zeros((robots, RECEIVERS, len(KINDS)))], -1))
    described = jnp.concatenate(rows, 1)
    return jnp.where(offered.valid[..., None], described, 0.0).reshape(robots, -1)


FIRST_OPTION = FIRST_MASK
"""Options in an observation without vectors: their rows follow those of the goals."""


def without_options(seen: Array, floats: int = 0) -> jax.Array:
    """Return observations (..., n) as of robots that choose goals only.

    Those have neither options and their mask nor others' vectors.

    Args:
        seen: The observations.
        floats: Numbers of a vector; 0: messages have none.
    """
    seen = split_vectors(seen, floats)[0] if floats else jnp.asarray(seen)
    options = option_count(floats)
    end = FIRST_OPTION + options * OPTION_NUMBERS
    return jnp.concatenate([seen[..., :FIRST_OPTION], seen[..., end:-options]], -1)


def with_options(plain: Array, seen: Array, floats: int = 0) -> jax.Array:
    """Return observations as of robots that choose goals only (..., m) with what messages add to others.

    Args:
        plain: The observations, see `without_options`.
        seen: The other observations (..., n), with options, and vectors of robots that `plain` shows, too.
        floats: Numbers of a vector; 0: messages have none.
    """
    seen, vectors = split_vectors(seen, floats) if floats else (seen, None)
    options = option_count(floats)
    rows, mask = seen[..., FIRST_OPTION : FIRST_OPTION + options * OPTION_NUMBERS], seen[..., -options:]
    whole = jnp.concatenate([plain[..., :FIRST_OPTION], rows, plain[..., FIRST_OPTION:], mask], -1)
    return whole if vectors is None else joined_vectors(whole, vectors)


def given_option(valid: Array, *, base_first: bool) -> jax.Array:
    """Return the options of robots that do not choose them (...,): the fixed protocol.

    They send their map, and their plan where they have nothing new; nothing where nobody is in range.

    Args:
        valid: Options that can be chosen (..., options).
        base_first: Whether the base alone gets it where it is in range; else all.
    """
    to_base = [option(1, MAP)] * base_first
    order = jnp.array([*to_base, option(0, MAP), option(0, PLAN), 0])
    # The first valid one in the order of preference; silence, the last, is always valid.
    first = (jnp.asarray(valid)[..., order] > 0.5).argmax(-1)
    return order[first]


def option(receivers: int, kind: int) -> int:
    """Return the number of the option to send a kind to a choice of receivers."""
    return OPTIONS + receivers if kind == VECTOR else 1 + receivers * len(KINDS) + kind


def of_options(state: MessageState, chosen: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the kinds and the choices of receivers of options (robots,); those of silence mean nothing."""
    kind, where = (chosen - 1) % len(KINDS), jnp.maximum(chosen - 1, 0) // len(KINDS)
    if not state.floats:
        return kind, where
    is_vector = chosen >= OPTIONS
    return jnp.where(is_vector, VECTOR, kind), jnp.where(is_vector, chosen - OPTIONS, where)


def best_strips(rank: jax.Array, most: jax.Array) -> jax.Array:
    """Return which strips go into a message (numbers,): the first of the highest ranks.

    Args:
        rank: Rank of each strip, 0 to `MARKED`; 0: never (numbers,).
        most: Count of strips for which there is room ().
    """
    thresholds = np.arange(1, MARKED + 1)[:, None]
    # By counts of ranks, not by sorting: there are 13 ranks, and maps of 1,000 strips.
    least = MARKED + 1 - ((rank >= thresholds).sum(-1) <= most).sum()
    whole = rank >= least
    edge = rank == least - 1
    rest = edge & (jnp.cumsum(edge) <= most - whole.sum())
    return (whole | rest) & (rank > 0)


def posted(
    state: MessageState,
    offered: Choices,
    squares: Array,
    chosen: jax.Array,
    numbers: jax.Array | None = None,
) -> MessageState:
    """Return the state after robots chose options (robots,), with what they send.

    Args:
        state: The state.
        offered: Their options.
        squares: Their maps (robots, i, j).
        chosen: The options.
        numbers: Numbers of the robots' vectors, from -1 to 1 (robots, floats); None: messages have none.
    """
    rows, own = jnp.arange(len(chosen)), packed_maps(squares)
    kind, where = of_options(state, chosen)
    to = offered.receivers[rows, where] & (chosen > 0)[:, None]
    # `room` may be infinite, where bytes are free: it is cut to the map before it becomes an integer.
    strips = jnp.maximum(offered.room[rows, where] - PLAN_BYTES, 0.0) / STRIP_BYTES
    most = jnp.minimum(strips, own.shape[-1]).astype(jnp.int32)
    only_marks = (kind == VICTIMS)[:, None]
    # Of a packed mark one bit is left, and a mark's code, 3, is both bits of its square.
    content = jnp.where(only_marks, packed_marks(own) * 3, own)
    changed = merge_numbers(content[:, None], state.known) ^ state.known
    new = _count(packed_known(changed))
    marked = (packed_marks(content)[:, None] & ~packed_marks(state.known)) > 0
    # One message serves all receivers: a strip counts as for the one that lacks most of it.
    rank = jnp.where(to[..., None], jnp.where(marked, MARKED, new), 0).max(1)
    has_map = (chosen > 0) & ((kind == MAP) | (kind == VICTIMS))
    vectors = state.vectors
    if isinstance(vectors, VectorState) and numbers is not None:
        vectors = vectors.replace(sent=quantised(numbers))
    sent = jax.vmap(best_strips)(jnp.where(has_map[:, None], rank, 0), most)
    strips = jnp.where(sent, content, 0)
    size = jnp.where(kind == POSE, POSE_BYTES, PLAN_BYTES) + STRIP_BYTES * sent.sum(-1)
    if state.floats:
        size = jnp.where(kind == VECTOR, vector_bytes(state.floats), size)
    size = jnp.where(chosen > 0, size, 0)
    return state.replace(
        # Over a link that holds a message is taken to arrive: nobody confirms it.
        known=jnp.where(to[..., None], merge_numbers(state.known, strips[:, None]), state.known),
        chosen=chosen.astype(jnp.int32),
        receivers=to,
        strips=strips,
        size=size.astype(jnp.int32),
        sent=state.sent + size * to.sum(-1),
        vectors=vectors,
    )


def letters(state: MessageState, header: jax.Array) -> jax.Array:
    """Return the contents of the messages that were posted last (robots, HEADER_SIZE + numbers + floats).

    Args:
        state: The state.
        header: Headers of the robots, see `HEADER_SIZE` (robots, HEADER_SIZE).
    """
    sends, vector = state.chosen > 0, list[jax.Array]()
    kind, _ = of_options(state, state.chosen)
    bare = sends & (kind == POSE)
    if isinstance(state.vectors, VectorState):
        has_vector = kind == VECTOR
        bare |= has_vector
        vector = [jnp.where(has_vector[:, None], state.vectors.sent, ABSENT)]
    # Kinds that are shorter have no room for the plan.
    header = header.at[:, 3:5].set(jnp.where(bare[:, None], ABSENT, header[:, 3:5]))
    # Exact: a strip has 24 bits, which single precision holds.
    return jnp.concatenate([header, state.strips.astype(jnp.float32), *vector], -1)


def encode(letter: np.ndarray, floats: int = 0) -> bytes:
    """Return the bytes of a message, little-endian, as sizes count them.

    Args:
        letter: Its contents (HEADER_SIZE + numbers + floats,).
        floats: Numbers of a vector at its end; 0: messages have none.
    """
    numbers = len(letter) - floats
    pose, plan, contact = letter[:3], letter[3:5], letter[5:HEADER_SIZE]
    head = np.concatenate([pose, contact, plan[:0] if plan[0] == ABSENT else plan]).astype("<f4").tobytes()
    if floats and letter[numbers] != ABSENT:
        # Padded where the size alone would not tell the kind, see `vector_bytes`.
        return (head + letter[numbers:].astype(np.int8).tobytes()).ljust(vector_bytes(floats), b"\0")
    strips = letter[HEADER_SIZE:numbers].astype(np.int64)
    parts = [
        int(index).to_bytes(2, "little") + int(strips[index]).to_bytes(3, "little")
        for index in np.flatnonzero(strips)
    ]
    return head + b"".join(parts)


def decode(data: bytes, numbers: int, floats: int = 0) -> np.ndarray:
    """Return the message of some bytes (HEADER_SIZE + numbers + floats,).

    Args:
        data: The bytes.
        numbers: Numbers of a map.
        floats: Numbers of a vector; 0: messages have none.

    Raises:
        ValueError: The bytes are none of a message of maps of that many numbers.
    """
    letter = np.zeros(HEADER_SIZE + numbers + floats, np.float32)
    letter[HEADER_SIZE + numbers :] = ABSENT
    has_vector = bool(floats) and len(data) == vector_bytes(floats)
    rest = len(data) - PLAN_BYTES
    if len(data) != POSE_BYTES and not has_vector and (rest < 0 or rest % STRIP_BYTES):
        or_vector = f", or {vector_bytes(floats)}" if floats else ""
        raise ValueError(
            f"a message of {len(data)} bytes, expected 16, or 24 and 5 for each strip{or_vector}"
        )
    head = np.frombuffer(data[: POSE_BYTES if has_vector else min(len(data), PLAN_BYTES)], "<f4")
    letter[:3], letter[5], letter[3:5] = head[:3], head[3], ABSENT
    if has_vector:
        vector = np.frombuffer(data[POSE_BYTES : POSE_BYTES + floats], np.int8)
        letter[HEADER_SIZE + numbers :] = np.maximum(vector, -LEVELS)  # a byte has one step more
        return letter
    if len(data) > POSE_BYTES:
        letter[3:5] = head[4:6]
    for at in range(PLAN_BYTES, len(data), STRIP_BYTES):
        index = int.from_bytes(data[at : at + 2], "little")
        # Bytes come from outside: their indices may lie beyond the map.
        if index >= numbers:
            raise ValueError(f"a strip {index} of a map of {numbers}")
        letter[HEADER_SIZE + index] = int.from_bytes(data[at + 2 : at + STRIP_BYTES], "little")
    return letter
