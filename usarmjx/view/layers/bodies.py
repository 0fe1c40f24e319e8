"""Where sensors sit and what cameras see of."""

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat, matvec
from usarmjx.models.build.housings import HOUSING_RGBA, HOUSING_SIZE
from usarmjx.view.drawing import Drawing, DrawnMount, Frame
from usarmjx.view.layers.colors import robot_colors
from usarmjx.view.layers.mounts import quat_product, quats_of
from usarmjx.view.layers.nodes import InstanceNode, LineNode, NodeLayer

VIEW_LENGTH = 0.5
"""How far ahead of a camera the frame of its picture is drawn [m]."""
ASPECT = 3 / 4
"""Height of pictures, as a share of their width."""


def box() -> tuple[np.ndarray, np.ndarray]:
    """Return corners (8, 3) and triangles (12, 3) of a cube of side 2 about the origin."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


class SensorBodyLayer(NodeLayer):
    """A small box for each sensor, as HiddenSensor=false shows it in pictures."""

    name = "Sensor bodies"
    about = "a small box where each sensor sits, as HiddenSensor=false draws it"
    shown_at_first = False

    def draw(self, drawing: Drawing) -> None:
        """Gather the sensors of all robots; with HiddenSensor=false they are part of their robots."""
        slot, body, pos, mat = [], [], [], []
        for robot in drawing.robots.values():
            for mount in robot.sensors:
                hidden = [bool(settings.get("hidden_sensor", True)) for settings in mount.settings]
                slot += [robot.slot] * sum(hidden)
                body.append(mount.body[hidden])
                back = mount.pos - HOUSING_SIZE[0] * mount.mat[:, :, 0]
                pos.append(back[hidden])
                mat.append(mount.mat[hidden])
        self._slot = np.array(slot, int)
        self._body = np.concatenate([np.zeros(0, int), *body])
        self._pos = np.concatenate([np.zeros((0, 3)), *pos])
        self._turn = quats_of(np.concatenate([np.zeros((0, 3, 3)), *mat]))
        corners, faces = box()
        self._boxes = InstanceNode(self.scene, f"{self.root}/boxes", (corners * HOUSING_SIZE, faces))
        self._rgb = (255 * np.array(HOUSING_RGBA[:3])).astype(np.uint8)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Move them along with what they sit on."""
        del drawing
        there = np.isin(self._slot, list(frame.robots))
        body, count = self._body[there], int(there.sum())
        quat = frame.quat[body]
        with numpy_backend():
            offset = np.asarray(matvec(mat_from_quat(quat), self._pos[there]))
        turns = quat_product(quat, self._turn[there])
        self._boxes.set(frame.pos[body] + offset, turns, np.ones(count), np.tile(self._rgb, (count, 1)))


def view_lines(fov: np.ndarray) -> np.ndarray:
    """Return the edges of what cameras see, in their axes [m] (cameras, 8, 2, 3).

    Args:
        fov: Horizontal fields of view [rad] (cameras,).
    """
    wide = VIEW_LENGTH * np.tan(np.minimum(fov, 2.8) / 2)
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    corners = np.stack(
        [
            np.full((len(wide), 4), VIEW_LENGTH),
            wide[:, None] * signs[:, 0],
            ASPECT * wide[:, None] * signs[:, 1],
        ],
        -1,
    )
    rim = np.stack([corners, np.roll(corners, -1, 1)], 2)
    return np.concatenate([np.stack([np.zeros_like(corners), corners], 2), rim], 1)


class CameraLayer(NodeLayer):
    """What cameras see of: the edges of their pictures."""

    name = "Camera views"
    about = "where cameras sit and look: the edges of their pictures"
    shown_at_first = False

    def draw(self, drawing: Drawing) -> None:
        """Look which cameras there are; mirrors look all around and have no edges."""
        self._cameras: list[tuple[int, int, DrawnMount]] = [
            (slot, place, mount)
            for slot, robot in drawing.robots.items()
            for place, mount in enumerate(robot.cameras)
            if mount.settings[0].get("lens", "pinhole") == "pinhole"
        ]
        self._lines = LineNode(self.scene, f"{self.root}/lines", width=1.5)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Follow pan, tilt and zoom."""
        del drawing
        there = [one for one in self._cameras if one[0] in frame.robots]
        fov = np.array([frame.robots[slot].fovs[place] for slot, place, _ in there], float)
        body = np.array([mount.body[0] for _, _, mount in there], int)
        local = np.array([mount.mat[0] for _, _, mount in there]).reshape(-1, 3, 3)
        at = np.array([mount.pos[0] for _, _, mount in there]).reshape(-1, 3)
        with numpy_backend():
            turn = np.asarray(mat_from_quat(frame.quat[body]))
        pos = frame.pos[body] + np.einsum("nij,nj->ni", turn, at)
        edges = pos[:, None, None] + np.einsum("nij,nklj->nkli", turn @ local, view_lines(fov))
        rgb = np.repeat(robot_colors(np.array([slot for slot, _, _ in there], int)), 8, axis=0)
        self._lines.set(edges.reshape(-1, 2, 3), rgb)
