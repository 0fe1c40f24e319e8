"""RFID sensor (manual 10.9)."""

from dataclasses import dataclass
from types import ModuleType
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.transforms import Array
from usarmjx.models.build.body_plan import Bodies
from usarmjx.models.spec.robot import GLASS, SKY
from usarmjx.models.spec.settings import NOT_NEGATIVE, OneOf
from usarmjx.sensors.base import SENSORS, Common, Sensor, Sight
from usarmjx.sensors.sketch import Sketch, blank
from usarmjx.sensors.surroundings import Surroundings

MOST = 16
"""Most tags that a sensor reads at once, the nearest; so many rays look for obstacles."""
RADIUS, OBSTACLE, ATTENUATION = "Radius", "Obstacle", "Attenuation"
MODES = OneOf((RADIUS, OBSTACLE, ATTENUATION))
RISE = 0.01
"""Rays end this far above a tag [m]: it lies on the ground, and is not hidden by it."""
SLACK = 0.02
"""What is nearer to a tag than this is no obstacle [m]."""
TOUCHING = 1e-3
"""No tag counts as nearer than this [m]: the path loss has no limit."""


@dataclass(frozen=True)
class RfidSettings(Common):
    """Manual 10.9.2.

    Attributes:
        sensing_mode: One of `MODES`, case ignored.
        max_range: Range in the modes Radius and Obstacle [m].
        max_single_shot_range: The same for tags that answer only once [m].
        d_bm_tx_power: Power of the transmitter [dBm].
        d_bm_rx_sensibility: Weakest signal that is received [dBm].
        d_b_obstacle_attenuation: Loss through an obstacle; there is never more than one [dB].
        trace_rfi_ds: Whether pictures show lines to the tags.
        always_read_rfi_dmem: Whether each report tells what is written on the tags.
    """

    sensing_mode: Annotated[str, MODES] = ATTENUATION
    max_range: Annotated[float, NOT_NEGATIVE] = 3.0
    max_single_shot_range: Annotated[float, NOT_NEGATIVE] = 6.0
    d_bm_tx_power: float = 36.0
    d_bm_rx_sensibility: float = -88.0
    d_b_obstacle_attenuation: Annotated[float, NOT_NEGATIVE] = 3.5
    trace_rfi_ds: bool = False
    always_read_rfi_dmem: bool = False

    @property
    def mode(self) -> str:
        """The member of `MODES` that is meant."""
        return next(mode for mode in MODES if mode.lower() == self.sensing_mode.lower())


def signal(settings: RfidSettings, distance: Array, blocked: Array, xp: ModuleType = jnp) -> Array:
    """Return the strength of a tag's answer [dBm] (...,): twice the indoor path loss (manual 10.9.3.3).

    Args:
        settings: The sensor's settings.
        distance: How far away the tag is [m] (...,).
        blocked: Whether something is between (...,).
        xp: Array module of both.
    """
    loss = 2 * 10 * (5.25 + 2 * xp.log10(xp.maximum(distance, TOUCHING)))
    return settings.d_bm_tx_power - loss - settings.d_b_obstacle_attenuation * blocked


def _goodness(settings: RfidSettings, strength: jax.Array) -> jax.Array:
    """Return how green a line is (...,): 1 as strong as from a metre away, 0 as weak as can be received."""
    least, best = settings.d_bm_rx_sensibility, signal(settings, np.float32(1.0), np.float32(0.0), np)
    return jnp.clip((strength - least) / max(float(best) - least, 1e-3), 0.0, 1.0)


class RfidMemory(struct.PyTreeNode, kw_only=True):
    """What an RFID sensor remembers.

    Attributes:
        answered: Which of the single-shot tags have answered it (tags + MOST,).
        near: IDs of the tags that it read last, -1 for none (MOST,).
        lines: Lines to the tags; None unless they are wanted.
    """

    answered: jax.Array
    near: jax.Array
    lines: Sketch | None = None


class _Tags(struct.PyTreeNode, kw_only=True):
    """The nearest tags, nearest first: places among all, positions, distances, and what they are."""

    place: jax.Array
    pos: jax.Array
    far: jax.Array
    id: jax.Array
    single: jax.Array
    there: jax.Array


def _nearest(around: Surroundings, pos: jax.Array) -> _Tags:
    """Return `MOST` tags, those that are there first; there are always as many, some of them not there."""
    spare = jnp.zeros(MOST)
    there = jnp.concatenate([jnp.asarray(around.tag_there), spare > 0])
    places = jnp.concatenate([jnp.asarray(around.tag_pos), jnp.zeros((MOST, 3))])
    far = jnp.where(there, jnp.linalg.norm(places - pos, axis=-1), jnp.inf)
    _, place = jax.lax.top_k(-far, MOST)
    single = jnp.concatenate([jnp.asarray(around.tag_single), spare > 0])
    ids = jnp.concatenate([jnp.asarray(around.tag_id, jnp.int32), spare.astype(jnp.int32)])
    return _Tags(
        place=place,
        pos=places[place],
        far=far[place],
        id=ids[place],
        single=single[place],
        there=there[place],
    )


@dataclass(frozen=True, eq=False)
class Rfid(Sensor):
    """Reads tags around it; value: read or not, ID and x, y, z [m] of the 16 nearest tags (16, 5).

    The nearest (`MOST`) come first. Where they are is in the sensor's axes.
    """

    kind = "RFID"
    looks_around = True
    passes = frozenset({SKY, GLASS})
    defaults = RfidSettings

    def aim(self, bodies: Bodies, around: Surroundings) -> tuple[jax.Array, jax.Array]:
        """One ray to each of the nearest tags, unless obstacles do not matter."""
        if self.settings[0].mode == RADIUS:
            return self.rays(bodies)
        pos, _ = self.mount_poses(bodies)
        tags = _nearest(around, pos[0])
        way = tags.pos + jnp.array([0.0, 0.0, RISE]) - pos[0]
        along = way / jnp.maximum(jnp.linalg.norm(way, axis=-1, keepdims=True), TOUCHING)
        return jnp.broadcast_to(pos[0], along.shape), along

    def start(self, sight: Sight, key: jax.Array) -> RfidMemory:
        """Nothing was read yet."""
        del key
        room = sight.around.tag_there.shape[0] + MOST
        lines = blank(MOST) if self.draws else None
        return RfidMemory(answered=jnp.zeros(room, bool), near=jnp.full(MOST, -1, jnp.int32), lines=lines)

    def read(self, sight: Sight, memory: RfidMemory, key: jax.Array) -> tuple[RfidMemory, jax.Array]:
        """Read all tags in reach once; those that answer only once never again."""
        del key
        settings = self.settings[0]
        pos, mat = self.mount_poses(sight.bodies)
        tags = _nearest(sight.around, pos[0])
        blocked = jnp.zeros(MOST, bool)
        if settings.mode != RADIUS:
            blocked = sight.hits.distance < tags.far - SLACK
        if settings.mode == ATTENUATION:
            near, strength = tags.there, signal(settings, tags.far, blocked)
            reached = near & (strength >= settings.d_bm_rx_sensibility)
            good = _goodness(settings, strength)
        else:
            reach = jnp.where(tags.single, settings.max_single_shot_range, settings.max_range)
            near = tags.there & (tags.far <= reach)
            reached, good = near & ~blocked, (~blocked).astype(jnp.float32)
        read = reached & ~memory.answered[tags.place]
        offset = jnp.where(read[:, None], tags.pos - pos[0], 0.0)
        told = (offset[:, :, None] * mat[0]).sum(1)  # in the sensor's axes
        row = jnp.stack([read.astype(jnp.float32), jnp.where(read, tags.id, 0).astype(jnp.float32)], -1)
        lines = None
        if self.draws:
            rgb = jnp.stack([1 - good, good, jnp.zeros(MOST)], -1)
            black = (settings.mode == ATTENUATION) & ~reached[:, None]
            start = jnp.broadcast_to(pos[0], tags.pos.shape)
            lines = Sketch(start=start, end=tags.pos, rgb=jnp.where(black, 0.0, rgb), shown=near)
        memory = RfidMemory(
            answered=memory.answered.at[tags.place].max(read & tags.single),
            near=jnp.where(read, tags.id, -1),
            lines=lines,
        )
        return memory, jnp.concatenate([row, told], -1)

    @property
    def draws(self) -> bool:
        """With bTraceRFIDs (manual 10.9.2)."""
        return self.settings[0].trace_rfi_ds

    def sketch(self, memory: RfidMemory) -> Sketch:
        """Lines to the nearest tags (manual 10.9.3).

        Green to those that are reached, red to those behind an obstacle, none to those out of range; in the
        mode Attenuation from green to red by the strength of the signal, black to those out of reach.
        """
        assert memory.lines is not None
        return memory.lines

    def order(self, opcode: str, params: tuple[float, ...], sight: Sight, memory: Any) -> Any | None:  # noqa: ANN401
        """Read and Write (manual 10.9.5, 10.9.6) are valid for a tag that is in range; the first parameter.

        What is written on tags is not the sensor's: see `server.tags`.
        """
        del sight
        known = opcode.lower() in ("read", "write") and bool(params) and params[0] >= 0
        return memory if known and bool(np.any(np.asarray(memory.near) == params[0])) else None


SENSORS.add(Rfid.kind, Rfid)
