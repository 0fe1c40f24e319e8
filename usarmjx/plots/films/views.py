"""Views of films: a camera in perspective, and parallel light for shadows, as projections of triangles."""

import math
from dataclasses import dataclass, replace

import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.plots.films.raster import Canvas, clip_near
from usarmjx.view.viewpoint import FOV, CameraPose


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
        return cls((low + high) / 2, axes, side / (2 * radius), side, 10 * radius)

    def draw(self, canvas: Canvas, corners: np.ndarray, number: np.ndarray) -> None:
        """Draw triangles (n, 3, 3) with their indices (n,); the nearness is `reach` minus the depth."""
        local = (corners - self.middle) @ self.axes
        xy = self.side / 2 + local[..., :2] * (self.scale, -self.scale)
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
        right, up, ahead = view.axes.T @ self.axes
        start = (view.eye - self.middle) @ self.axes
        nearness = canvas.surface().nearness.reshape(view.height, view.width)
        x = (np.arange(view.width) + 0.5 - view.width / 2) / view.focal
        rows = found.reshape(view.height, view.width)
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
