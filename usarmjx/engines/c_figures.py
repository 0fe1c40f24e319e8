"""Figures (`models.build.figures`) in a world of C MuJoCo, and how rays of cameras are cast at them."""

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from usarmjx.engines.c_rays import MARGIN, MIN_COSINE, CRayCaster
from usarmjx.models.build.figures import Figure
from usarmjx.models.spec.shapes import OPAQUE
from usarmjx.sensors.rays.raycast import RayQuery

BUNDLE_SIZE = 512
"""Rays that are cast together at what comes near their cone."""
NOBODY = -1
"""Slot of what is no robot."""


@dataclass(frozen=True, eq=False)
class WornFigure:
    """A figure, and what it follows.

    Attributes:
        figure: What is drawn.
        frames: Ids of the model's bodies (or geoms) that its frames are (frames,).
        of_geoms: Whether they are geoms: victims' boxes.
        label: What it is in a segmentation, see `cameras.paint`.
        slot: The robot's slot; `NOBODY`: it is no robot.
    """

    figure: Figure
    frames: np.ndarray
    of_geoms: bool
    label: int
    slot: int = NOBODY

    def posed(self, data: mujoco.MjData, first: int) -> "CameraTarget":
        """Return it where a world's state has it; its geoms count from `first` among what can be seen."""
        places, turns = (data.geom_xpos, data.geom_xmat) if self.of_geoms else (data.xpos, data.xmat)
        model = self.figure.model.__copy__()  # groups of geoms change while rays are cast
        here = mujoco.MjData(model)
        here.mocap_pos[:] = places[self.frames]
        for quat, mat in zip(here.mocap_quat, turns[self.frames], strict=True):
            mujoco.mju_mat2Quat(quat, mat)
        mujoco.mj_kinematics(model, here)
        caster = CRayCaster(model, here, [OPAQUE] * model.ngeom, {})
        return CameraTarget(caster, here.geom_xpos.copy(), model.geom_rbound + MARGIN, first, self.slot)


class Bundles(NamedTuple):
    """Rays from one point, in bundles of some after the other, each in a cone.

    Attributes:
        start: The point [m] (3,).
        bounds: The first ray of each bundle, and how many rays there are (ends,).
        axis: Unit vectors along the cones (bundles, 3).
        cosine: Of the angle between a cone's axis and its side (bundles, 1).
        sine: Of that angle (bundles, 1).
    """

    start: np.ndarray
    bounds: np.ndarray
    axis: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray

    @classmethod
    def of(cls, start: np.ndarray, along: np.ndarray) -> "Bundles":
        """Return the bundles of unit vectors (rays, 3) from a point (3,)."""
        bounds = np.append(np.arange(0, len(along), BUNDLE_SIZE), len(along))
        axis = np.add.reduceat(along, bounds[:-1])
        axis /= np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-9)
        ahead = (along * axis.repeat(np.diff(bounds), 0)).sum(-1)
        cosine = np.minimum.reduceat(ahead, bounds[:-1])[:, None]
        return cls(start, bounds, axis, cosine, np.sqrt(np.maximum(1 - cosine * cosine, 0.0)))

    def near(self, centre: np.ndarray, radius: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Return which cones meet which balls within their reach [m] (bundles,): (bundles, balls)."""
        way = centre - self.start
        square = (way * way).sum(-1)
        ahead = self.axis @ way.T
        aside = np.sqrt(np.maximum(square - ahead * ahead, 0.0))
        outside = (aside * self.cosine - ahead * self.sine > radius) & (self.cosine > MIN_COSINE)
        return ~outside & (np.sqrt(square) - radius <= reach[:, None])


class CameraTarget:
    """Something that rays of cameras are cast at, as far as they come near it.

    Args:
        caster: Casts rays at it.
        centre: Middles of balls about its geoms [m] (geoms, 3).
        radius: Their radii; infinite for what has no end [m] (geoms,).
        first: Place of its first geom among all that can be seen.
        slot: Slot of the robot that it is, or `NOBODY`.
    """

    def __init__(
        self, caster: CRayCaster, centre: np.ndarray, radius: np.ndarray, first: int, slot: int = NOBODY
    ) -> None:
        self._caster, self._centre, self._radius, self._first, self.slot = caster, centre, radius, first, slot
        self._middle = (centre.min(0) + centre.max(0))[None] / 2
        self._ball = (np.linalg.norm(centre - self._middle, axis=-1) + radius).max(keepdims=True)

    def closer(
        self,
        bundles: Bundles,
        along: np.ndarray,
        query: RayQuery,
        hidden: np.ndarray,
        met: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        """Replace what rays met by this where it is closer.

        Args:
            bundles: The rays.
            along: Unit vectors (rays, 3).
            query: What they pass.
            hidden: Geoms of it that they pass too (n,).
            met: Distances [m] (rays,), normals (rays, 3) and geoms (rays,); changed in place.
        """
        reach = np.maximum.reduceat(met[0], bundles.bounds[:-1])
        if not bundles.near(self._middle, self._ball, reach).any():
            return
        shown = bundles.near(self._centre, self._radius, reach)
        shown[:, hidden] = False
        for number in np.flatnonzero(shown.any(1)).tolist():
            rays = slice(bundles.bounds[number], bundles.bounds[number + 1])
            start = np.broadcast_to(bundles.start, along[rays].shape)
            found = self._caster.meet(start, along[rays], query, np.flatnonzero(~shown[number]))
            self._keep(rays, found, met)

    def closer_one_by_one(
        self,
        start: np.ndarray,
        along: np.ndarray,
        query: RayQuery,
        met: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        """As `closer`, for rays that start anywhere (rays, 3)."""
        way = self._middle - start
        ahead, square = (along * way).sum(-1), (way * way).sum(-1)
        aside = np.sqrt(np.maximum(square - ahead * ahead, 0.0))
        rays = np.flatnonzero((aside <= self._ball) & (ahead + self._ball >= 0))
        if len(rays):
            found = self._caster.meet(start[rays], along[rays], query, np.zeros(0, int))
            self._keep(rays, found, met)

    def _keep(
        self,
        rays: slice | np.ndarray,
        found: tuple[np.ndarray, np.ndarray, np.ndarray],
        met: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        """Put what some rays found in its place, where it is closer than what they met before."""
        better = found[0] < met[0][rays]
        places = np.arange(len(met[0]))[rays][better]
        for column, own in zip(met, found, strict=True):
            column[places] = own[better]
        met[2][places] += self._first
