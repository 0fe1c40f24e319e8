"""What of a recording a figure or a film shows: ways, scans, victims found, scores."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.models.build.victims import victim_table
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.recording.foxglove import is_scanner
from usarmjx.recording.reader import Recording
from usarmjx.recording.source import RecordingSource
from usarmjx.view.drawing import Drawing, DrawnMount, Frame

MOST_SCANS = 400
"""So many scans are drawn at most, spread over the time."""
NEARLY = 0.995
"""What is nearly as far as a scanner sees has met nothing."""
VICTIM_SENSOR = "VictSensor"


@dataclass
class RobotWay:
    """Where a robot was, and what it had left.

    Attributes:
        name: Its name.
        robot: Its class.
        times: When it was looked at [s].
        poses: Where it was then: x, y [m] and yaw [rad].
        battery: For how long its battery lasted yet [s].
    """

    name: str
    robot: str
    times: list[float] = field(default_factory=list[float])
    poses: list[tuple[float, float, float]] = field(default_factory=list[tuple[float, float, float]])
    battery: list[float] = field(default_factory=list[float])


@dataclass(frozen=True, eq=False)
class RecordedMission:
    """A recorded mission.

    Attributes:
        arena: Where it was.
        ways: The robots' ways, in the order in which they came.
        scans: Where beams of plane scanners ended, on the floor plan [m] (points, 2).
        found: When each victim was met first [s], and by whom, by its place in the arena.
        scores: Times [s] and scores of a task.
        loose: Times [s] and where what lies loose was: x, y [m] (objects, 2).
    """

    arena: ArenaSpec
    ways: list[RobotWay]
    scans: np.ndarray
    found: dict[int, tuple[float, str]]
    scores: list[tuple[float, float]]
    loose: list[tuple[float, np.ndarray]]


def read_mission(recording: Recording, world: int, span: tuple[float, float]) -> RecordedMission:
    """Return what a recording has of a world in a span of time [s].

    Raises:
        UsageError: There is no such world, or the file does not say where it was.
    """
    if world not in recording.worlds:
        known = ", ".join(map(str, recording.worlds))
        raise UsageError(f"{recording.path}: has no world {world}; it has: {known}")
    setup = recording.setup(world)
    if not setup.arenas:
        raise UsageError(f"{recording.path}: does not have the arena: {setup.why_not}")
    owners = np.asarray(victim_table(setup.arenas[0].victims, setup.arenas[0].false_alarms).owner)
    reader = _Reader(owners)
    for message in recording.messages(("drawings", "frames", "readings", "score"), world):
        kind = message.channel.kind
        if kind == "drawings":
            reader.drawing = message.value
        elif span[0] <= message.time <= span[1]:
            if kind == "frames":
                reader.take_frame(message.value)
            elif kind == "score":
                reader.scores.append((message.time, message.value["score"]))
            else:
                reader.take_readings(message.time, message.value)
    if not reader.ways:
        raise UsageError(f"{recording.path}: no robots in that time of world {world}")
    scans = _scan_points(recording, world, reader.scans)
    ways = list(reader.ways.values())
    return RecordedMission(setup.arenas[0], ways, scans, reader.found, reader.scores, reader.loose)


@dataclass
class _Reader:
    """Goes through a recording; `owners` are the victims of the sensor's rows."""

    owners: np.ndarray
    drawing: Drawing | None = None
    ways: dict[str, RobotWay] = field(default_factory=dict[str, RobotWay])
    scans: list[tuple[float, int, int, np.ndarray]] = field(default_factory=list[Any])
    found: dict[int, tuple[float, str]] = field(default_factory=dict[int, tuple[float, str]])
    scores: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    loose: list[tuple[float, np.ndarray]] = field(default_factory=list[Any])

    def take_frame(self, frame: Frame) -> None:
        if self.drawing is None:
            return
        for slot, robot in frame.robots.items():
            drawn = self.drawing.robots[slot]
            way = self.ways.setdefault(drawn.name, RobotWay(drawn.name, drawn.robot))
            mat = np.asarray(mat_from_quat(robot.quat))
            way.times.append(frame.time)
            way.poses.append((*robot.pos[:2].tolist(), float(np.arctan2(mat[1, 0], mat[0, 0]))))
            way.battery.append(robot.battery)
        lying = [n for n, body in enumerate(self.drawing.bodies) if body.name.startswith("loose/")]
        self.loose.append((frame.time, frame.pos[lying, :2]))

    def take_readings(self, time: float, said: dict[str, Any]) -> None:
        for slot, sensor, value in zip(said["slots"], said["sensors"], said["values"], strict=True):
            robot = None if self.drawing is None else self.drawing.robots.get(slot)
            if robot is None:
                continue
            if is_scanner(robot, sensor):
                self.scans.append((time, slot, sensor, value))
            elif robot.sensors[sensor].kind == VICTIM_SENSOR and len(value) == len(self.owners):
                for victim in np.unique(self.owners[(value[:, 0] > 0) & (self.owners >= 0)]).tolist():
                    self.found.setdefault(victim, (time, robot.name))


def _scan_points(
    recording: Recording, world: int, scans: list[tuple[float, int, int, np.ndarray]]
) -> np.ndarray:
    """Return where beams ended, seen from above (points, 2)."""
    source = RecordingSource(recording)
    points = [np.zeros((0, 2))]
    place = recording.worlds.index(world)
    for time, slot, sensor, value in scans[:: max(1, len(scans) // MOST_SCANS)]:
        source.seek(time)
        drawing, frame = source.drawing(place), source.frame(place)
        if slot in drawing.robots:
            points.append(_ends(drawing.robots[slot].sensors[sensor], frame, value))
    return np.concatenate(points)


def _ends(mount: DrawnMount, frame: Frame, value: np.ndarray) -> np.ndarray:
    """Return where the beams of a scan ended that met something (points, 2)."""
    settings, body = mount.settings[0], int(mount.body[0])
    ranges = np.asarray(value, float).reshape(-1)
    angle = -float(settings["scan_fov"]) / 2 + np.arange(len(ranges)) * float(settings["resolution"])
    along, aside = ranges * np.cos(angle), ranges * np.sin(angle)
    flat = settings.get("yaw", True)
    ends = np.stack([along, aside if flat else 0 * aside, 0 * aside if flat else aside], -1)
    ends = ends[ranges < NEARLY * float(settings["max_range"])]
    turn = np.asarray(mat_from_quat(frame.quat[body]))
    return ((mount.pos[0] + ends @ mount.mat[0].T) @ turn.T + frame.pos[body])[:, :2]
