"""Pictures of an environment's worlds from above, rendered without a display."""

import math
from typing import TYPE_CHECKING

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sensors.cameras.picture import Viewpoint, pinhole_viewpoint

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env, EnvState

RENDER_MODES = ("rgb_array",)
WIDTH, HEIGHT = 320, 240
"""Size of a picture [pixels]."""
FOV = 1.0
"""Horizontal field of view [rad]."""
MARGIN = 1.1
"""Factor on the arena's extent within a picture."""


def check_render_mode(mode: str | None) -> None:
    """Refuse a render mode that no adapter has.

    Raises:
        UsageError: Another mode than None or `rgb_array`.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise UsageError(f"render_mode {mode!r}, expected None or {', '.join(RENDER_MODES)}")


def overhead_viewpoint(arena: ArenaSpec) -> Viewpoint:
    """Return a viewpoint above an arena that sees its whole extent; x of the arena points to the right."""
    (x0, x1), (y0, y1) = arena.extent
    wide = max(x1 - x0, (y1 - y0) * WIDTH / HEIGHT, 1.0)
    height = arena.floor + MARGIN * wide / (2 * math.tan(FOV / 2))
    pos = np.array([(x0 + x1) / 2, (y0 + y1) / 2, height], np.float32)
    # Columns: ahead is down, left is -x, up in the picture is y.
    mat = np.array([[0, -1, 0], [0, 0, 1], [-1, 0, 0]], np.float32)
    return pinhole_viewpoint(pos, mat, FOV)


def picture_of(env: "Env", state: "EnvState", world: int = 0) -> np.ndarray:
    """Return a picture of a world from above, uint8 (height, width, 3)."""
    viewpoint = overhead_viewpoint(env.batch.arena_of(state.batch, world))
    return np.asarray(env.batch.render_view(state.batch, world, viewpoint, WIDTH, HEIGHT).rgb)
