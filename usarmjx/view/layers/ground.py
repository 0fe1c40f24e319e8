"""What lies on the floor: a grid that gives the scale, and RFID tags."""

import math

import numpy as np

from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.nodes import UPRIGHT, InstanceNode, NodeLayer

CELL = 1.2
"""Side of a cell of the grid: the side of an element that USARSim's arenas are built of [m]."""
CELLS_OF_SECTION = 5
"""So many cells a line is stronger."""
WIDE = 60.0
"""In arenas of more than this along a side only the stronger lines are drawn [m]: the others would melt into
one grey."""
LIFT, LIFT_SHARE = 0.008, 4e-4
"""What lies on the floor is drawn so far above it [m], in large arenas by a share of their size: else both
would flicker through each other."""
TAG_RADIUS, TAG_HEIGHT, TAG_SIDES = 0.09, 0.02, 20
TAG_RGB, DROPPED_RGB = (255, 196, 0), (255, 110, 0)
TAG_TEXT_HEIGHT = 0.22
"""Of the numbers over tags [m]."""


class GridLayer(NodeLayer):
    """A grid on the floor."""

    name = "Grid"
    about = "a grid of 1.2 m on the floor, each fifth line stronger"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Lay it below all that is worth seeing, its lines where the arena's elements meet."""
        low, high = np.asarray(drawing.extent, float).T
        cell = CELL if (high - low).max() <= WIDE else CELL * CELLS_OF_SECTION
        cells = np.ceil((high - low) / cell - 1e-6) + 2
        width, height = (cells * cell).tolist()
        x, y = (low + cell * (cells / 2 - 1)).tolist()
        size = math.hypot(width, height)
        self.scene.add_grid(
            f"{self.root}/lines",
            width,
            height,
            cell_size=cell,
            section_size=cell * CELLS_OF_SECTION,
            cell_color=(120, 112, 100),
            section_color=(84, 76, 66),
            cell_thickness=0.8,
            section_thickness=1.2,
            fade_distance=4 * size,
            fade_strength=1.0,
            shadow_opacity=0.0,
            position=(x, y, drawing.floor + max(LIFT, LIFT_SHARE * size)),
        )

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """It stays as it is."""
        del drawing, frame


def disc() -> tuple[np.ndarray, np.ndarray]:
    """Return corners (corners, 3) and triangles (triangles, 3) of a flat disc that stands on z = 0."""
    around = 2 * math.pi * np.arange(TAG_SIDES) / TAG_SIDES
    circle = TAG_RADIUS * np.stack([np.cos(around), np.sin(around)], -1)
    top = np.column_stack([circle, np.full(TAG_SIDES, TAG_HEIGHT)])
    bottom = np.column_stack([circle, np.zeros(TAG_SIDES)])
    this = np.arange(TAG_SIDES)
    following = (this + 1) % TAG_SIDES
    middle = np.array([[0.0, 0.0, TAG_HEIGHT]])
    faces = [
        np.stack([this, following, np.full(TAG_SIDES, 2 * TAG_SIDES)], -1),
        np.stack([this, TAG_SIDES + this, following], -1),
        np.stack([following, TAG_SIDES + this, TAG_SIDES + following], -1),
    ]
    return np.concatenate([top, bottom, middle]), np.concatenate(faces)


class TagLayer(NodeLayer):
    """RFID tags with their numbers, and those that robots dropped."""

    name = "Tags"
    about = "RFID tags with their numbers, and those that robots have dropped"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Draw the arena's tags."""
        for place, tag in enumerate(drawing.tags):
            self.scene.add_label(
                f"{self.root}/number{place}",
                str(tag.number),
                position=tuple(np.add(tag.pos, (0.0, 0.0, TAG_TEXT_HEIGHT))),
                anchor="bottom-center",
                font_size_mode="scene",
                font_scene_height=TAG_TEXT_HEIGHT,
                depth_test=True,
            )
        self._discs = InstanceNode(self.scene, f"{self.root}/discs", disc())
        self._dropped: np.ndarray | None = None
        self._fixed = np.array([tag.pos for tag in drawing.tags], np.float32).reshape(-1, 3)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show what was dropped too."""
        del drawing
        dropped = np.asarray(frame.dropped_tags, np.float32).reshape(-1, 3)
        if self._dropped is not None and np.array_equal(dropped, self._dropped):
            return
        self._dropped = dropped
        pos = np.concatenate([self._fixed, dropped])
        rgb = np.repeat([TAG_RGB, DROPPED_RGB], [len(self._fixed), len(dropped)], axis=0)
        self._discs.set(pos, np.tile(UPRIGHT, (len(pos), 1)), np.ones(len(pos)), rgb)
