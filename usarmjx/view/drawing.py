"""What there is to see of a world, as values: a `Drawing` that stays, and `Frame`s, one after the other.

Whoever shows or keeps worlds knows these only, and a recording gives them back as a running world does. A
drawing consists of bodies that move as a whole: fixed things together, each part of a robot, each limb of a
victim, each loose object and door.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links
from usarmjx.sensors.sketch import OverlayLines

NOBODY = -1
"""Slot of what is no robot's."""
MAP_PREFIX, MAP_GRID = "map/", "grid of maps"
"""Names in `Frame.extra`."""
Setting = float | bool | str
"""Value of a setting of a sensor."""


@dataclass(frozen=True, eq=False)
class DrawnShape:
    """Solids that move together, in the axes of their body.

    Attributes:
        kind: MuJoCo types, or kinds of `models.build.pieces` (n,).
        pos: Centres, of triangles the first corners [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: MuJoCo's size numbers, or those that `models.build.pieces` tells of [m] (n, 3).
        rgb: Colours, in [0, 1] (n, 3).
        transparency: Share of what is behind that is seen through them (n,).
        material: What they are made of; members of `spec.MATERIALS` (n,).
    """

    kind: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    size: np.ndarray
    rgb: np.ndarray
    transparency: np.ndarray
    material: np.ndarray


@dataclass(frozen=True)
class DrawnBody:
    """Something that moves as a whole.

    Attributes:
        name: Its name, unique in its drawing: `arena`, `victim/3`, `door/0`, `loose/ball`, `robot/0/HARD`.
        shape: What it looks like, as a key of `Drawing.shapes`; several bodies may share one.
        slot: Slot of the robot that it belongs to, else `NOBODY`.
        label: What it is in a segmentation, see `cameras.paint`.
    """

    name: str
    shape: str
    slot: int
    label: int


@dataclass(frozen=True, eq=False)
class DrawnMount:
    """A sensor, several that report together, or a camera, on a robot.

    Attributes:
        kind: Type as on the wire.
        names: Names on the wire (mounts,).
        body: Index into `Drawing.bodies` of what each sits on (mounts,).
        pos: Where on it [m] (mounts, 3).
        mat: How turned on it; x looks ahead (mounts, 3, 3).
        settings: Settings of each, by their names in the sensor's settings; of a camera `fov` [rad], and
            `width` and `height` where a picture has a size of its own.
    """

    kind: str
    names: tuple[str, ...]
    body: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    settings: tuple[Mapping[str, Setting], ...]


@dataclass(frozen=True, eq=False)
class DrawnRobot:
    """What stays of a robot as long as it is there.

    Attributes:
        slot: Its slot.
        name: Its name on the wire.
        robot: Name of its class.
        body: Index into `Drawing.bodies` of its chassis; its other bodies follow.
        num_bodies: How many it has.
        dimensions: Length, width and height [m] (3,).
        joints: Names of its joints.
        sensors: Its sensors, in the order in which they report.
        cameras: Its cameras, one mount each.
        battery_life: How long its battery lasts when full [s].
        drive_keys: Keys of DRIVE that it has.
        headlight: Its headlight, which shines along x; None: it has none.
    """

    slot: int
    name: str
    robot: str
    body: int
    num_bodies: int
    dimensions: np.ndarray
    joints: tuple[str, ...]
    sensors: tuple[DrawnMount, ...]
    cameras: tuple[DrawnMount, ...]
    battery_life: float
    drive_keys: tuple[str, ...] = ()
    headlight: DrawnMount | None = None


@dataclass(frozen=True, eq=False)
class DrawnTag:
    """An RFID tag of the arena: its number and where it is [m] (3,)."""

    number: int
    pos: np.ndarray


@dataclass(frozen=True, eq=False)
class Drawing:
    """What stays of a world's looks until a robot joins or leaves, or the world gets another arena.

    Attributes:
        arena: Name of the arena.
        floor: Height of its floor [m].
        has_floor: Whether it has an unbounded floor there.
        extent: Least and largest x and y of what is worth seeing [m] (2, 2).
        shapes: What bodies look like.
        bodies: All bodies.
        robots: The robots, by slot.
        tags: The arena's RFID tags.
        lamps: Positions of the arena's lamps [m] (lamps, 3); with none the sun shines.
        lamp_rgb: Their brightness, 1 a metre away being white (lamps, 3).
        cutoff: Power from which on radio links hold [dBm].
    """

    arena: str
    floor: float
    has_floor: bool
    extent: np.ndarray
    shapes: Mapping[str, DrawnShape]
    bodies: tuple[DrawnBody, ...]
    robots: Mapping[int, DrawnRobot]
    tags: tuple[DrawnTag, ...]
    lamps: np.ndarray
    lamp_rgb: np.ndarray
    cutoff: float = RadioSettings().cutoff


@dataclass(frozen=True, eq=False)
class RobotFrame:
    """What changes of a robot.

    Attributes:
        pos: Where its chassis is [m] (3,).
        quat: How it is turned, w first (4,).
        linear: Its velocity in the world's axes [m/s] (3,).
        angular: Its angular velocity in its own axes [rad/s] (3,).
        joint_pos: Positions of its joints [rad or m] (joints,).
        battery: For how long its battery lasts yet [s].
        light: Whether its headlight is on.
        drive: What the keys of its DRIVE are set to (keys,).
        readings: Each sensor's last reading.
        fovs: Fields of view of its cameras [rad] (cameras,).
    """

    pos: np.ndarray
    quat: np.ndarray
    linear: np.ndarray
    angular: np.ndarray
    joint_pos: np.ndarray
    battery: float
    light: bool
    drive: np.ndarray
    readings: tuple[np.ndarray, ...]
    fovs: np.ndarray


@dataclass(frozen=True, eq=False)
class Frame:
    """A world at one moment.

    Attributes:
        time: Simulated time since the world began [s].
        pos: Where the bodies of the drawing are [m] (bodies, 3).
        quat: How they are turned, w first (bodies, 4).
        shown: Which of them are to be seen: robots that wait parked are not (bodies,).
        robots: The robots that are in use, by slot.
        dropped_tags: Where RFID tags that robots dropped lie [m] (tags, 3).
        overlays: What robots' sensors draw of their last readings.
        links: The radio links by slot; None without a radio.
        trace: Points that robots left behind, and their colours.
        score: A task's score so far; None without a task.
    """

    time: float
    pos: np.ndarray
    quat: np.ndarray
    shown: np.ndarray
    robots: Mapping[int, RobotFrame]
    dropped_tags: np.ndarray
    overlays: tuple[OverlayLines, ...] = ()
    links: Links | None = None
    trace: OverlayLines | None = None
    score: float | None = None
    extra: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    """What a task adds, by name. `MAP_PREFIX` with a robot's name: the map that it builds, squares as in
    `train.mapping.maps` (i, j); `MAP_GRID`: x and y of the middle of their first square, and its
    side [m] (3,)."""


class FrameSource(Protocol):
    """Where frames come from: worlds that run, or a recording."""

    @property
    def num_worlds(self) -> int:
        """How many worlds there are to choose from."""
        ...

    def drawing(self, world: int) -> Drawing:
        """Return a world's drawing: the same object as long as nothing of it has changed."""
        ...

    def frame(self, world: int) -> Frame:
        """Return a world as it is now."""
        ...
