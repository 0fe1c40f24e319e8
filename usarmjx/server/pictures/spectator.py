"""What somebody who watches a served world sees: the viewing client's keys and buttons (manual 5.1, 9.4).

The left button attaches the view to a robot, again to the next one, and after the last one to the MultiView,
if there is one. The right button returns to the free view, which mouse and keyboard move. `C` changes between
what an attached robot's cameras see and a chase camera.
"""

import json
import math
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.errors import PeerError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sensors.cameras.picture import HIDDEN_GEOMS_MULTIPLE, Viewpoint
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE
from usarmjx.server.pictures.views import CompositeView, all_robots_view, robot_view
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld, ViewpointRequest

FOV = math.radians(75.0)
"""Field of view of the free view and of the chase camera [rad] (chosen)."""
STEEPEST = math.radians(89.0)
"""The free view looks up and down by no more than this [rad]."""
MAX_MOVE, MAX_TURN = 5.0, math.pi
"""The free view moves [m] and turns [rad] by no more than this at once."""
CHASE_BEHIND, CHASE_ABOVE = (1.0, 1.6), (0.6, 0.9)
"""The chase camera is so far behind and above a robot's origin: [m], and lengths of the robot (chosen)."""
MAX_BRACKETS, MAX_DIGITS = 8, 20
"""A message has no more opening brackets than this, and its whole numbers no more digits."""
LOOK_DOWN = math.radians(30.0)
"""It looks down by so much [rad]."""


def viewpoint_at(pos: Array, yaw: float, pitch: float) -> Viewpoint:
    """Return the viewpoint of nobody's camera.

    Args:
        pos: Where [m] (3,).
        yaw: To the left of the x axis [rad].
        pitch: Downwards [rad].
    """
    return Viewpoint(
        pos=np.asarray(pos, np.float32),
        mat=mat_from_angles(0.0, pitch, yaw).astype(np.float32),
        eye_offsets=np.zeros((1, 3)),
        fov=np.array(FOV, np.float32),
        default_fov=np.array(FOV, np.float32),
        slot=np.asarray(EXCLUDE_NONE),
        hidden_geoms=np.zeros(HIDDEN_GEOMS_MULTIPLE, bool),
        lens="pinhole",
    )


def read_message(text: str | bytes) -> object:
    """Return what a page says; None if it is not JSON.

    Raises:
        PeerError: It is nothing that our page says: nested, or with endless numbers.
    """
    text = text if isinstance(text, str) else text.decode("utf-8", "replace")
    if text.count("[") + text.count("{") > MAX_BRACKETS:
        raise PeerError(f"a message has at most {MAX_BRACKETS} opening brackets")
    try:
        return json.loads(text, parse_int=_whole)
    except ValueError:
        return None


def start_position(arena: ArenaSpec) -> np.ndarray:
    """Return where the free view begins: outside the arena's lower corner, as high as half its width (3,)."""
    (west, east), (south, north) = arena.extent
    height = max(2.0, min(30.0, max(east - west, north - south) / 2))
    return np.array([west, south, arena.floor + height])


@dataclass
class Spectator:
    """Somebody who watches.

    Attributes:
        world: The served world.
        size: Width and height of the pictures [pixels].
        robot: The robot that the view is attached to; None: it is free, or the MultiView.
        chase: Whether an attached view is the chase camera's.
        show_multi_view: Whether it is the MultiView.
    """

    world: ServedWorld
    size: tuple[int, int]
    robot: Robot | None = None
    chase: bool = False
    show_multi_view: bool = False
    pos: np.ndarray = field(init=False)
    yaw: float = field(init=False)
    pitch: float = field(init=False)

    def __post_init__(self) -> None:
        """Begin above a corner, looking at the arena's middle."""
        arena = self.world.arena
        self.pos = start_position(arena)
        middle = np.mean(arena.extent, axis=1)
        away = middle - self.pos[:2]
        self.yaw = math.atan2(away[1], away[0])
        self.pitch = math.atan2(self.pos[2] - arena.floor, float(np.hypot(*away)))

    def handle_message(self, message: object) -> None:
        """Take what the page says; what is not understood is skipped.

        Args:
            message: A mapping with `click` (left, right), `key` (c), `move` (metres forward, to the left and
                up) or `turn` (radians to the left and down).
        """
        if not isinstance(message, dict):
            return
        message = cast(dict[object, object], message)
        if message.get("click") == "left":
            self._next()
        elif message.get("click") == "right":
            self.robot, self.show_multi_view = None, False
        if message.get("key") in ("c", "C"):
            self.chase = not self.chase
        if self.robot is None and not self.show_multi_view:
            self._move(*_numbers(message.get("move"), 3, MAX_MOVE))
            self._turn(*_numbers(message.get("turn"), 2, MAX_TURN))

    def view(self) -> CompositeView:
        """Return what to show now."""
        robot = self._attached()
        if self.show_multi_view:
            return all_robots_view(self.world, self.size)
        if robot is None:
            return self._from(viewpoint_at(self.pos, self.yaw, self.pitch))
        if robot.cameras and not self.chase:
            return robot_view(robot, "", self.size)
        return self._from(self._chase_viewpoint(robot))

    def eye(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return from where it looks: position [m] (3,) and orientation (3, 3); None: from several places."""
        tiles = self.view().tiles
        if len(tiles) != 1:
            return None
        viewpoint = self.world.viewpoint(tiles[0][0])
        return np.asarray(viewpoint.pos), np.asarray(viewpoint.mat)

    def caption(self) -> str:
        """Return what it is, in words."""
        robot = self._attached()
        if self.show_multi_view:
            return "MultiView"
        if robot is None:
            return "free view"
        chase = self.chase or not robot.cameras
        return f"{robot.name}, {robot.spec.name}{': over it' if chase else ''}"

    def _from(self, viewpoint: Viewpoint) -> CompositeView:
        return CompositeView(self.size, ((ViewpointRequest(viewpoint, *self.size), 0, 0),))

    def _attached(self) -> Robot | None:
        """Return the robot that the view is attached to; free again if that has gone."""
        if self.robot is not None and self.world.robots.get(self.robot.slot) is not self.robot:
            self.robot = None
        return self.robot

    def _next(self) -> None:
        robots = [robot for _, robot in sorted(self.world.robots.items())]
        now = robots.index(self.robot) if self._attached() in robots and self.robot is not None else -1
        last = now == len(robots) - 1
        if self.world.multi_view is not None and last and not self.show_multi_view:
            self.robot, self.show_multi_view = None, True
        elif robots:
            self.robot, self.show_multi_view = robots[0 if last else now + 1], False

    def _chase_viewpoint(self, robot: Robot) -> Viewpoint:
        """Return the chase camera: behind and above the robot in its heading, looking down on it."""
        state, length = self.world.state(robot), max(robot.spec.dimensions[:2])
        ahead = np.asarray(mat_from_quat(state.quat))[:2, 0]
        yaw = math.atan2(ahead[1], ahead[0])
        behind, above = (at + share * length for at, share in (CHASE_BEHIND, CHASE_ABOVE))
        offset = np.array([-behind * math.cos(yaw), -behind * math.sin(yaw), above])
        return viewpoint_at(np.asarray(state.pos) + offset, yaw, LOOK_DOWN)

    def _move(self, forward: float, left: float, up: float) -> None:
        flat = np.array([[math.cos(self.yaw), -math.sin(self.yaw)], [math.sin(self.yaw), math.cos(self.yaw)]])
        along = forward * math.cos(self.pitch)
        self.pos[:2] += flat @ (along, left)
        self.pos[2] += up - forward * math.sin(self.pitch)

    def _turn(self, left: float, down: float) -> None:
        self.yaw = math.remainder(self.yaw + left, 2 * math.pi)
        self.pitch = min(max(self.pitch + down, -STEEPEST), STEEPEST)


def _whole(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise PeerError(f"a number has at most {MAX_DIGITS} digits")
    return int(digits)


def _numbers(given: object, count: int, most: float) -> list[float]:
    """Return so many numbers, none larger than `most`; zeros if they are not that."""
    values = cast(list[object], given) if isinstance(given, list) else []
    if len(values) != count:
        return [0.0] * count
    finite = [float(one) for one in values if isinstance(one, int | float) and math.isfinite(one)]
    return [min(max(number, -most), most) for number in finite] if len(finite) == count else [0.0] * count
