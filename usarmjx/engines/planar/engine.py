"""The engine `planar`."""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.engines.base import Engine, GeomPoses, Inputs, PhysicsState
from usarmjx.engines.planar.bodies import Motion, PlanarRobots, robots_of
from usarmjx.engines.planar.flight import fly, held_up
from usarmjx.engines.planar.footprints import Footprints, keep_apart, near_solids
from usarmjx.engines.planar.poses import FixedBodies, fixed_bodies
from usarmjx.engines.planar.rolling import place_on_ground, roll, rolled, stopped
from usarmjx.engines.planar.servos import PlanarServos, move_joints, servos_of
from usarmjx.engines.planar.solids import PlanSolids, floor_height, joined, solid_geoms, solids_of
from usarmjx.models.build.compose import Physics
from usarmjx.models.build.layout import RobotIndex
from usarmjx.models.build.moved import MovedGeoms
from usarmjx.models.build.variation import RandomizedBodies
from usarmjx.models.spec.robot import RobotSpec

NEAR = 8
"""A robot looks at so many solids closely."""
LONGEST_FLIGHT_STEP = 0.025
"""What flies or dives is held upright by forces that are worked out once in a control step [s]."""


class PlanarState(struct.PyTreeNode, kw_only=True):
    """What the worlds go on from.

    Attributes:
        qpos: Positions (worlds, nq).
        qvel: Velocities (worlds, nv).
        act: Activations (worlds, na).
        touched: Which robots touched a solid or each other in the last step (worlds, robots).
        left_out: Solids that were near a robot and not looked at (worlds,).
    """

    qpos: Array
    qvel: Array
    act: Array
    touched: Array
    left_out: Array


class Meetings(NamedTuple):
    """What may meet in a step of one world.

    Attributes:
        before: The robots as they are.
        after: Where they would go.
        near: The solids that each may meet (robots, k).
        left_out: How many more each may meet (robots,).
        solids: All solids.
        stacked: Which are over or under each other (robots, robots); None: nobody flies.
    """

    before: Footprints
    after: Footprints
    near: PlanSolids
    left_out: Array
    solids: PlanSolids
    stacked: Array | None


class PlanarEngine(Engine[PlanarState]):
    """Footprints on floors, ramps and levels; one step of a closed form per control step.

    Args:
        robots: The robots of the model and where they are in it, by slot; the other arguments are those of
            `Engine`.

    Raises:
        UnsupportedFeatureError: A robot or an arena that it cannot do; says which engines can.
    """

    name: ClassVar[str] = "planar"
    traceable: ClassVar[bool] = True
    needs_robots: ClassVar[bool] = True
    has_solver: ClassVar[bool] = False

    def __init__(
        self,
        spec: mujoco.MjSpec,
        physics: Physics,
        worlds: int,
        moved_geoms: MovedGeoms | None = None,
        varied_bodies: RandomizedBodies | None = None,
        robots: tuple[tuple[RobotSpec, RobotIndex], ...] = (),
    ) -> None:
        super().__init__(spec, physics, worlds, moved_geoms, varied_bodies)
        self._robots: PlanarRobots = robots_of(self.model, robots)
        if self._robots.flies.any() and physics.period > LONGEST_FLIGHT_STEP:
            raise UnsupportedFeatureError(
                "engine 'planar' moves what flies or dives in control steps of up to "
                f"{LONGEST_FLIGHT_STEP:g} s, not {physics.period:g} s"
            )
        self._servos: PlanarServos = servos_of(self.model)
        own = {body for _, index in robots for body in index.body_ids}
        self._fixed: FixedBodies = fixed_bodies(self.model, own)
        geoms = solid_geoms(self.model, own, self.moved_ids)
        can_move = (geoms.moved >= 0) | np.isin(geoms.bodies, self._fixed.movable)
        self._movable = geoms.where(can_move)
        rest = jnp.asarray(self._fixed.pos, jnp.float32), jnp.asarray(self._fixed.mat, jnp.float32)
        self._still: PlanSolids = solids_of(self.model, geoms.where(~can_move), rest, None)
        self._floor = floor_height(self.model)

    def start(self) -> PlanarState:
        """Return every world at the model's reference configuration."""
        worlds, model = self.worlds, self.model
        return PlanarState(
            qpos=jnp.tile(jnp.asarray(model.qpos0, jnp.float32), (worlds, 1)),
            qvel=jnp.zeros((worlds, model.nv)),
            act=jnp.zeros((worlds, model.na)),
            touched=jnp.zeros((worlds, self._robots.count), bool),
            left_out=jnp.zeros(worlds, jnp.int32),
        )

    def advance(self, engine_state: PlanarState, inputs: Inputs) -> PlanarState:
        """Make one control step in every world."""
        pinned = self.set_qpos(engine_state, inputs.pinned, inputs.pinned_dof, inputs.qpos)
        moves = ~inputs.pinned[:, self._robots.root_qpos[:, 0]]
        state, before, after, meetings = jax.vmap(self._aim)(pinned, inputs)
        kept, touched = keep_apart(*meetings[:3], moves, meetings.stacked)
        moved = jax.vmap(self._finish)(state, before, after, kept, touched, meetings.solids)
        moved = moved.replace(
            touched=touched & moves, left_out=jnp.where(moves, meetings.left_out, 0).sum(-1)
        )
        return moved.replace(
            qpos=jnp.where(inputs.pinned, pinned.qpos, moved.qpos),
            qvel=jnp.where(inputs.pinned_dof, 0.0, moved.qvel),
        )

    def _aim(self, state: PlanarState, inputs: Inputs) -> tuple[PlanarState, Motion, Motion, Meetings]:
        """Return one world with its joints turned, where robots are and would go, and what they may meet."""
        dt, robots = self.physics.period, self._robots
        moved = move_joints(self._servos, state, inputs.ctrl, inputs.act, dt)
        state, twist = roll(robots, state, moved, inputs, dt)
        solids = self._solids(state, inputs.geom_poses)
        before = robots.motion(state)
        after = robots.choose(
            fly(robots, before, inputs.xfrc_applied, self.model, dt), rolled(before, twist, dt)
        )
        left = robots.footprints(before)
        after, stacked = held_up(robots, left, after)
        near, left_out = near_solids(left, solids, NEAR, self._reach(dt))
        there = robots.footprints(after)
        there = there.replace(low=jnp.minimum(left.low, there.low), high=jnp.maximum(left.high, there.high))
        meetings = Meetings(left, there, near, left_out, solids, stacked)
        return state, before, after, meetings

    def _finish(
        self,
        state: PlanarState,
        before: Motion,
        after: Motion,
        kept: Footprints,
        touched: Array,
        solids: PlanSolids,
    ) -> PlanarState:
        """Return one world with its robots where they were kept, on the ground."""
        dt, robots = self.physics.period, self._robots
        after = stopped(robots, before, after, kept, touched, dt)
        after = place_on_ground(robots, before, after, solids, self._floor, dt)
        return robots.written(state, after)

    def _reach(self, dt: float) -> float:
        return 2.0 * self._robots.top_speed * dt + 0.05

    def _solids(self, state: PlanarState, poses: GeomPoses | None) -> PlanSolids:
        """Return the solids of one world: only those that may be elsewhere are worked out again."""
        if not len(self._movable.ids):
            return self._still
        moved = solids_of(self.model, self._movable, self._fixed.poses(state.qpos), poses)
        return joined(self._still, moved)

    def set_qpos(
        self, engine_state: PlanarState, pinned: Array, pinned_dof: Array, qpos: Array
    ) -> PlanarState:
        """Put the pinned coordinates at qpos, at rest."""
        return engine_state.replace(
            qpos=jnp.where(pinned, qpos, engine_state.qpos),
            qvel=jnp.where(pinned_dof, 0.0, engine_state.qvel),
        )

    def reset(self, engine_state: PlanarState, mask: Array, qpos: Array) -> PlanarState:
        """Put the masked worlds at rest at qpos; the others keep every bit."""

        def clear(value: Array) -> Array:
            return jnp.where(mask.reshape(-1, *[1] * (value.ndim - 1)), jnp.zeros_like(value), value)

        cleared = jax.tree.map(clear, engine_state)
        return cleared.replace(qpos=jnp.where(mask[:, None], qpos, engine_state.qpos))

    def state(self, engine_state: PlanarState) -> PhysicsState:
        """Return positions, velocities and activations."""
        return PhysicsState(qpos=engine_state.qpos, qvel=engine_state.qvel, act=engine_state.act)

    def overflow(self, engine_state: PlanarState, inputs: Inputs) -> jax.Array:
        """Return how many solids near robots were not looked at in the last step (worlds,)."""
        del inputs
        return jnp.asarray(engine_state.left_out)
