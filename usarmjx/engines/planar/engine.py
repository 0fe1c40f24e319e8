"""The engine `planar`."""

from functools import partial
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
from usarmjx.engines.planar.few_worlds import where_needed
from usarmjx.engines.planar.flight import fly, held_up
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.movable import MovableSolids, WhereSolids, movable_solids
from usarmjx.engines.planar.neighbours import (
    Margin,
    Neighbours,
    farthest_in_a_step,
    ground_of,
    look_around,
    most_near,
    places_of,
    stopping,
)
from usarmjx.engines.planar.parting import part_robots
from usarmjx.engines.planar.poses import FixedBodies, fixed_bodies
from usarmjx.engines.planar.rolling import feet_of, place_on_ground, reach_of, roll, rolled, stopped
from usarmjx.engines.planar.servos import PlanarServos, move_joints, servos_of
from usarmjx.engines.planar.solids import (
    PlanSolids,
    floor_height,
    ground_under,
    joined,
    solid_geoms,
    solids_of,
)
from usarmjx.models.build.compose import Physics
from usarmjx.models.build.layout import RobotIndex
from usarmjx.models.build.moved import MovedGeoms
from usarmjx.models.build.variation import RandomizedBodies
from usarmjx.models.spec.robot import RobotSpec

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
        around: What is around the robots, from one step to the next.
    """

    qpos: Array
    qvel: Array
    act: Array
    touched: Array
    left_out: Array
    around: Neighbours


class Aims(NamedTuple):
    """What the robots of a world would do in a step.

    Attributes:
        before: The robots as they are.
        after: Where they would go.
        left: What they take up on the plan before.
        there: What they would, as high as before and after.
        limit: Up to what height the ground may be under where they stand (4, robots).
        scene: Where the solids are that can be elsewhere.
        stacked: Which are over or under each other (robots, robots); None: nobody flies.
    """

    before: Motion
    after: Motion
    left: Footprints
    there: Footprints
    limit: Array
    scene: WhereSolids
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
        self._most_near = most_near(self._robots.half)
        self._servos: PlanarServos = servos_of(self.model)
        own = {body for _, index in robots for body in index.body_ids}
        self._fixed: FixedBodies = fixed_bodies(self.model, own)
        geoms = solid_geoms(self.model, own, self.moved_ids)
        can_move = (geoms.moved >= 0) | np.isin(geoms.bodies, self._fixed.movable)
        self._movable = geoms.where(can_move)
        self._elsewhere: MovableSolids = movable_solids(self.model, self._fixed, self._movable)
        rest = jnp.asarray(self._fixed.pos, jnp.float32), jnp.asarray(self._fixed.mat, jnp.float32)
        self._still: PlanSolids = solids_of(self.model, geoms.where(~can_move), rest, None)
        self._floor = floor_height(self.model)

    def start(self) -> PlanarState:
        """Return every world at the model's reference configuration."""
        worlds, model = self.worlds, self.model
        qpos = jnp.tile(jnp.asarray(model.qpos0, jnp.float32), (worlds, 1))
        here = {"qpos": qpos, "qvel": jnp.zeros((worlds, model.nv)), "act": jnp.zeros((worlds, model.na))}
        around = jax.eval_shape(jax.vmap(self._unknown), PhysicsState(**here))
        return PlanarState(
            **here,
            touched=jnp.zeros((worlds, self._robots.count), bool),
            left_out=jnp.zeros(worlds, jnp.int32),
            around=jax.tree.map(lambda one: jnp.zeros(one.shape, one.dtype), around),
        )

    def _unknown(self, state: PhysicsState) -> Neighbours:
        """Return something of the shapes of what is around the robots of a world."""
        before = self._robots.motion(state)
        limit = reach_of(self._robots, before).max(0)
        prints, near = self._robots.footprints(before), jnp.zeros_like(limit)
        reach = Margin(aside=near, height=near)
        return self._look(state, None, prints, limit, reach, self._elsewhere.where(state.qpos, None))

    def advance(self, engine_state: PlanarState, inputs: Inputs) -> PlanarState:
        """Make one control step in every world."""
        pinned = self.set_qpos(engine_state, inputs.pinned, inputs.pinned_dof, inputs.qpos)
        moves = ~inputs.pinned[:, self._robots.root_qpos[:, 0]]
        turned = PhysicsState(qpos=pinned.qpos, qvel=pinned.qvel, act=pinned.act)
        state, aims = jax.vmap(self._aim)(turned, inputs)
        around = self._around(pinned.around, state, aims, inputs)
        near = stopping(aims.left, around.near)
        kept, touched = part_robots(aims.left, aims.there, near, moves, aims.stacked, discs=around.near.discs)
        after = jax.vmap(self._stop)(aims.before, aims.after, kept, touched)
        ground = self._ground(around, state, after, aims, inputs)
        moved = jax.vmap(self._finish)(state, aims.before, after, ground)
        return PlanarState(
            qpos=jnp.where(inputs.pinned, pinned.qpos, moved.qpos),
            qvel=jnp.where(inputs.pinned_dof, 0.0, moved.qvel),
            act=moved.act,
            touched=touched & moves,
            left_out=jnp.where(moves, around.left_out, 0).sum(-1),
            around=around,
        )

    def _aim(self, state: PhysicsState, inputs: Inputs) -> tuple[PhysicsState, Aims]:
        """Return one world with its joints turned, where robots are and would go."""
        dt, robots = self.physics.period, self._robots
        moved = move_joints(self._servos, state, inputs.ctrl, inputs.act, dt)
        state, twist = roll(robots, state, moved, inputs, dt)
        before = robots.motion(state)
        after = robots.choose(
            fly(robots, before, inputs.xfrc_applied, self.model, dt), rolled(before, twist, dt)
        )
        left = robots.footprints(before)
        after, stacked = held_up(robots, left, after)
        there = robots.footprints(after)
        there = there.replace(low=jnp.minimum(left.low, there.low), high=jnp.maximum(left.high, there.high))
        limit, scene = reach_of(robots, before), self._elsewhere.where(state.qpos, inputs.geom_poses)
        return state, Aims(before, after, left, there, limit, scene, stacked)

    def _around(self, known: Neighbours, state: PhysicsState, aims: Aims, inputs: Inputs) -> Neighbours:
        """Return what is around all robots, looked up anew where some may have come to what was far away."""
        limit, reach = aims.limit.max(1), farthest_in_a_step(aims.left, aims.there)
        holds = known.holds(places_of(aims.left, limit), aims.scene.loose, reach)
        then, now = known.scene.geoms, aims.scene.geoms
        come_near = where_needed(
            holds & (then != now).any((1, 2)),
            jax.vmap(self._elsewhere.came_near),
            jnp.zeros(self.worlds, bool),
            *(then, now, aims.left, reach.aside),
        )
        needed = jnp.logical_not(holds) | come_near
        known = known.replace(left_out=jnp.zeros_like(known.left_out))
        args = state, inputs.geom_poses, aims.left, limit, reach, aims.scene
        return where_needed(needed, jax.vmap(self._look), known, *args)

    def _look(
        self,
        state: PhysicsState,
        poses: GeomPoses | None,
        prints: Footprints,
        limit: Array,
        reach: Margin,
        scene: WhereSolids,
    ) -> Neighbours:
        """Look up what is around the robots of one world."""
        return look_around(
            prints, limit, self._solids(state, poses), self._floor, reach, scene, self._most_near
        )

    def _ground(
        self, around: Neighbours, state: PhysicsState, after: Motion, aims: Aims, inputs: Inputs
    ) -> Array:
        """Return how high the ground is under where robots stand (worlds, 4, robots)."""
        feet = jax.vmap(partial(feet_of, self._robots))(after)
        middle = jax.vmap(self._robots.footprints)(after).replace(low=aims.left.low)
        known = around.knows_ground(places_of(middle, aims.limit.max(1))).all(-1)
        found = ground_of(around.under, self._floor, feet, aims.limit)

        def everywhere(state: PhysicsState, poses: GeomPoses | None, feet: Array, limit: Array) -> Array:
            return ground_under(self._solids(state, poses), self._floor, feet, limit)

        args = state, inputs.geom_poses, feet, aims.limit
        return where_needed(jnp.logical_not(known), jax.vmap(everywhere), found, *args)

    def _stop(self, before: Motion, after: Motion, kept: Footprints, touched: Array) -> Motion:
        return stopped(self._robots, before, after, kept, touched, self.physics.period)

    def _finish(self, state: PhysicsState, before: Motion, after: Motion, ground: Array) -> PhysicsState:
        """Return one world with its robots on the ground."""
        after = place_on_ground(self._robots, before, after, ground, self.physics.period)
        return self._robots.written(state, after)

    def _solids(self, state: PhysicsState, poses: GeomPoses | None) -> PlanSolids:
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
