"""Pictures of robots' cameras at times of a recording, and maps of its arenas, as messages for viewers."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.models.compile.raster import floor_map
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.recording.foxglove import WORLD, stamp
from usarmjx.recording.reader import Recording

UINT8 = 1
"""Foxglove's number of the type."""
OCCUPIED = 100
"""Value of an occupied square [percent]."""


@dataclass(frozen=True, eq=False)
class CameraShot:
    """A picture of a robot's camera.

    Attributes:
        time: Its time [s].
        world: Number of its world in the recording.
        robot: Name of the robot.
        camera: Name of the camera.
        pos: Position of the camera in the world [m] (3,).
        quat: Orientation of its optical frame, w first (4,): x to the right in the picture, y down, z ahead.
        fov: Horizontal field of view [rad].
        size: Width and height of the picture [pixels].
        jpeg: The picture as a JPEG.
    """

    time: float
    world: int
    robot: str
    camera: str
    pos: np.ndarray
    quat: np.ndarray
    fov: float
    size: tuple[int, int]
    jpeg: bytes

    @property
    def frame(self) -> str:
        """Name of its optical frame."""
        return f"{self.robot}/{self.camera}_optical"


def shot_messages(shot: CameraShot) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield kind of topic, Foxglove's schema and value of the messages of a picture."""
    now = stamp(shot.time)
    (x, y, z), (w, i, j, k) = shot.pos.tolist(), shot.quat.tolist()
    transform = {
        "timestamp": now,
        "parent_frame_id": WORLD,
        "child_frame_id": shot.frame,
        "translation": {"x": x, "y": y, "z": z},
        "rotation": {"x": i, "y": j, "z": k, "w": w},
    }
    yield "tf", "foxglove.FrameTransforms", {"transforms": [transform]}
    picture = {"timestamp": now, "frame_id": shot.frame, "data": shot.jpeg, "format": "jpeg"}
    yield f"camera/{shot.robot}_{shot.camera}", "foxglove.CompressedImage", picture


def recorded_arena(recording: Recording, world: int) -> ArenaSpec | None:
    """Return the arena of a recorded world; None if there are several, or the recording has it not."""
    try:
        arenas = recording.setup(world).arenas
    except UsageError:
        return None
    return arenas[0] if len(arenas) == 1 else None


def grid_message(arena: ArenaSpec, time: float) -> dict[str, Any]:
    """Return the map of an arena as `foxglove.Grid`: rows along x, from the lowest y on."""
    grid, filled = floor_map(arena)
    columns, _ = grid.shape
    x, y = grid.low
    return {
        "timestamp": stamp(time),
        "frame_id": WORLD,
        "pose": {
            "position": {"x": x, "y": y, "z": float(arena.floor)},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        },
        "column_count": columns,
        "cell_size": {"x": grid.cell, "y": grid.cell},
        "row_stride": columns,
        "cell_stride": 1,
        "fields": [{"name": "occupancy", "offset": 0, "type": UINT8}],
        "data": (filled.T.astype(np.uint8) * OCCUPIED).tobytes(),
    }
