"""Common parts of scanners that measure their sweep part by part."""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.rotations import matvec
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.sensors.base import Sensor, SensorInput


@dataclass(frozen=True, eq=False)
class SweptScanner(Sensor):
    """Scanner of a single mount; its memory is the number of the next part of its sweep."""

    steers_rays = True

    @property
    def max_distance(self) -> float:
        """MaxRange [m]."""
        return self.settings[0].max_range

    @abstractmethod
    def directions(self, part: Array) -> Array:
        """Return the unit directions of a part (...) of the sweep, in the mount's axes (..., rays, 3)."""

    def rays(self, bodies: BodyPoses) -> tuple[Array, Array]:
        """Return the beams of the first part."""
        return self.steered_rays(bodies, np.int32(0))

    def steered_rays(self, bodies: BodyPoses, memory: Array | np.int32) -> tuple[Array, Array]:
        """Return the beams of the next part."""
        pos, mat = self.mount_poses(bodies)
        along = matvec(mat[0], self.directions(xp.asarray(memory)))
        return xp.broadcast_to(pos[0], along.shape), along

    def init_memory(self, inputs: SensorInput, key: Array) -> Array:
        """Begin with the first part."""
        del key
        return xp.zeros_like(xp.asarray(inputs.clock.step, xp.int32))
