"""The engine `planar`."""

from functools import partial
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.engines.base import Engine, Inputs, PhysicsState
from usarmjx.engines.planar.bodies import (
    Motion,
    PlanarRobots,
    PlanarServos,
    fixed_bodies,
    move_joints,
    robots_of,
    servos_of,
)
from usarmjx.engines.planar.flight import fly, held_up
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.neighbor_lists import NeighborList, most_near
from usarmjx.engines.planar.neighbor_search import (
    AllSolids,
    all_solids,
    around_robots,
    ground_below,
    nothing_known,
)
from usarmjx.engines.planar.proposed_motion import ProposedMotion
from usarmjx.engines.planar.rolling import place_on_ground, reach_of, roll, rolled, stopped
from usarmjx.engines.planar.separation import part_robots
from usarmjx.engines.planar.solids import solid_geoms
from usarmjx.models.compile.geoms import MovedGeoms
from usarmjx.models.compile.layout import RobotIndex
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import RandomizedBodies
from usarmjx.models.types.robot import RobotSpec

LONGEST_FLIGHT_STEP = 0.05
"""What flies or dives is held upright by forces that are worked out once in a control step [s]."""


class PlanarState(struct.PyTreeNode, kw_only=True):
    """What the worlds go on from.

    Attributes:
        qpos: Positions (worlds, nq).
        qvel: Velocities (worlds, nv).
        act: Activations (worlds, na).
        touched: Which robots touched a solid or each other in the last step (worlds, robots).
        left_out: Solids that were near a robot and not looked at (worlds,).
        around: What is around the robots, from one step to the next.
    """

    qpos: Array
    qvel: Array
    act: Array
    touched: Array
    left_out: Array
    around: NeighborList


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
        geoms, fixed = solid_geoms(self.model, own, self.moved_ids), fixed_bodies(self.model, own)
        self._solids: AllSolids = all_solids(self.model, geoms, fixed, most_near(self._robots.half))

    def start(self) -> PlanarState:
        """Return every world at the model's reference configuration."""
        worlds, model = self.worlds, self.model
        qpos = jnp.tile(jnp.asarray(model.qpos0, jnp.float32), (worlds, 1))
        here = {"qpos": qpos, "qvel": jnp.zeros((worlds, model.nv)), "act": jnp.zeros((worlds, model.na))}
        return PlanarState(
            **here,
            touched=jnp.zeros((worlds, self._robots.count), bool),
            left_out=jnp.zeros(worlds, jnp.int32),
            around=self._nothing_known(PhysicsState(**here)),
        )

    def _nothing_known(self, state: PhysicsState) -> NeighborList:
        """Return that of nothing around the robots is known."""

        def aims_of(state: PhysicsState) -> ProposedMotion:
            robots = jax.vmap(self._robots.motion)(state)
            prints = jax.vmap(self._robots.footprints)(robots)
            limit = jax.vmap(partial(reach_of, self._robots))(robots)
            scene = jax.vmap(self._solids.elsewhere.where, (0, None))(state.qpos, None)
            return ProposedMotion(prints, prints, prints.yaw > 0, None, limit, scene, state.qpos, None)

        return nothing_known(self._solids, jax.eval_shape(aims_of, state))

    def advance(self, engine_state: PlanarState, inputs: Inputs) -> PlanarState:
        """Make one control step in every world."""
        pinned = self.set_qpos(engine_state, inputs.pinned, inputs.pinned_dof, inputs.qpos)
        moves = ~inputs.pinned[:, self._robots.root_qpos[:, 0]]
        turned = PhysicsState(qpos=pinned.qpos, qvel=pinned.qvel, act=pinned.act)
        state, before, after, aims = jax.vmap(self._aim)(turned, inputs, moves)
        around = around_robots(self._solids, pinned.around, aims)
        kept, touched = part_robots(aims, around)
        stopped_at = jax.vmap(self._stop)(before, after, kept, touched)
        ground = ground_below(self._solids, around, kept, aims)
        moved = jax.vmap(self._finish)(state, before, stopped_at, ground)
        return PlanarState(
            qpos=jnp.where(inputs.pinned, pinned.qpos, moved.qpos),
            qvel=jnp.where(inputs.pinned_dof, 0.0, moved.qvel),
            act=moved.act,
            touched=touched & moves,
            left_out=jnp.where(moves, around.left_out, 0).sum(-1),
            around=around,
        )

    def _aim(
        self, state: PhysicsState, inputs: Inputs, moves: Array
    ) -> tuple[PhysicsState, Motion, Motion, ProposedMotion]:
        """Return one world with its joints turned, where robots are and would go."""
        dt, robots = self.physics.period, self._robots
        moved = move_joints(self._servos, state, inputs.ctrl, inputs.act, dt)
        turned, twist = roll(robots, state, moved, inputs, dt)
        before = robots.motion(turned)
        after = robots.choose(
            fly(robots, before, inputs.xfrc_applied, self.model, dt), rolled(before, twist, dt)
        )
        left = robots.footprints(before)
        after, stacked = held_up(robots, left, after)
        there = robots.footprints(after)
        there = there.replace(low=jnp.minimum(left.low, there.low), high=jnp.maximum(left.high, there.high))
        limit, poses = reach_of(robots, before), inputs.geom_poses
        scene = self._solids.elsewhere.where(state.qpos, poses)
        return (
            turned,
            before,
            after,
            ProposedMotion(left, there, moves, stacked, limit, scene, state.qpos, poses),
        )

    def _stop(self, before: Motion, after: Motion, kept: Footprints, touched: Array) -> Motion:
        return stopped(self._robots, before, after, kept, touched, self.physics.period)

    def _finish(self, state: PhysicsState, before: Motion, after: Motion, ground: Array) -> PhysicsState:
        """Return one world with its robots on the ground."""
        after = place_on_ground(self._robots, before, after, ground, self.physics.period)
        return self._robots.written(state, after)

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

        # Without room nothing is known to be near: what was there is looked up anew, and need not be cleared.
        around = engine_state.around.replace(room=clear(engine_state.around.room))
        cleared = jax.tree.map(clear, engine_state.replace(around=()))
        return cleared.replace(qpos=jnp.where(mask[:, None], qpos, engine_state.qpos), around=around)

    def state(self, engine_state: PlanarState) -> PhysicsState:
        """Return positions, velocities and activations."""
        return PhysicsState(qpos=engine_state.qpos, qvel=engine_state.qvel, act=engine_state.act)

    def overflow(self, engine_state: PlanarState, inputs: Inputs) -> jax.Array:
        """Return how many solids near robots were not looked at in the last step (worlds,)."""
        del inputs
        return jnp.asarray(engine_state.left_out)
