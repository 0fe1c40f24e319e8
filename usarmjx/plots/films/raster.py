"""Rasterizer of triangles on NumPy, the views whose projections it draws, and solids as triangles.

Triangles become rows, rows become fragments, and each fragment competes for its pixel by a key: nearness in
the upper half, its triangle in the lower half. Nearness is positive and affine on the screen: 1 / depth for a
perspective, a constant minus the depth for parallel light.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from flax import struct

from usarmjx.base.backend import Array, numpy_backend
from usarmjx.base.rotations import mat_from_quat
from usarmjx.models.types.shapes import SKY
from usarmjx.sensors.cameras.paint import ARENA_LABEL, MIRROR_REFLECTANCE
from usarmjx.view.drawing import NOBODY, Drawing, DrawnShape, Frame
from usarmjx.view.mesh import BOX, Finish, TriangleMesh, meshes_of, rectangle
from usarmjx.view.viewpoint import FOV, CameraPose

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
        # Little-endian whatever the machine, as `surface` reads the halves of each key by their places.
        self.keys = np.zeros(width * height, "<u8")

    def copy(self) -> "Canvas":
        """Return a canvas with the same content."""
        # Without the constructor, which would fill the keys with zeros first.
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
        # Corners near the picture plane project millions of pixels away, where single precision is too
        # coarse.
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
            # One row at least, however long it is.
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
        # Never 0, which stands for an empty pixel.
        near = np.maximum(rows.base[row] + rows.slope[row] * along.astype(np.float32), np.float32(1e-20))
        # Bits of positive floats sort as the floats do, so one comparison of integers finds the nearest.
        key = near.view(np.uint32).astype(np.uint64)
        key <<= np.uint64(32)
        key |= rows.number[row]
        # Unbuffered: several fragments of one pixel in the same call all compete.
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
    # Rows whose centres lie inside, half open: triangles that share an edge share no pixel.
    top = np.clip(np.ceil(xy[..., 1].min(1) - 0.5), 0, height).astype(int)
    bottom = np.clip(np.ceil(xy[..., 1].max(1) - 0.5), 0, height).astype(int)
    count = np.maximum(bottom - top, 0)
    # Of each row its triangle.
    which = np.repeat(np.arange(len(xy)), count)
    y = top[which] + np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    middle = y + 0.5
    # The screen's sides bound each row, too.
    left, right = np.zeros(len(which)), np.full(len(which), float(width))
    for corner in range(3):
        start, edge = xy[:, corner], xy[:, (corner + 1) % 3] - xy[:, corner]
        # Level edges bound no row; the 1 below only avoids a division by 0.
        level = edge[:, 1] == 0
        slope = edge[:, 0] / np.where(level, 1.0, edge[:, 1])
        x = start[which, 0] + (middle - start[which, 1]) * slope[which]
        # Which side an edge bounds depends on its direction, and on the triangle's orientation.
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
        # Rotated, not mirrored, so that the parts keep the triangle's orientation.
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
    # Never 0 / 0: the two ends lie on different sides of the plane.
    share = (NEAR - one[:, 2]) / (other[:, 2] - one[:, 2])
    return one + share[:, None] * (other - one)


@dataclass(frozen=True, eq=False)
class FilmView:
    """A perspective.

    Attributes:
        eye: Position of the camera [m] (3,).
        axes: Directions right, up and ahead, as columns (3, 3).
        focal: Focal length [pixels].
        width: Pixels along a row.
        height: Rows.
    """

    eye: np.ndarray
    axes: np.ndarray
    focal: float
    width: int
    height: int

    @classmethod
    def of(cls, pose: CameraPose, width: int, height: int) -> "FilmView":
        """Return the view from a pose, with the vertical field of view of the live page."""
        ahead = pose.look_at - pose.pos
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, pose.up)
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(right, ahead), ahead], -1)
        return cls(np.asarray(pose.pos), axes, height / 2 / math.tan(FOV / 2), width, height)

    def enlarged(self, times: int) -> "FilmView":
        """Return the same view with more pixels along each side."""
        return replace(self, focal=self.focal * times, width=self.width * times, height=self.height * times)

    def same_as(self, other: "FilmView | None") -> bool:
        """Return whether it shows the same."""
        return other is not None and bool(
            np.array_equal(self.eye, other.eye) and np.array_equal(self.axes, other.axes)
        )

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points (..., 3) on the screen [pixels] (..., 2), and their depths [m] (...,)."""
        local = (points - self.eye) @ self.axes
        depth = local[..., 2]
        # A point beside the eye is nowhere on the screen, and must not divide by 0.
        scale = self.focal / np.where(np.abs(depth) < 1e-6, 1e-6, depth)
        x = self.width / 2 + local[..., 0] * scale
        return np.stack([x, self.height / 2 - local[..., 1] * scale], -1), depth

    def draw(self, canvas: Canvas, corners: np.ndarray, number: np.ndarray) -> None:
        """Draw triangles (n, 3, 3) with their indices (n,); the nearness is 1 / depth."""
        local, number = clip_near((corners - self.eye) @ self.axes, number)
        scale = self.focal / local[..., 2]
        x, y = self.width / 2 + local[..., 0] * scale, self.height / 2 - local[..., 1] * scale
        canvas.draw(np.stack([x, y], -1), 1 / local[..., 2], number)


class ShadowMap(struct.PyTreeNode, kw_only=True):
    """Solids as seen from the sun: nearness by texel (side * side,), and the map's `SunView` as numbers."""

    nearness: Array
    middle: Array
    axes: Array
    scale: Array
    reach: Array
    side: Array


@dataclass(frozen=True, eq=False)
class SunView:
    """The view of the sun, for its shadows.

    Attributes:
        middle: Point in the middle of the shadow map [m] (3,).
        axes: Directions right, up and away from the sun, as columns (3, 3).
        scale: Texels per metre.
        side: Texels along a side of the map.
        reach: Depths are in -reach to reach [m].
    """

    middle: np.ndarray
    axes: np.ndarray
    scale: float
    side: int
    reach: float

    @classmethod
    def over(cls, low: np.ndarray, high: np.ndarray, sun: np.ndarray, side: int) -> "SunView":
        """Return the view that shows a box between two corners (3,) and (3,) [m]."""
        away = -np.asarray(sun) / np.linalg.norm(sun)
        right = np.cross(away, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(right, away), away], -1)
        radius = float(np.linalg.norm(high - low)) / 2
        # The box's sphere fits into the map from any side; the reach is larger, as robots may
        # be above the box.
        return cls((low + high) / 2, axes, side / (2 * radius), side, 10 * radius)

    def draw(self, canvas: Canvas, corners: np.ndarray, number: np.ndarray) -> None:
        """Draw triangles (n, 3, 3) with their indices (n,); the nearness is `reach` minus the depth."""
        local = (corners - self.middle) @ self.axes
        xy = self.side / 2 + local[..., :2] * (self.scale, -self.scale)
        # Never 0, which stands for an empty texel.
        canvas.draw(xy, np.maximum(self.reach - local[..., 2], 1e-6), number)

    def numbers(self, canvas: Canvas) -> ShadowMap:
        """Return a drawn map for the shader."""
        return ShadowMap(
            nearness=canvas.surface().nearness,
            middle=self.middle.astype(np.float32),
            axes=self.axes.astype(np.float32),
            scale=np.array(self.scale, np.float32),
            reach=np.array(self.reach, np.float32),
            side=np.array(self.side, np.int32),
        )

    def texels(self, view: FilmView, canvas: Canvas) -> np.ndarray:
        """Return the texel of what each pixel of a view shows; one past the last for none (pixels,)."""
        found = np.full(len(canvas.keys), self.side * self.side, np.int32)
        # The view's axes in those of the sun: a pixel's texel needs no way through the world's axes.
        right, up, ahead = view.axes.T @ self.axes
        start = (view.eye - self.middle) @ self.axes
        nearness = canvas.surface().nearness.reshape(view.height, view.width)
        x = (np.arange(view.width) + 0.5 - view.width / 2) / view.focal
        rows = found.reshape(view.height, view.width)
        # Row by row: arrays of all samples of a large picture would take hundreds of megabytes.
        for row in range(view.height):
            y = (view.height / 2 - row - 0.5) / view.focal
            depth = 1 / np.maximum(nearness[row], 1e-9)
            ray = ahead + y * up + x[:, None] * right
            texel = np.floor(
                self.side / 2 + (start + depth[:, None] * ray)[:, :2] * (self.scale, -self.scale)
            )
            inside = (texel >= 0).all(1) & (texel < self.side).all(1) & (nearness[row] > 0)
            rows[row, inside] = (texel[inside, 1] * self.side + texel[inside, 0]).astype(np.int32)
        return found


FLOOR_REACH = 300.0
"""Distance from the arena up to which an unbounded floor is drawn [m]."""
FLOOR_RGB = np.full(3, 0.8)
"""Colour of the floor's triangles, which shading replaces by checkers."""
OVERHEAD = 2.2
"""Height of a solid's underside above the floor, or above robots, from which on it is overhead [m]."""
ROOF_SHARE = 0.5
"""Share of the plan from which on solids overhead are a roof, and are left out."""


@dataclass(frozen=True, eq=False)
class Solids:
    """Triangles of a drawing, in the axes of their bodies.

    Attributes:
        corners: Corners [m] (n, 3, 3).
        normals: Unit normals at the corners (n, 3, 3).
        rgb: Colours (n, 3).
        transparency: Share of light that passes through (n,).
        reflectance: Share of the reflection in the colour (n,).
        label: Labels, see `cameras.paint` (n,).
        body: Index of the body, `NOBODY` for the floor (n,).
        is_floor: Which are the unbounded floor (n,).
        two_sided: Which are visible from behind, too (n,).
    """

    corners: np.ndarray
    normals: np.ndarray
    rgb: np.ndarray
    transparency: np.ndarray
    reflectance: np.ndarray
    label: np.ndarray
    body: np.ndarray
    is_floor: np.ndarray
    two_sided: np.ndarray

    def __len__(self) -> int:
        """Return the number of triangles."""
        return len(self.corners)

    def at(self, frame: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return corners (n, 3, 3), normals (n, 3, 3) and which of them are shown (n,) in a frame."""
        with numpy_backend():
            turns = np.asarray(mat_from_quat(np.asarray(frame.quat, np.float64)))
        # One pose more, that of the floor: its body is -1, which indexes the last one.
        turns = np.concatenate([turns, np.eye(3)[None]])
        places = np.concatenate([frame.pos, np.zeros((1, 3))])
        shown = np.append(frame.shown, True)
        mat = turns[self.body].swapaxes(1, 2)
        corners = self.corners @ mat + places[self.body][:, None]
        return corners, self.normals @ mat, shown[self.body]


def solids_of(drawing: Drawing) -> Solids:
    """Return the triangles of a drawing, without its roof and its sky."""
    parts: list[Solids] = []
    robots_floor = drawing.floor + OVERHEAD
    for index, body in enumerate(drawing.bodies):
        # High parts of robots are no roof.
        shape = _kept(drawing.shapes[body.shape], drawing, robots_floor if body.slot == NOBODY else None)
        parts += [_part(mesh, finish, body.label, index) for finish, mesh in meshes_of(shape).items()]
    if drawing.has_floor:
        low, high = drawing.extent.T
        flat = rectangle(low - FLOOR_REACH, high + FLOOR_REACH, drawing.floor, FLOOR_RGB)
        parts.append(_part(flat, Finish(), ARENA_LABEL, NOBODY, is_floor=True))
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return Solids(*(np.concatenate(column) for column in columns))


def _part(mesh: TriangleMesh, finish: Finish, label: int, body: int, is_floor: bool = False) -> Solids:
    count = len(mesh.faces)
    return Solids(
        # In double precision, as poses and projections follow.
        corners=mesh.vertices[mesh.faces].astype(np.float64),
        normals=mesh.normals[mesh.faces].astype(np.float64),
        # Solids have one colour each, so any corner has that of the triangle.
        rgb=mesh.rgb[mesh.faces[:, 0]].astype(np.float32),
        transparency=np.full(count, 1.0 - finish.opacity, np.float32),
        reflectance=np.full(count, MIRROR_REFLECTANCE * (finish.metallic > 0), np.float32),
        label=np.full(count, label, np.int32),
        body=np.full(count, body),
        is_floor=np.full(count, is_floor),
        two_sided=np.full(count, finish.two_sided or finish.opacity < 1.0),
    )


def _kept(shape: DrawnShape, drawing: Drawing, overhead: float | None) -> DrawnShape:
    """Return a shape without sky, and without the boxes of a roof."""
    kept = np.asarray(shape.material) != SKY
    if overhead is not None:
        boxes = shape.kind == BOX
        half = np.abs(shape.mat) @ shape.size[..., None].astype(float)
        # By the underside, so that high walls that stand on the floor stay.
        above = boxes & (shape.pos[:, 2] - half[:, 2, 0] > overhead) & kept
        area = float((4 * half[above, 0, 0] * half[above, 1, 0]).sum())
        if area > ROOF_SHARE * float(np.prod(np.diff(drawing.extent, axis=1))):
            kept &= ~above
    return DrawnShape(**{name: value[kept] for name, value in vars(shape).items()})
