"""The visible state of a world as values: a constant `Drawing`, and `Frame`s, one after the other.

Pages and recordings use only these, and a recording returns them like a running world. A drawing consists of
bodies that move as a whole: all fixed solids together, each part of a robot, each limb of a victim, each
loose object and door. Class and field names stand in recordings (`recording.values`): do not rename them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links
from usarmjx.sensors.sketch import OverlayLines

NOBODY = -1
"""Slot of a body that belongs to no robot."""
MAP_PREFIX, MAP_GRID = "map/", "grid of maps"
"""Names in `Frame.extra`."""
Setting = float | bool | str
"""Value of a setting of a sensor."""


@dataclass(frozen=True, eq=False)
class DrawnShape:
    """Solids that move together, in the axes of their body.

    Attributes:
        kind: MuJoCo types, or kinds of `models.compile.ray_geoms` (n,).
        pos: Centres, of triangles the first corners [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: MuJoCo's size numbers, or those of `models.compile.ray_geoms` [m] (n, 3).
        rgb: Colours, in [0, 1] (n, 3).
        transparency: Share of light that passes through (n,).
        material: Materials; members of `types.shapes.MATERIALS` (n,).
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
    """A body that moves as a whole.

    Attributes:
        name: Its name, unique in its drawing: `arena`, `victim/3`, `door/0`, `loose/ball`, `robot/0/HARD`.
        shape: Its shape, a key of `Drawing.shapes`; several bodies may share one.
        slot: Slot of the robot that it belongs to, else `NOBODY`.
        label: Its label in a segmentation, see `cameras.paint`.
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
        body: Index of each one's body in `Drawing.bodies` (mounts,).
        pos: Position on the body [m] (mounts, 3).
        mat: Orientation on the body; x points ahead (mounts, 3, 3).
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
    """The constant part of a robot.

    Attributes:
        slot: Its slot.
        name: Its name on the wire.
        robot: Name of its class.
        body: Index of its chassis in `Drawing.bodies`; its other bodies follow.
        num_bodies: Number of its bodies.
        dimensions: Length, width and height [m] (3,).
        joints: Names of its joints.
        sensors: Its sensors, in the order in which they report.
        cameras: Its cameras, one mount each.
        battery_life: Life of its full battery [s].
        drive_keys: Keys of DRIVE that it has.
        headlight: Its headlight, which shines along x; None without one.
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
    """An RFID tag of the arena: its number and its position [m] (3,)."""

    number: int
    pos: np.ndarray


@dataclass(frozen=True, eq=False)
class Drawing:
    """The constant part of a world's looks, until a robot joins or leaves, or the world gets another arena.

    Attributes:
        arena: Name of the arena.
        floor: Height of its floor [m].
        has_floor: Whether it has an unbounded floor there.
        extent: Least and largest x and y of the visible arena [m] (2, 2).
        shapes: Shapes of bodies.
        bodies: All bodies.
        robots: The robots, by slot.
        tags: The arena's RFID tags.
        lamps: Positions of the arena's lamps [m] (lamps, 3); without any the sun shines.
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
    """The variable part of a robot.

    Attributes:
        pos: Position of its chassis [m] (3,).
        quat: Its orientation, w first (4,).
        linear: Its velocity in the world's axes [m/s] (3,).
        angular: Its angular velocity in its own axes [rad/s] (3,).
        joint_pos: Positions of its joints [rad or m] (joints,).
        battery: Remaining time of its battery [s].
        light: Whether its headlight is on.
        drive: Setpoints of the keys of its DRIVE (keys,).
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
        pos: Positions of the drawing's bodies [m] (bodies, 3).
        quat: Their orientations, w first (bodies, 4).
        shown: Which of them are visible: parked robots are not (bodies,).
        robots: The robots that are in use, by slot.
        dropped_tags: Positions of RFID tags that robots dropped [m] (tags, 3).
        overlays: Overlays of the robots' sensors, from their last readings.
        links: The radio links by slot; None without a radio.
        trace: Points of the robots' traces, and their colours.
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
    """Additional arrays of a task, by name.

    `MAP_PREFIX` with a robot's name: the map that it builds, squares as in `train.mapping.maps` (i, j);
    `MAP_GRID`: x and y of the middle of their first square, and its side [m] (3,).
    """


class FrameSource(Protocol):
    """Source of frames: running worlds, or a recording."""

    @property
    def num_worlds(self) -> int:
        """Number of worlds to choose from."""
        ...

    def drawing(self, world: int) -> Drawing:
        """Return a world's drawing: the same object as long as nothing of it has changed."""
        ...

    def frame(self, world: int) -> Frame:
        """Return the present frame of a world."""
        ...
