"""Maps that robots draw of what their scanners see: squares that are unknown, free or a wall.

Pure functions of one map; map them over robots. A square's middle lies at `low + cell * (i, j)`, so that the
walls of generated arenas, which stand 1.2 m apart, run through the middles of squares of 0.3 m.
"""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.compilation import materialize
from usarmjx.base.errors import UsageError
from usarmjx.models.compile.reachability import RobotFootprint, reach_map
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sensors.ranging import ScannerSettings

UNKNOWN, FREE, WALL, MARK = 0, 1, 2, 3
"""Kinds of squares; a mark is something that was looked for, as a victim."""
MAX_EVIDENCE = 4
"""Number of scans of a square as free, or as a wall, from which on further ones do not count."""
MAX_SURFACE_GAP = 1.0
"""Two neighbouring beams that end closer to each other than this met one surface [m]."""
WINDOW_SHARE = 0.5
"""Of a map with so many times more squares than a scanner reaches, only those are looked at."""
SQUARES_PER_NUMBER = 12
"""Squares in a number of a message: 2 bits each, in the 24 bits that single precision holds exactly."""


@dataclass(frozen=True)
class MapGrid:
    """Position of a map's squares.

    Attributes:
        low: Middle of the square (0, 0) [m].
        cell: Side of a square [m].
        shape: Squares along x and y.
    """

    low: tuple[float, float]
    cell: float
    shape: tuple[int, int]

    @property
    def square_count(self) -> int:
        """Number of them."""
        return self.shape[0] * self.shape[1]

    @property
    def packed_size(self) -> int:
        """Count of a message's numbers that a map takes."""
        return -(-self.square_count // SQUARES_PER_NUMBER)

    @property
    def centres(self) -> np.ndarray:
        """The middles of all squares [m] (i, j, 2)."""
        steps = np.stack(np.meshgrid(*map(np.arange, self.shape), indexing="ij"), -1)
        return (np.array(self.low) + self.cell * steps).astype(np.float32)

    def gaps(self, positions: Array) -> jax.Array:
        """Return how far the middles of all squares are from positions [m] (..., 2) [m] (..., i, j)."""
        return jnp.sqrt(self.squared_gaps(positions))

    def squared_gaps(self, positions: Array) -> jax.Array:
        """As `gaps`, squared [m^2] (..., i, j): enough to compare, and for many pairs far less work.

        Squares are the last axes: so they are computed eight at a time, and not one by one.
        """
        x, y = (jnp.asarray(positions)[..., axis, None, None] for axis in range(2))
        away_x, away_y = self.centres[..., 0] - x, self.centres[..., 1] - y
        return jnp.asarray(away_x * away_x + away_y * away_y)

    def index(self, position: Array) -> jax.Array:
        """Return the square that positions [m] (..., 2) lie in, or the next one to it, int32 (..., 2)."""
        # Middles of squares lie at whole steps from `low`: rounding finds the square, not flooring.
        steps = jnp.round((jnp.asarray(position) - np.array(self.low, np.float32)) / self.cell)
        return jnp.clip(steps.astype(jnp.int32), 0, np.array(self.shape) - 1)

    def only(self, square: Array) -> jax.Array:
        """Return a mask of all squares in which only one (2,) is set (i, j)."""
        rows, columns = map(np.arange, self.shape)
        # Compared, not written: mapped over robots, a write is a scatter, which is slow on a GPU.
        return (rows[:, None] == square[0]) & (columns == square[1])


def grid_of(arenas: tuple[ArenaSpec, ...], cell: float = 0.3) -> MapGrid:
    """Return a grid over all of some arenas' extents.

    Raises:
        UsageError: A side of a square that is not above 0.
    """
    if cell <= 0:
        raise UsageError(f"squares of {cell} m, expected a side above 0")
    extents = np.array([arena.extent for arena in arenas])  # (arenas, x or y, low or high)
    # One grid for all arenas: worlds with different ones share the shapes of their maps.
    low, high = extents[..., 0].min(0), extents[..., 1].max(0)
    # Both borders count: from 0 to 1.2 m by 0.3 m there are five middles.
    counts = np.rint((high - low) / cell) + 1
    return MapGrid(low=(float(low[0]), float(low[1])), cell=cell, shape=(int(counts[0]), int(counts[1])))


def reachable_squares(arena: ArenaSpec, grid: MapGrid, size: RobotFootprint) -> np.ndarray:
    """Return in which squares' middles a robot's middle can be, from the first start pose (i, j)."""
    there = reach_map(arena, size.radius, size.step, height=size.height, cell=grid.cell / 6)
    return there.reachable_points(grid.centres)


def classify_scan(
    grid: MapGrid, scanner: ScannerSettings, pose: Array, ranges: Array
) -> tuple[jax.Array, jax.Array]:
    """Return which squares a scan shows to be free, and which to be a wall, (i, j) each.

    For each square the two beams on either side of its middle are looked up. If both met one surface, it
    is taken to be flat between them. A square is free if its middle is nearer than that, or than both beams'
    ends, by more than half a square. It is a wall if its middle is within half a square of the surface, or of
    the end of the beam that passes it closer by. Squares within one and a half of the scanner are free: the
    robot stands there.

    Args:
        grid: The squares.
        scanner: The scanner's settings; it scans in the x-y plane.
        pose: Pose, true or believed: x, y [m] and yaw [rad] (3,).
        ranges: Ranges [m] (beams,).
    """
    # Odd, so that the robot's own square is in the middle.
    width = 2 * math.ceil(scanner.max_range / grid.cell + 2) + 1  # squares; beyond them it shows nothing
    if width * width > grid.square_count * WINDOW_SHARE or width > min(grid.shape):
        return _classify_squares(grid, jnp.asarray(grid.centres), scanner, pose, ranges)
    # Clipped, so that the window stays on the map: dynamic slices would be shifted without a word.
    corner = jnp.clip(grid.index(pose[:2]) - width // 2, 0, np.array(grid.shape) - width)
    rows, columns = (corner[axis] + np.arange(width) for axis in range(2))
    x, y = jnp.asarray(grid.centres[:, 0, 0])[rows], jnp.asarray(grid.centres[0, :, 1])[columns]
    near = jnp.stack(jnp.meshgrid(x, y, indexing="ij"), -1)
    free, wall = _classify_squares(grid, near, scanner, pose, ranges)
    # Both masks as one array of small integers, so that the window is placed in the map once.
    found = jnp.where(free, FREE, jnp.where(wall, WALL, UNKNOWN)).astype(jnp.uint8)
    found = _placed(materialize(found), corner, grid.shape)
    return found == FREE, found == WALL


def _placed(window: jax.Array, corner: jax.Array, shape: tuple[int, int]) -> jax.Array:
    """Return a map of some shape, zero but for a window (i, j) with its first square at `corner` (2,)."""
    if jax.default_backend() != "gpu":
        return jax.lax.dynamic_update_slice(jnp.zeros(shape, window.dtype), window, (corner[0], corner[1]))
    # A part of the window with a frame: mapped over robots, the above is a scatter, which is slow on a GPU.
    frame = [n - width for n, width in zip(shape, window.shape, strict=True)]
    framed = jnp.pad(window, [(n, n) for n in frame])  # pyright: ignore[reportUnknownMemberType]
    start = np.array(frame) - corner
    return jax.lax.dynamic_slice(framed, (start[0], start[1]), shape)


def _classify_squares(
    grid: MapGrid, centres: jax.Array, scanner: ScannerSettings, pose: Array, ranges: Array
) -> tuple[jax.Array, jax.Array]:
    """As `classify_scan`, of squares with some middles [m] (i, j, 2)."""
    away_x, away_y = centres[..., 0] - pose[0], centres[..., 1] - pose[1]
    distance = jnp.sqrt(away_x * away_x + away_y * away_y)
    bearing = jnp.arctan2(away_y, away_x) - pose[2]
    # Into -pi to pi, or squares behind the robot would lie beyond the scan's ends.
    bearing = jnp.mod(bearing + jnp.pi, 2 * jnp.pi) - jnp.pi
    step, beams = scanner.resolution, scanner.beams
    place = (bearing + scanner.scan_fov / 2) / step
    if scanner.is_full_turn:  # the first beam follows the last
        place = jnp.mod(place, beams)
        # The remainder of a number just below the count may round up to it.
        first = jnp.minimum(jnp.floor(place).astype(jnp.int32), beams - 1)
        seen, second = jnp.ones(place.shape, bool), jnp.mod(first + 1, beams)
    else:
        first = jnp.clip(jnp.floor(place).astype(jnp.int32), 0, max(beams - 2, 0))
        # Each beam stands for half a step on either side, the outermost ones too.
        seen, second = (place > -0.5) & (place < beams - 0.5), jnp.minimum(first + 1, beams - 1)
    one, two = ranges[first], ranges[second]
    share = jnp.clip(place - first, 0.0, 1.0) * step
    # The polar equation of the straight line through the ends of both beams.
    # A range of 0 has no inverse.
    flat = math.sin(step) / (
        jnp.sin(step - share) / jnp.maximum(one, 1e-3) + jnp.sin(share) / jnp.maximum(two, 1e-3)
    )
    # Rounding may make it negative for equal ranges, and its root NaN.
    apart = jnp.sqrt(jnp.maximum(one**2 + two**2 - 2 * one * two * math.cos(step), 0.0))
    smooth = (apart < MAX_SURFACE_GAP) & (jnp.maximum(one, two) < scanner.max_range)
    near = jnp.where(place - first < 0.5, one, two)
    end, half = jnp.where(smooth, flat, near), grid.cell / 2
    # A beam at full range met nothing: its end is no wall.
    wall = seen & (end < scanner.max_range) & (jnp.abs(distance - end) <= half)
    free = seen & (distance < jnp.where(smooth, flat, jnp.minimum(one, two)) - half)
    # A robot stands there itself, so no wall does.
    free = free | (distance < 1.5 * grid.cell)
    return free, wall & ~free


def update_evidence(evidence: Array, free: Array, wall: Array) -> jax.Array:
    """Return how sure a robot is of squares after a scan: below 0 free, above 0 a wall, int8 (i, j).

    Moving things, such as other robots, are so forgotten after some scans.
    """
    # Signed before the difference: unsigned ones would wrap around.
    change = jnp.asarray(wall, jnp.int8) - jnp.asarray(free, jnp.int8)
    # Bounded, so that a few scans undo evidence of any age.
    return jnp.clip(evidence + change, -MAX_EVIDENCE, MAX_EVIDENCE).astype(jnp.int8)


def fuse_maps(evidence: Array, marks: Array, received: Array) -> jax.Array:
    """Return what a robot believes of squares, uint8 (i, j): its own scans go before what it received.

    Args:
        evidence: See `update_evidence` (i, j).
        marks: Squares that it has marked (i, j).
        received: The map that came by mail, as this function returns it (i, j).
    """
    own = jnp.where(evidence < 0, FREE, jnp.where(evidence > 0, WALL, received))
    return jnp.where(marks | (received == MARK), MARK, own).astype(jnp.uint8)


def merge_received(received: Array, news: Array) -> jax.Array:
    """Return the received map (i, j) after another one came in.

    Marks go before all else, and what anybody has seen to be free before what another took for a wall: that
    may have been a robot.
    """
    ranks = np.array([0, 2, 1, 3])  # unknown, free, wall, mark
    return jnp.where(jnp.asarray(ranks)[news] > jnp.asarray(ranks)[received], news, received).astype(
        jnp.uint8
    )


def merge_packed(received: Array, numbers: Array, there: Array) -> jax.Array:
    """Return the received map (i, j) after others came in, as `merge_received` makes of one after another.

    All squares of a number are compared as they lie packed.

    Args:
        received: The map before.
        numbers: The others, as `pack` returns them (maps, numbers).
        there: Which of them count (maps,).
    """
    # A message that is not there says unknown of all squares, which is 0.
    whole = jnp.where(there[:, None], numbers, 0.0).astype(jnp.int32)
    joined = _joined(jnp.bitwise_or.reduce(whole, axis=0), jnp.bitwise_or.reduce(packed_marks(whole), axis=0))
    rows, columns = received.shape
    return merge_received(received, unpack(joined, (rows, columns)))


# The sum of the first powers of 4, in binary 0101...01.
LOWER_BITS = np.int32((4**SQUARES_PER_NUMBER - 1) // 3)
"""The lower bit of each square of a number."""


def packed_known(numbers: Array) -> jax.Array:
    """Return the lower bits of squares that are not unknown, of packed maps of int32."""
    return jnp.asarray((numbers | numbers >> 1) & LOWER_BITS)


def packed_free(numbers: Array) -> jax.Array:
    """Return the lower bits of squares that are free or marked, of packed maps of int32."""
    return jnp.asarray(numbers & LOWER_BITS)


def packed_marks(numbers: Array) -> jax.Array:
    """Return the lower bits of squares that are marked, of packed maps of int32."""
    return jnp.asarray(numbers & numbers >> 1 & LOWER_BITS)


def merge_numbers(one: Array, other: Array) -> jax.Array:
    """Return two packed maps of int32 as one, by the ranks of `merge_received`."""
    return _joined(one | other, packed_marks(one) | packed_marks(other))


def _joined(some: Array, marked: Array) -> jax.Array:
    """Return packed maps from the union of their bits, and the lower bits of their marks."""
    # Free squares and marks have the lower bit, walls and marks the upper one: so free goes before wall.
    free = packed_free(some)
    walls = (some >> 1) & LOWER_BITS & ~free
    return jnp.asarray(free | ((marked | walls) << 1))


def pack(squares: Array) -> jax.Array:
    """Return a map (i, j) as numbers of a message, `SQUARES_PER_NUMBER` squares each, float32 (numbers,)."""
    flat = jnp.ravel(squares).astype(jnp.int32)
    missing = jnp.zeros(-flat.shape[0] % SQUARES_PER_NUMBER, jnp.int32)
    rows = jnp.concatenate([flat, missing]).reshape(-1, SQUARES_PER_NUMBER)
    # Sums below 2^24 are whole in single precision, which all payloads have.
    return (rows * 4 ** np.arange(SQUARES_PER_NUMBER)).sum(-1).astype(jnp.float32)


def unpack(numbers: Array, shape: tuple[int, int]) -> jax.Array:
    """Return the map of that shape that was packed, uint8."""
    whole = jnp.asarray(numbers).astype(jnp.int32)
    rows = (whole[:, None] >> (2 * np.arange(SQUARES_PER_NUMBER))) & 3
    return jnp.ravel(rows)[: shape[0] * shape[1]].reshape(shape).astype(jnp.uint8)


def to_robot_frame(pose: Array, position: Array) -> jax.Array:
    """Return positions [m] (..., 2) in the axes of robots at poses x, y [m], yaw [rad] (..., 3)."""
    away = position - pose[..., :2]
    cos, sin = jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])
    return jnp.stack([cos * away[..., 0] + sin * away[..., 1], cos * away[..., 1] - sin * away[..., 0]], -1)


def points_around(pose: Array, width: int, spacing: float) -> jax.Array:
    """Return positions [m] of points around a robot (width, width, 2): first axis ahead, second to the left.

    Args:
        pose: x, y [m] and yaw [rad] (3,).
        width: Points along a side.
        spacing: Between two points [m].
    """
    # Less half the width: the robot is in the middle for odd and even widths alike.
    line = (np.arange(width) - (width - 1) / 2) * spacing
    ahead, aside = np.meshgrid(line, line, indexing="ij")
    cos, sin = jnp.cos(pose[2]), jnp.sin(pose[2])
    return jnp.stack([pose[0] + cos * ahead - sin * aside, pose[1] + sin * ahead + cos * aside], -1)


def egocentric_map(grid: MapGrid, squares: Array, pose: Array, width: int, spacing: float) -> jax.Array:
    """Return a map as seen from a robot: x ahead, y to the left, the robot in the middle (width, width).

    Args:
        grid: The squares.
        squares: The map (i, j).
        pose: x, y [m] and yaw [rad] (3,).
        width: Points along a side.
        spacing: Between two points [m]; each shows the square that it lies in. Off the map all is wall.
    """
    position = points_around(pose, width, spacing)
    steps = jnp.round((position - np.array(grid.low, np.float32)) / grid.cell).astype(jnp.int32)
    # Tested before `index` clips, which would repeat the squares at the map's edge beyond it.
    inside = ((steps >= 0) & (steps < np.array(grid.shape))).all(-1)
    there = grid.index(position)
    return jnp.where(inside, squares[there[..., 0], there[..., 1]], WALL)
