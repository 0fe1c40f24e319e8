"""Radio links: pairs of robots, their received power, and the walls between them."""

import numpy as np
import viser

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat
from usarmjx.comms.links import MIN_ANTENNA_HEIGHT
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.base import LINK_TEXT_SCALE, LineNode, NodeLayer, scale_colors

GAP_SHARE, GAP_SPACING = 0.025, 0.05
"""Length of the gap for a wall, and distance of two gaps' middles, as shares of the link."""
MOST_GAPS = 8
"""Most drawn gaps of a link."""
MOST_LABELS = 15
"""Most links with texts: more would hide each other and the world."""
LEAST_SPAN = 10.0
"""Least span of the colour scale [dB]."""


def dashes(walls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the drawn parts of links: with a gap for each wall, in the middle.

    Args:
        walls: Number of walls on each link (links,).

    Returns:
        Link of each part (parts,), and its start and end, as shares of the link (parts, 2).
    """
    # Without a limit the gaps of many walls would run beyond the ends of the link, which 20 fill.
    gaps = np.minimum(walls, MOST_GAPS)
    link = np.repeat(np.arange(len(gaps)), gaps + 1)
    # Index of each part within its link: parts of all links stand in one row.
    number = np.arange(len(link)) - np.repeat(np.cumsum(gaps + 1) - (gaps + 1), gaps + 1)
    first, last = number == 0, number == gaps[link]
    middle = 0.5 + GAP_SPACING * (number - gaps[link] / 2)
    start = np.where(first, 0.0, middle - (GAP_SPACING - GAP_SHARE) / 2)
    end = np.where(last, 1.0, middle + (GAP_SPACING - GAP_SHARE) / 2)
    return link, np.stack([start, end], -1)


class RadioLayer(NodeLayer):
    """Lines between robots in radio range."""

    name = "Radio links"
    about = (
        "lines between robots that hear each other, from weak (red) to strong (green), a gap for each wall"
    )
    shown_at_first = False

    def draw(self, drawing: Drawing) -> None:
        """Prepare the nodes."""
        del drawing
        self._lines = LineNode(self.scene, f"{self.root}/lines", width=3.0)
        self._labels: list[viser.LabelHandle] = []

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the links of their last evaluation."""
        links = frame.links
        slots = np.array(sorted(frame.robots), int)
        if links is None or len(slots) < 2:
            self._lines.set(np.zeros((0, 2, 3)), np.zeros((0, 3)))
            self._write([], np.zeros((0, 3)))
            return
        antennas = self._antennas(drawing, frame, slots)
        # Each pair once.
        low, high = np.triu_indices(len(slots), 1)
        a, b = slots[low], slots[high]
        holds = np.asarray(links.in_range)[a, b]
        low, high, a, b = low[holds], high[holds], a[holds], b[holds]
        power, walls = np.asarray(links.power)[a, b], np.asarray(links.walls)[a, b]
        # A least span, or a single weak link would be drawn as the best.
        best = max(float(power.max(initial=-np.inf)), drawing.cutoff + LEAST_SPAN)
        rgb = scale_colors((power - drawing.cutoff) / (best - drawing.cutoff))
        start, end = antennas[low], antennas[high]
        link, share = dashes(walls)
        along = (end - start)[link]
        parts = start[link, None] + share[..., None] * along[:, None]
        self._lines.set(parts, rgb[link])
        # Each text is an element of the page.
        few = len(power) <= MOST_LABELS
        texts = [_text(p, w) for p, w in zip(power.tolist(), walls.tolist(), strict=True)] if few else []
        self._write(texts, (start + end) / 2)

    def _antennas(self, drawing: Drawing, frame: Frame, slots: np.ndarray) -> np.ndarray:
        """Return the positions of the robots' antennas [m] (robots, 3): on top of them, as usual."""
        robots = [frame.robots[slot] for slot in slots.tolist()]
        top = np.array([drawing.robots[slot].dimensions[2] / 2 for slot in slots.tolist()])
        with numpy_backend():
            up = np.asarray(mat_from_quat(np.array([robot.quat for robot in robots])))[:, :, 2]
        pos = np.array([robot.pos for robot in robots]) + top[:, None] * up
        # As in `comms.links`: the antenna of a robot on its back would be inside the floor.
        return np.maximum(pos, (-np.inf, -np.inf, drawing.floor + MIN_ANTENNA_HEIGHT))

    def _write(self, texts: list[str], positions: np.ndarray) -> None:
        """Show texts at positions [m] (texts, 3)."""
        while len(self._labels) < len(texts):
            name = f"{self.root}/text{len(self._labels)}"
            self._labels.append(
                self.scene.add_label(name, "", anchor="center-center", font_screen_scale=LINK_TEXT_SCALE)
            )
        for number, label in enumerate(self._labels):
            label.visible = number < len(texts)
            if number < len(texts):
                label.text, label.position = texts[number], positions[number]


def _text(power: float, walls: int) -> str:
    """Return the text of a link."""
    behind = "" if not walls else f", {walls} wall{'s' * (walls > 1)}"
    return f"{power:.0f} dBm{behind}"
