"""Plots of what cameras see, for docs/sensors.md."""

import math
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from usarmjx.cameras.paint import (
    ARENA_LABEL,
    DOOR_LABEL,
    FALSE_ALARM_LABEL,
    LOOSE_LABEL,
    OUTSIDE_LABEL,
    ROBOT_LABEL,
    SKY_LABEL,
    VICTIM_LABEL,
    WATER_LABEL,
)
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.shapes import Shape
from usarmjx.plots.sensor_plots import PLOTS
from usarmjx.plots.sensor_studies import camera_study

BEFORE_SITTING_VICTIM = ((9.9, 2.55), math.radians(4))
BEFORE_LYING_VICTIM = ((2.1, 2.85), math.radians(185))
"""Where in the yellow arena pictures are taken: before a victim that sits, and one that lies."""
LABELS: dict[int, tuple[str, str]] = {
    OUTSIDE_LABEL: ("outside", "#000000"),
    SKY_LABEL: ("sky", "#bcd9ee"),
    ARENA_LABEL: ("arena", "#cdbf9f"),
    LOOSE_LABEL: ("loose object", "#e07b39"),
    DOOR_LABEL: ("door", "#7a4a1e"),
    VICTIM_LABEL: ("victim", "#c4122f"),
    FALSE_ALARM_LABEL: ("false alarm", "#e58fa0"),
    WATER_LABEL: ("water", "#4080a5"),
    ROBOT_LABEL: ("the robot", "#1f5fa8"),
}
"""What pixels show, by label, and the colour of each here; further robots are as the first."""


def label_indices(segmentation: np.ndarray) -> np.ndarray:
    """Return labels as indices in `LABELS`; all robots count as one."""
    return np.searchsorted(list(LABELS), np.minimum(segmentation, ROBOT_LABEL))


def _image(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_anchor("N")
    axes.set_axis_off()


def _camera(figure: Figure) -> None:
    seen = camera_study(ARENAS.get("yellow"), *BEFORE_SITTING_VICTIM, "P2AT", 320, 240)
    rgb, depth, labels = figure.subplots(1, 3)
    rgb.imshow(seen.rgb)
    _image(rgb, "RGB")
    drawn = depth.imshow(np.where(np.isfinite(seen.depth), seen.depth, np.nan), cmap="viridis_r")
    figure.colorbar(drawn, ax=depth, label="depth [m]", orientation="horizontal", shrink=0.8, pad=0.04)
    _image(depth, "depth")
    numbers = label_indices(np.asarray(seen.segmentation))
    palette = ListedColormap([colour for _, colour in LABELS.values()])
    bounds = BoundaryNorm(np.arange(len(LABELS) + 1) - 0.5, len(LABELS))
    labels.imshow(numbers, cmap=palette, norm=bounds, interpolation="nearest")
    _image(labels, "segmentation")
    names = [list(LABELS.values())[number] for number in np.unique(numbers)]
    keys = [Patch(color=colour, label=name) for name, colour in names]
    labels.legend(handles=keys, loc="upper center", bbox_to_anchor=(0.5, -0.04), ncols=4, frameon=False)


def _stereo(figure: Figure) -> None:
    for i, (side, axes) in enumerate(zip(("left", "right"), figure.subplots(1, 2), strict=True)):
        seen = camera_study(ARENAS.get("yellow"), *BEFORE_SITTING_VICTIM, "StereoP2AT", 320, 240, camera=i)
        axes.imshow(seen.rgb)
        _image(axes, f"{side}: {ROBOTS.get('StereoP2AT').cameras[i].name}")


def _omni(figure: Figure) -> None:
    seen = camera_study(ARENAS.get("yellow"), *BEFORE_LYING_VICTIM, "OmniP2AT", 420, 420)
    axes = figure.add_subplot()
    axes.imshow(seen.rgb)
    axes.set_axis_off()


def _textures(figure: Figure) -> None:
    seen = camera_study(texture_wall(), (0.0, 0.0), math.pi, "P2AT", 640, 300)
    axes = figure.add_subplot()
    axes.imshow(seen.rgb)
    axes.set_axis_off()


def texture_wall() -> ArenaSpec:
    """Return an arena with a wall behind the origin, in the sun, that shows all textures, four to a row."""
    names, shapes = (
        ("brick", "wood", "concrete", "tiles", "chart:1", "hazmat:3", "tag:7", "tag:0"),
        list[Shape](),
    )
    for place, name in enumerate(names):
        row, column = divmod(place, 4)
        colour = (0.75, 0.5, 0.35, 1.0) if place < 2 else (0.75, 0.75, 0.75, 1.0)
        at = (-3.0, 0.81 * (2 * column / 3 - 1), 0.86 - 0.54 * row)
        like = Shape(kind="box", size=(0.1, 0.25, 0.25), at=at, surface="wall", rgba=colour)
        shapes.append(replace(like, texture=name))
    return ArenaSpec(name="DM-Textures", shapes=tuple(shapes), starts=(), extent=((-4.0, 1.0), (-2.0, 2.0)))


PLOTS.add("camera", (_camera, (10.5, 4.1)))
PLOTS.add("stereo", (_stereo, (8.4, 3.4)))
PLOTS.add("omni", (_omni, (4.6, 4.6)))
PLOTS.add("textures", (_textures, (6.4, 3.0)))
