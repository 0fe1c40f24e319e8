"""Drawings and frames as messages for Foxglove and similar viewers."""

import hashlib
import json
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from usarmjx.recording.values import pack
from usarmjx.view.drawing import NOBODY, Drawing, DrawnRobot, DrawnShape, Frame, RobotFrame
from usarmjx.view.mesh import meshes_of

Schema = dict[str, Any]

NUMBER: Schema = {"type": "number"}
INTEGER: Schema = {"type": "integer"}
TEXT: Schema = {"type": "string"}
FLAG: Schema = {"type": "boolean"}


def _array(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _object(**properties: Schema) -> Schema:
    return {"type": "object", "properties": properties}


SECONDS = _object(sec=INTEGER, nsec=INTEGER)
VECTOR = _object(x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
POSE = _object(position=VECTOR, orientation=QUATERNION)
COLOUR = _object(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
TRANSFORM = _object(
    timestamp=SECONDS,
    parent_frame_id=TEXT,
    child_frame_id=TEXT,
    translation=VECTOR,
    rotation=QUATERNION,
)
BYTES: Schema = {"type": "string", "contentEncoding": "base64"}
ARROW = _object(
    pose=POSE,
    shaft_length=NUMBER,
    shaft_diameter=NUMBER,
    head_length=NUMBER,
    head_diameter=NUMBER,
    color=COLOUR,
)
LINE = _object(
    type=INTEGER,
    pose=POSE,
    thickness=NUMBER,
    scale_invariant=FLAG,
    points=_array(VECTOR),
    color=COLOUR,
    colors=_array(COLOUR),
    indices=_array(INTEGER),
)
MODEL = _object(
    pose=POSE, scale=VECTOR, color=COLOUR, override_color=FLAG, url=TEXT, media_type=TEXT, data=BYTES
)
ENTITY = _object(
    timestamp=SECONDS,
    frame_id=TEXT,
    id=TEXT,
    lifetime=SECONDS,
    frame_locked=FLAG,
    metadata=_array(_object(key=TEXT, value=TEXT)),
    arrows=_array(ARROW),
    cubes=_array(_object(pose=POSE, size=VECTOR, color=COLOUR)),
    spheres=_array(_object(pose=POSE, size=VECTOR, color=COLOUR)),
    cylinders=_array(_object(pose=POSE, size=VECTOR, bottom_scale=NUMBER, top_scale=NUMBER, color=COLOUR)),
    lines=_array(LINE),
    triangles=_array(
        _object(
            pose=POSE, points=_array(VECTOR), color=COLOUR, colors=_array(COLOUR), indices=_array(INTEGER)
        )
    ),
    texts=_array(
        _object(pose=POSE, billboard=FLAG, font_size=NUMBER, scale_invariant=FLAG, color=COLOUR, text=TEXT)
    ),
    models=_array(MODEL),
)
SCHEMAS: dict[str, Schema] = {
    "foxglove.FrameTransforms": _object(transforms=_array(TRANSFORM)),
    "foxglove.SceneUpdate": _object(
        deletions=_array(_object(timestamp=SECONDS, type=INTEGER, id=TEXT)), entities=_array(ENTITY)
    ),
    "foxglove.LaserScan": _object(
        timestamp=SECONDS,
        frame_id=TEXT,
        pose=POSE,
        start_angle=NUMBER,
        end_angle=NUMBER,
        ranges=_array(NUMBER),
        intensities=_array(NUMBER),
    ),
    "foxglove.PosesInFrame": _object(timestamp=SECONDS, frame_id=TEXT, poses=_array(POSE)),
    "foxglove.Log": _object(
        timestamp=SECONDS, level=INTEGER, message=TEXT, name=TEXT, file=TEXT, line=INTEGER
    ),
    "usarmjx.Lines": _object(peer=TEXT, robot=TEXT, sent=FLAG, text=TEXT),
    "usarmjx.Event": _object(kind=TEXT, robot=TEXT, slot=INTEGER, text=TEXT),
    "usarmjx.Score": _object(score=NUMBER),
}
"""JSON schemas by name."""


def schema_text(name: str) -> bytes:
    """Return a schema as JSON Schema; empty for channels that only usarmjx reads."""
    if name not in SCHEMAS:
        return b""
    return json.dumps({"title": name, **SCHEMAS[name]}).encode()


WORLD = "world"
"""Root frame."""
BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
INFO = 2
"""Foxglove's log level for information."""
DELETE_ALL = 1
"""Foxglove's deletion of all former entities."""
NANO = 10**9
DIGITS = 4
"""Decimals of coordinates: tenths of a millimetre."""
ALL_PERIOD = 5.0
"""Interval between two transforms of a body at rest [s]."""
TRAIL_STEP = 0.2
"""Distance between two poses of a trail [m]."""
TRAIL_PERIOD = 2.0
"""Least interval between two messages of a trail [s]."""
MOST_POSES = 200
"""Most poses of a trail; beyond that, every other one is dropped, and the step doubles."""
SCANNERS = ("RangeScanner", "IRScanner")
"""Kinds of sensors whose readings are a plane scan, from right to left or from below."""
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation of a scan's plane from horizontal to vertical."""


def stamp(time: float) -> dict[str, int]:
    """Return a time [s] in Foxglove's form."""
    nano = round(time * NANO)
    # Rounded once, as a whole: separate rounding could give 10**9 nanoseconds.
    return {"sec": nano // NANO, "nsec": nano % NANO}


def frame_id(drawing: Drawing, body: int) -> str:
    """Return the name of a body's frame: for a robot, its name and the part's."""
    drawn = drawing.bodies[body]
    if drawn.slot == NOBODY:
        return drawn.name
    return "/".join((drawing.robots[drawn.slot].name, *drawn.name.split("/")[2:]))


class Transforms:
    """Poses of bodies as `foxglove.FrameTransforms`: of those that have moved, and of all now and then."""

    def __init__(self) -> None:
        self._drawing: Drawing | None = None
        self._pos = self._quat = np.zeros(0)
        self._names: list[str] = []
        self._all_due = 0.0

    def message(self, drawing: Drawing, frame: Frame) -> dict[str, Any]:
        """Return the transforms of visible bodies."""
        is_new = drawing is not self._drawing
        if is_new:
            self._drawing = drawing
            self._names = [frame_id(drawing, body) for body in range(len(drawing.bodies))]
        sent = frame.shown
        # A viewer that joins in the middle needs bodies at rest, too.
        if is_new or frame.time >= self._all_due:
            self._all_due = frame.time + ALL_PERIOD
        else:
            # Exactly: bodies at rest have the same bits in every frame.
            sent = sent & ((frame.pos != self._pos).any(-1) | (frame.quat != self._quat).any(-1))
        self._pos, self._quat, now = frame.pos, frame.quat, stamp(frame.time)
        # As doubles: rounded single-precision numbers show all their digits again in JSON.
        pos, quat = frame.pos.astype(float).round(DIGITS), frame.quat.astype(float).round(DIGITS + 1)
        return {
            "transforms": [
                {
                    "timestamp": now,
                    "parent_frame_id": WORLD,
                    "child_frame_id": self._names[body],
                    "translation": _xyz(pos[body].tolist()),
                    "rotation": _quaternion(quat[body].tolist()),
                }
                for body in np.flatnonzero(sent).tolist()
            ]
        }


KEPT_SHAPES = 256
"""Most shapes whose texts are kept."""


class SceneTexts:
    """Shapes of bodies, each in its own frame, as texts of `foxglove.SceneUpdate`.

    The text of a shape is kept: a body of triangles has a megabyte, and most have not changed when a robot
    joins.
    """

    def __init__(self) -> None:
        self._digests: dict[int, tuple[DrawnShape, bytes]] = {}
        self._texts: dict[bytes, str] = {}

    def key(self, drawing: Drawing, bodies: Sequence[int]) -> bytes:
        """Return a digest of bodies: their names, frames, labels and shapes."""
        found = hashlib.blake2b(digest_size=16)
        for body in bodies:
            about = _entity(drawing, body, {})
            found.update(json.dumps(about, sort_keys=True).encode())
            found.update(self._digest(drawing.shapes[drawing.bodies[body].shape]))
        return found.digest()

    def writing(
        self, drawing: Drawing, bodies: Sequence[int], time: float, write: Callable[[bytes], None]
    ) -> Iterator[None]:
        """Write the message in the end; yield after each body, as each may take a tenth of a second."""
        now, entities = stamp(time), list[str]()
        for body in bodies:
            about = json.dumps(_entity(drawing, body, now))
            solids = self._solids(drawing.shapes[drawing.bodies[body].shape])
            # Two texts of JSON objects are joined at their braces: encoding megabytes again would take long.
            entities.append(f"{about[:-1]}, {solids[1:]}")
            yield
        # Bodies that are gone would stay on the screen otherwise.
        deletions = json.dumps([{"timestamp": now, "type": DELETE_ALL, "id": ""}])
        write(f'{{"deletions": {deletions}, "entities": [{", ".join(entities)}]}}'.encode())

    def _digest(self, shape: DrawnShape) -> bytes:
        # The shape is kept with its digest, or another one could get its id.
        known = self._digests.get(id(shape))
        if known is None:
            found = hashlib.blake2b(digest_size=16)
            for values in vars(shape).values():
                found.update(pack(values))  # the bytes of an array of texts are addresses
            if len(self._digests) >= KEPT_SHAPES:
                self._digests.clear()
            known = self._digests[id(shape)] = shape, found.digest()
        return known[1]

    def _solids(self, shape: DrawnShape) -> str:
        digest = self._digest(shape)
        if digest not in self._texts:
            if len(self._texts) >= KEPT_SHAPES:
                self._texts.clear()
            self._texts[digest] = json.dumps(_primitives(shape))
        return self._texts[digest]


def _entity(drawing: Drawing, body: int, now: dict[str, int]) -> dict[str, Any]:
    """Return a body without its solids."""
    return {
        "timestamp": now,
        "frame_id": frame_id(drawing, body),
        "id": drawing.bodies[body].name,
        # In Foxglove a lifetime of 0 never ends.
        "lifetime": {"sec": 0, "nsec": 0},
        # Locked to its frame: a body moves by its transforms, and its shapes are sent once.
        "frame_locked": True,
        "metadata": [],
        **{kind: [] for kind in ("arrows", "spheres", "cylinders", "lines", "models")},
        "texts": _labels(drawing, body),
    }


def _labels(drawing: Drawing, body: int) -> list[dict[str, Any]]:
    """Return a label with a robot's name over its chassis; none for other bodies."""
    for robot in drawing.robots.values():
        if robot.body == body:
            above = [0.0, 0.0, float(robot.dimensions[2]) + 0.3]
            return [
                {
                    "pose": {"position": _xyz(above), "orientation": _quaternion([1.0, 0.0, 0.0, 0.0])},
                    "billboard": True,
                    "font_size": 14,
                    "scale_invariant": True,
                    "color": {"r": 1.0, "g": 1.0, "b": 1.0, "a": 1.0},
                    "text": robot.name,
                }
            ]
    return []


def _primitives(shape: DrawnShape) -> dict[str, list[dict[str, Any]]]:
    """Return boxes as cubes, and all other shapes as triangles."""
    boxes = np.flatnonzero(shape.kind == BOX)
    rest = np.flatnonzero(shape.kind != BOX)
    cubes = [
        {
            "pose": {
                "position": _xyz(_short(shape.pos[box])),
                "orientation": _quaternion(_short(_quat_of(shape.mat[box]))),
            },
            "size": _xyz(_short(2 * shape.size[box])),
            "color": _colour(shape.rgb[box], 1.0 - float(shape.transparency[box])),
        }
        for box in boxes.tolist()
    ]
    picked = DrawnShape(**{name: values[rest] for name, values in vars(shape).items()})
    triangles = [
        {
            "pose": {"position": _xyz([0.0] * 3), "orientation": _quaternion([1.0, 0.0, 0.0, 0.0])},
            "points": [_xyz(corner) for corner in mesh.vertices.astype(float).round(DIGITS).tolist()],
            "color": _colour(mesh.rgb[0], finish.opacity),
            "colors": [_colour(rgb, finish.opacity) for rgb in mesh.rgb],
            "indices": mesh.faces.reshape(-1).tolist(),
        }
        for finish, mesh in (meshes_of(picked).items() if len(rest) else ())
    ]
    return {"cubes": cubes, "triangles": triangles}


def laser_scan(
    drawing: Drawing, robot: DrawnRobot, sensor: int, value: np.ndarray, time: float
) -> dict[str, Any]:
    """Return a reading of a plane scanner as `foxglove.LaserScan`; see `is_scanner`."""
    mount = robot.sensors[sensor]
    settings = mount.settings[0]
    first, apart = -float(settings["scan_fov"]) / 2, float(settings["resolution"])
    # JSON has no infinity.
    ranges = np.minimum(np.asarray(value, float).reshape(-1), float(settings["max_range"]))
    mat = mount.mat[0] if settings.get("yaw", True) else mount.mat[0] @ UPRIGHT
    return {
        "timestamp": stamp(time),
        "frame_id": frame_id(drawing, int(mount.body[0])),
        "pose": {
            "position": _xyz(_short(mount.pos[0])),
            "orientation": _quaternion(_short(_quat_of(mat))),
        },
        "start_angle": first,
        "end_angle": first + (len(ranges) - 1) * apart,
        "ranges": ranges.round(3).tolist(),
        "intensities": [],
    }


def is_scanner(robot: DrawnRobot, sensor: int) -> bool:
    """Return whether a robot's sensor scans a plane fan."""
    return robot.sensors[sensor].kind in SCANNERS


@dataclass
class _Trail:
    """Path of a robot so far, and the time of its next message [s]."""

    poses: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    last: list[float] = field(default_factory=list[float])
    step: float = TRAIL_STEP
    due: float = 0.0
    is_sent: bool = False


class Trails:
    """Paths of robots, as `foxglove.PosesInFrame`."""

    def __init__(self) -> None:
        self._trails: dict[str, _Trail] = {}

    def keep(self, names: Collection[str]) -> None:
        """Forget the paths of all robots but these: a robot that comes back begins a new path."""
        for name in self._trails.keys() - set(names):
            del self._trails[name]

    def add(self, name: str, robot: RobotFrame, time: float) -> dict[str, Any] | None:
        """Return a robot's path so far, if it has changed and is due."""
        trail, here = self._trails.setdefault(name, _Trail()), robot.pos.tolist()
        if not trail.poses or math.dist(here, trail.last) >= trail.step:
            trail.last, trail.is_sent = here, False
            trail.poses.append({"position": _xyz(here), "orientation": _quaternion(robot.quat.tolist())})
        if len(trail.poses) > MOST_POSES:
            # Every other one: the path keeps its length at half the resolution.
            del trail.poses[1::2]
            trail.step *= 2
        if trail.is_sent or time < trail.due:
            return None
        trail.is_sent, trail.due = True, time + TRAIL_PERIOD
        return {"timestamp": stamp(time), "frame_id": WORLD, "poses": trail.poses}


def log(text: str, name: str, time: float) -> dict[str, Any]:
    """Return a line as `foxglove.Log`."""
    return {"timestamp": stamp(time), "level": INFO, "message": text, "name": name, "file": "", "line": 0}


def _short(values: np.ndarray) -> list[float]:
    return np.asarray(values, float).round(DIGITS + 1).tolist()


def _xyz(values: list[float]) -> dict[str, float]:
    return {"x": values[0], "y": values[1], "z": values[2]}


def _quaternion(values: list[float]) -> dict[str, float]:
    """Return a quaternion, w first, by component names."""
    return {"x": values[1], "y": values[2], "z": values[3], "w": values[0]}


def _colour(rgb: np.ndarray, opacity: float) -> dict[str, float]:
    red, green, blue = np.asarray(rgb, float).round(3).tolist()
    return {"r": red, "g": green, "b": blue, "a": round(opacity, 3)}


def _quat_of(mat: np.ndarray) -> np.ndarray:
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.asarray(mat, float).reshape(9))
    return quat
