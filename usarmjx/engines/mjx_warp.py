"""MJX on NVIDIA Warp's kernels (engine `warp`): contact budget, sleeping loose objects and CUDA graphs.

On a CPU recorded launches of a step are replayed by Warp's C++ code. Python spends some 80 us on each of the
150 to 300 launches of a step, most of them on arguments that do not change; a recording holds these, so a
launch costs a hundredth. On GPUs CUDA graphs do the same.
"""

import atexit
import copy
import ctypes
import dataclasses
import logging
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from importlib import import_module
from types import SimpleNamespace
from typing import Any, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.custom_batching import custom_vmap

from usarmjx.base.backend import Array
from usarmjx.base.errors import EngineError
from usarmjx.base.registry import Registry
from usarmjx.base.warp_functions import pause_collection_in_callbacks, with_globals
from usarmjx.base.warp_modules import WarpModule, load_side_by_side, modules_of
from usarmjx.engines.base import Inputs, SolvedStep, StepArguments, StepOutcome, choose_solver
from usarmjx.engines.block import why_not
from usarmjx.engines.cylinder_box import check_mjx_version
from usarmjx.engines.mjx import MjxEngine, local_device, mjx
from usarmjx.models.compile.compose import LOOSE_PREFIX, VICTIM_PREFIX
from usarmjx.models.compile.geoms import MovedGeoms
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import RandomizedBodies

LOGGER = logging.getLogger(__name__)
NUM_KINDS = int(mujoco.mjtGeom.mjGEOM_MESH) + 1
"""Number of geom types that collide."""
NEAR_BOX_GAP = 0.05
"""Gap up to which two bounding boxes count as near [m]."""
CONVEX_PAIR_FACTOR = 2
"""Safety factor on the number of convex pairs that are near each other at the start."""
MIN_CONVEX_FRACTION = 0.25
"""Lower bound of the convex contact budget, as a fraction of all contacts. A P2AT has a budget of 16 contacts
and, driving at random in `yellow`, `orange` and `red`, 0.4 convex pairs on average and 1.2 at most."""
SLEEP_DELAY = 0.5
"""Time at rest after which an object sleeps [s]: longer than at the top of a throw."""
WAKE_DISTANCE = 0.1
"""Distance between bounding spheres at which an approaching body wakes an object [m]."""
WAKE_LOOKAHEAD = 2.0
"""Look-ahead of the wake distance [control steps]."""
LIMB_SPEED = 1.0
"""Assumed speed of doors and of victims' limbs [m/s]."""
NO_CONTACT_MARGIN = -1e3
"""Margin of the geoms of sleeping objects, which disables their contacts [m]."""
# Bits of MJX-Warp's overflow word (mujoco_warp OverflowType) for a solver that used all of its iterations,
# which the capped CG solver does on nearly every step.
ITERATION_BITS = 512 | 1024
FORWARD = "mujoco.mjx.third_party.mujoco_warp._src.forward"
"""Module of the stages of a step; private, the version of MJX is pinned."""


def convex_kinds() -> np.ndarray:
    """Return which pairs of geom types use the convex collider, the lower type first (kinds, kinds)."""
    # Private name; the version of MJX is pinned.
    table = import_module("mujoco.mjx.third_party.mujoco_warp._src.collision_driver").MJ_COLLISION_TABLE
    convex = np.zeros((NUM_KINDS, NUM_KINDS), bool)
    for kinds, how in table.items():
        if max(map(int, kinds)) < len(convex):
            convex[tuple(map(int, kinds))] = how.name == "CONVEX"
    return convex


def world_boxes(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the world-aligned bounding boxes of all geoms at the start: two corners [m] (geoms, 3) each."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mat = data.geom_xmat.reshape(-1, 3, 3)
    middle = data.geom_xpos + (mat @ model.geom_aabb[:, :3, None])[..., 0]
    # Half of the gap on either side: two boxes overlap when they are up to a whole gap apart.
    half = (np.abs(mat) @ model.geom_aabb[:, 3:, None])[..., 0] + NEAR_BOX_GAP / 2
    return middle - half, middle + half


def convex_contact_budget(model: mujoco.MjModel, pairs: np.ndarray, contacts: int) -> int:
    """Return the budget of convex pairs of one world.

    Args:
        model: The model, with its robots at their starts.
        pairs: Geom pairs that may collide (pairs, 2).
        contacts: Contact budget of a world.
    """
    kinds = np.sort(model.geom_type[pairs], axis=1)
    pairs, kinds = (rows[convex_kinds()[kinds[:, 0], kinds[:, 1]]] for rows in (pairs, kinds))
    low, high = world_boxes(model)
    one, other = pairs.T
    near = ((low[one] <= high[other]) & (low[other] <= high[one])).all(1)
    # The largest kind decides: MuJoCo Warp's convex buffer is used again for each kind of pairs.
    _, counts = np.unique(kinds[near], axis=0, return_counts=True)
    most = CONVEX_PAIR_FACTOR * int(counts.max(initial=0))
    return int(np.clip(most, np.ceil(MIN_CONVEX_FRACTION * contacts), contacts))


class SleepState:
    """Sleep state of the loose objects.

    The time that each object has been still is in MuJoCo's user data (worlds, objects) [control steps];
    `reserve_sleep_data` reserves it before the model is compiled.

    Args:
        model: The engine's model.
        tolerance: Speed below which an object is still [m/s]; rotation counts by the speed of the point
            farthest from the centre.
        period: The control step [s].
    """

    def __init__(self, model: mujoco.MjModel, tolerance: float, period: float) -> None:
        self._tolerance, self._period = tolerance, period
        self.bodies = np.array([b for b in range(model.nbody) if _is_loose(model, b)], int)
        joints = model.body_jntadr[self.bodies]
        self.qposadr = model.jnt_qposadr[joints][:, None] + np.arange(7)
        self.dofadr = model.jnt_dofadr[joints][:, None] + np.arange(6)
        touching = (model.geom_contype | model.geom_conaffinity) != 0
        body = model.geom_bodyid
        self.geoms = np.flatnonzero(touching & np.isin(body, self.bodies))
        # `bodies` rises, as it is a list of body numbers in order.
        self._owner = np.searchsorted(self.bodies, body[self.geoms])
        limbs = [model.geom(g).name.startswith(VICTIM_PREFIX) for g in range(model.ngeom)]
        # The arena is a mocap body, which no welding counts as the world's; what moves has a tree of joints.
        moves = (model.body_treeid[body] >= 0) & ~np.isin(body, self.bodies)
        self._movers = np.flatnonzero(touching & (moves | limbs))
        # Free joint of the robot that a geom belongs to; limbs and doors have none.
        roots = model.body_jntadr[model.body_rootid[body[self._movers]]]
        free = (roots >= 0) & (model.jnt_type[roots] == mujoco.mjtJoint.mjJNT_FREE)
        self._mover_dof = np.where(free, model.jnt_dofadr[roots], -1)
        radius = model.geom_rbound.astype(np.float32)
        self._reach = radius[self.geoms][:, None] + radius[self._movers] + np.float32(WAKE_DISTANCE)
        self._between = radius[self.geoms][:, None] + radius[self.geoms] + np.float32(WAKE_DISTANCE)
        # Radius of each object, which converts rotation to speed.
        self._radius = np.zeros(len(self.bodies), np.float32)
        np.maximum.at(self._radius, self._owner, radius[self.geoms])

    def steps_at_rest(self, data: mjx.Data, force: Array) -> jax.Array:
        """Return how long each object has been still, this control step included (worlds, objects).

        Args:
            data: Engine state of all worlds.
            force: Applied forces and torques on each body (worlds, nbody, 6).
        """
        qvel, xpos = data.qvel, data.geom_xpos
        own = qvel[:, self.dofadr]
        speed = jnp.linalg.norm(own[..., :3], axis=-1)
        speed += self._radius * jnp.linalg.norm(own[..., 3:], axis=-1)
        moving = ~(speed < self._tolerance)  # negated so that NaN counts as moving
        moving |= (jnp.asarray(force)[:, self.bodies] != 0.0).any(-1)
        # Approaching bodies wake an object before they touch it: asleep, it has no contacts to wake by.
        near = (self._distances(xpos, self._movers) < self._reach + self._look_ahead(qvel)[:, None]).any(-1)
        # A moving object wakes its neighbours likewise, so that a pile falls as a whole.
        beside = (self._distances(xpos, self.geoms) < self._between) & moving[:, None, self._owner]
        disturbed = moving | self._any_geom(near | beside.any(-1))
        return jnp.where(disturbed, 0.0, data.userdata + 1.0)

    def asleep(self, steps_at_rest: jax.Array) -> jax.Array:
        """Return which objects sleep (worlds, objects)."""
        return steps_at_rest * self._period > SLEEP_DELAY

    def margin(self, margin: jax.Array, asleep: jax.Array) -> jax.Array:
        """Return the margins of all geoms (worlds, ngeom) [m], given those of the model (ngeom,)."""
        everywhere = jnp.broadcast_to(margin.reshape(-1), (len(asleep), margin.size))
        mine = jnp.where(asleep[:, self._owner], NO_CONTACT_MARGIN, everywhere[:, self.geoms])
        return everywhere.at[:, self.geoms].set(mine)

    def moved(self, pinned: Array, qpos: Array, before: Array) -> jax.Array:
        """Return which objects are teleported (worlds, objects); masks and qpos as in `Inputs`."""
        # Pinned coordinates that keep their values are held, which is no teleport.
        return (jnp.asarray(pinned) & (qpos != before))[:, self.qposadr].any(-1)

    def _look_ahead(self, qvel: jax.Array) -> jax.Array:
        """Return how far robots, limbs and doors may move during the look-ahead [m] (worlds, movers)."""
        # Limbs and doors (-1) read row 0 and are given a fixed speed below.
        rows = np.maximum(self._mover_dof, 0)[:, None] + np.arange(3)
        speed = jnp.linalg.norm(qvel[:, rows], axis=-1)
        return WAKE_LOOKAHEAD * self._period * jnp.where(self._mover_dof >= 0, speed, LIMB_SPEED)

    def _distances(self, xpos: jax.Array, others: np.ndarray) -> jax.Array:
        """Return the distances between the objects' geoms and others (worlds, geoms, others) [m]."""
        return jnp.linalg.norm(xpos[:, self.geoms, None] - xpos[:, None, others], axis=-1)

    def _any_geom(self, of_geoms: jax.Array) -> jax.Array:
        """Reduce a mask of geoms to a mask of their objects (worlds, objects)."""
        # A mask and a reduction: a scatter per world would be slower on a GPU.
        mine = jnp.asarray(self._owner == np.arange(len(self.bodies))[:, None])  # (objects, geoms)
        return (of_geoms[:, None] & mine).any(-1)


def reserve_sleep_data(spec: mujoco.MjSpec) -> None:
    """Reserve user data for each loose object of a description."""
    spec.nuserdata = sum(body.name.startswith(LOOSE_PREFIX) for body in spec.bodies)


def _is_loose(model: mujoco.MjModel, body: int) -> bool:
    return model.body(body).name.startswith(LOOSE_PREFIX)


@dataclass(frozen=True)
class GraphMode:
    """Mode of CUDA graph capture.

    Attributes:
        mode: Name of one of Warp's JaxCallableGraphMode. WARP captures a graph for each set of array
            addresses that XLA passes, WARP_STAGED one for all of them, which copies in and out,
            WARP_STAGED_EX copies before and after it. A CPU has no graphs.
        control_step: Whether a graph contains all physics steps of a control step.
    """

    mode: str = "WARP"
    control_step: bool = False


GRAPH_MODES: Registry[GraphMode] = Registry("kind of CUDA graphs")
"""Graph modes by name, as in `usarmjx bench step --graph`."""
for _mode, _suffix in (("WARP", ""), ("WARP_STAGED", "-staged"), ("WARP_STAGED_EX", "-staged-ex")):
    GRAPH_MODES.add(f"step{_suffix}", GraphMode(_mode))
    GRAPH_MODES.add(f"control{_suffix}", GraphMode(_mode, control_step=True))


def _passive_without_gravcomp() -> Callable[..., Any]:
    """Return MuJoCo Warp's passive forces without the kernel of gravity compensation.

    That kernel has a thread for each pair of a body and a degree of freedom, also if no body compensates for
    gravity: 0.7 ms of a step of 4,096 worlds of 16 P2AT on an H200.
    """
    passive = import_module("mujoco.mjx.third_party.mujoco_warp._src.passive")

    def launch(kernel: object, *args: object, **kwargs: object) -> None:
        # Leaving out the launch is exact here: without gravity compensation the kernel adds zeros.
        if kernel is not passive._gravity_force:
            passive.wp.launch(kernel, *args, **kwargs)

    return with_globals(
        passive.passive.__wrapped__, wp=SimpleNamespace(**vars(passive.wp) | {"launch": launch})
    )


def _collision(broad_phase: Callable[..., None] | None) -> Callable[..., None]:
    """Return MuJoCo Warp's collision detection with our narrow phase; arguments as of `_step_by_blocks`."""
    # MuJoCo Warp's functions look up their modules as globals: copies with other globals change only our
    # step.
    changed = {"_narrowphase": import_module("usarmjx.engines.block.branches").narrow_phase}
    changed |= {} if broad_phase is None else {"nxn_broadphase": broad_phase}
    return with_globals(import_module(FORWARD).collision_driver.collision.__wrapped__, **changed)


def _position_stage(collision: Callable[..., None]) -> dict[str, object]:
    """Return the part of a step that has the collision detection, by its name."""
    stage = import_module(FORWARD).fwd_position.__wrapped__
    return {"fwd_position": with_globals(stage, collision_driver=SimpleNamespace(collision=collision))}


@cache
def _step_of_warp() -> Callable[..., Any]:
    """Return MuJoCo Warp's step, with its solver, and with our narrow phase."""
    forward = import_module(FORWARD)
    dynamics = with_globals(forward.forward.__wrapped__, **_position_stage(_collision(None)))
    return with_globals(forward.step.__wrapped__, forward=dynamics)


def _step_by_blocks(
    broad_phase: Callable[..., None] | None,
    gravcomp: bool,
    smooth_dynamics: Callable[..., None] | None = None,
) -> Callable[..., Any]:
    """Return MuJoCo Warp's step with solver `block`, and maybe other stages, in place of its own.

    Args:
        broad_phase: The broad phase of that solver; None: MuJoCo Warp's.
        gravcomp: Whether a body compensates for gravity; without one the step leaves this out.
        smooth_dynamics: Everything that does not depend on contacts; None: MuJoCo Warp's.
    """
    solve = import_module("usarmjx.engines.block.solver").solve
    forward = import_module(FORWARD)
    collision = _collision(broad_phase)
    changed: dict[str, object] = {"solver": SimpleNamespace(solve=solve)} | _position_stage(collision)
    if not gravcomp:
        passive = SimpleNamespace(passive=_passive_without_gravcomp())
        changed["fwd_velocity"] = with_globals(forward.fwd_velocity.__wrapped__, passive=passive)
    smooth = import_module("usarmjx.engines.block.trees").smooth_module()
    changed["fwd_acceleration"] = with_globals(forward.fwd_acceleration.__wrapped__, smooth=smooth)
    if smooth_dynamics is not None:
        stages = import_module("usarmjx.engines.block.smooth").stages
        changed |= stages(smooth_dynamics, collision, smooth.factor_solve_i)
    dynamics = with_globals(forward.forward.__wrapped__, **changed)
    euler = getattr(smooth_dynamics, "advance", None)
    if euler is None:
        euler = with_globals(forward.euler.__wrapped__, smooth=smooth)
    return with_globals(forward.step.__wrapped__, forward=dynamics, euler=euler)


@cache
def multi_step(count: int, one_step: Callable[[Any, Any], None]) -> Callable[[Any, Any], Any]:
    """Return `mjx.step` for MuJoCo Warp with `count` physics steps in one call, to be vmapped over worlds.

    Args:
        count: Physics steps.
        one_step: A step of all worlds on Warp's arrays.

    Raises:
        EngineError: mujoco-mjx is of another version than the one whose private names these are.
    """
    check_mjx_version()
    forward, ffi = (import_module(f"mujoco.mjx.warp.{name}") for name in ("forward", "ffi"))
    replay = LaunchReplay(one_step)

    def run_kernels(model: object, data: object) -> None:
        if jax.default_backend() == "cpu":
            replay.run(model, data, count)
            return
        for _ in range(count):
            one_step(model, data)

    # MJX's own marshalling of arguments stays: only the function that it calls is another one.
    shim = with_globals(forward._step_shim.__wrapped__, mjwarp=SimpleNamespace(step=run_kernels))
    call = with_globals(forward._step_jax_impl, _step_shim=ffi.format_args_for_warp(shim))
    step = custom_vmap(ffi.marshal_jax_warp_callable(call))

    @step.def_vmap
    @ffi.marshal_custom_vmap
    def step_worlds(axis_size: int, is_batched: tuple[Any, Any], model: Any, data: Any) -> tuple[Any, Any]:  # noqa: ANN401
        del axis_size
        return step(model, data), is_batched[1]

    return step


def block_until_finished() -> None:
    """Block until all computations have finished.

    On a CPU, MuJoCo Warp's kernels are launched by Python: a step still running when the interpreter ends
    would wait for the interpreter for ever, and the interpreter for the step.
    """
    jax.block_until_ready(jax.live_arrays())


class WarpEngine(MjxEngine):
    """MJX on MuJoCo Warp: NVIDIA GPUs, and slowly CPUs. Not bit-exact: its sums are atomic.

    All worlds share one contact buffer, so an overflow can drop contacts of other worlds.

    Attributes:
        solver: Name of the constraint solver: where `uncovered` is set, or for `auto`, not that of the
            settings.
        uncovered: Feature of the scene for which MuJoCo Warp's solver takes the place of `block`; or None:
            Newton if `block` is named, CG for `auto`.
    """

    name = "warp"
    impl = "warp"
    _graphs = GraphMode()
    _sleep: SleepState | None = None

    def __init__(
        self,
        spec: mujoco.MjSpec,
        physics: Physics,
        worlds: int,
        moved_geoms: MovedGeoms | None = None,
        varied_bodies: RandomizedBodies | None = None,
    ) -> None:
        try:
            import_module("warp")
        except ImportError as missing:
            raise EngineError(
                "engine 'warp' needs warp-lang: install usarmjx[cuda] or usarmjx[warp]"
            ) from missing
        pause_collection_in_callbacks()
        self.solver = choose_solver(physics, self.name)
        self.uncovered: str | None = None
        super().__init__(spec, physics, worlds, moved_geoms, varied_bodies)
        if jax.default_backend() == "cpu":
            atexit.register(block_until_finished)
        masses = jnp.asarray(self.model.body_mass, jnp.float32)
        self._masses = masses if self._applies_weight(self.model) else None
        # MuJoCo's own gravity cannot be switched off for single bodies: sleep needs applied weight.
        if self.model.nuserdata and self._masses is not None:
            self._sleep = SleepState(self.model, physics.sleep_tolerance, physics.period)

    def compile(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Compile the model, with user data for the sleep state if loose objects may sleep."""
        if self.physics.sleep_tolerance:
            reserve_sleep_data(spec)
        return super().compile(spec)

    @staticmethod
    def _applies_weight(model: mujoco.MjModel) -> bool:
        """Whether weight is an applied force instead of MuJoCo's own gravity.

        With gravity on, MuJoCo Warp evaluates gravity compensation of all bodies and degrees of freedom, 5 %
        of a step of 4096 x 16, though no body asks for it. Sleeping objects must be free of force.
        """
        sleeps = model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP
        return not model.body_gravcomp.any() and not sleeps

    def _put_model(self, model: mujoco.MjModel) -> mjx.Model:
        if self._applies_weight(model):
            model = copy.copy(model)
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
        if self.solver == "block":
            self.uncovered = why_not(model, self._row_budget(model))
            if self.uncovered is None:
                model = copy.copy(model)
                # For Newton's method, MuJoCo Warp also lists the rows of each constraint.
                model.opt.solver = mujoco.mjtSolver.mjSOL_CG
            else:
                self.solver = "Newton" if model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON else "CG"
                level = logging.WARNING if self.physics.solver == "block" else logging.INFO
                text = "solver 'block' does not cover %s: MuJoCo Warp's %s solves all"
                LOGGER.log(level, text, self.uncovered, self.solver)
        self._compiled = model
        # Its kernels print a line per world and step when the solver uses all its iterations, which
        # halves the speed. `overflow` reports it instead.
        return super()._put_model(model).tree_replace({"opt._impl.warn_overflow": 0})

    def _row_budget(self, model: mujoco.MjModel) -> int:
        """Return the constraint rows that a world has room for."""
        # This budget is per world, that of contacts over all worlds: rows allow three times the average.
        return 3 * self.physics.rows_per_contact * int(model.numeric("max_contact_points").data[0])

    def _make_data(self) -> mjx.Data:
        contacts = self._contacts
        pairs = self.mx._impl.nxn_geom_pair_filtered
        return mjx.make_data(
            self.model,
            impl=self.impl,
            device=local_device(),
            naconmax=self.worlds * contacts,
            naccdmax=self.worlds * convex_contact_budget(self.model, pairs, contacts),
            njmax=self._row_budget(self.model),
        )

    def advance(self, engine_state: mjx.Data, inputs: Inputs) -> mjx.Data:
        """Step every world by one control step, from cleared overflow bits: Warp only ever sets them."""
        clear = jnp.zeros_like(engine_state._impl.overflow)
        engine_state = engine_state.tree_replace({"_impl.overflow": clear})
        awake: jax.Array | None = None
        if self._sleep is not None:
            still = self._sleep.steps_at_rest(engine_state, inputs.xfrc_applied)
            engine_state, awake = engine_state.replace(userdata=still), ~self._sleep.asleep(still)
            # Velocities of sleeping objects are zeroed, so that remaining drift does not add up.
            held = jnp.asarray(inputs.pinned_dof).at[:, self._sleep.dofadr].max(~awake[..., None])
            inputs = inputs.replace(pinned_dof=held)
        if self._masses is not None:
            # Randomized masses change the weight, too.
            masses = self._fields(inputs).get("body_mass", self._masses).reshape(-1, self.model.nbody)
            if self._sleep is not None and awake is not None:
                # Without a weight a sleeping object has no force at all, and stays without contacts.
                masses = jnp.broadcast_to(masses, (self.worlds, self.model.nbody))
                masses = masses.at[:, self._sleep.bodies].multiply(awake)
            # MuJoCo applies these forces at a body's centre of mass, where weight acts.
            weight = masses[..., None] * jnp.asarray(self.model.opt.gravity, jnp.float32)
            inputs = inputs.replace(xfrc_applied=jnp.asarray(inputs.xfrc_applied).at[..., :3].add(weight))
        return super().advance(engine_state, inputs)

    def _state_fields(self, engine_state: mjx.Data) -> dict[str, jax.Array]:
        """Return margins that disable the contacts of sleeping objects."""
        if self._sleep is None:
            return {}
        asleep = self._sleep.asleep(engine_state.userdata)
        margin = self._sleep.margin(self.mx.geom_margin, asleep)
        return {"geom_margin": margin.reshape(self.worlds, *self.mx.geom_margin.shape)}

    def set_qpos(self, engine_state: mjx.Data, pinned: Array, pinned_dof: Array, qpos: Array) -> mjx.Data:
        """Set the pinned coordinates to qpos, at rest; teleported loose objects wake."""
        done = super().set_qpos(engine_state, pinned, pinned_dof, qpos)
        if self._sleep is None:
            return done
        moved = self._sleep.moved(pinned, qpos, engine_state.qpos)
        return done.replace(userdata=jnp.where(moved, 0.0, engine_state.userdata))

    def reset(self, engine_state: mjx.Data, mask: Array, qpos: Array) -> mjx.Data:
        """Reset the masked worlds to qpos, at rest, with all objects awake; the others keep every bit."""
        done = super().reset(engine_state, mask, qpos)
        return done.replace(userdata=jnp.where(mask[:, None], 0.0, engine_state.userdata))

    def select_graphs(self, name: str) -> None:
        """Select a CUDA graph mode of `GRAPH_MODES`; already compiled steps keep theirs."""
        self._graphs = GRAPH_MODES.get(name)
        if jax.default_backend() != "cpu":
            mode = import_module("warp").JaxCallableGraphMode[self._graphs.mode]
            self.mx = self.mx.tree_replace({"opt._impl.graph_mode": mode})

    def _step_and_count(self) -> tuple[Callable[[mjx.Model, mjx.Data], mjx.Data], int]:
        count = self.physics.substeps
        if jax.default_backend() != "cpu":
            # Streams cannot be made while a graph is captured, which happens at the first step.
            import_module("usarmjx.engines.block.branches").branches_of(_warp_device())  # makes its streams
            self._load_kernels()
        if self._graphs.control_step or jax.default_backend() == "cpu":
            # The number of calls is 1: the substeps are inside.
            return multi_step(count, self._own_step), 1
        return multi_step(1, self._own_step), count

    def _load_kernels(self) -> None:
        """Start to load the kernels of a step; a program that was kept finds them in Warp's cache."""
        try:
            load_side_by_side(self.modules_of_step(), _warp_device())
        # Only time is lost: the first launch loads what is missing.
        except Exception as error:
            LOGGER.warning("kernels are compiled one after another: %r", error)

    def modules_of_step(self) -> list[WarpModule]:
        """Return the modules of the kernels that a physics step launches, those with most code first."""
        wp, mjwarp = import_module("warp"), import_module("mujoco.mjx.warp.forward").mjwarp
        check_mjx_version()
        contacts, rows = self._contacts, self._row_budget(self.model)
        # No kernel depends on the number of worlds, nor is any launched here. Some would be where arrays are.
        with wp.ScopedDevice(_warp_device() or "cpu"):
            model = mjwarp.put_model(self._compiled)
            data = mjwarp.make_data(self._compiled, nworld=1, naconmax=contacts, njmax=rows)
            # It is compiled into some of them.
            model.opt.warn_overflow = cast("Any", self.mx).opt._impl.warn_overflow
            return modules_of(partial(self._own_step, model, data))

    @cached_property
    def _own_step(self) -> Callable[[Any, Any], None]:
        """Physics step on Warp's arrays, with the solver that is taken."""
        if self.solver != "block":
            return _step_of_warp()
        gravcomp = bool(self.model.body_gravcomp.any())
        return _step_by_blocks(self._broad_phase, gravcomp, self._smooth_dynamics)

    @property
    def _contacts(self) -> int:
        """Contact budget of a world."""
        return int(self.model.numeric("max_contact_points").data[0])

    @cached_property
    def _broad_phase(self) -> Callable[..., None]:
        """Return the broad phase of solver `block`."""
        block, impl = import_module("usarmjx.engines.block.broad_phase"), self.mx._impl
        pairs, own = np.asarray(impl.nxn_geom_pair_filtered), np.asarray(impl.nxn_pairid_filtered)
        return block.BroadPhase(block.make_table(self.model, pairs, (own >= 0).any(1)), _warp_device())

    @cached_property
    def _smooth_dynamics(self) -> Callable[..., None] | None:
        """Return the smooth dynamics of solver `block`, or None if MuJoCo Warp's are needed."""
        block = import_module("usarmjx.engines.block.smooth")
        uncovered = block.why_not(self.model)
        if uncovered is None:
            return block.SmoothDynamics(self.model, _warp_device())
        LOGGER.info("MuJoCo Warp's kernels compute the smooth dynamics: the scene has %s", uncovered)
        return None

    def blocking(self, step: Callable[StepArguments, StepOutcome]) -> Callable[StepArguments, StepOutcome]:
        """Return a step function that blocks on a CPU: `block_until_finished` misses dropped results."""
        if jax.default_backend() != "cpu":
            return step

        def step_and_wait(*args: StepArguments.args, **kwargs: StepArguments.kwargs) -> StepOutcome:
            return jax.block_until_ready(step(*args, **kwargs))

        return step_and_wait

    def overflow(self, engine_state: mjx.Data, inputs: Inputs) -> jax.Array:
        """Return the overflow bits of the last control step (worlds,)."""
        del inputs
        return (
            (engine_state._impl.overflow & ~ITERATION_BITS).reshape(self.worlds, -1).max(-1).astype(jnp.int32)
        )

    def solved(self, engine_state: mjx.Data) -> SolvedStep:
        """Return contacts, rows and iterations of each world's last physics step."""
        impl = engine_state._impl
        used = jnp.arange(impl.contact__worldid.size) < impl.nacon.reshape(-1)[0]
        # The contact buffer keeps stale entries past nacon.
        world = jnp.where(used, impl.contact__worldid.reshape(-1), self.worlds)  # past the end: dropped
        contacts = jnp.zeros(self.worlds, jnp.int32).at[world].add(1, mode="drop")
        return SolvedStep(contacts, impl.nefc.reshape(-1), impl.solver_niter.reshape(-1))


def _warp_device() -> Any:  # noqa: ANN401 - Warp's
    """Return Warp's device of an engine's arrays; None: the CPU."""
    if jax.default_backend() == "cpu":
        return None
    return import_module("warp").device_from_jax(local_device() or jax.devices()[0])


MOST_RECORDINGS = 4
"""Recordings that are kept of a function, those used last: each has a copy of all worlds' data."""


@dataclass
class Recording:
    """Recorded launches on arrays of their own, into which and out of which each call copies.

    Attributes:
        model: Copy of the model, with arrays of its own.
        data: Likewise.
        copies: Addresses of these arrays in the order of `_arrays`, and their sizes [bytes].
        graph: The launches.
    """

    model: Any
    data: Any
    copies: list[tuple[int, int]]
    graph: Any = None


class LaunchReplay:
    """A function whose kernel launches are recorded once for each kind of arguments, and replayed.

    Arrays of JAX are at other addresses in each call, but a recording holds addresses: it works on copies.
    Warp calls functions of JAX programs one at a time, so no other launches get into a recording.

    Args:
        function: Launches kernels on a model, which it does not change, and its data, whatever their values.
    """

    def __init__(self, function: Callable[[Any, Any], None]) -> None:
        self.function = function
        self._recordings: OrderedDict[Hashable, Recording] = OrderedDict()

    def run(self, model: object, data: object, count: int) -> None:
        """Call the function some times. The first call with a kind of arguments is plain, to load kernels."""
        warp = import_module("warp")
        found = _Arguments()
        # The model comes first, so that its arrays can be left out of the copies back.
        found.visit(model)
        constant = len(found.arrays)
        found.visit(data)
        recording = self._recordings.get(key := tuple(found.key))
        if recording is None:
            self.function(model, data)
            # The plain call has done one of the steps already.
            count -= 1
            recording = self._recordings[key] = _own_copies(model, data, found.arrays)
            with warp.ScopedCapture("cpu") as capture:
                self.function(recording.model, recording.data)
            recording.graph = capture.graph
        self._recordings.move_to_end(key)
        # The recording just used is the last one, so it is never dropped here.
        while len(self._recordings) > MOST_RECORDINGS:
            self._recordings.popitem(last=False)
        if not count:
            return
        for array, (address, size) in zip(found.arrays, recording.copies, strict=True):
            ctypes.memmove(address, array.ptr, size)
        for _ in range(count):
            warp.capture_launch(recording.graph)
        for array, (address, size) in zip(found.arrays[constant:], recording.copies[constant:], strict=True):
            ctypes.memmove(array.ptr, address, size)


@dataclass
class _Arguments:
    """The arrays of a function's arguments, without empty ones, and what else a recording depends on."""

    arrays: list[Any] = field(default_factory=list[Any])
    key: list[Hashable] = field(default_factory=list[Hashable])

    def visit(self, value: Any) -> None:  # noqa: ANN401 - of any field
        """Add what a value has."""
        if _is_array(value):
            self.key += (value.dtype, value.shape, value.strides, value.ptr is None)
            if value.ptr is not None:
                self.arrays.append(value)
        elif dataclasses.is_dataclass(value):
            for one in dataclasses.fields(value):
                self.visit(getattr(value, one.name))
        elif isinstance(value, tuple | list):
            for one in cast("Sequence[object]", value):
                self.visit(one)
        else:
            self.key.append(value)


def _is_array(value: object) -> bool:
    return hasattr(value, "ptr") and hasattr(value, "strides")


def _span(array: Any) -> int:  # noqa: ANN401 - Warp's
    """Return the memory from an array's first to its last number [bytes]; a stride may be 0."""
    item = import_module("warp").types.type_size_in_bytes(array.dtype)
    return (
        sum((length - 1) * stride for length, stride in zip(array.shape, array.strides, strict=True)) + item
    )


def _own_copies(model: object, data: object, arrays: list[Any]) -> Recording:
    """Return a recording without launches; fields that share an array share its copy."""
    warp, made = import_module("warp"), dict[tuple[Any, ...], Any]()

    def own(value: Any) -> Any:  # noqa: ANN401 - of any field
        if _is_array(value):
            if value.ptr is None:
                return value
            # Fields that share an array must share its copy: else one misses writes to the other.
            key = value.ptr, value.dtype, value.shape, value.strides
            if key not in made:
                memory = warp.empty(_span(value), dtype=warp.uint8, device="cpu")
                form = {"dtype": value.dtype, "shape": value.shape, "strides": value.strides}
                made[key] = warp.array(ptr=memory.ptr, device="cpu", **form)
                made[key].memory = memory  # kept as long as the array
            return made[key]
        if dataclasses.is_dataclass(value):
            changed = copy.copy(value)
            for one in dataclasses.fields(value):
                before = getattr(value, one.name)
                if (now := own(before)) is not before:
                    object.__setattr__(changed, one.name, now)  # some are frozen
            return changed
        if isinstance(value, tuple | list):
            parts = [own(one) for one in cast("Sequence[object]", value)]
            return parts if isinstance(value, list) else tuple(parts)
        return value

    mine = Recording(own(model), own(data), [])
    mine.copies = [(own(array).ptr, _span(array)) for array in arrays]
    return mine
