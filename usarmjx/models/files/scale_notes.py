"""Doubts about the scale of an arena from a file: millimetres that were taken for metres, and the reverse."""

from pathlib import Path

import numpy as np

from usarmjx.models.compile.reachability import shapes_in_arena
from usarmjx.models.files.content import corners_of
from usarmjx.models.types.arena import ArenaSpec

MAX_SPAN, MIN_SPAN = 200.0, 0.05
"""Lengths of an arena outside which its scale is doubted [m]."""
SCALES = (0.001, 0.01, 0.0254, 0.3048)
"""Factors to metres that are proposed: of millimetres, centimetres, inches, feet."""
LEAST_SPAN, GOOD_SPAN = 0.3, 100.0
"""Lengths of an arena between which a factor is proposed [m]."""
LARGEST_SCALE = 1000.0
"""Factor that is proposed for an arena that is too small: it was scaled to metres twice."""
REMEDIES = {
    **dict.fromkeys((".obj", ".stl", ".dae"), "load it with meshes: [{{file: {name}, scale: {scale:g}}}]"),
    ".map": "load it with moving_ai: {{file: {name}, cell: {cell:.3g}}}",
    ".scen": "load it with moving_ai: {{file: {name}, cell: {cell:.3g}}}",
    ".rndf": "",
}
"""Lines to write for a file of a suffix; empty: such files are large."""


def scale_notes(arena: ArenaSpec, path: Path) -> tuple[str, ...]:
    """Return a doubt about an arena's scale, with a proposal; empty: its size is plausible.

    Args:
        arena: The arena.
        path: Its file.
    """
    shapes = [*arena.shapes, *(shape for one in arena.loose for shape in shapes_in_arena(one))]
    if not shapes or arena.gps is not None:
        return ()
    corners = np.concatenate([corners_of(shape) for shape in shapes])
    size = corners.max(0) - corners.min(0)
    span = float(size.max())
    if MIN_SPAN <= span <= MAX_SPAN:
        return ()
    remedy = REMEDIES.get(
        path.suffix.lower(), "mind the units of its file; meshes have a `scale`, as {scale:g}"
    )
    scale = (
        LARGEST_SCALE
        if span < MIN_SPAN
        else next((s for s in SCALES if LEAST_SPAN <= s * span <= GOOD_SPAN), 0.001)
    )
    said = remedy.format(name=path.name, scale=scale, cell=GOOD_SPAN / span)
    if not said:
        return ()
    limit = f"over {MAX_SPAN:g} m" if span > MAX_SPAN else f"under {100 * MIN_SPAN:g} cm"
    shown = " x ".join(f"{length:.4g}" for length in size.tolist())
    return (f"{path}: its solids span {shown} m, {limit}: if its unit is not the metre, {said}",)
