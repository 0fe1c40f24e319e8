"""Robots driven from place to place on C MuJoCo, and what they touch on the way."""

import math

import numpy as np

AIM = 0.25  # rad: further off than this, turn in place
NEAR = 0.12  # m: close enough to a place
TURN = 4.0  # rad/s of the wheels when turning in place, per radian


class ArenaRoute:
    """Drives a skid-steered robot of a rig along places.

    Attributes:
        path: Position and up axis after each control step (steps, 4).
        touched: How long it touched something other than the ground [s].
        deepest: How deep it was in any of that [m].
    """

    def __init__(self, rig):
        self.rig = rig
        self.touched = self.deepest = 0.0
        self._rows = []
        self._root = rig.indices[0].root_qposadr
        robot = np.isin(rig.model.geom_bodyid, rig.indices[0].body_ids)
        self._robot = robot
        self._wall = ~robot & np.array([rig.model.geom(g).name != "floor" for g in range(rig.model.ngeom)])

    def ignore(self, geoms):
        """Do not count touching those geoms."""
        self._wall[list(geoms)] = False
        return self

    def to(self, places, speed=0.4, limit=30.0):
        """Drive to each of the places in turn, within so many seconds each; returns whether it got there."""
        return all(self._to(np.array(place), speed, limit) for place in places)

    def _to(self, place, speed, limit):
        drive = self.rig.robot.drive
        for _ in range(round(limit * 50)):
            pos, mat = self.rig.data.qpos[self._root :][:2], self.rig.mat("chassis")
            way = place - pos
            if np.hypot(*way) < NEAR:
                return True
            error = math.remainder(math.atan2(way[1], way[0]) - math.atan2(mat[1, 0], mat[0, 0]), 2 * math.pi)
            ahead = speed / drive.radius if abs(error) < AIM else 0.0
            turn = float(np.clip(TURN * error, -3.0, 3.0))
            self.rig.tell(Left=ahead - turn, Right=ahead + turn)
            self.step()
        return False

    def step(self):
        """Go on for one control step, looking at what is touched."""
        rig = self.rig
        rig.step()
        self._rows.append(np.r_[rig.data.qpos[self._root :][:3], rig.up[0]])
        contact = rig.data.contact
        hits = (self._robot[contact.geom] & self._wall[contact.geom[:, ::-1]]).any(-1)
        hits &= contact.dist < 0
        if hits.any():
            self.touched += 0.02
            self.deepest = max(self.deepest, -float(contact.dist[hits].min()))

    @property
    def path(self):
        return np.array(self._rows)
