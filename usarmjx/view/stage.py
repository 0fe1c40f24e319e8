"""Worlds in a scene of viser: all bodies that look the same are one batch, and only what moved is sent."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser

from usarmjx.view.drawing import Drawing, DrawnShape, Frame
from usarmjx.view.mesh import PLANE, Finish, glb_of, meshes_of, rectangle

STILL_TOLERANCE = 1e-5
"""What moved by less, and turned by less, stays where it is drawn [m]."""
FLOOR_DROP = 3e-4
"""The floor is drawn lower by this share of the arena's diagonal: what lies on it is seen from afar."""
GROUND_MARGIN = 2.0
"""So far beyond the arena its floor is drawn [m]."""


@dataclass(frozen=True, eq=False)
class StagedWorld:
    """A world on the stage.

    Attributes:
        drawing: Its drawing.
        offset: How far it is moved aside [m] (3,).
    """

    drawing: Drawing
    offset: np.ndarray


class BodyBatch:
    """Bodies that look the same, one instance each.

    Args:
        scene: Where to draw.
        path: Its node in the scene.
        shape: What they look like.
    """

    def __init__(self, scene: viser.SceneApi, path: str, shape: DrawnShape) -> None:
        self._scene, self._path = scene, path
        self._meshes = [(finish, glb_of(mesh, finish)) for finish, mesh in meshes_of(shape).items()]
        self._handles: list[viser.BatchedGlbHandle] = []
        self._rows, self._visible = np.zeros(0, int), True
        self._pos, self._quat = np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32)

    def begin(self, rows: np.ndarray) -> None:
        """Stand for other bodies: rows of the arrays that `update` gets (instances,)."""
        self._rows = rows

    def update(self, pos: np.ndarray, quat: np.ndarray, shown: np.ndarray) -> None:
        """Show its bodies where they are.

        Args:
            pos: Where all bodies are [m] (bodies, 3).
            quat: How they are turned (bodies, 4).
            shown: Which of them are to be seen (bodies,).
        """
        rows = self._rows[shown[self._rows]]
        pos, quat = pos[rows], quat[rows]
        if _are_near(pos, self._pos) and _are_near(quat, self._quat):
            return
        self._pos, self._quat = pos, quat
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
        """Take the bodies off the stage."""
        for handle in self._handles:
            handle.remove()
        self._handles = []

    def _add(self, number: int, finish: Finish, data: bytes) -> viser.BatchedGlbHandle:
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
        scene: Where to draw.
        root: Path in the scene below which all nodes are.
    """

    def __init__(self, scene: viser.SceneApi, root: str = "/bodies") -> None:
        self._scene, self._root = scene, root
        self._top = scene.add_frame(root, show_axes=False)
        self._batches: dict[str, BodyBatch] = {}
        self._floors: dict[str, viser.GlbHandle] = {}
        self._keys: dict[DrawnShape, str] = {}
        self.cells: tuple[StagedWorld, ...] = ()

    def begin(self, cells: Sequence[StagedWorld]) -> None:
        """Show other drawings; what looks as before is not sent again.

        Args:
            cells: What to draw, and where.
        """
        self.cells = tuple(cells)
        rows: dict[str, list[int]] = {}
        shapes: dict[str, DrawnShape] = {}
        first = 0
        for cell in cells:
            drawing = cell.drawing
            for place, body in enumerate(drawing.bodies):
                shape = drawing.shapes[body.shape]
                key = self._key(shape)
                shapes[key] = shape
                rows.setdefault(key, []).append(first + place)
            first += len(drawing.bodies)
        for key in self._batches.keys() - rows.keys():
            self._batches.pop(key).end()
        for key, own in rows.items():
            if key not in self._batches:
                self._batches[key] = BodyBatch(self._scene, f"{self._root}/{key}", shapes[key])
            self._batches[key].begin(np.array(own))
        used = {id(shape) for shape in shapes.values()}
        self._keys = {shape: key for shape, key in self._keys.items() if id(shape) in used}
        self._lay_floors()

    def update(self, frames: Sequence[Frame]) -> None:
        """Show the worlds as they are.

        Args:
            frames: One for each cell.
        """
        pos = np.concatenate(
            [frame.pos + cell.offset for frame, cell in zip(frames, self.cells, strict=True)],
            dtype=np.float32,
        )
        quat = np.concatenate([frame.quat for frame in frames])
        shown = np.concatenate([frame.shown for frame in frames])
        for batch in self._batches.values():
            batch.update(pos, quat, shown)

    def end(self) -> None:
        """Remove all nodes."""
        self._top.remove()
        self._batches, self._floors = {}, {}

    def _key(self, shape: DrawnShape) -> str:
        """Return a name that all shapes have which look the same."""
        if shape not in self._keys:
            fields = [np.ascontiguousarray(value, np.float32).tobytes() for value in _numbers(shape)]
            data = b"".join([*fields, "\n".join(map(str, shape.material)).encode()])
            self._keys[shape] = hashlib.blake2b(data, digest_size=8).hexdigest()
        return self._keys[shape]

    def _lay_floors(self) -> None:
        """Draw the floors that have no bounds as far as there is something to see, and a little further."""
        wanted: dict[str, tuple[StagedWorld, np.ndarray]] = {}
        for number, cell in enumerate(self.cells):
            rgb = floor_rgb(cell.drawing)
            if rgb is not None:
                wanted[f"{self._root}/floor/{number}"] = cell, rgb
        for handle in self._floors.values():
            handle.remove()
        self._floors = {path: self._floor(path, *value) for path, value in wanted.items()}

    def _floor(self, path: str, cell: StagedWorld, rgb: np.ndarray) -> viser.GlbHandle:
        low, high = cell.drawing.extent.T
        height = cell.drawing.floor - FLOOR_DROP * float(np.linalg.norm(high - low))
        mesh = rectangle(low - GROUND_MARGIN, high + GROUND_MARGIN, height, rgb)
        data = glb_of(mesh, Finish(roughness=1.0))
        return self._scene.add_glb(path, data, position=cell.offset, cast_shadow=False)


def floor_rgb(drawing: Drawing) -> np.ndarray | None:
    """Return the colour of a drawing's floor without bounds (3,); None if it has none."""
    for shape in drawing.shapes.values():
        is_floor = (shape.kind == PLANE) & ~(shape.size[:, :2] > 0.0).all(1)
        if is_floor.any():
            return shape.rgb[np.flatnonzero(is_floor)[0]]
    return None


def send_arrays(handle: viser.BatchedGlbHandle, **arrays: np.ndarray) -> None:
    """Give a handle arrays of single precision that nobody changes afterwards.

    As an assignment does, which looks at what type each property has anew every time and compares and copies
    what is known to be another one: that is most of the cost of moving a batch.
    """
    for name, array in arrays.items():
        setattr(handle._impl.props, name, array)
        handle._queue_update(name, array)


def in_rows(drawings: Sequence[Drawing]) -> list[np.ndarray]:
    """Return how far to move worlds aside so that they stand in rows, the first in the middle of its cell.

    Args:
        drawings: The worlds.

    Returns:
        Offsets [m] (3,), one each: rows go from left to right and from far to near.
    """
    columns = int(np.ceil(np.sqrt(len(drawings))))
    size = np.max([np.diff(drawing.extent, axis=1)[:, 0] for drawing in drawings], axis=0)
    step = size + 2 * GROUND_MARGIN
    return [
        np.array([*(np.array([n % columns, -(n // columns)]) * step - _middle(drawing)), -drawing.floor])
        for n, drawing in enumerate(drawings)
    ]


def _middle(drawing: Drawing) -> np.ndarray:
    return drawing.extent.mean(axis=1)


def _numbers(shape: DrawnShape) -> tuple[np.ndarray, ...]:
    return shape.kind, shape.pos, shape.mat, shape.size, shape.rgb, shape.transparency


def _are_near(one: np.ndarray, other: np.ndarray) -> bool:
    return one.shape == other.shape and bool((np.abs(one - other) < STILL_TOLERANCE).all())
