"""Worlds in a scene of viser: equal bodies are one batch, and only moved ones are sent."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser

from usarmjx.view.drawing import Drawing, DrawnShape, Frame
from usarmjx.view.layers.base import TEXT_SCALE
from usarmjx.view.mesh import PLANE, Finish, glb_of, meshes_of, rectangle

STILL_TOLERANCE = 1e-5
"""Movement [m] and change of a quaternion below which a body is not sent again."""
FLOOR_DROP = 3e-4
"""Drop of the drawn floor, as a share of the arena's diagonal: objects on it stay visible from afar."""
GROUND_MARGIN = 2.0
"""Margin of the drawn floor around the arena [m]."""


@dataclass(frozen=True, eq=False)
class StagedWorld:
    """A world on the stage.

    Attributes:
        drawing: Its drawing.
        offset: Its displacement [m] (3,).
        name: Its name, which is shown where several worlds are.
    """

    drawing: Drawing
    offset: np.ndarray
    name: str = ""


class BodyBatch:
    """Bodies of one shape, one instance each.

    Args:
        scene: Scene of viser.
        path: Its node in the scene.
        shape: Their shape.
    """

    def __init__(self, scene: viser.SceneApi, path: str, shape: DrawnShape) -> None:
        self._scene, self._path = scene, path
        # A glTF material covers a whole mesh, so each finish is a mesh of its own.
        self._meshes = [(finish, glb_of(mesh, finish)) for finish, mesh in meshes_of(shape).items()]
        self._handles: list[viser.BatchedGlbHandle] = []
        self._rows, self._visible = np.zeros(0, int), True
        self._pos, self._quat = np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32)

    def begin(self, rows: np.ndarray) -> None:
        """Set the bodies: rows of the arrays of `update` (instances,)."""
        self._rows = rows

    def update(self, pos: np.ndarray, quat: np.ndarray, shown: np.ndarray) -> None:
        """Show its bodies at their present poses.

        Args:
            pos: Positions of all bodies [m] (bodies, 3).
            quat: Their orientations (bodies, 4).
            shown: Which of them are visible (bodies,).
        """
        rows = self._rows[shown[self._rows]]
        pos, quat = pos[rows], quat[rows]
        # Browsers keep what they have: only changed poses are worth a message.
        if _are_near(pos, self._pos) and _are_near(quat, self._quat):
            return
        self._pos, self._quat = pos, quat
        # Sent with the first visible body: a mesh that no one sees costs time in every browser.
        if len(rows) and not self._handles:
            self._handles = [self._add(n, *mesh) for n, mesh in enumerate(self._meshes)]
        elif len(rows):
            for handle in self._handles:
                send_arrays(handle, batched_positions=pos, batched_wxyzs=quat)
        if bool(len(rows)) != self._visible:
            self._visible = bool(len(rows))
            for handle in self._handles:
                handle.visible = self._visible

    def end(self) -> None:
        """Remove the bodies from the stage."""
        for handle in self._handles:
            handle.remove()
        self._handles = []

    def _add(self, number: int, finish: Finish, data: bytes) -> viser.BatchedGlbHandle:
        # Shadows in a browser know no transparency: glass would cast that of a wall.
        is_clear = finish.opacity < 1.0
        return self._scene.add_batched_glb(
            f"{self._path}/{number}",
            data,
            batched_wxyzs=self._quat,
            batched_positions=self._pos,
            lod="off",
            cast_shadow=not is_clear,
            receive_shadow=not is_clear,
        )


class Stage:
    """Draws worlds side by side.

    Args:
        scene: Scene of viser.
        root: Root path of all nodes.
    """

    def __init__(self, scene: viser.SceneApi, root: str = "/bodies") -> None:
        self._scene, self._root = scene, root
        self._top = scene.add_frame(root, show_axes=False)
        self._batches: dict[str, BodyBatch] = {}
        self._floors: dict[str, viser.GlbHandle] = {}
        self._labels: list[viser.LabelHandle] = []
        self._keys: dict[DrawnShape, str] = {}
        self.cells: tuple[StagedWorld, ...] = ()

    def begin(self, cells: Sequence[StagedWorld]) -> None:
        """Show other drawings; unchanged shapes are not sent again.

        Args:
            cells: Worlds with their offsets.
        """
        self.cells = tuple(cells)
        rows: dict[str, list[int]] = {}
        shapes: dict[str, DrawnShape] = {}
        first = 0
        for cell in cells:
            drawing = cell.drawing
            for index, body in enumerate(drawing.bodies):
                shape = drawing.shapes[body.shape]
                key = self._key(shape)
                shapes[key] = shape
                rows.setdefault(key, []).append(first + index)
            # Rows count through all worlds, as their frames are joined in `update`.
            first += len(drawing.bodies)
        for key in self._batches.keys() - rows.keys():
            self._batches.pop(key).end()
        for key, own in rows.items():
            if key not in self._batches:
                self._batches[key] = BodyBatch(self._scene, f"{self._root}/{key}", shapes[key])
            self._batches[key].begin(np.array(own))
        # Keys of shapes that are not drawn any more would keep their arrays in memory.
        used = {id(shape) for shape in shapes.values()}
        self._keys = {shape: key for shape, key in self._keys.items() if id(shape) in used}
        self._draw_floors()
        self._write_names()

    def update(self, frames: Sequence[Frame]) -> None:
        """Show the present frames.

        Args:
            frames: One for each cell.
        """
        pos = np.concatenate(
            [frame.pos + cell.offset for frame, cell in zip(frames, self.cells, strict=True)],
            # Offsets are in double precision, and the browser takes single.
            dtype=np.float32,
        )
        quat = np.concatenate([frame.quat for frame in frames])
        shown = np.concatenate([frame.shown for frame in frames])
        for batch in self._batches.values():
            batch.update(pos, quat, shown)
        # A single world has no label.
        for label, cell, frame in zip(self._labels, self.cells, frames, strict=False):
            text = cell.name if frame.score is None else f"{cell.name}: {frame.score:.0f}"
            if text != label.text:
                label.text = text

    def end(self) -> None:
        """Remove all nodes."""
        self._top.remove()
        self._batches, self._floors, self._labels = {}, {}, []

    def _key(self, shape: DrawnShape) -> str:
        """Return the common name of all equal shapes."""
        if shape not in self._keys:
            # By contents: equal robots of several worlds share one mesh in the browser.
            # Single precision is what it draws, whatever types a recording holds.
            fields = [np.ascontiguousarray(value, np.float32).tobytes() for value in _numbers(shape)]
            data = b"".join([*fields, "\n".join(map(str, shape.material)).encode()])
            # A short digest: keys are part of the nodes' paths in the scene.
            self._keys[shape] = hashlib.blake2b(data, digest_size=8).hexdigest()
        return self._keys[shape]

    def _draw_floors(self) -> None:
        """Draw unbounded floors below all that is visible, with a margin."""
        wanted: dict[str, tuple[StagedWorld, np.ndarray]] = {}
        for number, cell in enumerate(self.cells):
            rgb = floor_rgb(cell.drawing)
            if rgb is not None:
                wanted[f"{self._root}/floor/{number}"] = cell, rgb
        for handle in self._floors.values():
            handle.remove()
        self._floors = {path: self._floor(path, *value) for path, value in wanted.items()}

    def _write_names(self) -> None:
        """Write the names of several worlds at their near sides."""
        for label in self._labels:
            label.remove()
        self._labels = []
        for number, cell in enumerate(self.cells if len(self.cells) > 1 else ()):
            (west, east), (south, _) = cell.drawing.extent.tolist()
            # In the south, from where the first view of several worlds looks (`viewpoint.ROWS_DIRECTION`).
            near = np.array([(west + east) / 2, south - GROUND_MARGIN / 2, cell.drawing.floor])
            self._labels.append(
                self._scene.add_label(
                    f"{self._root}/name/{number}",
                    cell.name,
                    position=near + cell.offset,
                    anchor="center-center",
                    font_screen_scale=TEXT_SCALE,
                )
            )

    def _floor(self, path: str, cell: StagedWorld, rgb: np.ndarray) -> viser.GlbHandle:
        low, high = cell.drawing.extent.T
        # Depth resolution falls with the distance, and a larger arena is seen from farther away.
        height = cell.drawing.floor - FLOOR_DROP * float(np.linalg.norm(high - low))
        mesh = rectangle(low - GROUND_MARGIN, high + GROUND_MARGIN, height, rgb)
        data = glb_of(mesh, Finish(roughness=1.0))
        return self._scene.add_glb(path, data, position=cell.offset, cast_shadow=False)


def floor_rgb(drawing: Drawing) -> np.ndarray | None:
    """Return the colour of a drawing's unbounded floor (3,); None without one."""
    for shape in drawing.shapes.values():
        # A plane of size 0 has no bounds, in MuJoCo's words.
        is_floor = (shape.kind == PLANE) & ~(shape.size[:, :2] > 0.0).all(1)
        if is_floor.any():
            return shape.rgb[np.flatnonzero(is_floor)[0]]
    return None


def send_arrays(handle: viser.BatchedGlbHandle, **arrays: np.ndarray) -> None:
    """Set arrays of single precision of a handle; they must not be changed afterwards.

    It equals an assignment, which checks each property's type again every time and compares and copies the
    arrays: that is most of the cost of moving a batch.
    """
    for name, array in arrays.items():
        setattr(handle._impl.props, name, array)  # pyright: ignore[reportPrivateUsage]
        handle._queue_update(name, array)  # pyright: ignore[reportPrivateUsage]


def grid_offsets(drawings: Sequence[Drawing]) -> list[np.ndarray]:
    """Return offsets that put worlds in rows, the first in the middle of its cell.

    Args:
        drawings: The worlds.

    Returns:
        Offsets [m] (3,), one each: rows go from left to right and from far to near.
    """
    # At least as many columns as rows: pictures are wider than high.
    columns = int(np.ceil(np.sqrt(len(drawings))))
    size = np.max([np.diff(drawing.extent, axis=1)[:, 0] for drawing in drawings], axis=0)
    step = size + 2 * GROUND_MARGIN
    return [
        # All floors come to height 0, and the middles of all arenas onto the grid.
        np.array([*(np.array([n % columns, -(n // columns)]) * step - _middle(drawing)), -drawing.floor])
        for n, drawing in enumerate(drawings)
    ]


def _middle(drawing: Drawing) -> np.ndarray:
    return drawing.extent.mean(axis=1)


def _numbers(shape: DrawnShape) -> tuple[np.ndarray, ...]:
    return shape.kind, shape.pos, shape.mat, shape.size, shape.rgb, shape.transparency


def _are_near(one: np.ndarray, other: np.ndarray) -> bool:
    return one.shape == other.shape and bool((np.abs(one - other) < STILL_TOLERANCE).all())
