"""Boxes whose sizes differ between worlds, in pieces: for an engine to which a long one is near everything.

Where all worlds share an arena, `compose_arena.split_long_boxes` cuts it once; here the cuts are data too.
"""

import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.rotations import mat_from_quat
from usarmjx.engines.base import GeomPoses
from usarmjx.models.build.moved import MovedGeoms


class ShortBoxes:
    """Each box as a fixed number of pieces along its longest axis, which may be another in each world.

    Args:
        moved_geoms: The boxes.
        max_length: A box that is longer in no world than this [m] stays whole.

    Attributes:
        moved_geoms: The pieces.
    """

    def __init__(self, moved_geoms: MovedGeoms, max_length: float) -> None:
        counts = np.maximum(1, np.ceil(2 * moved_geoms.max_half_length / max_length - 1e-6)).astype(int)
        self._whole = moved_geoms.names
        self._counts = counts
        self._owner = np.repeat(np.arange(len(counts)), counts)
        piece_indices: list[np.ndarray] = [np.arange(int(count)) for count in counts]
        self._piece_index: np.ndarray = np.concatenate(piece_indices)
        whole = moved_geoms.names
        names = [f"{whole[o]}/{k}" if counts[o] > 1 else whole[o] for o, k in self._pairs()]
        self.moved_geoms = MovedGeoms(
            names=tuple(names),
            max_half_length=(moved_geoms.max_half_length / counts)[self._owner],
            resized=True,
        )

    def _pairs(self) -> list[tuple[int, int]]:
        return list(zip(self._owner.tolist(), self._piece_index.tolist(), strict=True))

    def compile(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Return the model with the pieces in place of the boxes."""
        spec = spec.copy()
        arena = spec.body("arena")
        assert arena is not None
        kept = (
            "type", "size", "pos", "quat", "rgba", "friction", "priority", "contype", "conaffinity", "condim",
            "mass", "solref", "solimp",
        )  # fmt: skip
        for name, count in zip(self._whole, self._counts.tolist(), strict=True):
            if count > 1:
                geom = spec.geom(name)
                shared = {key: getattr(geom, key) for key in kept}
                for k in range(count):
                    arena.add_geom(name=f"{name}/{k}", **shared)
                spec.delete(geom)
        return spec.compile()

    def split_poses(self, poses: GeomPoses) -> GeomPoses:
        """Return the poses and sizes of the pieces."""
        assert poses.size is not None
        size, quat = poses.size[:, self._owner], poses.quat[:, self._owner]
        count = self._counts[self._owner, None]
        along = jnp.arange(3) == jnp.argmax(size, -1, keepdims=True)
        shift = (2 * (self._piece_index[:, None] + 0.5) / count - 1) * size * along
        # An overload of einsum leaves its arguments open.
        turned = jnp.einsum("...ij,...j->...i", mat_from_quat(quat), shift)  # pyright: ignore[reportUnknownMemberType]
        pos = poses.pos[:, self._owner] + turned
        return GeomPoses(pos=pos, quat=quat, size=jnp.where(along, size / count, size))
