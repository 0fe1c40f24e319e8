"""Robots on plain C MuJoCo, of any classes, that are put anywhere."""

import mujoco
import numpy as np

from usarmjx.base.transforms import quat_from_angles
from usarmjx.engines.c.placement import free_pose
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.standing import START_GAP
from usarmjx.models.robots import ROBOTS
from usarmjx.sim.scene import build_scene

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


class Crowd:
    """Robots in an arena, parked until they are put somewhere."""

    def __init__(self, arena, *names):
        scene = build_scene(arena, [*names])
        self.floor, self.model, self.data = scene.arena.floor, scene.model, mujoco.MjData(scene.model)
        groups = [scene.group_of(slot) for slot in range(len(names))]
        self.indices = [scene.groups[group].indices[place] for group, place in groups]
        self.heights = [
            self.floor + kinematic_tree_of(ROBOTS.get(name)).clearance + START_GAP for name in names
        ]

    def ask(self, robot, pos, yaw=0.0, sinking=0.0, **options):
        quat, floor = quat_from_angles(0.0, 0.0, yaw), self.floor - sinking
        return free_pose(self.model, self.data, self.indices[robot], pos, quat, floor, **options)

    def on_floor(self, robot, x=0.0, y=0.0, above=0.0):
        return np.array([x, y, self.heights[robot] + above])

    def put(self, robot, pos, quat=UPRIGHT):
        start = self.indices[robot].root_qposadr
        self.data.qpos[start : start + 7] = *pos, *quat

    def qpos(self, robot):
        index = self.indices[robot]
        return self.data.qpos[[*range(index.root_qposadr, index.root_qposadr + 7), *index.qposadr]].copy()

    def depth(self, robot):
        """How deep it is in anything [m], as MuJoCo has it for the whole world."""
        mujoco.mj_forward(self.model, self.data)
        own = np.isin(self.model.geom_bodyid, self.indices[robot].body_ids)
        mine = own[self.data.contact.geom].reshape(-1, 2).any(-1)
        return -self.data.contact.dist[mine].min(initial=0.0)

    def run(self, seconds):
        for index in self.indices:
            self.data.ctrl[list(index.hold_actuator_ids)] = 1.0
        mujoco.mj_step(self.model, self.data, nstep=round(seconds / self.model.opt.timestep))
