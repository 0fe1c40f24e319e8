"""RFID reader (manual 10.9)."""

from dataclasses import dataclass
from types import ModuleType
from typing import Annotated, Any

import numpy as np

from usarmjx.base.backend import Array, set_at, xp
from usarmjx.base.nodes import Node
from usarmjx.base.settings import NOT_NEGATIVE, Setting
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.types.shapes import GLASS, SKY
from usarmjx.sensors.base import SENSORS, Sensor, SensorInput, SensorSettings, vectorized
from usarmjx.sensors.sketch import OverlayLines, empty_overlay
from usarmjx.sensors.surroundings import Surroundings, nearest

MAX_TAGS = 16
"""Number of tags that a sensor reads at once, nearest first, and of rays that test for obstacles."""
RADIUS_MODE, OBSTACLE_MODE, ATTENUATION_MODE = "Radius", "Obstacle", "Attenuation"
SENSING_MODES = (RADIUS_MODE, OBSTACLE_MODE, ATTENUATION_MODE)
RAY_END_HEIGHT = 0.01
"""Height above a tag at which its ray ends [m]: the tag lies on the ground, which must not hide it."""
OBSTACLE_MARGIN = 0.02
"""Distance from a tag within which surfaces are not obstacles [m]."""
MIN_TAG_DISTANCE = 1e-3
"""Lower bound of a tag's distance [m]: the path loss diverges at 0."""
MAX_EXPONENT = 6.0
"""Upper bound of the range as a power of ten [m], larger than any arena."""


@dataclass(frozen=True)
class RfidSettings(SensorSettings):
    """Manual 10.9.2.

    Attributes:
        sensing_mode: One of `SENSING_MODES`, case ignored.
        max_range: Range in the modes Radius and Obstacle [m].
        max_single_shot_range: The same for tags that answer only once [m].
        tx_power_dbm: Power of the transmitter [dBm].
        rx_sensitivity_dbm: Weakest received signal [dBm].
        obstacle_attenuation_db: Loss through an obstacle, of which at most one counts [dB].
        trace_rfids: Whether pictures show lines to the tags.
        always_read_rfid_mem: Whether each report contains the tags' memory.
    """

    sensing_mode: Annotated[str, Setting(choices=SENSING_MODES)] = ATTENUATION_MODE
    max_range: Annotated[float, NOT_NEGATIVE] = 3.0
    max_single_shot_range: Annotated[float, NOT_NEGATIVE] = 6.0
    tx_power_dbm: Annotated[float, Setting(manual_key="dBmTXPower")] = 36.0
    rx_sensitivity_dbm: Annotated[float, Setting(manual_key="dBmRXSensibility")] = -88.0
    obstacle_attenuation_db: Annotated[float, Setting(ge=0, manual_key="dBObstacleAttenuation")] = 3.5
    trace_rfids: Annotated[bool, Setting(manual_key="bTraceRFIDs")] = False
    always_read_rfid_mem: Annotated[bool, Setting(manual_key="bAlwaysReadRFIDmem")] = False

    @property
    def mode(self) -> str:
        """Member of `SENSING_MODES` in its canonical spelling."""
        return next(mode for mode in SENSING_MODES if mode.lower() == self.sensing_mode.lower())


def signal_strength(settings: RfidSettings, distance: Array, blocked: Array, xp: ModuleType = xp) -> Array:
    """Return the strength of a tag's answer [dBm] (...,): twice the indoor path loss (manual 10.9.3.3).

    Args:
        settings: Settings of the sensor.
        distance: Distance of the tag [m] (...,).
        blocked: Whether there is an obstacle (...,).
        xp: Array module of both.
    """
    # Twice, because the signal travels to the tag and back.
    loss = 2 * 10 * (5.25 + 2 * xp.log10(xp.maximum(distance, MIN_TAG_DISTANCE)))
    return settings.tx_power_dbm - loss - settings.obstacle_attenuation_db * blocked


def distance_of_strength(settings: RfidSettings) -> float:
    """Return the distance at which an unobstructed tag's answer has the weakest received strength [m]."""
    loss = settings.tx_power_dbm - settings.rx_sensitivity_dbm
    # Rounded up: `signal_strength` decides, and a ray must reach whatever it accepts.
    return 10 ** min((loss / 20 - 5.25) / 2, MAX_EXPONENT) * (1 + 1e-5)


def _link_quality(settings: RfidSettings, strength: Array) -> Array:
    """Return the green share of a line (...,): 1 at the strength from 1 m, 0 at the weakest received one."""
    least, best = (
        settings.rx_sensitivity_dbm,
        signal_strength(settings, np.ones((), np.float32), np.zeros((), np.float32), np),
    )
    # The lower bound is for a receiver so deaf that it would miss a tag at 1 m.
    return xp.clip((strength - least) / max(float(best) - least, 1e-3), 0.0, 1.0)


class RfidMemory(Node, kw_only=True):
    """Memory of an RFID reader.

    Attributes:
        answered: Which single-shot tags have answered it, dropped ones last (all_tags,).
        last_read_ids: IDs of the tags in the last reading, -1 for none (max_tags,).
        overlay: Lines to the tags; None unless requested.
    """

    answered: Array
    last_read_ids: Array
    overlay: OverlayLines | None = None


class _Tags(Node, kw_only=True):
    """Nearest tags, nearest first.

    Attributes:
        index: Indices among all tags, dropped ones last (..., n).
        pos: Positions [m] (..., n, 3).
        distance: Distances [m] (..., n).
        id: IDs (..., n).
        single: Whether they answer only once (..., n).
        there: Whether the tag exists (..., n).
    """

    index: Array
    pos: Array
    distance: Array
    id: Array
    single: Array
    there: Array


def _pad_tags(values: Array) -> Array:
    """Pad values of tags (tags, ...) with zeros to `MAX_TAGS`."""
    values = xp.asarray(values)
    missing = MAX_TAGS - len(values)
    if missing <= 0:
        return values
    return xp.concatenate([values, xp.zeros((missing, *values.shape[1:]), values.dtype)])


def _row_index(index: Array) -> Any:  # noqa: ANN401 - what indexes
    """Return an index for tags (n,), or for each robot's tags (robots, n)."""
    return index if index.ndim == 1 else (np.arange(len(index))[:, None], index)


def _nearest_tags(surroundings: Surroundings, pos: Array) -> _Tags:
    """Return the `MAX_TAGS` tags nearest to a position [m] (..., 3), existing ones first."""
    names = ("tag_there", "tag_pos", "tag_single", "tag_id")
    there, positions, single, ids = (_pad_tags(getattr(surroundings, name)) for name in names)
    # Missing tags sort last.
    far = xp.where(there, xp.linalg.norm(positions - pos[..., None, :], axis=-1), xp.inf)
    # A fixed number: arrays in programs cannot grow with the tags in range.
    index = nearest(far, MAX_TAGS)
    return _Tags(
        index=index,
        pos=positions[index],
        distance=far[_row_index(index)],
        id=ids[index],
        single=single[index],
        there=there[index],
    )


@dataclass(frozen=True, eq=False)
class Rfid(Sensor):
    """RFID reader; value: read or not, ID and x, y, z [m] of the 16 nearest tags (16, 5).

    The nearest (`MAX_TAGS`) come first. Positions are in the sensor's axes.
    """

    kind = "RFID"
    needs_surroundings = True
    needs_victims = False
    transparent = frozenset({SKY, GLASS})
    # Bundles are for rays of similar directions, and tags lie in any direction.
    bundle_size = 1
    settings_class = RfidSettings

    @property
    def max_distance(self) -> float:
        """Distance beyond which no tag is read, with or without obstacles [m]."""
        settings = self.settings[0]
        if settings.mode != ATTENUATION_MODE:
            return max(settings.max_range, settings.max_single_shot_range)
        return max(distance_of_strength(settings), MIN_TAG_DISTANCE)

    @vectorized
    def aimed_rays(self, bodies: BodyPoses, surroundings: Surroundings) -> tuple[Array, Array]:
        """Return one ray to each of the nearest tags in range, unless obstacles are irrelevant."""
        if self.settings[0].mode == RADIUS_MODE:
            return self.rays(bodies)
        pos, _ = self.mount_poses(bodies)
        tags = _nearest_tags(surroundings, pos[..., 0, :])
        way = tags.pos + xp.array([0.0, 0.0, RAY_END_HEIGHT]) - pos
        along = way / xp.maximum(xp.linalg.norm(way, axis=-1, keepdims=True), MIN_TAG_DISTANCE)
        # A zero direction is not cast, and hits nothing.
        along = xp.where((tags.there & (tags.distance <= self.max_distance))[..., None], along, 0.0)
        return xp.broadcast_to(pos, along.shape), along

    def init_memory(self, inputs: SensorInput, key: Array) -> RfidMemory:
        """Return an empty memory."""
        del key
        # Padding of `_pad_tags` has indices past the last tag.
        room = inputs.surroundings_or_empty.tag_there.shape[0] + MAX_TAGS
        lines = empty_overlay(MAX_TAGS) if self.has_overlay else None
        return RfidMemory(
            answered=xp.zeros(room, bool), last_read_ids=xp.full(MAX_TAGS, -1, xp.int32), overlay=lines
        )

    @vectorized
    def read(self, inputs: SensorInput, memory: RfidMemory, key: Array) -> tuple[RfidMemory, Array]:
        """Read all tags in range once; single-shot tags answer only the first time."""
        del key
        settings = self.settings[0]
        pos, mat = self.mount_poses(inputs.bodies)
        # The same tags in the same order as those that the rays were aimed at: hit k belongs to tag k.
        tags = _nearest_tags(inputs.surroundings_or_empty, pos[..., 0, :])
        blocked = xp.zeros(tags.there.shape, bool)
        if settings.mode != RADIUS_MODE:
            # A ray that was not cast has an infinite distance: its tag, out of range, is not blocked either.
            blocked = inputs.hits.distance < tags.distance - OBSTACLE_MARGIN
        if settings.mode == ATTENUATION_MODE:
            near, strength = tags.there, signal_strength(settings, tags.distance, blocked)
            reached = near & (strength >= settings.rx_sensitivity_dbm)
            good = _link_quality(settings, strength)
        else:
            reach = xp.where(tags.single, settings.max_single_shot_range, settings.max_range)
            near = tags.there & (tags.distance <= reach)
            reached, good = near & ~blocked, (~blocked).astype(xp.float32)
        here = _row_index(tags.index)
        read = reached & ~memory.answered[here]
        offset = xp.where(read[..., None], tags.pos - pos, 0.0)
        position = (offset[..., None] * mat).sum(-2)  # in the sensor's axes
        # IDs are whole numbers, exact in single precision up to 2^24.
        row = xp.stack([read.astype(xp.float32), xp.where(read, tags.id, 0).astype(xp.float32)], -1)
        lines = None
        if self.has_overlay:
            rgb = xp.stack([1 - good, good, xp.zeros_like(good)], -1)
            black = (settings.mode == ATTENUATION_MODE) & ~reached[..., None]
            start = xp.broadcast_to(pos, tags.pos.shape)
            lines = OverlayLines(start=start, end=tags.pos, rgb=xp.where(black, 0.0, rgb), shown=near)
        memory = RfidMemory(
            answered=set_at(memory.answered, here, memory.answered[here] | (read & tags.single)),
            last_read_ids=xp.where(read, tags.id, -1),
            overlay=lines,
        )
        return memory, xp.concatenate([row, position], -1)

    @property
    def has_overlay(self) -> bool:
        """Whether bTraceRFIDs is set (manual 10.9.2)."""
        return self.settings[0].trace_rfids

    def overlay(self, memory: RfidMemory) -> OverlayLines:
        """Return lines to the nearest tags (manual 10.9.3).

        Green to readable tags, red to those behind an obstacle, none to those out of range; in the mode
        Attenuation from green to red by signal strength, black to unreadable ones.
        """
        assert memory.overlay is not None
        return memory.overlay

    def handle_set(
        self,
        opcode: str,
        params: tuple[float, ...],
        inputs: SensorInput,
        memory: Any,  # noqa: ANN401
    ) -> Any | None:  # noqa: ANN401
        """Validate Read and Write (manual 10.9.5, 10.9.6), whose first parameter is a tag in range.

        The content of tags is not part of the sensor: see `server.worlds`.
        """
        del inputs
        # Not negative: -1 would match the entries of `last_read_ids` that stand for no tag.
        known = opcode.lower() in ("read", "write") and bool(params) and params[0] >= 0
        # Tags of the last reading are those in range now.
        return memory if known and bool(np.any(np.asarray(memory.last_read_ids) == params[0])) else None


SENSORS.add(Rfid.kind, Rfid)
