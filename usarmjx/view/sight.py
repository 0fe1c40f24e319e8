"""What stands between a robot and who looks at it from over it."""

import mujoco
import numpy as np

from usarmjx.view.drawing import NOBODY, Drawing

BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
SEEN_THROUGH = 0.5
"""Of what lets more light through one sees enough."""


class Walls:
    """The solid boxes of a drawing that stay where they are.

    Args:
        drawing: The drawing.
    """

    def __init__(self, drawing: Drawing) -> None:
        still = [body.shape for body in drawing.bodies if body.slot == NOBODY and body.name == "arena"]
        shapes = [drawing.shapes[name] for name in still]
        kept = [(shape.kind == BOX) & (shape.transparency < SEEN_THROUGH) for shape in shapes]
        pairs = [*zip(shapes, kept, strict=True)]
        self._pos = np.concatenate([np.zeros((0, 3)), *(shape.pos[one] for shape, one in pairs)])
        self._mat = np.concatenate([np.zeros((0, 3, 3)), *(shape.mat[one] for shape, one in pairs)])
        self._size = np.concatenate([np.zeros((0, 3)), *(shape.size[one] for shape, one in pairs)])

    def hide(self, start: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return which places cannot be seen from another (places,).

        Args:
            start: From where [m] (3,).
            ends: The places [m] (places, 3).
        """
        if not len(self._pos):
            return np.zeros(len(ends), bool)
        begin = np.einsum("bj,bji->bi", start - self._pos, self._mat)
        along = np.einsum("ej,bji->ebi", ends - start, self._mat)
        along = np.where(np.abs(along) < 1e-9, 1e-9, along)
        sides = np.sort([(-self._size - begin) / along, (self._size - begin) / along], axis=0)
        enters, leaves = sides[0].max(-1), sides[1].min(-1)
        return ((enters <= leaves) & (enters < 1.0) & (leaves > 0.0)).any(-1)
