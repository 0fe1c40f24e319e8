"""Random states of robots: standing, driving, falling, wedged, on each other, and at loose objects."""

# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from usarmjx.models.compile.compose import LOOSE_PREFIX
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sim.scene import prefix_of

ABOVE = 0.3
"""Height above a start pose from which the ground is looked for [m]."""
DOWN = np.array([0.0, 0.0, -1.0])
GAP = 0.02
"""Most height of a robot's lowest point over the ground [m]."""
SPEED = 6.0
"""Most speed of driven joints [rad/s]."""
BURN_IN = {"standing": 60}
"""Physics steps before the first state of a kind, if not one."""
BAD = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_CONTACTFULL,
    mujoco.mjtWarning.mjWARN_CNSTRFULL,
)


@dataclass(frozen=True)
class Mover:
    """A robot or loose object.

    Attributes:
        qpos: Index of its first coordinate.
        dof: Index of its first degree of freedom.
        low: Height of its lowest point under its origin, as it is compiled [m].
        radius: Of a circle around its origin that has all its geoms [m].
    """

    qpos: int
    dof: int
    low: float
    radius: float


def _movers(model: mujoco.MjModel, prefixes: list[str]) -> list[Mover]:
    """Return the free bodies whose names begin with one of the prefixes."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    touching, found = (model.geom_contype | model.geom_conaffinity) != 0, []
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        root = model.jnt_bodyid[joint]
        if not any(model.body(root).name.startswith(prefix) for prefix in prefixes):
            continue
        mine = touching & (model.body_rootid[model.geom_bodyid] == model.body_rootid[root])
        turn = data.geom_xmat[mine].reshape(-1, 3, 3)
        middle = data.geom_xpos[mine] + (turn @ model.geom_aabb[mine, :3, None])[..., 0]
        half = (np.abs(turn) @ model.geom_aabb[mine, 3:, None])[..., 0]
        low = data.xpos[root, 2] - (middle - half)[:, 2].min(initial=data.xpos[root, 2])
        far = np.linalg.norm(np.abs(middle - data.xpos[root])[:, :2] + half[:, :2], axis=1)
        found.append(
            Mover(
                int(model.jnt_qposadr[joint]),
                int(model.jnt_dofadr[joint]),
                float(low),
                float(far.max(initial=0.1)),
            )
        )
    return found


class StateMaker:
    """Random states of a scene.

    Args:
        model: The scene's model.
        arena: Its arena.
        robots: Number of robots.
    """

    def __init__(self, model: mujoco.MjModel, arena: ArenaSpec, robots: int) -> None:
        self._usual = copy(model)
        self._usual.opt.tolerance = 1e-8
        self._usual.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        self.model, self._starts = model, np.array([start.at for start in arena.starts])
        self._extent = np.array(arena.extent)
        self.robots = _movers(model, [prefix_of(slot) for slot in range(robots)])
        self.loose = _movers(model, [LOOSE_PREFIX])
        self._data, self._at_rest = mujoco.MjData(model), mujoco.MjData(model)
        mujoco.mj_forward(model, self._at_rest)
        kinds = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
        fixed = (model.body_weldid[model.geom_bodyid] == 0) & (model.geom_contype != 0)
        self._solids = np.flatnonzero(fixed & ~np.isin(model.geom_type, kinds))
        names = [model.actuator(a).name for a in range(model.nu)]
        self._hold = np.array([name.endswith("/hold") for name in names], bool)
        self._places: dict[str, Callable[[mujoco.MjData, np.random.Generator], None]] = {
            "standing": self._apart,
            "driving": self._apart,
            "falling": self._fall,
            "wedged": self._wedge,
            "robot on robot": self._stack,
            "pushing": self._push,
        }

    @property
    def kinds(self) -> tuple[str, ...]:
        """Return the kinds of states."""
        return tuple(self._places)

    def trajectory(
        self, kind: str, rng: np.random.Generator, states: int, every: int = 5
    ) -> Iterator[mujoco.MjData]:
        """Yield the data of states after C MuJoCo's forward dynamics, always the same object.

        It ends early where the physics goes bad.

        Args:
            kind: One of `kinds`.
            rng: Source of all that is random.
            states: Most states.
            every: Physics steps between two.
        """
        data = self._data
        mujoco.mj_resetData(self.model, data)
        data.warning.number[:] = 0
        self._places[kind](data, rng)
        for number in range(states):
            self._command(data, kind, rng)
            mujoco.mj_step(self._usual, data, BURN_IN.get(kind, 1) if number == 0 else every)
            warm = data.qacc_warmstart.copy()
            mujoco.mj_forward(self.model, data)
            data.qacc_warmstart[:] = warm
            if data.warning.number[list(map(int, BAD))].any() or not np.isfinite(data.qacc).all():
                return
            yield data

    def _command(self, data: mujoco.MjData, kind: str, rng: np.random.Generator) -> None:
        shape = () if kind == "pushing" else self.model.nu
        speeds = np.broadcast_to(rng.uniform(-SPEED, SPEED, shape), self.model.nu)
        if kind == "standing":
            speeds = np.zeros(self.model.nu)
        held = rng.uniform(size=self.model.nu) < (1.0 if kind == "standing" else 0.8)
        data.ctrl[:] = np.where(self._hold, held, speeds)

    def _ground(self, at: np.ndarray) -> float:
        """Return the height of what is fixed under a point [m]."""
        which, groups = np.zeros(1, np.int32), np.ones(6, np.uint8)
        start, height = np.array([at[0], at[1], at[2] + ABOVE]), at[2]
        for _ in range(20):
            way = mujoco.mj_ray(self.model, self._at_rest, start, DOWN, groups, 1, -1, which)
            if way < 0:
                return float(height)
            start[2] -= way
            if self.model.body_weldid[self.model.geom_bodyid[which[0]]] == 0:
                return float(start[2])
            start[2] -= 1e-6
        return float(height)

    def _put(
        self, data: mujoco.MjData, one: Mover, at: np.ndarray, rng: np.random.Generator, tilt: float = 0.0
    ) -> None:
        """Put the lowest point of something at a point, turned at random and tilted at most so much [rad]."""
        axis = rng.normal(size=3) * [1.0, 1.0, 0.0]
        yaw, lean, turn = np.zeros(4), np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(yaw, np.array([0.0, 0.0, 1.0]), rng.uniform(-np.pi, np.pi))
        mujoco.mju_axisAngle2Quat(lean, axis / np.linalg.norm(axis), rng.uniform(0.0, tilt))
        mujoco.mju_mulQuat(turn, lean, yaw)
        data.qpos[one.qpos : one.qpos + 3] = at + np.array([0.0, 0.0, one.low + rng.uniform(0.0, GAP)])
        data.qpos[one.qpos + 3 : one.qpos + 7] = turn

    def _start_places(self, rng: np.random.Generator) -> np.ndarray:
        """Return points on the ground at start poses, a few decimetres off (robots, 3) [m]."""
        chosen = rng.permutation(len(self._starts))[np.arange(len(self.robots)) % len(self._starts)]
        off = rng.uniform(-0.3, 0.3, (len(chosen), 3)) * [1.0, 1.0, 0.0]
        return np.array([[x, y, self._ground(np.array([x, y, z]))] for x, y, z in self._starts[chosen] + off])

    def _apart(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        for one, at in zip(self.robots, self._start_places(rng), strict=True):
            self._put(data, one, at, rng)

    def _fall(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        for one, at in zip(self.robots, self._start_places(rng), strict=True):
            up = rng.uniform(0.0, 1.0)
            self._put(data, one, at + np.array([0.0, 0.0, up]), rng, tilt=np.pi)
            data.qvel[one.dof : one.dof + 3] = rng.uniform(-2.0, 2.0, 3)
            data.qvel[one.dof + 3 : one.dof + 6] = rng.uniform(-4.0, 4.0, 3)

    def _wedge(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        if not len(self._solids):
            return self._stack(data, rng)
        for one in self.robots:
            solid = rng.choice(self._solids)
            turn = np.abs(self._at_rest.geom_xmat[solid].reshape(3, 3))
            half = (turn @ self.model.geom_aabb[solid, 3:]) + [0.7 * one.radius, 0.7 * one.radius, 0.0]
            at = self._at_rest.geom_xpos[solid] + rng.uniform(-1.0, 1.0, 3) * half
            at[:2] = np.clip(at[:2], self._extent[:, 0], self._extent[:, 1])
            self._put(data, one, at, rng, tilt=0.5)

    def _stack(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Put all robots around the first, over each other."""
        first, height = self._start_places(rng)[0], 0.0
        reach = self.robots[0].radius
        for one in self.robots:
            off = rng.uniform(-0.5, 0.5, 2) * reach
            self._put(data, one, first + np.array([*off, height]), rng, tilt=0.3)
            height += rng.uniform(0.3, 1.5) * one.low

    def _push(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Put loose objects, or else the other robots, beside robots."""
        places = self._start_places(rng)
        if not self.loose:
            for one in self.robots:
                off = rng.uniform(-0.9, 0.9, 2) * self.robots[0].radius
                self._put(data, one, places[0] + [*off, 0.0], rng)
            return
        for one, at in zip(self.robots, places, strict=True):
            self._put(data, one, at, rng)
        for k in rng.permutation(len(self.loose))[: 2 * len(places)]:
            which = rng.integers(len(places))
            far = rng.uniform(0.5, 1.0) * (self.robots[which].radius + self.loose[k].radius)
            angle = rng.uniform(-np.pi, np.pi)
            off = [far * np.cos(angle), far * np.sin(angle), 0.0]
            self._put(data, self.loose[k], places[which] + off, rng)
