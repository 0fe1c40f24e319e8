"""Interface of layers, a class for each kind of overlay of a world, and the nodes of viser they show.

A node is created at the first instance, and hidden while there is none: viser sends only changed
properties, and supports no empty arrays.
"""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
import viser

from usarmjx.view.drawing import Drawing, Frame

ROBOT_COLORS = np.array(
    [
        (0, 180, 255),
        (255, 75, 105),
        (165, 255, 0),
        (105, 0, 240),
        (240, 180, 105),
        (105, 75, 0),
        (240, 195, 240),
        (135, 135, 0),
        (195, 90, 195),
        (60, 75, 120),
        (120, 255, 180),
        (135, 45, 60),
        (105, 105, 255),
        (150, 195, 0),
        (255, 120, 165),
        (120, 30, 180),
    ],
    np.uint8,
)
"""Red, green and blue of robots by slot, repeated after the last.

They were searched for, so that any two are far apart for people with normal, protanopic, deuteranopic and
tritanopic sight.
"""
SCALE = np.array([(213, 94, 0), (240, 228, 66), (0, 158, 115)], float)
"""Colours from bad over fair to good, distinct for the colour-blind, too (Okabe and Ito's colours)."""
TEXT_SCALE = 0.9
"""Size of texts on the screen, the same at any distance; 1 is the page's text."""
LINK_TEXT_SCALE, TAG_TEXT_SCALE = TEXT_SCALE - 0.01, TEXT_SCALE - 0.02
"""Sizes of the texts of links and tags, equal to the eye: of two that overlap the larger keeps its place."""
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
"""The quaternion of no rotation, w first."""


def robot_colors(slots: np.ndarray) -> np.ndarray:
    """Return the colours of robots by slot, 0 to 255 (..., 3)."""
    # Slots have no bound: after the last colour the first follows.
    return ROBOT_COLORS[np.asarray(slots, int) % len(ROBOT_COLORS)]


def scale_colors(share: np.ndarray) -> np.ndarray:
    """Return colours of shares from 0, bad, to 1, good (...,), 0 to 255 (..., 3)."""
    stops = np.linspace(0.0, 1.0, len(SCALE))
    # NumPy interpolates one channel at a time, and keeps shares outside of [0, 1] at the ends.
    columns = [np.interp(share, stops, SCALE[:, channel]) for channel in range(3)]
    return np.stack(columns, -1).astype(np.uint8)


class Layer(ABC):
    """An overlay of a world that users may hide.

    Attributes:
        name: Name of its switch.
        about: Description in one line.
        shown_at_first: Whether it is on when the page opens.
        alone: Whether no other world is shown beside its own.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    shown_at_first: ClassVar[bool]
    alone: bool = True

    @abstractmethod
    def begin(self, scene: viser.SceneApi, drawing: Drawing, prefix: str) -> None:
        """Start with a new drawing: another world, or other robots.

        Args:
            scene: Scene of viser.
            drawing: Drawing of the world.
            prefix: Root path of the layer's nodes; it moves with the world.
        """

    @abstractmethod
    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the present frame of the world; called only while the layer is on."""

    @abstractmethod
    def show(self, on: bool) -> None:
        """Show or hide its nodes."""

    @abstractmethod
    def end(self) -> None:
        """Remove its nodes."""


class NodeLayer(Layer):
    """A layer whose nodes all hang below one.

    Attributes:
        scene: Scene of viser.
        root: Path of its root node.
    """

    name: ClassVar[str]
    scene: viser.SceneApi
    root: str

    def __init__(self) -> None:
        self._on = self.shown_at_first
        self._top: viser.FrameHandle | None = None

    def begin(self, scene: viser.SceneApi, drawing: Drawing, prefix: str) -> None:
        """Start with a new drawing."""
        # The nodes of the earlier drawing may hang below the same path.
        self.end()
        self.scene, self.root = scene, f"{prefix}/{self.name.lower().replace(' ', '_')}"
        # One node above all others: a single message shows or hides the layer.
        self._top = scene.add_frame(self.root, show_axes=False, visible=self._on)
        self.draw(drawing)

    def draw(self, drawing: Drawing) -> None:
        """Draw the constant part, and prepare the variable one; by default nothing."""
        del drawing

    def show(self, on: bool) -> None:
        """Show or hide its nodes."""
        self._on = on
        if self._top is not None:
            self._top.visible = on

    def end(self) -> None:
        """Remove its nodes."""
        if self._top is not None:
            self._top.remove()
        self._top = None


class LineNode:
    """Straight lines.

    Args:
        scene: Scene of viser.
        name: Path of the node.
        width: Width of the lines on the screen [pixels].
    """

    def __init__(self, scene: viser.SceneApi, name: str, width: float = 2.0) -> None:
        self._scene, self._name, self._width = scene, name, width
        self._handle: viser.LineSegmentsHandle | None = None

    def set(self, ends: np.ndarray, rgb: np.ndarray) -> None:
        """Show lines.

        Args:
            ends: Starts and ends [m] (lines, 2, 3).
            rgb: Their colours, 0 to 255 (lines, 3), or one for all (3,).
        """
        ends = np.asarray(ends, np.float32)
        colors = np.asarray(rgb, np.uint8)
        if colors.ndim == 2:
            # viser colours the two ends of a line apart.
            colors = np.repeat(colors[:, None], 2, 1)
        # Added with the first line and hidden without any: a node of nothing is never sent.
        if self._handle is None and len(ends):
            self._handle = self._scene.add_line_segments(
                self._name, ends, colors, thickness=self._width, thickness_units="screen"
            )
        if self._handle is None:
            return
        self._handle.visible = bool(len(ends))
        if len(ends):
            # Both at each change: their numbers of rows must agree in the browser.
            self._handle.points, self._handle.colors = ends, colors


class PointNode:
    """Points.

    Args:
        scene: Scene of viser.
        name: Path of the node.
        size: Radius of a point [m].
    """

    def __init__(self, scene: viser.SceneApi, name: str, size: float) -> None:
        self._scene, self._name, self._size = scene, name, size
        self._rgb: np.ndarray | None = None
        self._handle: viser.PointCloudHandle | None = None

    def set(self, points: np.ndarray, rgb: np.ndarray) -> None:
        """Show points.

        Args:
            points: Positions [m] (points, 3).
            rgb: Their colours, 0 to 255 (points, 3), or one for all (3,). The same array as before counts as
                unchanged.
        """
        points, colors = np.asarray(points, np.float32), np.asarray(rgb, np.uint8)
        if self._handle is None and len(points):
            self._handle = self._scene.add_point_cloud(
                self._name,
                points,
                colors,
                point_size=self._size,
                point_shape="circle",
                point_shading="flat",
                precision="float32",
            )
        if self._handle is None:
            return
        self._handle.visible = bool(len(points))
        if len(points):
            self._handle.points = points
            # Compared by identity: comparing arrays in every update costs more than it saves.
            if rgb is not self._rgb:
                self._handle.colors = colors
            self._rgb = rgb


class MeshNode:
    """Transparent triangles of one colour.

    Args:
        scene: Scene of viser.
        name: Path of the node.
        rgb: Their colour, 0 to 255.
        opacity: In [0, 1].
    """

    def __init__(self, scene: viser.SceneApi, name: str, rgb: tuple[int, int, int], opacity: float) -> None:
        self._scene, self._name, self._rgb, self._opacity = scene, name, rgb, opacity
        self._handle: viser.MeshHandle | None = None
        self._faces: np.ndarray | None = None

    def set(self, corners: np.ndarray, faces: np.ndarray) -> None:
        """Show triangles.

        Args:
            corners: Their corners [m] (corners, 3).
            faces: Corners of each (faces, 3). The same array as before counts as unchanged.
        """
        corners, faces = np.asarray(corners, np.float32), np.asarray(faces, np.uint32)
        if self._handle is None and len(faces):
            self._handle = self._scene.add_mesh_simple(
                self._name,
                corners,
                faces,
                color=self._rgb,
                opacity=self._opacity,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
        if self._handle is None:
            return
        self._handle.visible = bool(len(faces))
        if len(faces):
            self._handle.vertices = corners
            if faces is not self._faces:
                self._handle.faces = faces
            self._faces = faces


class InstanceNode:
    """Many bodies of one shape.

    Args:
        scene: Scene of viser.
        name: Path of the node.
        shape: Corners (corners, 3) and triangles (faces, 3) of the shape.
        opacity: In [0, 1].
        cast_shadow: Whether they cast shadows.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        shape: tuple[np.ndarray, np.ndarray],
        *,
        opacity: float = 1.0,
        cast_shadow: bool = False,
    ) -> None:
        self._scene, self._name, self._shape = scene, name, shape
        # None is opaque to viser; a number may put a mesh among the transparent ones, which are sorted by
        # depth.
        self._opacity = None if opacity >= 1 else opacity
        self._cast_shadow = cast_shadow
        self._handle: viser.BatchedMeshHandle | None = None

    def set(self, pos: np.ndarray, quat: np.ndarray, scale: np.ndarray, rgb: np.ndarray) -> None:
        """Show bodies.

        Args:
            pos: Positions [m] (bodies, 3).
            quat: Orientations, w first (bodies, 4).
            scale: Scale of each (bodies,) or, by axis, (bodies, 3).
            rgb: Their colours, 0 to 255 (bodies, 3).
        """
        pos, quat, scale = (np.asarray(value, np.float32) for value in (pos, quat, scale))
        colors = np.asarray(rgb, np.uint8)
        if self._handle is None and len(pos):
            self._handle = self._scene.add_batched_meshes_simple(
                self._name,
                *self._shape,
                batched_wxyzs=quat,
                batched_positions=pos,
                batched_scales=scale,
                batched_colors=colors,
                opacity=self._opacity,
                side="double",
                lod="off",
                cast_shadow=self._cast_shadow,
                receive_shadow=False,
            )
        handle = self._handle
        if handle is None:
            return
        handle.visible = bool(len(pos))
        if len(pos):
            handle.batched_positions, handle.batched_wxyzs = pos, quat
            handle.batched_scales, handle.batched_colors = scale, colors
