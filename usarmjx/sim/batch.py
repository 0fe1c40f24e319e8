"""Many worlds at once: the only place that maps over worlds and compiles.

The same few lines drive all engines. On a traceable engine a step is one compiled function;
with C MuJoCo the parts around the engine are.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, ArrayLike, jax_entry_points, numpy_backend, set_at
from usarmjx.base.compilation import NOTICE, enable_cache_after_import
from usarmjx.base.errors import EngineError, UnsupportedFeatureError, UsageError
from usarmjx.base.nodes import Node
from usarmjx.base.program_cache import ProgramCache, compile_program
from usarmjx.base.tables import facts_table
from usarmjx.comms.links import Links
from usarmjx.comms.mail import clear_inboxes
from usarmjx.engines import PhysicsState, choose_engine, make_engine
from usarmjx.engines.base import Engine
from usarmjx.models.compile.arena_set import ArenaState
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.compile.standing import stances_in
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sensors.base import Reading
from usarmjx.sensors.cameras.picture import (
    Annotation,
    Picture,
    Viewpoint,
    annotate,
    camera_viewpoint,
    render_picture_jit,
)
from usarmjx.sensors.cameras.shading import RenderScene
from usarmjx.sim.control import CommandUpdate, ControlMode, update_command
from usarmjx.sim.operate import OperationResult, find_operation, operate_in_worlds
from usarmjx.sim.radio import mailboxes, outgoing_messages, radio_of, send, update_links_of_worlds
from usarmjx.sim.reset import init_world, reset
from usarmjx.sim.scene import Scene, build_scene
from usarmjx.sim.views import (
    GroupCamera,
    build_render_scene,
    find_camera,
    map_pictures,
    render_groups,
    render_scene_of_world,
)
from usarmjx.sim.world import (
    GroupState,
    World,
    compute_inputs,
    finish_and_compute_inputs,
    finish_step,
    observe,
)

Readings = tuple[tuple[Reading, ...], ...]
"""Per group and sensor a reading with leading axes (worlds, robots of the group)."""


class BatchState(Node, kw_only=True):
    """A batch of worlds.

    Attributes:
        physics: The engine's own state.
        worlds: Everything else (worlds, ...).
        arenas: The arenas that resets draw from, which may be replaced by others of the same shapes
            (arenas, ...); None where all worlds have the same arena.
    """

    physics: Any
    worlds: World
    arenas: ArenaState | None = None


def select_worlds(mask: jax.Array, new: jax.Array, old: jax.Array) -> jax.Array:
    """Return new where masked (worlds,), else old (worlds, ...)."""
    # The mask gets an axis of length 1 for each further one: `where` aligns axes from the last.
    return jnp.where(mask.reshape(-1, *[1] * (new.ndim - 1)), new, old)


MAX_SOLVER_TIMESTEP = 0.025
"""With longer steps a solver of contacts throws robots about [s]."""


def engine_of(scene: Scene, name: str, worlds: int) -> Engine[Any]:
    """Build the engine that steps copies of a scene.

    Args:
        scene: The scene.
        name: Name of the engine, or `auto`: the best to train with here.
        worlds: Number of copies.

    Raises:
        UnknownNameError: No such engine.
        UnsupportedFeatureError: The scene has a feature that the engine would ignore, or too long steps.
        UncalibratedRobotError: Engine `planar` has no figures of a robot.
        EngineError: The engine cannot run here.
    """
    kind = choose_engine(name, "batch")
    if kind != "planar" and scene.physics.timestep > MAX_SOLVER_TIMESTEP:
        raise UnsupportedFeatureError(
            f"engine {kind!r} cannot run this scene: physics steps of {scene.physics.timestep:g} s are for "
            f"engine planar, others take up to {MAX_SOLVER_TIMESTEP:g} s"
        )
    built = scene.spec, scene.physics, worlds, scene.moved_geoms, scene.varied_bodies
    return make_engine(kind, *built, robots=scene.robots)


@jax_entry_points
class Batch:
    """Copies of a scene that are stepped together.

    Args:
        scene: The scene that every world copies, or the arena of one with a P2AT.
        worlds: Number of worlds.
        engine: `warp`, `jax`, `c`, `planar`, or `auto`.
        seed: Seed of all random numbers.
        first: Number of the first world. World k draws the same numbers alone as in a batch.
        shuffle: Draw start poses at each reset instead of handing them out in the arena's order.

    Raises:
        UsageError: Fewer than one world.
        UnsupportedFeatureError: The scene has a feature that the engine would ignore.
        UncalibratedRobotError: Engine `planar` has no figures of a robot, which
            `usarmjx.sim.ensure_calibrated` measures.
        EngineError: The engine cannot run here.
        UnknownNameError: No such engine.
    """

    _program_cache: ProgramCache | None = None
    """Cache of compiled programs; None: they are compiled at each start."""

    def __repr__(self) -> str:
        """Return a short line: what is stepped, by which engine."""
        return f"Batch({self.scene!r}, worlds={self.worlds}, engine={type(self.engine).__name__})"

    def _repr_html_(self) -> str:
        facts = {"worlds": self.worlds, "engine": type(self.engine).__name__, **self.scene.facts}
        return facts_table("Batch", facts)

    def __init__(
        self,
        scene: Scene | str | Path,
        worlds: int = 1,
        *,
        engine: str = "auto",
        seed: int = 0,
        first: int = 0,
        shuffle: bool = False,
    ) -> None:
        if worlds < 1:
            raise UsageError(f"a batch needs at least one world, not {worlds}")
        # Before anything is compiled, so that the first programs are kept too.
        enable_cache_after_import()
        scene = build_scene(scene) if isinstance(scene, str | Path) else scene
        self.scene = scene
        self.worlds = worlds
        self.engine = engine_of(scene, engine, worlds)
        NOTICE.expect(f"Batch(worlds={worlds}, engine={engine!r})")
        # World numbers, not indices: `first` lets a part of a batch draw what the whole would.
        self.origin, self._numbers = (seed, first, shuffle), np.arange(first, first + worlds, dtype=np.int32)
        # All of these close over the scene: its constants are compiled in, and a change of scene needs a new
        # batch.
        inputs_of = partial(compute_inputs, scene, solved=self.engine.has_solver)
        self._compute_inputs = self._compile(jax.vmap(inputs_of))
        self._finish_step = self._compile(jax.vmap(partial(finish_step, scene)))
        self._finish_and_compute_inputs = self._compile(jax.vmap(partial(finish_and_compute_inputs, scene)))
        self._fresh = jax.vmap(partial(reset, scene, shuffle=shuffle), in_axes=(0, None))
        self._reset = self._compile(self._reset_worlds_where)
        self._init = self._compile(
            jax.vmap(partial(init_world, scene, shuffle=shuffle), in_axes=(0, 0, None))
        )
        self._observe = self._compile(jax.vmap(partial(observe, scene)))
        self._operate = self._compile(partial(operate_in_worlds, scene), static=(2, 3))
        self._render = self._compile(partial(render_groups, scene), static=(2, 3))
        self._render_scene = self._compile(partial(render_scene_of_world, scene))
        self._links = self._compile(partial(update_links_of_worlds, scene))
        self._send = self._compile(jax.vmap(partial(send, scene)))
        # C MuJoCo steps outside of JAX, so with it the parts around it are compiled instead of the whole
        # step.
        self._step_program, self._reset_program = self._step, self._reset_where
        if self.engine.traceable:
            self._step_program = self._compile(self._step)
            self._reset_program = self._compile(self._reset_where)

    def _keys_of(self, seed: int) -> jax.Array:
        # Keys depend on a world's number alone, so results do not depend on the size of the batch.
        return jax.vmap(partial(jax.random.fold_in, random.key(seed)))(self._numbers)

    def _compile(self, function: Callable[..., Any], static: tuple[int, ...] = ()) -> Callable[..., Any]:
        return self.engine.blocking(compile_program(function, self._program_cache, "Batch", static=static))

    def reset(self, seed: int | None = None, arenas: ArenaState | None = None) -> BatchState:
        """Return all worlds at the start of their first episode.

        Args:
            seed: Seed of all random numbers; None: the batch's own.
            arenas: Arenas to draw from instead of the scene's, of the same shapes.
        """
        if arenas is None and self.scene.arenas is not None:
            arenas = jax.device_put(self.scene.arenas.states)  # `jnp.asarray` compiles for each shape
        keys = self._keys_of(self.origin[0] if seed is None else seed)
        worlds, qpos = self._init(keys, self._numbers, arenas)
        everywhere = jnp.ones(self.worlds, bool)
        physics = self.engine.reset(self.engine.start(), everywhere, qpos)
        return BatchState(physics=physics, worlds=worlds, arenas=arenas)

    def step(self, state: BatchState) -> BatchState:
        """Advance every world by one control step under the commands in force."""
        return self._step_program(state)

    def reset_where(self, state: BatchState, mask: jax.Array) -> BatchState:
        """Start the next episode in some worlds; the others keep every bit.

        Args:
            state: The batch.
            mask: Which worlds (worlds,).
        """
        return self._reset_program(state, mask)

    def _reset_worlds_where(
        self, worlds: World, arenas: ArenaState | None, mask: jax.Array
    ) -> tuple[World, Array]:
        # Every world computes a reset, and a mask selects: under `vmap` a condition would compute both sides
        # too.
        fresh, qpos = self._fresh(worlds, arenas)
        return jax.tree.map(partial(select_worlds, mask), fresh, worlds), qpos

    def _reset_where(self, state: BatchState, mask: jax.Array) -> BatchState:
        worlds, qpos = self._reset(state.worlds, state.arenas, mask)
        return state.replace(physics=self.engine.reset(state.physics, mask, qpos), worlds=worlds)

    def _recover_where(
        self, state: BatchState, mask: jax.Array, before: Array, reset_bad: bool
    ) -> BatchState:
        """Mend worlds that broke: they start their next episode, or go on from qpos (worlds, nq), at rest."""
        if reset_bad:
            return self._reset_where(state, mask)
        # The state before the step may be broken already, if the caller set it: then the model's own takes
        # over.
        finite = jnp.isfinite(before).all(-1, keepdims=True)
        qpos = jnp.where(finite, before, np.float32(self.scene.model.qpos0))
        return state.replace(physics=self.engine.reset(state.physics, mask, qpos))

    def _step(self, state: BatchState, reset_bad: bool = True) -> BatchState:
        before = self.engine.state(state.physics)
        worlds, inputs = self._compute_inputs(state.worlds, before)
        with jax.named_scope("physics"):
            physics = self.engine.advance(state.physics, inputs)
        # Before anything is reset: afterwards the step's contact counts are gone.
        overflow = self.engine.overflow(physics, inputs)
        worlds, finite = self._finish_step(worlds, self.engine.state(physics), overflow)
        state = state.replace(physics=physics, worlds=worlds)
        recover = partial(self._recover_where, mask=~finite, before=before.qpos, reset_bad=reset_bad)
        if self.engine.traceable:
            if not (reset_bad or self.engine.has_solver):
                return recover(state)  # takes less than a condition, for which the host of a GPU waits
            # A condition over the whole batch stays a condition, so that a sound step pays for no reset.
            return jax.lax.cond(finite.all(), lambda s: s, recover, state)
        return state if bool(finite.all()) else recover(state)

    def run(self, state: BatchState, steps: int, *, reset_bad: bool = True) -> BatchState:
        """Advance every world by some control steps, as `step` does, in fewer calls.

        A subclass's own `step` is used, but not with `reset_bad=False`.

        Args:
            state: The batch.
            steps: Number of control steps.
            reset_bad: Whether worlds whose physics is no longer finite start their next episode at once. If
                not, they go on from where they were, at rest: for who resets them afterwards.
        """
        if self.engine.traceable:
            # `self.step` and not `self._step`: a subclass may extend a step.
            step = self.step if reset_bad else partial(self._step, reset_bad=False)
            # A loop within one program: a call from Python for each step would cost as much as a small step.
            return self.engine.blocking(jax.lax.fori_loop)(0, steps, lambda _, s: step(s), state)
        if reset_bad and type(self).step is not Batch.step:
            for _ in range(steps):
                state = self.step(state)
            return state
        if steps < 1:
            return state
        physics, current = state.physics, self.physics(state)
        # Each step's end and the next one's start are one program: half as many calls from Python.
        worlds, inputs = self._compute_inputs(state.worlds, current)
        for remaining in reversed(range(steps)):
            before, physics = current.qpos, self.engine.advance(physics, inputs)
            overflow, current = self.engine.overflow(physics, inputs), self.engine.state(physics)
            finished, finite, (next_worlds, inputs) = self._finish_and_compute_inputs(
                worlds, current, overflow
            )
            if not bool(finite.all()):
                broken = state.replace(physics=physics, worlds=finished)
                # The inputs made above belong to the broken state: the rest of the run starts anew from the
                # mended one.
                recovered = self._recover_where(broken, ~finite, before, reset_bad)
                return self.run(recovered, remaining, reset_bad=reset_bad)
            # Inputs after the last step are thrown away: the next call makes them under its own commands.
            worlds = next_worlds if remaining else finished
        return state.replace(physics=physics, worlds=worlds)

    def arena_of(self, state: BatchState, world: int) -> ArenaSpec:
        """Return the arena that a world has in its present episode."""
        return self.scene.arena_of(jax.tree.map(lambda rows: rows[world], state.worlds.arena_state))

    def physics(self, state: BatchState) -> PhysicsState:
        """Return positions, velocities and activations of all worlds."""
        return self.engine.state(state.physics)

    def observe(self, state: BatchState) -> tuple[BatchState, Readings]:
        """Read the sensors that are due; the others repeat their last reading, marked as not fresh."""
        worlds, readings = self._observe(state.worlds, self.physics(state))
        return state.replace(worlds=worlds), readings

    def links(self, state: BatchState) -> tuple[BatchState, Links]:
        """Look at the radio links, which are evaluated at most once in a control step, or radio `period`.

        Returns:
            The batch, and the links (worlds, ...). Their events tell what changed since the evaluation
            before; a table that is older than the control step has none.

        Raises:
            UsageError: The scene has no radio.
        """
        radio_of(self.scene)
        links = self._links(state.worlds, self.physics(state))
        return state.replace(worlds=state.worlds.replace(links=links)), links

    def send(
        self, state: BatchState, to: ArrayLike, payload: ArrayLike, length: ArrayLike | None = None
    ) -> BatchState:
        """Let each robot send a message to any of the others, over the links of `links`.

        Messages that arrive are in `state.worlds.mail` at once, which also counts those that were lost.

        Args:
            state: The batch.
            to: Receivers, sender by row, broadcast to (worlds, robots, robots).
            payload: Numbers to send, broadcast to (worlds, robots, numbers).
            length: Size of each message [bytes], broadcast to (worlds, robots); None: 4 a number.

        Raises:
            UsageError: The scene has no mail.
        """
        # Checked before links are evaluated: an error leaves the state as it was.
        messages = outgoing_messages(self.scene, (self.worlds,), to, payload, length)
        state, _ = self.links(state)
        return state.replace(worlds=state.worlds.replace(mail=self._send(state.worlds, messages)))

    def clear_mail(self, state: BatchState, where: ArrayLike = True) -> BatchState:
        """Empty the boxes of robots that have read their mail: those masked, broadcast to (worlds, robots).

        Raises:
            UsageError: The scene has no mail.
        """
        mail = clear_inboxes(mailboxes(self.scene, state.worlds), jnp.asarray(where))
        return state.replace(worlds=state.worlds.replace(mail=mail))

    def drive(self, state: BatchState, group: int, values: Mapping[str, ArrayLike]) -> BatchState:
        """Set keys of DRIVE for a group's robots; the other keys keep what they were last set to.

        Args:
            state: The batch.
            group: Index into `scene.groups`.
            values: Numbers for some of the keys of the robots' drive (`robot.drive.full_scale` lists them
                with their limits), as {"Left": 2.0, "Right": 2.0} [rad/s, m/s or rad], broadcast to
                (worlds, robots).

        Raises:
            UnknownNameError: A key that this drive does not have; lists those it has.
        """
        return self._update_command(state, group, CommandUpdate(drive=values))

    def move(
        self,
        state: BatchState,
        group: int,
        targets: Mapping[str, ArrayLike],
        mode: ControlMode = ControlMode.POSITION,
    ) -> BatchState:
        """Tell joints of a group's robots where to go, how fast to move or what to exert.

        Args:
            state: The batch.
            group: Index into `scene.groups`.
            targets: Joint names and positions [rad or m], velocities [rad/s or m/s] or torques [N m or N],
                broadcast to (worlds, robots).
            mode: Control mode of the targets.

        Raises:
            UnknownNameError: A joint that these robots do not have; lists those they have.
        """
        return self._update_command(state, group, CommandUpdate(joints=targets, mode=mode))

    def _update_command(self, state: BatchState, group: int, update: CommandUpdate) -> BatchState:
        members = state.worlds.groups[group]
        command = update_command(self.scene.groups[group].plan, members.command, update)
        return self.with_group(state, group, members.replace(command=command))

    def operate(
        self,
        state: BatchState,
        group: int,
        name: str,
        opcode: str,
        value: ArrayLike | None = None,
        where: ArrayLike = True,
    ) -> tuple[BatchState, OperationResult]:
        """Let a group's robots operate an effecter (manual 8), as SET does.

        Args:
            state: The batch.
            group: Index into `scene.groups`.
            name: Name of the effecter, case ignored.
            opcode: Name of one of its operations, case ignored.
            value: Its parameter, broadcast to (worlds, robots); None: the usual one.
            where: Mask of the robots that carry it out, broadcast to (worlds, robots).

        Returns:
            The batch, and the result per world and robot.

        Raises:
            UnknownNameError: The robots have no such effecter, or it no such operation; lists those known.
            UsageError: The operation needs a parameter.
        """
        effecter, operation, number = find_operation(self.scene.groups[group], name, opcode, value)
        shape = state.worlds.groups[group].active.shape
        # Broadcast here, outside of the program, which would be compiled anew for each
        # shape of the arguments.
        command = jnp.broadcast_to(jnp.asarray(number, jnp.float32), shape), jnp.broadcast_to(where, shape)
        worlds, result = self._operate(
            state.worlds, self.physics(state), (group, effecter), operation, *command
        )
        return state.replace(worlds=worlds), result

    def render(
        self,
        state: BatchState,
        group: int,
        camera: str | int | None = None,
        width: int = 64,
        height: int = 64,
    ) -> Picture:
        """Return the view of a camera of each of a group's robots (worlds, robots, ...).

        Args:
            state: The batch.
            group: Index into `scene.groups`.
            camera: Name or index of a camera of the class; None: the main one.
            width: Pixels along a row.
            height: Rows.

        Raises:
            UnknownNameError: The robots have no such camera; lists those they have.
            UsageError: A picture of that size cannot be taken.
        """
        group_camera = find_camera(self.scene, group, camera, (width, height))
        return self._render(state.worlds, self.physics(state), group_camera, (width, height))

    def render_robot(
        self,
        state: BatchState,
        world: int,
        slot: int,
        camera: str | int | None = None,
        width: int = 320,
        height: int = 240,
    ) -> Picture:
        """Return the view of a camera of the robot in one slot of one world; see `render`."""
        group, member = self.scene.group_of(slot)
        _, lens, index = find_camera(self.scene, group, camera, (width, height))
        render_scene, bodies = self._render_scene(state.worlds, self.physics(state), world)
        # As `compile_program` does: TensorFloat-32 would move rays by a millimetre.
        with jax.default_matmul_precision("highest"):
            body = jax.tree.map(lambda x: x[member], bodies[group])
            fov = state.worlds.groups[group].fov[world, member, index]
            viewpoint = camera_viewpoint(lens, body, jnp.int32(slot), fov)
            return render_picture_jit(render_scene, viewpoint, width, height)

    def render_view(
        self, state: BatchState, world: int, viewpoint: Viewpoint, width: int = 320, height: int = 240
    ) -> Picture:
        """Return the view of a world from any viewpoint."""
        render_scene, _ = self._render_scene(state.worlds, self.physics(state), world)
        with jax.default_matmul_precision("highest"):
            return render_picture_jit(render_scene, viewpoint, width, height)

    def zoom(
        self, state: BatchState, group: int, camera: str | int | None, fov: ArrayLike, where: ArrayLike = True
    ) -> BatchState:
        """Set a camera's field of view, as SET does: within its limits, and 0 is the default (manual 9.4).

        Args:
            state: The batch.
            group: Index into `scene.groups`.
            camera: Name or index of a camera of the class; None: the main one.
            fov: Horizontal field of view [rad], broadcast to (worlds, robots).
            where: Mask of the robots that do it, broadcast to (worlds, robots).

        Raises:
            UnknownNameError: The robots have no such camera; lists those they have.
        """
        members, (_, lens, index) = state.worlds.groups[group], find_camera(self.scene, group, camera)
        zoomed = jnp.where(where, lens.clamp(jnp.asarray(fov), jnp), members.fov[..., index])
        return self.with_group(state, group, members.replace(fov=set_at(members.fov, (..., index), zoomed)))

    @staticmethod
    def with_group(state: BatchState, group: int, group_state: GroupState) -> BatchState:
        """Return the batch with one group's state replaced."""
        return state.replace(worlds=state.worlds.with_group(group, group_state))

    def check_overflow(self, state: BatchState) -> None:
        """Refuse to go on with results that a full contact buffer has falsified.

        Raises:
            EngineError: Says how many worlds lost contacts, and what to raise.
        """
        overflow = int((np.asarray(state.worlds.faults.overflow) > 0).sum())
        if overflow:
            raise EngineError(
                f"contact buffers overflowed in {overflow} of {self.worlds} worlds; raise "
                f"Physics.contacts_per_robot (now {self.scene.physics.contacts_per_robot})"
            )


def put_robot(batch: Batch, state: BatchState, world: int, slot: int, pos: Array, quat: Array) -> BatchState:
    """Return a batch with a robot put somewhere, at rest; its joints stay as they are, unless it is parked.

    Args:
        batch: The batch.
        state: Its state.
        world: Index of the world.
        slot: Slot of the robot.
        pos: Position of its chassis' origin [m] (3,).
        quat: Orientation (4,).
    """
    scene = batch.scene
    group, member = scene.group_of(slot)
    index = scene.groups[group].indices[member]
    shape = batch.worlds, scene.model.nq
    pinned, qpos = np.zeros(shape, bool), np.zeros(shape, np.float32)
    pinned_dof = np.zeros((batch.worlds, scene.model.nv), bool)
    root = slice(index.root_qposadr, index.root_qposadr + 7)
    # All engines can pin coordinates, as they do for parked robots: so a robot is moved without stepping.
    pinned[world, root], qpos[world, root] = True, (*pos, *quat)
    pinned_dof[world, index.root_dofadr : index.root_dofadr + 6] = True
    if not bool(state.worlds.groups[group].active[world, member]):
        joints = list(index.qposadr)
        with numpy_backend():
            varied = jax.tree.map(lambda x: np.asarray(x)[world], state.worlds.varied)
            # If wheels vary between worlds, its joints stand as this world's do.
            own = stances_in(scene.vary, varied, scene.groups[group].robot, [slot])
        pinned[world, joints] = True
        qpos[world, joints] = scene.parked_qpos[joints] if own is None else own.joints[0]
        pinned_dof[world, list(index.dofadr)] = True
    return state.replace(physics=batch.engine.set_qpos(state.physics, pinned, pinned_dof, qpos))


Moment = tuple[World, PhysicsState]
"""Worlds, and where everything is in them."""
Member = tuple[BodyPoses, Array, Array]
"""Bodies of robots, their slots, and the fields of view of a camera [rad]."""


class Annotator:
    """Annotates what the cameras of a batch see; compiled once for each camera and size.

    Args:
        batch: The batch.
    """

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        # TensorFloat-32 would move rays by a millimetre.
        exact = jax.default_matmul_precision("highest")(partial(_annotate_worlds, batch.scene))
        self._annotate: Callable[..., Annotation] = jax.jit(exact, static_argnums=(2, 3))

    def annotate(
        self,
        state: BatchState,
        group: int,
        camera: str | int | None = None,
        width: int = 64,
        height: int = 64,
        *,
        later: BatchState | None = None,
    ) -> Annotation:
        """Return the view of a camera of each of a group's robots (worlds, robots, ...).

        Args:
            state: The batch.
            group: Index into `scene.groups`.
            camera: Name or index of a camera of the class; None: the main one.
            width: Pixels along a row.
            height: Rows.
            later: The batch at the moment up to which the flow is; None: nothing moves.

        Raises:
            UnknownNameError: The robots have no such camera; lists those they have.
            UsageError: A picture of that size cannot be taken.
        """
        then, size = state if later is None else later, (width, height)
        # The same instant twice, if nothing moves: one program serves both cases.
        moments = [(one.worlds, self._batch.physics(one)) for one in (state, then)]
        return self._annotate(*moments, find_camera(self._batch.scene, group, camera, size), size)


def _annotate_worlds(
    scene: Scene, now: Moment, then: Moment, group_camera: GroupCamera, size: tuple[int, int]
) -> Annotation:
    group, camera, camera_index = group_camera
    slots = jnp.asarray(scene.groups[group].slots)

    def build(moment: Moment) -> tuple[RenderScene, Member]:
        render_scene, bodies = build_render_scene(scene, *moment)
        return render_scene, (bodies[group], slots, moment[0].groups[group].fov[:, camera_index])

    def of_world(now: Moment, then: Moment) -> Annotation:
        (scene_now, members_now), (scene_later, members_later) = build(now), build(then)

        def of_robot(members_now: Member, members_later: Member) -> Annotation:
            views = [camera_viewpoint(camera, *member) for member in (members_now, members_later)]
            return annotate(scene_now, views[0], scene_later, views[1], *size)

        return map_pictures(of_robot, members_now, members_later)

    return map_pictures(of_world, now, then)
