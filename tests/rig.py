"""Robots of one class on plain C MuJoCo with the product's control function, as a served world has them."""

import math
from dataclasses import replace
from functools import cache, partial

import jax
import mujoco
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of, lowest_point, robot_state
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.standing import START_GAP
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.sim.control import ControlMode, DriveConditions, compute_actuation, idle_command, set_drive
from usarmjx.sim.scene import build_scene
from usarmjx.sim.world import depth_in_water

PERIOD = Physics().period
BARE = ArenaSpec(name="track", starts=(), extent=((-3, 3), (-3, 3)))


@cache
def control_of(name):
    """The product's control function of a class, compiled once per process."""
    return jax.jit(partial(compute_actuation, kinematic_tree_of(ROBOTS.get(name)), period=PERIOD))


class Rig:
    """Robots of one class on a floor with some solids, by default at the origin, on a tilt if asked.

    `places`: x, y and yaw of each, and the height of the ground there if it is not the floor. `height`: of
    the robots' origins; None puts them on the ground. `tilt`: of gravity, uphill along x. `arena`: a whole
    arena, to which the solids are added. `contents`: other parts of the arena, as `waters` or `loose`.
    """

    def __init__(
        self,
        name,
        *solids,
        places=((0.0, 0.0, 0.0),),
        roll=0.0,
        tilt=0.0,
        height=None,
        arena=BARE,
        **contents,
    ):
        starts = tuple(
            StartPose(tag=f"S{i}", at=(x, y, 0.188), yaw=yaw) for i, (x, y, yaw, *_) in enumerate(places)
        )
        arena = replace(arena, starts=starts, shapes=(*arena.shapes, *solids), **contents)
        scene = build_scene(arena, [name] * len(places))
        self.arena, self.robot, self.model = arena, scene.groups[0].robot, scene.model
        self.plan, self.indices = scene.groups[0].plan, scene.groups[0].indices
        self.model.opt.gravity[:] = 9.81 * np.array([-math.sin(tilt), 0.0, -math.cos(tilt)])
        self.data = mujoco.MjData(self.model)
        for index, (x, y, yaw, *ground) in zip(self.indices, places, strict=True):
            self.data.ctrl[list(index.hold_actuator_ids)] = 1.0
            root = slice(index.root_qposadr, index.root_qposadr + 7)
            self.data.qpos[root] = (x, y, height or 0.0, *quat_from_angles(roll, 0.0, yaw))
            if height is None:
                mujoco.mj_kinematics(self.model, self.data)
                low = lowest_point(self.model, self.data, np.isin(self.model.geom_bodyid, index.body_ids))
                self.data.qpos[index.root_qposadr + 2] = arena.floor + sum(ground) + START_GAP - low
        self.commands = [jax.tree.map(np.array, idle_command(self.robot)) for _ in places]
        self.powered = True
        self._control = control_of(name)

    def tell(self, robot=0, flip_until=None, **values):
        """Set keys of DRIVE, as `tell(Left=1, Right=1)`."""
        with numpy_backend():
            told = set_drive(self.robot, self.commands[robot], values)
        if flip_until is not None:
            told = told.replace(flip_until=np.int32(round(flip_until / PERIOD)))
        self.commands[robot] = told
        return self

    def move(self, targets, order=ControlMode.POSITION, robot=0):
        """Give joints by name an order."""
        names, told = joint_names(self.robot), self.commands[robot]
        target, orders = told.target.copy(), told.mode.copy()
        for name, value in targets.items():
            target[names.index(name)], orders[names.index(name)] = value, order
        self.commands[robot] = told.replace(target=target, mode=orders)
        return self

    def state(self, robot=0):
        state = robot_state(self.indices[robot], self.data.qpos, self.data.qvel)
        return jax.tree.map(np.float32, state)

    def joint(self, name, robot=0):
        """Position of a joint [rad or m]."""
        return float(self.data.qpos[self.indices[robot].qposadr[joint_names(self.robot).index(name)]])

    def step(self):
        data = self.data
        for i, (index, command) in enumerate(zip(self.indices, self.commands, strict=True)):
            targets, state = list(index.actadr), self.state(i)
            holding = list(index.hold_actuator_ids)
            depth = depth_in_water(self.arena, state.pos) if self.arena.waters else np.float32(-1e3)
            now = DriveConditions(
                step=np.int32(round(data.time / PERIOD)),
                powered=np.bool_(self.powered),
                depth=np.float32(depth),
                hold=data.ctrl[holding].astype(np.float32),
            )
            told = self._control(command, state, data.act[targets].astype(np.float32), now)
            data.ctrl[list(index.actuator_ids)], data.ctrl[holding] = told.ctrl, told.hold
            data.act[targets] = told.act
            data.xfrc_applied[index.body_ids[0]] = told.wrench
        mujoco.mj_step(self.model, data, nstep=Physics().substeps)

    def run(self, seconds):
        """Return position, velocity and turning rate of the first robot after each control step (n, 9)."""
        q, v = self.indices[0].root_qposadr, self.indices[0].root_dofadr
        rows = []
        for _ in range(round(seconds / PERIOD)):
            self.step()
            rows.append(np.r_[self.data.qpos[q : q + 3], self.data.qvel[v : v + 6]])
        return np.array(rows)

    @property
    def up(self):
        """How upright the robots are: 1 on their wheels, -1 upside down (robots,)."""
        return np.array([self.data.xmat[index.body_ids[0]][8] for index in self.indices])

    def mat(self, part):
        return self.data.body(f"r0/{part}").xmat.reshape(3, 3)


def steady_speed(rig, settle=2.0):
    """Speed over ground [m/s]."""
    rig.run(settle)
    return np.linalg.norm(rig.run(2.0)[:, 3:5], axis=1).mean()


def steady_spin(rig, settle=2.0):
    """Turning rate about the vertical [rad/s], positive to the left."""
    rig.run(settle)
    return rig.run(2.0)[:, 8].mean()
