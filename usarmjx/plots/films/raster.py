"""Rasterizer of triangles on NumPy: which one is nearest at each pixel, for thousands of them at once.

Triangles become rows, rows become fragments, and each fragment competes for its pixel by a key: nearness in
the upper half, its triangle in the lower half. Nearness is positive and affine on the screen: 1 / depth for a
perspective, a constant minus the depth for parallel light.
"""

from typing import NamedTuple

import numpy as np

FRAGMENTS = 1 << 20
"""Fragments at a time: their arrays fit into a few MiB."""
NEAR = 0.03
"""Least distance of a perspective's picture plane [m]."""
LEAST_AREA = 1e-9
"""Area on the screen from which a triangle is drawn [pixels]."""


class Surface(NamedTuple):
    """Result of rasterization.

    Attributes:
        triangle: Index of the nearest triangle, -1 for none, int32 (height * width,).
        nearness: Its nearness, 0 for none, float32 (height * width,).
    """

    triangle: np.ndarray
    nearness: np.ndarray


class Canvas:
    """Pixels for which triangles compete.

    Args:
        width: Pixels along a row.
        height: Rows.

    Attributes:
        keys: Nearness as the bits of a float, and the triangle plus 1, of each pixel (height * width,).
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self.keys = np.zeros(width * height, "<u8")

    def copy(self) -> "Canvas":
        """Return a canvas with the same content."""
        other = Canvas.__new__(Canvas)
        other.width, other.height, other.keys = self.width, self.height, self.keys.copy()
        return other

    def surface(self) -> Surface:
        """Return what is nearest at each pixel."""
        return Surface(self.keys.view("<i4")[::2] - 1, self.keys.view("<f4")[1::2].copy())

    def draw(self, xy: np.ndarray, nearness: np.ndarray, number: np.ndarray) -> None:
        """Draw triangles.

        Args:
            xy: Corners on the screen, to the right and down from the upper left corner [pixels] (n, 3, 2).
            nearness: Nearness of the corners, above 0 (n, 3).
            number: Index of each in the surface (n,).
        """
        xy, nearness = np.asarray(xy, np.float64), np.asarray(nearness, np.float64)
        first, second = xy[:, 1] - xy[:, 0], xy[:, 2] - xy[:, 0]
        area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        low, high = xy.min(1), xy.max(1)
        kept = (np.abs(area) > LEAST_AREA) & (high > 0).all(1) & (low < (self.width, self.height)).all(1)
        rows = _rows(xy[kept], area[kept], nearness[kept], np.asarray(number)[kept], self.width, self.height)
        ends = np.cumsum(rows.pixels)
        begin = 0
        while begin < len(ends):
            before = ends[begin - 1] if begin else 0
            end = max(begin + 1, int(np.searchsorted(ends, before + FRAGMENTS, side="right")))
            self._fill(_Rows(*(column[begin:end] for column in rows)))
            begin = end

    def _fill(self, rows: "_Rows") -> None:
        """Let the fragments of rows compete."""
        total = int(rows.pixels.sum())
        if not total:
            return
        row = np.repeat(np.arange(len(rows.pixels), dtype=np.int32), rows.pixels)
        along = np.arange(total, dtype=np.int32) - np.repeat(
            (np.cumsum(rows.pixels) - rows.pixels).astype(np.int32), rows.pixels
        )
        near = np.maximum(rows.base[row] + rows.slope[row] * along.astype(np.float32), np.float32(1e-20))
        key = near.view(np.uint32).astype(np.uint64)
        key <<= np.uint64(32)
        key |= rows.number[row]
        np.maximum.at(self.keys, rows.pixel[row] + along, key)


class _Rows(NamedTuple):
    """Rows of triangles.

    Attributes:
        pixel: Index of the first pixel (rows,).
        pixels: Number of pixels (rows,).
        base: Nearness at the first pixel (rows,).
        slope: Change of the nearness from pixel to pixel (rows,).
        number: Index of the triangle, plus 1 (rows,).
    """

    pixel: np.ndarray
    pixels: np.ndarray
    base: np.ndarray
    slope: np.ndarray
    number: np.ndarray


def _rows(
    xy: np.ndarray, area: np.ndarray, nearness: np.ndarray, number: np.ndarray, width: int, height: int
) -> _Rows:
    """Return the rows of triangles whose pixels have their centres inside."""
    top = np.clip(np.ceil(xy[..., 1].min(1) - 0.5), 0, height).astype(int)
    bottom = np.clip(np.ceil(xy[..., 1].max(1) - 0.5), 0, height).astype(int)
    count = np.maximum(bottom - top, 0)
    which = np.repeat(np.arange(len(xy)), count)
    y = top[which] + np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    middle = y + 0.5
    left, right = np.zeros(len(which)), np.full(len(which), float(width))
    for corner in range(3):
        start, edge = xy[:, corner], xy[:, (corner + 1) % 3] - xy[:, corner]
        level = edge[:, 1] == 0
        slope = edge[:, 0] / np.where(level, 1.0, edge[:, 1])
        x = start[which, 0] + (middle - start[which, 1]) * slope[which]
        ends = (edge[:, 1] * np.sign(area) > 0)[which]
        begins = (edge[:, 1] * np.sign(area) < 0)[which]
        right = np.where(ends, np.minimum(right, x), right)
        left = np.where(begins, np.maximum(left, x), left)
    x0 = np.ceil(left - 0.5).astype(int)
    pixels = np.maximum(np.ceil(right - 0.5).astype(int) - x0, 0)
    across, down = _gradient(xy, area, nearness)
    base = (
        nearness[which, 0]
        + across[which] * (x0 + 0.5 - xy[which, 0, 0])
        + down[which] * (middle - xy[which, 0, 1])
    )
    return _Rows(
        (y * width + x0).astype(np.int64),
        pixels,
        base.astype(np.float32),
        across[which].astype(np.float32),
        (number[which] + 1).astype(np.uint64),
    )


def _gradient(xy: np.ndarray, area: np.ndarray, nearness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the change of the nearness per pixel to the right and down (n,) and (n,)."""
    first, second = xy[:, 1] - xy[:, 0], xy[:, 2] - xy[:, 0]
    rise, more = nearness[:, 1] - nearness[:, 0], nearness[:, 2] - nearness[:, 0]
    across = (rise * second[:, 1] - more * first[:, 1]) / area
    return across, (more * first[:, 0] - rise * second[:, 0]) / area


def clip_near(corners: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts of triangles beyond `NEAR`, and the index of each one's triangle.

    Args:
        corners: Corners in a camera's axes: right, up, ahead [m] (n, 3, 3).
        number: Indices of the triangles (n,).
    """
    ahead = corners[..., 2] > NEAR
    many = ahead.sum(1)
    whole = many == 3
    parts, numbers = [corners[whole]], [number[whole]]
    for inside in (1, 2):
        some = np.flatnonzero(many == inside)
        lone = ahead[some] if inside == 1 else ~ahead[some]
        order = (np.argmax(lone, 1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(corners[some], order[..., None], 1), 1, 0)
        on_b, on_c = _cut(a, b), _cut(a, c)
        if inside == 1:
            parts.append(np.stack([a, on_b, on_c], 1))
        else:
            parts += [np.stack([on_b, b, c], 1), np.stack([on_b, c, on_c], 1)]
            numbers.append(number[some])
        numbers.append(number[some])
    return np.concatenate(parts), np.concatenate(numbers)


def _cut(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the points of segments (n, 3) at the distance `NEAR`."""
    share = (NEAR - one[:, 2]) / (other[:, 2] - one[:, 2])
    return one + share[:, None] * (other - one)
