"""Render scenes with capacity to spare: robots that come and go do not change the shapes of arrays.

Programs that render pictures are compiled for the shapes of what is to be seen; with these they are compiled
again only when the capacity no longer suffices, which doubles each time.
"""

from typing import Any

import jax
import numpy as np

from usarmjx.cameras.light import Headlights
from usarmjx.cameras.paint import GeomAppearance
from usarmjx.cameras.shading import RenderScene
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, GeomBlock

SPARE = 8
"""For so many more there is always room."""


def capacity(count: int) -> int:
    """Return for how many to make room: a power of two, with some to spare."""
    return max(SPARE, 1 << (count + SPARE - 1).bit_length())


def with_spare_capacity(render_scene: RenderScene) -> RenderScene:
    """Return a render scene of NumPy arrays, padded by geoms far away and headlights that are off."""
    ends = np.cumsum([len(block.owner) for block in render_scene.geoms.blocks])
    blocks: list[GeomBlock] = []
    appearances: list[GeomAppearance] = []
    for block, end in zip(render_scene.geoms.blocks, ends, strict=True):
        count = len(block.owner)
        mine = jax.tree.map(lambda x, a=end - count, b=end: x[a:b], render_scene.appearance)
        padded = jax.tree.map(_padded, block)
        padded.pos[count:], padded.mat[count:], padded.owner[count:] = PADDING_DISTANCE, np.eye(3), -1
        blocks.append(padded)
        appearances.append(jax.tree.map(_padded, mine))
    return render_scene.replace(
        geoms=render_scene.geoms.replace(blocks=tuple(blocks)),
        appearance=jax.tree.map(lambda *parts: np.concatenate(parts), *appearances),
        headlights=_padded_headlights(render_scene.headlights),
    )


def _padded_headlights(headlights: Headlights) -> Headlights:
    return jax.tree.map(_padded, headlights)


def _padded(values: Any) -> np.ndarray:  # noqa: ANN401 - an array
    """Return an array with zeros (False) behind its rows, single precision."""
    values = np.asarray(values)
    single = {"f": np.float32, "i": np.int32, "u": values.dtype, "b": bool}[values.dtype.kind]
    out = np.zeros((capacity(len(values)), *values.shape[1:]), single)
    out[: len(values)] = values
    return out
