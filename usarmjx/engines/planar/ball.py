"""Ball of engine `planar`: a loose sphere that rolls on, bounces off solids, and is pushed by robots.

A robot that pushes it is not slowed down, but a ball that has nowhere to go stops the robots at it, as a wall
does. It stays at its height: it climbs nothing, and meets only what is beside it.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.backend import Array, set_rows
from usarmjx.base.rotations import Components, cross, parts, rotation, transposed
from usarmjx.base.rotations import apply as turned
from usarmjx.engines.base import PhysicsState
from usarmjx.engines.planar.bodies import FixedBodies
from usarmjx.engines.planar.flight import rotate
from usarmjx.engines.planar.footprints import OVERLAP_TOLERANCE, Footprints
from usarmjx.engines.planar.overlap import Outlines, disc_overlap
from usarmjx.engines.planar.solids import PlanSolids, SolidGeoms

RESTITUTION = 0.16
"""Share of its speed that a ball bounces off with: of C MuJoCo with the usual contacts, from 0.14 to 0.17 at
0.5 to 2 m/s."""
ITERATIONS = 4
"""Iterations that move the ball out of the deepest overlap."""
SPIN = 2.5
"""Ratio of mass times squared radius to the inertia of a solid sphere."""
MIN_RISE = 0.01
"""Solids that are lower than this, from the ball's lowest point on, do not stop it [m]."""
NEARBY = 0.002
"""Robots this near to a ball that has nowhere to go are stopped [m]."""
SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)


class BallMotion(NamedTuple):
    """Motion of the ball of a world, components by themselves; world axes.

    Attributes:
        x: Position [m] ().
        y: Position [m] ().
        linear: Velocity on the plan [m/s], two of ().
        spin: Angular velocity [rad/s], three of ().
    """

    x: Array
    y: Array
    linear: Components
    spin: Components


class Obstacles(NamedTuple):
    """Solids and robots that a ball can touch.

    Attributes:
        outline: Their outlines (n,).
        touches: Whether they are at the ball's height (n,).
        friction: Friction of the ball on them (n,).
        share: Share of the mass of ball and obstacle that is the obstacle's (n,).
        speed: Velocities of their middles [m/s], x and y (n,) each.
        turn: Rates of turn [rad/s] (n,).
    """

    outline: Outlines
    touches: Array
    friction: Array
    share: Array
    speed: tuple[Array, Array]
    turn: Array


@dataclass(frozen=True, eq=False)
class Ball:
    """The ball of a model.

    Attributes:
        qpos: Its indices in qpos (7,).
        dof: Its indices in qvel (6,).
        radius: Radius [m].
        mass: Mass [kg].
        floor_friction: Friction on the floor.
        solid_friction: Friction on each solid, negative where the two do not collide (solids,).
        robot_friction: The same for each robot (robots,).
        gravity: Acceleration of gravity [m/s^2].
    """

    qpos: np.ndarray
    dof: np.ndarray
    radius: float
    mass: float
    floor_friction: float
    solid_friction: np.ndarray
    robot_friction: np.ndarray
    gravity: float

    def motion(self, state: PhysicsState) -> BallMotion:
        """Return the ball's motion in one world."""
        x, y, _, *quat = parts(state.qpos[self.qpos])
        vx, vy, _, *local = parts(state.qvel[self.dof])
        # MuJoCo has angular velocities of free bodies in their own axes.
        return BallMotion(x, y, (vx, vy), turned(rotation(quat), local))

    def write(self, state: PhysicsState, moved: BallMotion, dt: float) -> PhysicsState:
        """Return one world with its ball moved; it turns with its spin for dt [s]."""
        _, _, z, *quat = parts(state.qpos[self.qpos])
        local = turned(transposed(rotation(quat)), moved.spin)
        turn = rotate(quat, tuple(rate * dt for rate in local))
        # About its own axis of turn a body's rates are the same before and after.
        return state.replace(
            qpos=set_rows(state.qpos, (self.qpos, jnp.stack([moved.x, moved.y, z, *turn]))),
            qvel=set_rows(state.qvel, (self.dof, jnp.stack([*moved.linear, jnp.zeros_like(z), *local]))),
        )

    def roll(self, now: BallMotion, dt: float) -> BallMotion:
        """Return the motion after dt [s] on the floor, where it slides until it rolls."""
        (vx, vy), (wx, wy, wz) = now.linear, now.spin
        slip = vx - self.radius * wy, vy + self.radius * wx
        # The small number gives a rolling ball a slip of 0 and a finite derivative.
        speed = jnp.sqrt(slip[0] ** 2 + slip[1] ** 2 + 1e-12)
        # Friction slows it and turns it: the slip falls by 1 + SPIN times as much as the speed.
        change = jnp.minimum(self.floor_friction * self.gravity * dt, speed / (1.0 + SPIN))
        dx, dy = (change * part / speed for part in slip)
        linear = vx - dx, vy - dy
        spin = wx - SPIN * dy / self.radius, wy + SPIN * dx / self.radius, wz
        return BallMotion(now.x + linear[0] * dt, now.y + linear[1] * dt, linear, spin)

    def overlaps(self, now: BallMotion, others: Obstacles) -> tuple[Array, Array, Array]:
        """Return the overlap with each obstacle (n,) [m], and the ball's ways out of it, x and y (n,)."""
        none = jnp.zeros_like(others.outline.x)
        # A disc around the ball grown by the obstacle's own radius turns disc against disc into disc and
        # point.
        disc = Outlines(now.x, now.y, none + 1.0, none, none, none, self.radius + others.outline.radius)
        depth, x, y = disc_overlap(others.outline, disc)
        # `disc_overlap` returns the rectangle's way out; the ball's is the opposite.
        return jnp.where(others.touches, depth, -1.0), -x, -y

    def collide(self, now: BallMotion, others: Obstacles) -> BallMotion:
        """Return the motion after contacts with the deepest obstacles, one after the other."""

        def separate(_: int, now: BallMotion) -> BallMotion:
            depth, out_x, out_y = self.overlaps(now, others)
            # One obstacle at a time: in a corner, pushes out of both at once would go too far.
            worst = jnp.argmax(depth)
            deep, x, y = (part[worst] for part in (depth, out_x, out_y))
            hit = self._bounced(now, others, worst, (x, y))
            pushed = hit._replace(x=now.x + deep * x, y=now.y + deep * y)
            return jax.tree.map(lambda new, old: jnp.where(deep > 0, new, old), pushed, now)

        return jax.lax.fori_loop(0, ITERATIONS, separate, now)

    def _bounced(
        self, now: BallMotion, others: Obstacles, which: Array, normal: tuple[Array, Array]
    ) -> BallMotion:
        """Return the motion after an impulse along a normal, and friction across it."""
        x, y = normal
        outline = others.outline
        # The obstacle's surface moves with its middle and its turn.
        arm_x = now.x - self.radius * x - outline.x[which]
        arm_y = now.y - self.radius * y - outline.y[which]
        surface_x = others.speed[0][which] - others.turn[which] * arm_y
        surface_y = others.speed[1][which] + others.turn[which] * arm_x
        vx, vy = now.linear[0] - surface_x, now.linear[1] - surface_y
        # Only an approach is reversed: a ball that already leaves gets no impulse.
        impulse = (1.0 + RESTITUTION) * others.share[which] * jnp.maximum(-(vx * x + vy * y), 0.0)
        zero = jnp.zeros_like(x)
        back = (-self.radius * x, -self.radius * y, zero)
        slip = tuple(
            a + b for a, b in zip((vx, vy, zero), cross(now.spin, back), strict=True)
        )  # of the ball's point of contact
        along = slip[0] * x + slip[1] * y
        slip = slip[0] - along * x, slip[1] - along * y, slip[2]
        size = jnp.sqrt(slip[0] ** 2 + slip[1] ** 2 + slip[2] ** 2 + 1e-12)
        # Coulomb's limit, and no more than what stops the slip: the impulse slows it and turns it at once.
        grip = jnp.minimum(others.friction[which] * impulse, size / (1.0 + SPIN))
        rub = tuple(-grip * part / size for part in slip)
        torque = cross(back, rub)
        spin = tuple(w + SPIN * part / self.radius**2 for w, part in zip(now.spin, torque, strict=True))
        # Friction may lift the ball, which falls back on the floor: it stays at its height.
        linear = now.linear[0] + impulse * x + rub[0], now.linear[1] + impulse * y + rub[1]
        return now._replace(linear=linear, spin=spin)

    def obstacles(
        self, height: Array, solids: PlanSolids, before: Footprints, after: Footprints, dt: float
    ) -> Obstacles:
        """Return what the ball of one world can touch: its solids, then its robots as they moved in dt [s].

        Args:
            height: Height of the ball's middle [m] ().
            solids: The solids.
            before: The robots at the beginning of the step.
            after: The robots at its end.
            dt: Control step [s].
        """
        robots = after.outlines
        none = jnp.zeros_like(solids.outline.x)
        outline = Outlines(
            *(jnp.concatenate([one, other]) for one, other in zip(solids.outline, robots, strict=True))
        )
        low, high = jnp.concatenate([solids.low, after.low]), jnp.concatenate([solids.highest, after.high])
        friction = np.concatenate([self.solid_friction, self.robot_friction]).astype(np.float32)
        beside = (low < height + self.radius) & (high > height - self.radius + MIN_RISE)
        moved, turn = (after.pos - before.pos) / dt, after.yaw - before.yaw
        # Wrapped: at +-pi the difference would be a whole turn, and the robot would seem to spin.
        turn = jnp.arctan2(jnp.sin(turn), jnp.cos(turn)) / dt
        # Of an impulse the ball takes all at a solid, which cannot move, and its share by mass at a robot.
        return Obstacles(
            outline=outline,
            touches=beside & (friction >= 0),
            friction=jnp.asarray(friction),
            share=jnp.concatenate([none + 1.0, after.mass / (after.mass + self.mass)]),
            speed=(jnp.concatenate([none, moved[:, 0]]), jnp.concatenate([none, moved[:, 1]])),
            turn=jnp.concatenate([none, turn]),
        )

    def push(
        self, state: PhysicsState, solids: PlanSolids, before: Footprints, after: Footprints, dt: float
    ) -> tuple[BallMotion, Footprints, Array]:
        """Return the ball of one world after a step, and the robots, and which of them it stopped (robots,).

        Arguments are those of `obstacles`; `state` has the ball before the step.
        """
        rolled, height = self.roll(self.motion(state), dt), state.qpos[self.qpos[2]]
        others = self.obstacles(height, solids, before, after, dt)
        depth, _, _ = self.overlaps(self.collide(rolled, others), others)
        at_robots = depth[solids.count :]
        # If an overlap is left after all iterations, the ball has nowhere to go.
        stopped = (at_robots > -NEARBY) & (depth.max() > OVERLAP_TOLERANCE)
        # A robot that would squeeze the ball against a wall stays where it was, as solids do not give way.
        kept = after.replace(
            pos=jnp.where(stopped[:, None], before.pos, after.pos),
            yaw=jnp.where(stopped, before.yaw, after.yaw),
        )
        # Stopped robots have no speed any more, so the ball collides anew, from before the first attempt.
        others = self.obstacles(height, solids, before, kept, dt)
        return self.collide(rolled, others), kept, stopped


class FoundBall(NamedTuple):
    """Body and geom of a ball, and the first index of its joint in qpos and in qvel."""

    body: int
    geom: int
    qpos: int
    dof: int


def find_ball(model: mujoco.MjModel, fixed: FixedBodies, geoms: SolidGeoms) -> FoundBall | None:
    """Return the ball of a model: its only loose body that is one sphere about its middle; None: no such.

    Args:
        model: The model.
        fixed: Its bodies other than robots.
        geoms: Its geoms that robots can touch.
    """
    found: list[FoundBall] = []
    for body in fixed.free.tolist():
        own = geoms.ids[geoms.bodies == body].tolist()
        if len(own) == 1 and model.geom_type[own[0]] == SPHERE and not model.geom_pos[own[0]].any():
            joint = int(model.body_jntadr[body])
            found.append(FoundBall(body, own[0], int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])))
    # Of several balls none is moved: they would have to push each other.
    return found[0] if len(found) == 1 else None


def without_body(fixed: FixedBodies, body: int) -> FixedBodies:
    """Return the bodies without a loose one."""
    stays = fixed.free != body
    return replace(fixed, free=fixed.free[stays], free_qpos=fixed.free_qpos[stays])


def ball_of(model: mujoco.MjModel, found: FoundBall, order: np.ndarray, chassis: np.ndarray) -> Ball:
    """Return a ball.

    Args:
        model: The model.
        found: The ball there.
        order: Geoms of the solids, in their order (solids,).
        chassis: Bodies of the robots' chassis (robots,).
    """
    geom = found.geom
    floors = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    return Ball(
        qpos=found.qpos + np.arange(7),
        dof=found.dof + np.arange(6),
        radius=float(model.geom_size[geom, 0]),
        mass=float(model.body_mass[found.body]),
        floor_friction=max((_pair_friction(model, geom, one) for one in floors.tolist()), default=0.0),
        solid_friction=np.array([_pair_friction(model, geom, one) for one in order.tolist()]),
        robot_friction=np.array([_body_friction(model, geom, one) for one in chassis.tolist()]),
        gravity=float(-model.opt.gravity[2]),
    )


def _pair_friction(model: mujoco.MjModel, one: int, other: int) -> float:
    """Return the sliding friction of two geoms by MuJoCo's rule; -1 if they do not collide."""
    masks = model.geom_contype, model.geom_conaffinity
    if not (masks[0][one] & masks[1][other] or masks[0][other] & masks[1][one]):
        return -1.0
    friction, rank = model.geom_friction[:, 0], model.geom_priority
    # MuJoCo takes the friction of the geom of higher priority, and of equal ones the larger.
    if rank[one] != rank[other]:
        return float(friction[one if rank[one] > rank[other] else other])
    return float(max(friction[one], friction[other]))


def _body_friction(model: mujoco.MjModel, ball: int, body: int) -> float:
    """Return the friction of the ball on the first geom of a body that it collides with; -1: on none."""
    geoms = np.flatnonzero(model.geom_bodyid == body).tolist()
    found = (_pair_friction(model, ball, geom) for geom in geoms)
    return next((one for one in found if one >= 0), -1.0)
