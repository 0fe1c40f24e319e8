"""Marks: grid, tags, names and rings of robots, traces and hits."""

import math
from collections.abc import Sequence

import numpy as np
import viser

from usarmjx.sensors.sketch import OverlayLines
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.base import (
    TAG_TEXT_SCALE,
    TEXT_SCALE,
    UPRIGHT,
    InstanceNode,
    LineNode,
    NodeLayer,
    PointNode,
    robot_colors,
)

CELL = 1.2
"""Side of a cell of the grid: the side of an element that USARSim's arenas are built of [m]."""
CELLS_OF_SECTION = 5
"""Cells between two stronger lines."""
WIDE = 60.0
"""Side of an arena from which only the stronger lines are drawn [m]: the others would merge into grey."""
LIFT, LIFT_SHARE = 0.008, 4e-4
"""Height of the grid above the floor [m], in large arenas a share of their size: less would flicker."""
TAG_RADIUS, TAG_HEIGHT, TAG_SIDES = 0.09, 0.02, 20
TAG_RGB, DROPPED_RGB = (255, 196, 0), (255, 110, 0)
TAG_TEXT_HEIGHT = 0.22
"""Height of the numbers above tags [m]."""
HIT_SIZE, TRAIL_SIZE = 0.02, 0.035
"""Radii of the points of victim sensors and of trails [m]."""
NO_SKETCHES = np.zeros((0, 2, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
NAME_GAP = 0.15
"""Height of names above robots [m]."""
NAME_TOLERANCE = 0.01
"""Movement below which a name is not sent again: each is a message of its own [m]."""
RING_GAP, RING_SHARE = 0.08, 1.2
"""Radius of a ring: a share of the robot's half size, and a gap [m]."""
RING_WIDTH, RING_HEIGHT = 0.14, 0.05
"""Width and height of a ring of radius 1."""
RING_SIDES = 40


class GridLayer(NodeLayer):
    """A grid on the floor."""

    name = "Grid"
    about = "a grid of 1.2 m on the floor, each fifth line stronger"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Draw it below the whole arena, with its lines at the joints of the arena's elements."""
        low, high = np.asarray(drawing.extent, float).T
        # A multiple of the cell, so that the stronger lines of a wide arena stay where they are.
        cell = CELL if (high - low).max() <= WIDE else CELL * CELLS_OF_SECTION
        # Less a little, or rounding would add a cell where whole ones fit.
        cells = np.ceil((high - low) / cell - 1e-6) + 2
        width, height = (cells * cell).tolist()
        # The middle of the grid, which begins one cell before the arena's corner.
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
            # Beyond the whole grid, or its far lines would fade out.
            fade_distance=4 * size,
            fade_strength=1.0,
            shadow_opacity=0.0,
            position=(x, y, drawing.floor + max(LIFT, LIFT_SHARE * size)),
        )

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Do nothing: the grid is constant."""
        del drawing, frame


def disc() -> tuple[np.ndarray, np.ndarray]:
    """Return corners (corners, 3) and triangles (triangles, 3) of a flat disc on z = 0."""
    around = 2 * math.pi * np.arange(TAG_SIDES) / TAG_SIDES
    circle = TAG_RADIUS * np.stack([np.cos(around), np.sin(around)], -1)
    top = np.column_stack([circle, np.full(TAG_SIDES, TAG_HEIGHT)])
    bottom = np.column_stack([circle, np.zeros(TAG_SIDES)])
    this = np.arange(TAG_SIDES)
    following = (this + 1) % TAG_SIDES
    middle = np.array([[0.0, 0.0, TAG_HEIGHT]])
    # No faces below: tags lie on the ground.
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
        """Draw the arena's tags; their numbers would hide a world among others."""
        for number, tag in enumerate(drawing.tags if self.alone else ()):
            self.scene.add_label(
                f"{self.root}/number{number}",
                str(tag.number),
                position=tuple(np.add(tag.pos, (0.0, 0.0, TAG_TEXT_HEIGHT))),
                anchor="bottom-center",
                font_screen_scale=TAG_TEXT_SCALE,
                depth_test=True,
            )
        self._discs = InstanceNode(self.scene, f"{self.root}/discs", disc())
        self._dropped: np.ndarray | None = None
        self._fixed = np.array([tag.pos for tag in drawing.tags], np.float32).reshape(-1, 3)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show dropped tags, too."""
        del drawing
        dropped = np.asarray(frame.dropped_tags, np.float32).reshape(-1, 3)
        # Tags stay where they are dropped: an equal array has nothing new to send.
        if self._dropped is not None and np.array_equal(dropped, self._dropped):
            return
        self._dropped = dropped
        pos = np.concatenate([self._fixed, dropped])
        # In the order of `pos` above: fixed tags first.
        rgb = np.repeat([TAG_RGB, DROPPED_RGB], [len(self._fixed), len(dropped)], axis=0)
        self._discs.set(pos, np.tile(UPRIGHT, (len(pos), 1)), np.ones(len(pos)), rgb)


def split_sketches(sketches: Sequence[OverlayLines]) -> tuple[np.ndarray, ...]:
    """Return lines and points of overlays.

    Returns:
        Starts and ends of lines [m] (lines, 2, 3), their colours, 0 to 255 (lines, 3), points [m]
        (points, 3), and their colours (points, 3).
    """
    if not sketches:
        return NO_SKETCHES
    shown = [np.asarray(one.shown, bool) for one in sketches]
    start, end, rgb = (
        np.concatenate(
            [
                np.zeros((0, 3)),
                *(np.asarray(getattr(one, name))[own] for one, own in zip(sketches, shown, strict=True)),
            ]
        )
        for name in ("start", "end", "rgb")
    )
    # Clipped: a negative number would wrap around to a bright byte.
    colors = (np.clip(rgb, 0.0, 1.0) * 255).astype(np.uint8)
    # Overlays have one form for both: a line of no length is a point.
    is_point = (start == end).all(-1)
    ends = np.stack([start, end], 1)
    return ends[~is_point], colors[~is_point], end[is_point], colors[is_point]


class RfidLayer(NodeLayer):
    """Lines from RFID sensors with bTraceRFIDs to tags."""

    name = "RFID lines"
    about = "lines to the tags near sensors with bTraceRFIDs: green strong, red weak, black out of reach"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Prepare the lines."""
        del drawing
        self._lines = LineNode(self.scene, f"{self.root}/lines", width=3.0)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the lines of the last readings."""
        del drawing
        ends, rgb, _, _ = split_sketches(frame.overlays)
        self._lines.set(ends, rgb)


class VictimHitLayer(NodeLayer):
    """Ends of the rays of victim sensors with bShowResults."""

    name = "Victim hits"
    about = "where rays of victim sensors with bShowResults ended: green on a victim, yellow on a false alarm"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Prepare the points."""
        del drawing
        self._points = PointNode(self.scene, f"{self.root}/points", HIT_SIZE)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the points of the last readings."""
        del drawing
        _, _, points, rgb = split_sketches(frame.overlays)
        self._points.set(points, rgb)


class TrailLayer(NodeLayer):
    """Points of the robots' traces (Trace command)."""

    name = "Trails"
    about = "the points that robots leave behind since Trace was sent, in its colour"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Prepare the points."""
        del drawing
        self._points = PointNode(self.scene, f"{self.root}/points", TRAIL_SIZE)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show all points."""
        del drawing
        _, _, points, rgb = split_sketches(() if frame.trace is None else (frame.trace,))
        self._points.set(points, rgb)


def heading_ring() -> tuple[np.ndarray, np.ndarray]:
    """Return corners (corners, 3) and triangles (triangles, 3) of a ring about the z axis.

    Its outer radius is 1, and it has a tip along x.
    """
    around = 2 * math.pi * np.arange(RING_SIDES) / RING_SIDES
    circle = np.stack([np.cos(around), np.sin(around), np.zeros(RING_SIDES)], -1)
    up = np.array([0.0, 0.0, RING_HEIGHT / 2])
    # Once around the section, so that each rim and the next make a side of the ring.
    rims = [circle + up, circle * (1 - RING_WIDTH) + up, circle * (1 - RING_WIDTH) - up, circle - up]
    this = np.arange(RING_SIDES)
    following = (this + 1) % RING_SIDES
    faces: list[np.ndarray] = []
    for rim in range(4):
        one, two = rim * RING_SIDES, (rim + 1) % 4 * RING_SIDES
        faces.append(np.stack([one + this, one + following, two + following], -1))
        faces.append(np.stack([one + this, two + following, two + this], -1))
    tip = np.array([[0.98, 0.22, 0.0], [0.98, -0.22, 0.0], [1.35, 0.0, 0.0]])
    first = 4 * RING_SIDES
    ends = np.array([[0, 2, 1], [3, 4, 5]])
    sides = np.array(
        [[a, b, c] for i in range(3) for j in [(i + 1) % 3] for a, b, c in ((i, 3 + i, j), (j, 3 + i, 3 + j))]
    )
    faces += [first + ends, first + sides]
    return np.concatenate([*rims, tip + up, tip - up]), np.concatenate(faces)


class NameLayer(NodeLayer):
    """Names over robots."""

    name = "Names"
    about = "names over robots"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Add the labels, hidden until their robots are present."""
        self._labels: dict[int, viser.LabelHandle] = {}
        self._above: dict[int, np.ndarray] = {}
        """Positions of the labels of present robots."""
        for slot, robot in drawing.robots.items():
            self._labels[slot] = self.scene.add_label(
                f"{self.root}/{slot}",
                robot.name,
                anchor="bottom-center",
                font_screen_scale=TEXT_SCALE,
                visible=False,
            )

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Move each label to its robot."""
        for slot, label in self._labels.items():
            robot, before = frame.robots.get(slot), self._above.get(slot)
            # Only changes: each assignment is a message to all browsers.
            if (robot is None) != (before is None):
                label.visible = robot is not None
            if robot is None:
                self._above.pop(slot, None)
                continue
            above = np.add(robot.pos, (0.0, 0.0, drawing.robots[slot].dimensions[2] / 2 + NAME_GAP))
            if before is None or np.abs(above - before).max() > NAME_TOLERANCE:
                label.position = self._above[slot] = above


class RingLayer(NodeLayer):
    """Rings around robots in their colours, which identify them from above, and point along their heading."""

    name = "Rings"
    about = "a ring around each robot in its own colour, with a tip where its front is"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Prepare the ring."""
        del drawing
        self._rings = InstanceNode(self.scene, f"{self.root}/rings", heading_ring())

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Move each ring to its robot."""
        # Sorted, so that an instance keeps its robot from update to update.
        slots = np.array(sorted(frame.robots), int)
        robots = [frame.robots[slot] for slot in slots.tolist()]
        size = np.array([drawing.robots[slot].dimensions for slot in slots.tolist()]).reshape(-1, 3)
        # Along and across: the ring of a long robot is an ellipse.
        radius = RING_SHARE * size[:, :2] / 2 + RING_GAP
        scale = np.column_stack([radius, radius.max(-1)]) if len(slots) else np.zeros((0, 3))
        pos = np.array([robot.pos for robot in robots]).reshape(-1, 3)
        quat = np.array([robot.quat for robot in robots]).reshape(-1, 4)
        self._rings.set(pos, quat, scale, robot_colors(slots))
