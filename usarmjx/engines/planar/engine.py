"""Engine `planar`: footprints on floors, ramps and levels, without a contact solver.

Robots that overlap are separated on JAX, or on a GPU by one Warp kernel with JAX's gradient.
"""

from functools import partial
from typing import Any, ClassVar, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.base.warp_functions import warp_function, warp_in_use
from usarmjx.engines.base import Engine, Inputs, PhysicsState
from usarmjx.engines.planar.ball import Ball, BallMotion, ball_of, find_ball, without_body
from usarmjx.engines.planar.bodies import (
    Motion,
    PlanarRobots,
    PlanarServos,
    fixed_bodies,
    move_joints,
    robots_of,
    servos_of,
)
from usarmjx.engines.planar.flight import fly, resolve_stacking
from usarmjx.engines.planar.footprints import Footprints, separate_footprints
from usarmjx.engines.planar.neighbor_lists import NeighborList, neighbor_capacity, obstacle_outlines
from usarmjx.engines.planar.neighbor_search import (
    SceneSolids,
    ground_below_robots,
    invalid_neighbor_list,
    scene_solids,
    update_neighbors,
)
from usarmjx.engines.planar.proposed_motion import ProposedMotion, pack_motion
from usarmjx.engines.planar.rolling import (
    apply_contacts,
    ground_limits,
    integrate_twist,
    place_on_ground,
    roll,
)
from usarmjx.engines.planar.solids import solid_geoms
from usarmjx.models.compile.compose import RobotIndex
from usarmjx.models.compile.geoms import MovedGeoms
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import RandomizedBodies
from usarmjx.models.types.robot import RobotSpec


def separate_robots(proposed: ProposedMotion, neighbors: NeighborList) -> tuple[Footprints, Array]:
    """Return the robots' resolved poses, as `separate_footprints` does; equal on Warp within rounding."""
    return (separate_on_warp if _fits_on_warp(proposed.moves.shape[1]) else _separate_on_jax)(
        proposed, neighbors
    )


def _separate_on_jax(proposed: ProposedMotion, neighbors: NeighborList) -> tuple[Footprints, Array]:
    near = obstacle_outlines(proposed.left, neighbors.near)
    return separate_footprints(
        proposed.left, proposed.there, near, proposed.moves, proposed.stacked, discs=neighbors.discs
    )


def _fits_on_warp(robots: int) -> bool:
    """Return whether Warp is used for worlds of `robots` robots."""
    if not warp_in_use():
        return False
    from usarmjx.engines.planar.warp_separation import MAX_ROBOTS

    return 0 < robots <= MAX_ROBOTS


def separate_on_warp(proposed: ProposedMotion, neighbors: NeighborList) -> tuple[Footprints, Array]:
    """As `separate_robots`, on Warp: one launch, with as many iterations per world as it needs."""
    return _with_jax_gradient(proposed, neighbors)


def _separate_on_warp(proposed: ProposedMotion, neighbors: NeighborList) -> tuple[Footprints, Array]:
    worlds, robots = proposed.moves.shape
    stacked, near = proposed.stacked, neighbors.packed_obstacles
    # Kernels take no empty arrays: one number stands for a table that is not read.
    over = jnp.zeros(1, jnp.int32) if stacked is None else jnp.asarray(stacked, jnp.int32).reshape(-1)
    solids = near.reshape(-1) if near.size else jnp.zeros(1)
    found = _kernel(robots)(
        *(pack_motion(proposed), solids, over, worlds, near.shape[2], int(stacked is not None)),
        output_dims=worlds * robots * 4,
        launch_dims=worlds * _lanes(robots),
    )
    kept = found[0].reshape(worlds, robots, 4)
    return proposed.there.replace(pos=kept[..., :2], yaw=kept[..., 2]), kept[..., 3] > 0


@warp_function
def _kernel(robots: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel for worlds of `robots` robots."""
    # Here, as Warp belongs to an extra.
    import warp as wp

    from usarmjx.engines.planar.warp_separation import block_threads_for, separation_kernel

    return wp.jax_kernel(separation_kernel(robots), block_dim=block_threads_for(robots))


def _lanes(robots: int) -> int:
    """Return the number of threads per world."""
    from usarmjx.engines.planar.warp_separation import lanes_for

    return lanes_for(robots)


def _gradients(values: tuple[Any, ...], rates: tuple[Any, ...]) -> tuple[Any, Any]:
    """Return the result and its derivative, forward or backward: that of `separate_footprints`."""
    return separate_on_warp(*values), jax.jvp(_separate_on_jax, values, rates)[1]


# Warp's kernel has no derivative of its own: JAX's version of the same computation provides it.
_with_jax_gradient = cast(Any, jax.custom_jvp)(_separate_on_warp)  # JAX leaves its types open
_with_jax_gradient.defjvp(_gradients)


MAX_FLIGHT_PERIOD = 0.05
"""Longest control step for flying and diving robots [s]: the forces that hold them upright are computed once
per control step."""


class PlanarState(struct.PyTreeNode, kw_only=True):
    """State of the worlds.

    Attributes:
        qpos: Positions (worlds, nq).
        qvel: Velocities (worlds, nv).
        act: Activations (worlds, na).
        touched: Which robots touched a solid or each other in the last step (worlds, robots).
        omitted: Number of solids near robots beyond the neighbor lists (worlds,).
        neighbors: Neighbor lists, kept from step to step.
    """

    qpos: Array
    qvel: Array
    act: Array
    touched: Array
    omitted: Array
    neighbors: NeighborList


class PlanarEngine(Engine[PlanarState]):
    """Engine with one closed-form step per control step.

    Args:
        robots: Robots of the model and their indices in it, by slot; the other arguments are those of
            `Engine`.

    Raises:
        UnsupportedFeatureError: A robot or an arena is not supported; names the engines that support it.
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
        if self._robots.flies.any() and physics.period > MAX_FLIGHT_PERIOD:
            raise UnsupportedFeatureError(
                "engine 'planar' moves flyers and divers in control steps of up to "
                f"{MAX_FLIGHT_PERIOD:g} s, not {physics.period:g} s"
            )
        self._servos: PlanarServos = servos_of(self.model, robots)
        own = {body for _, index in robots for body in index.body_ids}
        geoms, fixed = solid_geoms(self.model, own, self.moved_ids), fixed_bodies(self.model, own)
        ball = find_ball(self.model, fixed, geoms)
        if ball is not None:
            geoms, stays = geoms.where(geoms.ids != ball.geom), without_body(fixed, ball.body)
        else:
            stays = fixed
        self._solids: SceneSolids = scene_solids(
            self.model, geoms, stays, neighbor_capacity(self._robots.half)
        )
        # The order of `SceneSolids.of_world`: still solids, then movable ones.
        still = geoms.ids[~np.isin(geoms.ids, self._solids.movable.ids)]
        order = np.concatenate([still, self._solids.movable.ids])
        self._ball: Ball | None = ball and ball_of(self.model, ball, order, self._robots.chassis)

    def start(self) -> PlanarState:
        """Return every world in the model's reference configuration."""
        worlds, model = self.worlds, self.model
        qpos = jnp.tile(jnp.asarray(model.qpos0, jnp.float32), (worlds, 1))
        here = {"qpos": qpos, "qvel": jnp.zeros((worlds, model.nv)), "act": jnp.zeros((worlds, model.na))}
        return PlanarState(
            **here,
            touched=jnp.zeros((worlds, self._robots.count), bool),
            omitted=jnp.zeros(worlds, jnp.int32),
            neighbors=self._invalid_lists(PhysicsState(**here)),
        )

    def _invalid_lists(self, state: PhysicsState) -> NeighborList:
        """Return an empty neighbor list."""

        def proposed_of(state: PhysicsState) -> ProposedMotion:
            robots = jax.vmap(self._robots.motion)(state)
            footprints = jax.vmap(self._robots.footprints)(robots)
            limit = jax.vmap(partial(ground_limits, self._robots))(robots)
            scene = jax.vmap(self._solids.movable_set.placement, (0, None))(state.qpos, None)
            # Of `moves` only type and shape matter.
            return ProposedMotion(
                footprints, footprints, footprints.yaw > 0, None, limit, scene, state.qpos, None
            )

        # Shapes are enough: nothing is computed for a list that the first step builds anew.
        return invalid_neighbor_list(self._solids, jax.eval_shape(proposed_of, state))

    def advance(self, engine_state: PlanarState, inputs: Inputs) -> PlanarState:
        """Make one control step in every world."""
        pinned = self.set_qpos(engine_state, inputs.pinned, inputs.pinned_dof, inputs.qpos)
        # A pinned robot is not pushed: it acts like a wall.
        moves = ~inputs.pinned[:, self._robots.root_qpos[:, 0]]
        turned = PhysicsState(qpos=pinned.qpos, qvel=pinned.qvel, act=pinned.act)
        state, before, after, proposed = jax.vmap(self._aim)(turned, inputs, moves)
        # Lists are of all worlds at once, outside of `vmap`, under which a condition would always rebuild.
        neighbors = update_neighbors(self._solids, pinned.neighbors, proposed)
        kept, touched = separate_robots(proposed, neighbors)
        if self._ball is not None:
            rolled, kept, stopped = jax.vmap(self._push_ball)(state, proposed, kept)
            state, touched = jax.vmap(self._write_ball)(state, rolled), touched | stopped
        stopped_at = jax.vmap(self._stop)(before, after, kept, touched)
        # After the pushes: the ground under a robot is that of where it ends.
        ground = ground_below_robots(self._solids, neighbors, kept, proposed)
        moved = jax.vmap(self._finish)(state, before, stopped_at, ground, inputs)
        return PlanarState(
            # Pinned robots took part as walls, and their own motion is thrown away.
            qpos=jnp.where(inputs.pinned, pinned.qpos, moved.qpos),
            qvel=jnp.where(inputs.pinned_dof, 0.0, moved.qvel),
            act=moved.act,
            touched=touched & moves,
            omitted=jnp.where(moves, neighbors.omitted, 0).sum(-1, dtype=jnp.int32),
            neighbors=neighbors,
        )

    def _robots_in(self, inputs: Inputs) -> PlanarRobots:
        """Return the robots as they stand in one world."""
        vary = None if self.varied_bodies is None else self.varied_bodies.vary
        return self._robots.varied(vary, inputs.varied)

    def _aim(
        self, state: PhysicsState, inputs: Inputs, moves: Array
    ) -> tuple[PhysicsState, Motion, Motion, ProposedMotion]:
        """Return one world with its joints moved, its motion before, and the proposed motion."""
        dt, robots = self.physics.period, self._robots_in(inputs)
        moved = move_joints(self._servos, state, inputs.ctrl, inputs.act, dt)
        turned, twist = roll(robots, state, moved, inputs, dt)
        before = robots.motion(turned)
        after = robots.choose(
            fly(robots, before, inputs.xfrc_applied, self.model, dt), integrate_twist(before, twist, dt)
        )
        left = robots.footprints(before)
        after, stacked = resolve_stacking(robots, left, after)
        there = robots.footprints(after)
        # The height range of the whole step: a robot that falls past a ledge would else miss it.
        there = there.replace(low=jnp.minimum(left.low, there.low), high=jnp.maximum(left.high, there.high))
        # Only randomized robots stand with a tilt that differs from their class's.
        level = before if robots is self._robots else robots.without_tilt(before)
        limit, poses = ground_limits(robots, level), inputs.geom_poses
        scene = self._solids.movable_set.placement(state.qpos, poses)
        return (
            turned,
            before,
            after,
            ProposedMotion(left, there, moves, stacked, limit, scene, state.qpos, poses),
        )

    def _push_ball(
        self, state: PhysicsState, proposed: ProposedMotion, kept: Footprints
    ) -> tuple[BallMotion, Footprints, Array]:
        """Return the ball of one world after the step, the robots, and which of them it stops (robots,)."""
        assert self._ball is not None  # as the caller says
        solids = self._solids.of_world(state.qpos, proposed.poses)
        return self._ball.push(state, solids, proposed.left, kept, self.physics.period)

    def _write_ball(self, state: PhysicsState, rolled: BallMotion) -> PhysicsState:
        assert self._ball is not None  # as the caller says
        return self._ball.write(state, rolled, self.physics.period)

    def _stop(self, before: Motion, after: Motion, kept: Footprints, touched: Array) -> Motion:
        return apply_contacts(self._robots, before, after, kept, touched, self.physics.period)

    def _finish(
        self, state: PhysicsState, before: Motion, after: Motion, ground: Array, inputs: Inputs
    ) -> PhysicsState:
        """Return one world with its robots on the ground."""
        after = place_on_ground(self._robots_in(inputs), before, after, ground, self.physics.period)
        return self._robots.write(state, after)

    def set_qpos(
        self, engine_state: PlanarState, pinned: Array, pinned_dof: Array, qpos: Array
    ) -> PlanarState:
        """Set the pinned coordinates to qpos, at rest."""
        return engine_state.replace(
            qpos=jnp.where(pinned, qpos, engine_state.qpos),
            qvel=jnp.where(pinned_dof, 0.0, engine_state.qvel),
        )

    def reset(self, engine_state: PlanarState, mask: Array, qpos: Array) -> PlanarState:
        """Reset the masked worlds to qpos, at rest; the others keep every bit."""

        def clear(value: Array) -> Array:
            return jnp.where(mask.reshape(-1, *[1] * (value.ndim - 1)), jnp.zeros_like(value), value)

        # A margin of 0 invalidates the neighbor list, which is then rebuilt; its solids need not be cleared.
        neighbors = engine_state.neighbors.replace(room=clear(engine_state.neighbors.room))
        # The lists are by far the largest part of the state.
        cleared = jax.tree.map(clear, engine_state.replace(neighbors=()))
        return cleared.replace(qpos=jnp.where(mask[:, None], qpos, engine_state.qpos), neighbors=neighbors)

    def state(self, engine_state: PlanarState) -> PhysicsState:
        """Return positions, velocities and activations."""
        return PhysicsState(qpos=engine_state.qpos, qvel=engine_state.qvel, act=engine_state.act)

    def overflow(self, engine_state: PlanarState, inputs: Inputs) -> jax.Array:
        """Return the number of solids near robots that the last step did not test (worlds,)."""
        del inputs
        return jnp.asarray(engine_state.omitted)
