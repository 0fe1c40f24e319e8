"""Viewpoint of each user of the page: free, over a robot, or through its camera (manual 5.1)."""

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from usarmjx.view.drawing import NOBODY, Drawing, DrawnRobot, Frame
from usarmjx.view.mesh import BOX

DIRECTION = math.radians(-115.0), math.radians(50.0)
"""Direction of the first viewpoint from the world's middle: azimuth and elevation [rad]."""
ROWS_DIRECTION = math.radians(-90.0), math.radians(62.0)
"""Direction to worlds side by side: their rows are level in the picture."""
FOV = math.radians(50.0)
"""Vertical field of view of the first viewpoint [rad]."""
FILL_SHARE = 0.94
"""Share of the picture's width or height that the world fills, whichever is full first."""
RETREAT, MAX_RETREATS, RETREAT_SHIFTS = 1.03, 60, 7
"""Factor of the distance, most of them, and tried places, until a corner of the picture is free."""
MIN_HEIGHT = 1.0
"""Least height of a world for the first viewpoint [m]."""
UP = np.array([0.0, 0.0, 1.0])
OCCLUDER_TRANSPARENCY = 0.5
"""Transparency from which a solid does not hide a robot."""
CHASE_BEHIND, CHASE_ABOVE = (0.6, 2.0), (0.4, 1.2)
"""Distance of the view behind and above a robot: [m], and lengths of the robot (chosen)."""
MAX_ELEVATION, ELEVATIONS = math.radians(85.0), 6
"""Steepest elevation where walls hide a robot [rad], and number of tried ones."""
WALL_GAP = 0.15
"""Distance of the view over a robot from a wall that is in its way [m]."""
MAX_RISE, MAX_SINK = 0.15, 0.02
"""Largest change of the elevation in an update, up and down [rad]: quickly out of a wall, and slowly back."""
LOOK_AHEAD = 1.0
"""Distance of the pivot in front of a robot's camera, about which the mouse turns the picture [m]."""
# Browsers report cameras in single precision, and late.
FRAMED_TOLERANCE, MAX_FRAMED = 1e-3, 4
"""Share of its position within which a camera counts as unmoved, and most remembered positions."""
PICK_MARGIN = 0.15
"""Distance beside a robot up to which a click selects it [m]."""


@dataclass(frozen=True, eq=False)
class CameraPose:
    """Position and target of a camera [m], both (3,), and the upward direction of its picture (3,)."""

    pos: np.ndarray
    look_at: np.ndarray
    up: np.ndarray


def bounds_of(drawing: Drawing) -> tuple[np.ndarray, np.ndarray]:
    """Return least and largest x, y and z of a drawing's visible bodies [m], both (3,)."""
    low, high = drawing.extent.T
    tops = [drawing.floor + MIN_HEIGHT]
    # Robots move about, and would zoom the first view with them.
    for shape in (drawing.shapes[body.shape] for body in drawing.bodies if body.slot == NOBODY):
        boxes = shape.kind == BOX
        # Half the height of a turned box: what its half axes have along z.
        upward = (np.abs(shape.mat[boxes, 2]) * shape.size[boxes]).sum(1)
        tops += (shape.pos[boxes, 2] + upward).tolist()
    return np.array([*low, drawing.floor]), np.array([*high, max(tops)])


def fit_box(
    low: np.ndarray,
    high: np.ndarray,
    aspect: float = 1.6,
    corner: tuple[float, float] = (0.0, 0.0),
    direction: tuple[float, float] = DIRECTION,
) -> CameraPose:
    """Return the pose from which a box fills the picture.

    Args:
        low: Its least x, y and z [m] (3,).
        high: Its largest x, y and z [m] (3,).
        aspect: Width of the picture over its height.
        corner: Shares of the picture's width and height, at the upper left, that the box leaves free.
        direction: Direction of the viewpoint from the box: azimuth and elevation [rad].
    """
    framing = _Framing(
        np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T, aspect, direction
    )
    target, distance = framing.fitted()
    if any(corner):
        target, distance = framing.beside(corner, target, distance)
    return CameraPose(target - distance * framing.ahead, target, UP)


class _Framing:
    """Corners of a box (8, 3) [m] in a picture of some aspect, seen from a direction."""

    def __init__(self, corners: np.ndarray, aspect: float, direction: tuple[float, float]) -> None:
        self._corners = corners
        azimuth, elevation = direction
        self.ahead = -np.array(
            [
                math.cos(elevation) * math.cos(azimuth),
                math.cos(elevation) * math.sin(azimuth),
                math.sin(elevation),
            ]
        )
        right = np.cross(self.ahead, UP)
        right /= np.linalg.norm(right)
        self._axes = np.stack([right, np.cross(right, self.ahead)])
        # viser's field of view is vertical; the width follows from the aspect.
        self._half = math.tan(FOV / 2) * np.array([aspect, 1.0])

    def fitted(self) -> tuple[np.ndarray, float]:
        """Return target [m] (3,) and distance [m] at which the box fills the middle of the picture."""
        low, high = self._corners.min(0), self._corners.max(0)
        target, distance = (low + high) / 2, 1.0
        # Perspective enlarges the near side: the target moves until both sides have the same margin.
        for _ in range(4):
            around = self._corners - target
            depth, across = around @ self.ahead, np.abs(around @ self._axes.T)
            # A corner is inside if its offset across is at most half the picture times distance plus depth.
            distance = max(float((across / (self._half * FILL_SHARE) - depth[:, None]).max()), 0.5)
            seen = self._seen(target, distance)
            # The pictured middle, back from shares of the picture to metres at the target's distance.
            target = target + distance / 2 * ((seen.max(0) + seen.min(0)) * self._half) @ self._axes
        return target, distance

    def beside(
        self, corner: tuple[float, float], target: np.ndarray, distance: float
    ) -> tuple[np.ndarray, float]:
        """Return the nearest target and distance at which a corner of the picture stays free.

        The box moves to the right and down as far as it must, and away if that is not enough.
        """
        # From shares of the upper left to coordinates from -1 to 1, up positive.
        edge = np.array([2 * corner[0] - 1, 1 - 2 * corner[1]])
        for away in distance * RETREAT ** np.arange(MAX_RETREATS):
            centred = self._moved(target, away, np.array([0.5, 0.5]))
            aside = self._moved(target, away, np.array([1.0, 0.0]))
            for share in np.linspace(0.0, 1.0, RETREAT_SHIFTS):
                shifted = (1 - share) * centred + share * aside
                if not self._covers(self._seen(shifted, away), edge):
                    return shifted, float(away)
        return target, distance

    def _seen(self, target: np.ndarray, distance: float) -> np.ndarray:
        """Return where the corners are in the picture, from -1 to 1 to the right and up (8, 2)."""
        around = self._corners - target
        return around @ self._axes.T / (distance + around @ self.ahead)[:, None] / self._half

    def _moved(self, target: np.ndarray, distance: float, place: np.ndarray) -> np.ndarray:
        """Return the target that puts the box at a place: shares of the room to the right and up (2,)."""
        for _ in range(4):
            seen = self._seen(target, distance)
            low, high = seen.min(0), seen.max(0)
            room = np.maximum(2 * FILL_SHARE - (high - low), 0.0)
            # A share of 0 is the lower left: there the box's lower edge is at -FILL_SHARE.
            move = place * room - FILL_SHARE - low
            target = target - distance * (move * self._half) @ self._axes
        return target

    @staticmethod
    def _covers(seen: np.ndarray, edge: np.ndarray) -> bool:
        """Return whether the hull of points (8, 2) reaches the corner left of and above an edge (2,)."""
        # The edge between two corners may reach in where neither of them does.
        share = np.linspace(0.0, 1.0, 33)[:, None, None, None]
        between = seen[:, None] + share * (seen[None] - seen[:, None])
        return bool(((between[..., 0] < edge[0]) & (between[..., 1] > edge[1])).any())


class Walls:
    """The opaque boxes of a drawing that do not move.

    Args:
        drawing: The drawing.
    """

    def __init__(self, drawing: Drawing) -> None:
        # Loose objects and doors move: their poses at the start would soon be wrong.
        still = [body.shape for body in drawing.bodies if body.slot == NOBODY and body.name == "arena"]
        shapes = [drawing.shapes[name] for name in still]
        kept = [(shape.kind == BOX) & (shape.transparency < OCCLUDER_TRANSPARENCY) for shape in shapes]
        pairs = [*zip(shapes, kept, strict=True)]
        # An empty first part, as a drawing may have no walls.
        self._pos = np.concatenate([np.zeros((0, 3)), *(shape.pos[one] for shape, one in pairs)])
        self._mat = np.concatenate([np.zeros((0, 3, 3)), *(shape.mat[one] for shape, one in pairs)])
        self._size = np.concatenate([np.zeros((0, 3)), *(shape.size[one] for shape, one in pairs)])

    def occluded(self, start: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return which points are hidden from a viewpoint (points,).

        Args:
            start: The viewpoint [m] (3,).
            ends: The points [m] (points, 3).
        """
        if not len(self._pos):
            return np.zeros(len(ends), bool)
        begin = np.einsum("bj,bji->bi", start - self._pos, self._mat)
        along = np.einsum("ej,bji->ebi", ends - start, self._mat)
        # A ray parallel to a side would divide by 0.
        along = np.where(np.abs(along) < 1e-9, 1e-9, along)
        sides = np.sort([(-self._size - begin) / along, (self._size - begin) / along], axis=0)
        enters, leaves = sides[0].max(-1), sides[1].min(-1)
        # A ray is in a box while it is between all three pairs of sides, here within the way to the point.
        return ((enters <= leaves) & (enters < 1.0) & (leaves > 0.0)).any(-1)

    def free_share(self, start: np.ndarray, end: np.ndarray) -> float:
        """Return the share of the way between two points (3,) [m] before the first wall, up to 1.

        A wall around the first point does not count.
        """
        if not len(self._pos):
            return 1.0
        begin = np.einsum("bj,bji->bi", start - self._pos, self._mat)
        along = np.einsum("j,bji->bi", end - start, self._mat)
        along = np.where(np.abs(along) < 1e-9, 1e-9, along)
        sides = np.sort([(-self._size - begin) / along, (self._size - begin) / along], axis=0)
        enters, leaves = sides[0].max(-1), sides[1].min(-1)
        met = (enters <= leaves) & (enters > 0.0)
        return float(np.clip(enters[met].min(initial=1.0), 0.0, 1.0))


class Chase:
    """View over robots of a drawing that no wall hides: it rises, and where that does not do, comes closer.

    Args:
        drawing: The drawing.
        follow: Share of a turn of the robot that one update follows; 1: all of it.
    """

    def __init__(self, drawing: Drawing, follow: float = 1.0) -> None:
        self.drawing, self._follow = drawing, follow
        self._walls = Walls(drawing)
        self.restart()

    def restart(self) -> None:
        """Forget the last pose, as for another robot."""
        self._elevation: float | None = None
        self._ahead: np.ndarray | None = None

    def pose(self, robot: DrawnRobot, frame: Frame) -> CameraPose:
        """Return the next pose over a robot; it changes gradually."""
        ahead = _heading_of(robot, frame)
        if self._ahead is not None:
            ahead = self._ahead + self._follow * (ahead - self._ahead)
            length = float(np.linalg.norm(ahead))
            # Half a turn in one update may pass through no direction at all.
            ahead = ahead / length if length > 1e-3 else _heading_of(robot, frame)
        self._ahead = ahead
        wanted = clear_elevation(self._walls, robot, frame, ahead)
        if self._elevation is None:
            self._elevation = wanted
        self._elevation += float(np.clip(wanted - self._elevation, -MAX_SINK, MAX_RISE))
        pose = chase_pose(robot, frame, self._elevation, ahead)
        top = frame.pos[robot.body] + 0.5 * float(robot.dimensions[2]) * UP
        way = pose.pos - top
        share = self._walls.free_share(top, pose.pos)
        if share >= 1.0:
            return pose
        length = float(np.linalg.norm(way))
        # At least half of the way: closer, the robot alone would fill the picture.
        near = max(share * length - WALL_GAP, share * length / 2)
        return CameraPose(top + near / length * way, pose.look_at, pose.up)


class ViewMode(Enum):
    """Kind of attachment of a view; the value is its name on the page."""

    FREE = "Free"
    OVER = "Over it"
    CAMERA = "Its camera"


@dataclass
class Viewer:
    """A user of the page.

    Attributes:
        client: Client of viser.
        robot: Slot of the robot that the view is attached to; None: it is free.
        mode: Kind of attachment.
        camera: Index of the robot's camera that it looks through.
        aspect: Aspect of the picture for which `frame` was last called.
        framed: Positions of the camera that the user has not chosen [m], each (3,).
    """

    client: viser.ClientHandle
    robot: int | None = None
    mode: ViewMode = ViewMode.FREE
    camera: int = 0
    aspect: float = 1.0
    framed: list[np.ndarray] = field(default_factory=list[np.ndarray], repr=False)
    _last_pose: CameraPose | None = field(default=None, repr=False)
    _chase: Chase | None = field(default=None, repr=False)

    def attach(self, robot: int | None) -> None:
        """Attach to a robot in the present mode, or at first to its camera, as the viewing client did."""
        # Without a last pose, the next update moves the camera even if the pose is the same by chance.
        self.robot, self.camera, self._last_pose, self._chase = robot, 0, None, None
        if robot is None:
            self.mode = ViewMode.FREE
        elif self.mode is ViewMode.FREE:
            self.mode = ViewMode.CAMERA

    def attach_next(self, drawing: Drawing, frame: Frame, step: int = 1) -> None:
        """Attach to the next robot, or to the previous one; the first follows the last."""
        # Robots that have left stay in the drawing until the next one.
        slots = sorted(drawing.robots.keys() & frame.robots.keys())
        if not slots:
            self.attach(None)
        elif self.robot in slots:
            self.attach(slots[(slots.index(self.robot) + step) % len(slots)])
        else:
            self.attach(slots[0 if step > 0 else -1])

    def toggle(self) -> None:
        """Switch between a robot's camera and the view over it."""
        if self.robot is not None:
            self.mode = ViewMode.OVER if self.mode is ViewMode.CAMERA else ViewMode.CAMERA
            self._last_pose = self._chase = None

    def update(self, drawing: Drawing, frame: Frame, offset: np.ndarray) -> None:
        """Move the view with the robot.

        Args:
            drawing: Drawing of its world.
            frame: Present frame of the world.
            offset: Displacement of the world on the stage [m] (3,).
        """
        if self.robot is None:
            return
        if self.robot not in drawing.robots or self.robot not in frame.robots:
            self.attach(None)
            self._set_fov(FOV)
            return
        robot = drawing.robots[self.robot]
        if self.mode is ViewMode.CAMERA and robot.cameras:
            self.camera %= len(robot.cameras)
            self._move(camera_pose(robot, frame, self.camera), offset)
            # Fields of view of cameras are horizontal, viser's are vertical.
            half = math.tan(float(frame.robots[self.robot].fovs[self.camera]) / 2)
            self._set_fov(2 * math.atan(half / self.client.camera.aspect))
        else:
            # Another drawing has other walls.
            if self._chase is None or self._chase.drawing is not drawing:
                self._chase = Chase(drawing)
            self._move(self._chase.pose(robot, frame), offset)
            self._set_fov(FOV)

    @property
    def is_untouched(self) -> bool:
        """Whether the view is where `frame` put it: the user has neither moved nor attached it."""
        # The browser tells late where its camera is, so that earlier places count, too.
        return self.robot is None and any(self._is_at(place) for place in self.framed)

    @property
    def is_fitted(self) -> bool:
        """Whether the view is where `frame` put it last."""
        return bool(self.framed) and self._is_at(self.framed[-1])

    def _is_at(self, place: np.ndarray) -> bool:
        distance = np.linalg.norm(np.asarray(self.client.camera.position) - place)
        return bool(distance < FRAMED_TOLERANCE * np.linalg.norm(place))

    def frame(self, pose: CameraPose, aspect: float) -> None:
        """Move a free view to a pose that was fitted for an aspect of its picture."""
        # The same pose again must not push out earlier ones, at which a slow browser may still be.
        if not (self.framed and np.array_equal(self.framed[-1], pose.pos)):
            self.framed = [*self.framed[-MAX_FRAMED + 1 :], pose.pos]
        self.aspect = aspect
        move_camera(self.client, pose)

    def free(self) -> None:
        """Detach from the robot, and keep the viewpoint."""
        self.attach(None)
        self._set_fov(FOV)

    def _move(self, pose: CameraPose, offset: np.ndarray) -> None:
        last = self._last_pose
        moved = last is None or any(
            not np.allclose(one, other, atol=1e-4)
            for one, other in ((pose.pos, last.pos), (pose.look_at, last.look_at), (pose.up, last.up))
        )
        if not moved:
            return
        self._last_pose = pose
        move_camera(self.client, CameraPose(pose.pos + offset, pose.look_at + offset, pose.up))

    def _set_fov(self, fov: float) -> None:
        # Each assignment is a message to the browser.
        if abs(self.client.camera.fov - fov) > 1e-3:
            self.client.camera.fov = fov


def move_camera(client: viser.ClientHandle, pose: CameraPose) -> None:
    """Move a user's camera, in one message."""
    with client.atomic():
        client.camera.up_direction = pose.up
        # The target comes after the position: viser moves the target along with a new position.
        client.camera.position = pose.pos
        client.camera.look_at = pose.look_at


def camera_pose(robot: DrawnRobot, frame: Frame, camera: int) -> CameraPose:
    """Return the present pose of a robot's camera."""
    mount = robot.cameras[camera]
    body = int(mount.body[0])
    turn = _turn(frame, body)
    pos, mat = frame.pos[body] + turn @ mount.pos[0], turn @ mount.mat[0]
    return CameraPose(pos, pos + LOOK_AHEAD * mat[:, 0], mat[:, 2])


def chase_pose(
    robot: DrawnRobot, frame: Frame, elevation: float | None = None, ahead: np.ndarray | None = None
) -> CameraPose:
    """Return the pose of the view over a robot: behind and above it, however it leans.

    Args:
        robot: The robot.
        frame: Present frame of the world.
        elevation: Elevation of the view [rad]; None: that over open ground.
        ahead: Level unit vector of the view (3,); None: the robot's heading.
    """
    pos, ahead = frame.pos[robot.body], _heading_of(robot, frame) if ahead is None else ahead
    distance, angle = _chase(robot)
    angle = angle if elevation is None else elevation
    aside = distance * (math.sin(angle) * UP - math.cos(angle) * ahead)
    return CameraPose(pos + aside, pos + 0.5 * float(robot.dimensions[0]) * ahead, UP)


def clear_elevation(walls: Walls, robot: DrawnRobot, frame: Frame, ahead: np.ndarray | None = None) -> float:
    """Return the elevation over a robot from which no wall hides it, or the usual one [rad]."""
    pos, ahead = frame.pos[robot.body], _heading_of(robot, frame) if ahead is None else ahead
    distance, usual = _chase(robot)
    angles = np.linspace(usual, MAX_ELEVATION, ELEVATIONS)[:, None]
    eyes = pos + distance * (np.sin(angles) * UP - np.cos(angles) * ahead)
    hidden = walls.occluded(pos + 0.5 * float(robot.dimensions[2]) * UP, eyes)
    # The first free elevation; where none is free argmin gives the first, the usual one.
    return float(angles[int(np.argmin(hidden)), 0])


def _heading_of(robot: DrawnRobot, frame: Frame) -> np.ndarray:
    """Return the level unit vector of a robot's heading (3,)."""
    ahead = _turn(frame, robot.body)[:, 0] * [1.0, 1.0, 0.0]
    norm = float(np.linalg.norm(ahead))
    # A robot that stands on its nose has no heading.
    return ahead / norm if norm > 1e-3 else np.array([1.0, 0.0, 0.0])


def _chase(robot: DrawnRobot) -> tuple[float, float]:
    """Return distance [m] and elevation [rad] of the view over a robot on open ground."""
    length = float(robot.dimensions[0])
    behind, above = (fixed + share * length for fixed, share in (CHASE_BEHIND, CHASE_ABOVE))
    return math.hypot(behind, above), math.atan2(above, behind)


def robot_on_ray(drawing: Drawing, frame: Frame, start: np.ndarray, ray: np.ndarray) -> int | None:
    """Return the slot of the nearest robot that a ray hits; None without one.

    Args:
        drawing: The robots' sizes.
        frame: Their poses.
        start: Start of the ray [m] (3,).
        ray: Its unit direction (3,).
    """
    hits: list[tuple[float, int]] = []
    for slot, robot in drawing.robots.items():
        if slot not in frame.robots:
            continue
        turn = _turn(frame, robot.body)
        half = robot.dimensions / 2 + PICK_MARGIN
        middle = frame.pos[robot.body] + turn[:, 2] * robot.dimensions[2] / 4
        distance = _box_distance((start - middle) @ turn, ray @ turn, half)
        if distance is not None:
            hits.append((distance, slot))
    return min(hits)[1] if hits else None


def _box_distance(start: np.ndarray, ray: np.ndarray, half: np.ndarray) -> float | None:
    """Return the distance along a ray to a box about the origin [m]; None if the ray misses it."""
    # A ray parallel to a side would divide by 0.
    ray = np.where(np.abs(ray) < 1e-9, 1e-9, ray)
    sides = np.sort([(-half - start) / ray, (half - start) / ray], axis=0)
    enters, leaves = sides[0].max(), sides[1].min()
    # A box around the start is entered behind it; one behind the start is left before 0.
    return max(float(enters), 0.0) if leaves >= max(float(enters), 0.0) else None


def _turn(frame: Frame, body: int) -> np.ndarray:
    return Rotation.from_quat(frame.quat[body], scalar_first=True).as_matrix()
