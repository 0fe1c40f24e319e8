"""What a world's recorder was told, as messages of a file; all of this runs in the file's thread."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from usarmjx.base.errors import UsageError
from usarmjx.recording import foxglove
from usarmjx.recording.file import ChannelName, RecordingFile
from usarmjx.recording.inputs import Input, Interrupted, StepState, WorldSetup
from usarmjx.view.capture import Capture
from usarmjx.view.drawing import Drawing, Frame

if TYPE_CHECKING:
    from usarmjx.recording.recorder import Look, SensorValues


class WorldMessages:
    """Messages about one world.

    Args:
        number: Its number in the recording.
    """

    def __init__(self, number: int) -> None:
        self._number = number
        self._key: tuple[object, ...] | None = None
        self._capture: Capture | None = None
        self._drawing: Drawing | None = None
        self._trails, self._transforms = foxglove.Trails(), foxglove.Transforms()
        self._score: float | None = None

    def _channel(self, kind: str, about: str = "") -> ChannelName:
        return ChannelName(self._number, kind, about)

    def setup(self, setup: WorldSetup, at: float, file: RecordingFile) -> None:
        """Write what the world was made of; without its arenas if these are not usarmjx's own values."""
        try:
            file.write(self._channel("setup"), at, setup)
        except UsageError as error:
            file.write(self._channel("setup"), at, replace(setup, arenas=(), roster=(), why_not=str(error)))

    def input(self, given: Input, at: float, file: RecordingFile) -> None:
        """Write what came into the world."""
        try:
            file.write(self._channel("inputs"), at, given)
        except UsageError as error:
            file.write(self._channel("inputs"), at, Interrupted(step=given.step, reason=str(error)))

    def state(self, state: StepState, file: RecordingFile) -> None:
        """Write the physics after a control step."""
        file.write(self._channel("states"), state.time, state)

    def event(self, said: Mapping[str, Any], at: float, file: RecordingFile) -> None:
        """Write what happened, for us and for Foxglove."""
        file.write(self._channel("events"), at, dict(said))
        file.write(self._channel("log"), at, foxglove.log(said["text"], said["robot"] or "world", at))

    def lines(self, who: tuple[str, str, bool], data: bytes, at: float, file: RecordingFile) -> None:
        """Write lines of the protocol."""
        peer, robot, sent = who
        text = data.decode("utf-8", "replace")
        file.write(self._channel("lines"), at, {"peer": peer, "robot": robot, "sent": sent, "text": text})

    def readings(self, measured: "SensorValues", at: float, file: RecordingFile) -> None:
        """Write what sensors measured; plane scans for Foxglove too."""
        slots, sensors, values = zip(*measured, strict=True)
        said = {"slots": slots, "sensors": sensors, "values": values}
        file.write(self._channel("readings"), at, said)
        drawing = self._drawing
        for slot, sensor, value in measured:
            robot = None if drawing is None else drawing.robots.get(slot)
            if drawing is not None and robot is not None and foxglove.is_scanner(robot, sensor):
                about = f"{robot.name}/{robot.sensors[sensor].names[0]}"
                scan = foxglove.laser_scan(drawing, robot, sensor, value, at)
                file.write(self._channel("scan", about), at, scan)

    def look(self, look: "Look", at: float, file: RecordingFile) -> None:
        """Write what a world looks like, and its drawing where that is another one."""
        world, scene = look.world, look.scene
        episode = 0 if world.arena_state is None else int(world.episode)
        key = scene, tuple((look.names or {}).items()), int(world.number), episode
        if self._capture is None or self._key is None or self._key[0] is not scene:
            self._capture = Capture(scene)
        if self._drawing is None or self._key != key:
            self._key = key
            self._drawing = self._capture.drawing(world, look.physics, look.names)
            file.write(self._channel("drawings"), at, self._drawing)
            file.write(self._channel("scene"), at, foxglove.scene_update(self._drawing, at))
        seen = self._capture.frame(world, look.physics)
        links = seen.links if look.links is None else look.links
        frame = replace(seen, time=at, trace=look.trace, score=look.score, links=links)
        self._write_frame(self._drawing, frame, file)

    def _write_frame(self, drawing: Drawing, frame: Frame, file: RecordingFile) -> None:
        at = frame.time
        file.write(self._channel("frames"), at, frame)
        file.write(self._channel("tf"), at, self._transforms.message(drawing, frame))
        for slot, robot in frame.robots.items():
            name = drawing.robots[slot].name
            trail = self._trails.add(name, robot, at)
            if trail is not None:
                file.write(self._channel("trail", name), at, trail)
        if frame.score is not None and frame.score != self._score:
            self._score = frame.score
            file.write(self._channel("score"), at, {"score": frame.score})
