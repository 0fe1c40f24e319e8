"""Background compilation of picture programs: no client waits for a compiler."""

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

SPARE_GEOMS = 8
"""Spare capacity beyond a count."""
SPARE_COMPACT_GEOMS = 40
"""Spare capacity for a type's compact geoms, robots' visuals: one more P2AT, which has 36."""

Capacities = dict[tuple[int, str, bool] | str, int]
"""Capacities for geoms by type, material and compactness, and for headlights."""
HEADLIGHTS = "headlights"
"""Key of the capacity for headlights."""
log = logging.getLogger(__name__)
View = tuple[Viewpoint, int, int]
"""Viewpoint, width and height of a picture."""


def capacity(count: int, spare: int = SPARE_GEOMS) -> int:
    """Return the capacity for `count` items: a power of two with some spare."""
    # Powers of two, so that a growing world needs few programs.
    return 1 << (count + spare - 1).bit_length()


def pad_render_scene(render_scene: RenderScene, capacities: Capacities | None = None) -> RenderScene:
    """Pad a render scene of NumPy arrays with geoms far away and headlights that are off.

    Args:
        render_scene: The scene.
        capacities: Current capacities, which are kept if sufficient and otherwise enlarged in place.
    """
    capacities = {} if capacities is None else capacities
    geoms = render_scene.geoms
    ends = np.cumsum([len(block.owner) for block in geoms.blocks])
    compact = geoms.compact or (False,) * len(ends)
    blocks: list[GeomBlock] = []
    appearances: list[GeomAppearance] = []
    sorts = zip(geoms.kinds, geoms.materials, compact, strict=True)
    for sort, block, end in zip(sorts, geoms.blocks, ends, strict=True):
        count, (_, _, is_compact) = len(block.owner), sort
        pad = partial(
            _padded, size=_size(capacities, sort, count, SPARE_COMPACT_GEOMS if is_compact else SPARE_GEOMS)
        )
        # Appearances are in one table, block after block.
        mine = jax.tree.map(lambda x, a=end - count, b=end: x[a:b], render_scene.appearance)
        padded = jax.tree.map(pad, block)
        # Zeros would be a degenerate geom in the middle of the arena.
        padded.pos[count:], padded.mat[count:], padded.owner[count:] = PADDING_DISTANCE, np.eye(3), -1
        blocks.append(padded)
        appearances.append(jax.tree.map(pad, mine))
    return render_scene.replace(
        geoms=geoms.replace(blocks=tuple(blocks)),
        appearance=jax.tree.map(lambda *parts: np.concatenate(parts), *appearances),
        headlights=_padded_headlights(render_scene.headlights, capacities),
    )


def _size(
    capacities: Capacities, sort: tuple[int, str, bool] | str, count: int, spare: int = SPARE_GEOMS
) -> int:
    """Return the capacity for `count` items, enlarged if necessary."""
    if sort not in capacities or count > capacities[sort]:
        capacities[sort] = capacity(count, spare)
    return capacities[sort]


def _padded_headlights(headlights: Headlights, capacities: Capacities) -> Headlights:
    return jax.tree.map(lambda x: _padded(x, _size(capacities, HEADLIGHTS, len(x))), headlights)


def _padded(values: Any, size: int) -> np.ndarray:  # noqa: ANN401 - an array
    """Pad an array with rows of zeros (False) to a size, single precision."""
    values = np.asarray(values)
    # As JAX would convert them: other types would need a program of their own.
    single = {"f": np.float32, "i": np.int32, "u": values.dtype, "b": bool}[values.dtype.kind]
    out = np.zeros((size, *values.shape[1:]), single)
    out[: len(values)] = values
    return out


class PicturePrograms:
    """Compiled picture programs; missing ones are compiled one at a time in a background thread.

    Args:
        render: Renders a picture, and compiles first if necessary.
    """

    def __init__(
        self, render: Callable[[RenderScene, Viewpoint, int, int], Picture] = render_picture_jit
    ) -> None:
        self._render = render
        # One thread: compilations would share the cores with the world that is served.
        self._compiler = ThreadPoolExecutor(1, thread_name_prefix="compiler")
        self._programs: dict[Hashable, Future[Any]] = {}
        self._room: Capacities = {}

    @property
    def idle(self) -> bool:
        """Whether no compilation is running."""
        return all(program.done() for program in self._programs.values())

    def find(self, render_scene: RenderScene, views: Sequence[View]) -> Callable[[], list[Picture]] | None:
        """Return a function that renders some pictures; None while their programs are missing.

        Missing programs are compiled from now on. Robots may join and leave within the spare capacity without
        new programs.

        Args:
            render_scene: The scene, in NumPy arrays.
            views: The pictures.
        """
        padded = pad_render_scene(render_scene, self._room)
        # A list: on a generator `all` would stop at the first one, and compile the others later.
        if not all([self._is_ready(padded, view) for view in views]):
            return None
        return lambda: [jax.device_get(self._render(padded, *view)) for view in views]

    def _is_ready(self, render_scene: RenderScene, view: View) -> bool:
        viewpoint, *size = view
        leaves, tree = jax.tree.flatten((render_scene, viewpoint))
        # The same key by which `jax.jit` finds a program: structure, shapes, types and static size.
        key = tree, *((np.shape(leaf), np.result_type(leaf)) for leaf in leaves), *size
        if key not in self._programs:
            self._programs[key] = self._compiler.submit(self._compile, render_scene, view)
        program = self._programs[key]
        # A program that failed stays False: it is not compiled again for each picture.
        return program.done() and program.result()

    def _compile(self, render_scene: RenderScene, view: View) -> bool:
        """Render a picture in order to compile its program; return whether that succeeded."""
        try:
            jax.block_until_ready(self._render(render_scene, *view))
        except Exception:
            log.exception("no program for pictures could be compiled: they are rendered without one")
            return False
        return True
