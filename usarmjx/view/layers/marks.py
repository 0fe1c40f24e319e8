"""Who is who: names over robots and rings in their colours."""

import math

import numpy as np
import viser

from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.colors import robot_colors
from usarmjx.view.layers.nodes import InstanceNode, NodeLayer

NAME_GAP = 0.15
"""Names stand so far above robots [m]."""
NAME_TOLERANCE = 0.01
"""A name that would move by less stays: each is a message of its own, and nobody sees it [m]."""
RING_GAP, RING_SHARE = 0.08, 1.2
"""Rings are so much wider than robots: a share of them, and something on top [m]."""
RING_WIDTH, RING_HEIGHT = 0.14, 0.05
"""Of a ring of radius 1."""
RING_SIDES = 40


def heading_ring() -> tuple[np.ndarray, np.ndarray]:
    """Return corners (corners, 3) and triangles (triangles, 3) of a ring about the z axis.

    Its outer radius is 1, and it has a tip along x.
    """
    around = 2 * math.pi * np.arange(RING_SIDES) / RING_SIDES
    circle = np.stack([np.cos(around), np.sin(around), np.zeros(RING_SIDES)], -1)
    up = np.array([0.0, 0.0, RING_HEIGHT / 2])
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
        """Write the names; they are hidden until their robots are there."""
        self._labels: dict[int, viser.LabelHandle] = {}
        self._above: dict[int, np.ndarray] = {}
        """Where names of robots that are there stand."""
        for slot, robot in drawing.robots.items():
            self._labels[slot] = self.scene.add_label(
                f"{self.root}/{slot}",
                robot.name,
                anchor="bottom-center",
                font_screen_scale=0.9,
                visible=False,
            )

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Move each to its robot."""
        for slot, label in self._labels.items():
            robot, before = frame.robots.get(slot), self._above.get(slot)
            if (robot is None) != (before is None):
                label.visible = robot is not None
            if robot is None:
                self._above.pop(slot, None)
                continue
            above = np.add(robot.pos, (0.0, 0.0, drawing.robots[slot].dimensions[2] / 2 + NAME_GAP))
            if before is None or np.abs(above - before).max() > NAME_TOLERANCE:
                label.position = self._above[slot] = above


class RingLayer(NodeLayer):
    """Rings around robots in their colours, which tell them apart from above, and where they are heading."""

    name = "Rings"
    about = "a ring around each robot in its own colour, with a tip where its front is"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Get the ring ready."""
        del drawing
        self._rings = InstanceNode(self.scene, f"{self.root}/rings", heading_ring())

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Move each to its robot."""
        slots = np.array(sorted(frame.robots), int)
        robots = [frame.robots[slot] for slot in slots.tolist()]
        size = np.array([drawing.robots[slot].dimensions for slot in slots.tolist()]).reshape(-1, 3)
        radius = RING_SHARE * size[:, :2] / 2 + RING_GAP
        scale = np.column_stack([radius, radius.max(-1)]) if len(slots) else np.zeros((0, 3))
        pos = np.array([robot.pos for robot in robots]).reshape(-1, 3)
        quat = np.array([robot.quat for robot in robots]).reshape(-1, 4)
        self._rings.set(pos, quat, scale, robot_colors(slots))
