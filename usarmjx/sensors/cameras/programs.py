"""Programs that render pictures, compiled in the background: nobody waits for one."""

import logging
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import numpy as np

from usarmjx.sensors.cameras.paint import GeomAppearance
from usarmjx.sensors.cameras.picture import Picture, Viewpoint, render_picture_jit
from usarmjx.sensors.cameras.shading import Headlights, RenderScene
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, GeomBlock

SPARE = 8
"""For so many more there is always room when a capacity is chosen."""
SPARE_COMPACT = 40
"""Likewise for the compact geoms of a kind, which robots are drawn as: for one more P2AT, which has 36."""

SpareRoom = dict[tuple[int, str, bool] | str, int]
"""The capacity for geoms of a kind and material, compact or not, and the one for headlights."""
HEADLIGHTS = "headlights"


def capacity(count: int, spare: int = SPARE) -> int:
    """Return for how many to make room: a power of two, with some to spare."""
    return 1 << (count + spare - 1).bit_length()


def with_spare_capacity(render_scene: RenderScene, room: SpareRoom | None = None) -> RenderScene:
    """Return a render scene of NumPy arrays, padded by geoms far away and headlights that are off.

    Args:
        render_scene: What there is to see.
        room: The capacities so far, which are kept where they suffice and otherwise changed here.
    """
    room = {} if room is None else room
    geoms = render_scene.geoms
    ends = np.cumsum([len(block.owner) for block in geoms.blocks])
    compact = geoms.compact or (False,) * len(ends)
    blocks: list[GeomBlock] = []
    appearances: list[GeomAppearance] = []
    sorts = zip(geoms.kinds, geoms.materials, compact, strict=True)
    for sort, block, end in zip(sorts, geoms.blocks, ends, strict=True):
        count, (_, _, is_compact) = len(block.owner), sort
        pad = partial(_padded, size=_size(room, sort, count, SPARE_COMPACT if is_compact else SPARE))
        mine = jax.tree.map(lambda x, a=end - count, b=end: x[a:b], render_scene.appearance)
        padded = jax.tree.map(pad, block)
        padded.pos[count:], padded.mat[count:], padded.owner[count:] = PADDING_DISTANCE, np.eye(3), -1
        blocks.append(padded)
        appearances.append(jax.tree.map(pad, mine))
    return render_scene.replace(
        geoms=geoms.replace(blocks=tuple(blocks)),
        appearance=jax.tree.map(lambda *parts: np.concatenate(parts), *appearances),
        headlights=_padded_headlights(render_scene.headlights, room),
    )


def _size(room: SpareRoom, sort: tuple[int, str, bool] | str, count: int, spare: int = SPARE) -> int:
    """Return the capacity for so many of a sort, after making room for them if there is too little."""
    if sort not in room or count > room[sort]:
        room[sort] = capacity(count, spare)
    return room[sort]


def _padded_headlights(headlights: Headlights, room: SpareRoom) -> Headlights:
    return jax.tree.map(lambda x: _padded(x, _size(room, HEADLIGHTS, len(x))), headlights)


def _padded(values: Any, size: int) -> np.ndarray:  # noqa: ANN401 - an array
    """Return an array with zeros (False) behind its rows, up to a size, single precision."""
    values = np.asarray(values)
    single = {"f": np.float32, "i": np.int32, "u": values.dtype, "b": bool}[values.dtype.kind]
    out = np.zeros((size, *values.shape[1:]), single)
    out[: len(values)] = values
    return out


log = logging.getLogger(__name__)

View = tuple[Viewpoint, int, int]
"""From where a picture is taken, its width and its height."""


class PicturePrograms:
    """Knows which pictures can be rendered by a compiled program, and has others compiled, one at a time.

    Args:
        render: Renders a picture, and compiles first if there is no program for it.
    """

    def __init__(
        self, render: Callable[[RenderScene, Viewpoint, int, int], Picture] = render_picture_jit
    ) -> None:
        self._render = render
        self._compiler = ThreadPoolExecutor(1, thread_name_prefix="compiler")
        self._programs: dict[Hashable, Future[Any]] = {}
        self._room: SpareRoom = {}

    @property
    def idle(self) -> bool:
        """Whether nothing is being compiled."""
        return all(program.done() for program in self._programs.values())

    def find(self, render_scene: RenderScene, views: Sequence[View]) -> Callable[[], list[Picture]] | None:
        """Return what renders some pictures; None while programs for them are missing.

        Those are compiled from now on. Robots that come and go need no others, within some limits.

        Args:
            render_scene: What there is to see; NumPy's arrays.
            views: From where.
        """
        padded = with_spare_capacity(render_scene, self._room)
        if not all([self._is_ready(padded, view) for view in views]):
            return None
        return lambda: [jax.device_get(self._render(padded, *view)) for view in views]

    def _is_ready(self, render_scene: RenderScene, view: View) -> bool:
        viewpoint, *size = view
        leaves, tree = jax.tree.flatten((render_scene, viewpoint))
        key = tree, *((np.shape(leaf), np.result_type(leaf)) for leaf in leaves), *size
        if key not in self._programs:
            self._programs[key] = self._compiler.submit(self._compile, render_scene, view)
        program = self._programs[key]
        return program.done() and program.result()

    def _compile(self, render_scene: RenderScene, view: View) -> bool:
        """Render a picture, for the sake of the program; return whether that went well."""
        try:
            jax.block_until_ready(self._render(render_scene, *view))
        except Exception:
            log.exception("no program for pictures could be compiled: they are rendered without one")
            return False
        return True
