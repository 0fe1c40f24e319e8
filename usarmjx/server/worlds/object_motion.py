"""Motion of a loose object along waypoints, and its rotation: what a world controller sets in motion.

An object that moves is put at a pose, at rest, in every control step: it pushes what is in its way, and
nothing stops it.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import angles_from_mat, quat_from_angles

MAX_POINTS = 1000
"""Largest number of waypoints of an object."""


@dataclass
class ObjectMotion:
    """Motion of an object, in our axes.

    Attributes:
        points: Waypoints [m] (points, 3).
        speed: Speed along them [m/s].
        loops: Whether the path leads from the last point to the first, without end.
        aligned: Whether the object's x axis points along its path.
        moving: Whether it moves; else it is where physics takes it.
        resets: Whether it returns to its first pose when the points are cleared.
        progress: Length of the path behind it [m].
        spin: Changes of roll, pitch and yaw [rad/s] (3,).
        angles: Roll, pitch and yaw while it rotates [rad] (3,).
    """

    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    speed: float = 0.0
    loops: bool = False
    aligned: bool = False
    moving: bool = True
    resets: bool = True
    progress: float = 0.0
    spin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    angles: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def _segments(self) -> np.ndarray:
        """Vectors from each point to the next one on the path [m] (segments, 3)."""
        # The last of them leads back to the first point, and closes the path.
        following = np.roll(self.points, -1, axis=0) - self.points
        return following if self.loops else following[:-1]

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(np.linalg.norm(self._segments, axis=1).sum())

    @property
    def is_under_way(self) -> bool:
        """Whether it is moving along its points."""
        return self.moving and self.speed > 0 and self.length > 0

    def place(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Return position [m] (3,) and the vector of the present segment [m] (3,); None: there is none."""
        segments = self._segments
        lengths = np.linalg.norm(segments, axis=1)
        behind = 0.0
        # Two equal waypoints make a segment of no length, which has no direction.
        for index in np.flatnonzero(lengths):
            share = (self.progress - behind) / lengths[index]
            behind += lengths[index]
            # Closeness at the end: a sum of lengths may miss the whole by its last digit.
            if share < 1 or math.isclose(behind, lengths.sum()):
                return self.points[index] + min(share, 1.0) * segments[index], segments[index]
        # All waypoints are one point, from which no direction follows.
        return self.points[0], None

    def advance(self, pose: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Advance by a control step; return position [m] (3,) and orientation (4,), None: physics moves it.

        Args:
            pose: Present position and orientation (7,).
            period: Length of the step [s].
        """
        is_rotating, is_under_way = bool(self.spin.any()), self.is_under_way
        if not is_rotating and not is_under_way:
            return None
        pos, quat = pose[:3], pose[3:]
        if is_rotating:
            # Angles are added up: the spin changes roll, pitch and yaw, and is no turn about axes of the
            # body.
            self.angles = self.angles + self.spin * period
            quat = np.asarray(quat_from_angles(*self.angles.tolist()))
        if is_under_way:
            self._proceed(self.speed * period)
            pos, along = self.place()
            if self.aligned and along is not None:
                quat = np.asarray(quat_from_angles(*angles_along(along).tolist()))
        return pos, quat

    def _proceed(self, distance: float) -> None:
        """Advance along the path; an open one ends at its last point."""
        self.progress += distance
        if self.progress >= self.length:
            self.moving = self.loops
            self.progress = self.progress % self.length if self.loops else self.length


def angles_along(vector: np.ndarray) -> np.ndarray:
    """Return roll, pitch and yaw of an object that points along a vector (3,) [rad] (3,)."""
    x, y, z = vector
    # With y to the left, a positive pitch lowers the front.
    return np.array([0.0, -math.atan2(z, math.hypot(x, y)), math.atan2(y, x)])


def angles_of(quat: np.ndarray) -> np.ndarray:
    """Return roll, pitch and yaw of an orientation (4,) [rad] (3,)."""
    with numpy_backend():
        return np.asarray(angles_from_mat(np.asarray(mat_from_quat(quat), float)))
