"""Pictures of robots' cameras, rendered from the frames of a recording."""

import math
from collections.abc import Iterator

import mujoco
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.plots.films.picture import FilmScene
from usarmjx.plots.films.views import FilmView
from usarmjx.recording.reader import Recording
from usarmjx.recording.shots import CameraShot
from usarmjx.recording.source import RecordingSource
from usarmjx.server.protocol.images import format_number, jpeg
from usarmjx.view.drawing import Drawing, DrawnMount, Frame

SIZE = 320, 240
"""Width and height of a picture [pixels], those of ROS topics of a served world."""
QUALITY = format_number("good")
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Axes of an optical frame in those of a camera, which has x ahead and z up, as columns."""
MIN_PERIOD = 0.02
"""Shortest interval between two pictures of a camera [s]."""


def camera_shots(recording: Recording, period: float, world: int | None = None) -> Iterator[CameraShot]:
    """Yield a picture of each robot's pinhole cameras at every period, with their initial fields of view.

    Args:
        recording: The recording.
        period: Interval between two pictures of a camera [s].
        world: Number of its world; None: all.

    Raises:
        UsageError: A period below 0.02 s, no such world, or no frames.
    """
    if not period >= MIN_PERIOD:
        raise UsageError(f"pictures every {period:g} s; expected {MIN_PERIOD:g} or more")
    source = RecordingSource(recording)
    if world is not None and world not in source.worlds:
        raise UsageError(f"{recording.path}: has no world {world}")
    for index, number in enumerate(source.worlds):
        if world in (None, number):
            yield from _shots(source, index, number, period)


def _shots(source: RecordingSource, index: int, number: int, period: float) -> Iterator[CameraShot]:
    drawn: Drawing | None = None
    scene: FilmScene | None = None
    for step in range(math.floor((source.end - source.start) / period) + 1):
        source.seek(source.start + step * period)
        drawing, frame = source.drawing(index), source.frame(index)
        if scene is None or drawing is not drawn:
            drawn, scene = drawing, FilmScene(drawing)
        for slot in sorted(frame.robots):
            robot = drawing.robots.get(slot)
            for camera in robot.cameras if robot is not None else ():
                if camera.settings[0].get("lens") == "pinhole":
                    assert robot is not None
                    view = camera_view(camera, frame, SIZE)
                    quat = np.zeros(4)
                    mujoco.mju_mat2Quat(quat, (view.axes * [1.0, -1.0, 1.0]).ravel())
                    yield CameraShot(
                        time=source.time,
                        world=number,
                        robot=robot.name,
                        camera=camera.names[0],
                        pos=view.eye,
                        quat=quat if quat[0] >= 0 else -quat,
                        fov=float(camera.settings[0]["fov"]),
                        size=SIZE,
                        jpeg=jpeg(QUALITY, scene.render(frame, view)),
                    )


def camera_view(camera: DrawnMount, frame: Frame, size: tuple[int, int]) -> FilmView:
    """Return the view through a camera of a frame, with pictures of that width and height [pixels]."""
    body, turn = int(camera.body[0]), np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.asarray(frame.quat[body], float))
    mat = turn.reshape(3, 3)
    ahead = mat @ np.asarray(camera.mat[0], float) @ OPTICAL  # right, down, ahead
    focal = size[0] / 2 / math.tan(float(camera.settings[0]["fov"]) / 2)  # type: ignore[arg-type]
    eye = np.asarray(frame.pos[body], float) + mat @ np.asarray(camera.pos[0], float)
    return FilmView(eye, ahead * [1.0, -1.0, 1.0], focal, *size)
