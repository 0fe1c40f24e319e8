"""Programs that render pictures, compiled in the background: nobody waits for one."""

import logging
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from usarmjx.cameras.padding import SpareRoom, with_spare_capacity
from usarmjx.cameras.picture import Picture, Viewpoint, render_picture_jit
from usarmjx.cameras.shading import RenderScene

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
