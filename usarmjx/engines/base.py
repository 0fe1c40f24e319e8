"""The interface that all engines have, and the check that a model means the same to all of them."""

import copy
import importlib.util
from abc import ABC, abstractmethod
from collections.abc import Callable
from importlib import import_module
from typing import Any, ClassVar, Generic, Literal, NamedTuple, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.base.registry import Registry
from usarmjx.models.compile.geoms import MovedGeoms
from usarmjx.models.compile.layout import RobotIndex
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import RandomizedBodies, RandomizedValues
from usarmjx.models.types.robot import RobotSpec

KNOTS = 9
"""Masses for which MuJoCo works out the numbers that follow from them; between two they are interpolated."""
BODY_FIELDS = ("body_mass", "body_inertia", "body_subtreemass", "body_invweight0")
DOF_FIELDS = ("dof_invweight0", "dof_M0")
CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER


class VariedModel:
    """What a model's fields are in each world.

    Args:
        model: The engine's model: its bodies and joints are in the order of the scene's, its geoms may not.
        bodies: The robots that vary.
        with_dof_m0: Whether to give `dof_M0` too, which only C MuJoCo reads.

    Raises:
        UnsupportedFeatureError: Wheels whose radius shall vary and that are no cylinders.
    """

    def __init__(self, model: mujoco.MjModel, bodies: RandomizedBodies, with_dof_m0: bool = False) -> None:
        self._model, self._bodies = model, bodies
        self._wheels = np.flatnonzero(bodies.wheel[model.geom_bodyid])
        self._wheel_owner = bodies.owner[model.geom_bodyid[self._wheels]]
        dof_names = DOF_FIELDS if with_dof_m0 else DOF_FIELDS[:1]
        self._mass_names = (*BODY_FIELDS, *dof_names)
        vary = bodies.vary
        if vary.wheel is not None:
            odd = [model.geom(g).name for g in self._wheels if model.geom_type[g] != CYLINDER]
            if odd:
                raise UnsupportedFeatureError(f"vary: wheel needs cylinders, not {', '.join(odd)}")
        if vary.mass is not None:
            self._span = vary.mass
            tables = [self._derived(factor) for factor in np.linspace(*vary.mass, KNOTS)]
            self._tables = {name: np.stack([t[name] for t in tables]) for name in self._mass_names}
        joints = model.jnt_bodyid
        self._joint_owner = np.where(model.jnt_actfrclimited != 0, bodies.owner[joints], -1)

    def _derived(self, factor: float) -> dict[str, np.ndarray]:
        """Return what MuJoCo makes of all chassis with that many times their mass."""
        model, own = copy.copy(self._model), self._bodies.chassis[self._bodies.varies]
        model.body_mass[own] *= factor
        model.body_inertia[own] *= factor
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return {name: getattr(model, name).astype(np.float32) for name in self._mass_names}

    def fields(
        self, told: RandomizedValues, here: dict[str, jax.Array] | None = None
    ) -> dict[str, jax.Array]:
        """Return the fields that differ between worlds (worlds, ...).

        Args:
            told: The worlds' numbers.
            here: Fields that differ already.
        """
        fields = dict(here or {})

        def base(name: str, worlds: int) -> jax.Array:
            value = jnp.asarray(getattr(self._model, name), jnp.float32)
            # MJX-Warp has some of these in another shape.
            shape = (worlds, *value.shape)
            return fields[name].reshape(shape) if name in fields else jnp.broadcast_to(value, shape)

        if told.friction is not None:
            worlds = told.friction.shape[0]
            fields["geom_friction"] = (
                base("geom_friction", worlds).at[..., 0].multiply(told.friction[:, None])
            )
        if told.torque is not None:
            factor = _of(told.torque, self._joint_owner)[..., None]
            fields["jnt_actfrcrange"] = base("jnt_actfrcrange", len(factor)) * factor
        if told.wheel is not None:
            fields |= self._resized(told.wheel, base)
        if told.mass is not None:
            fields |= self._loaded(told.mass)
        return fields

    def _resized(self, wheel: Array, base: Callable[[str, int], jax.Array]) -> dict[str, jax.Array]:
        """Return the sizes of geoms with wheels of other radii."""
        ids, factor = self._wheels, _of(wheel, self._wheel_owner)
        size = base("geom_size", len(factor)).at[:, ids, 0].multiply(factor)
        box = base("geom_aabb", len(factor)).at[:, ids, 3:5].multiply(factor[..., None])
        rbound = base("geom_rbound", len(factor)).at[:, ids].set(jnp.linalg.norm(size[:, ids, :2], axis=-1))
        return {"geom_size": size, "geom_aabb": box, "geom_rbound": rbound}

    def _loaded(self, mass: Array) -> dict[str, jax.Array]:
        """Return masses, and what follows from them, by interpolation between the tables' knots."""
        low, high = self._span
        step = max((high - low) / (KNOTS - 1), 1e-9)
        dof_owner = self._bodies.owner[self._model.dof_bodyid]
        fields: dict[str, jax.Array] = {}
        for name, table in self._tables.items():
            owner = self._bodies.owner if name in BODY_FIELDS else dof_owner
            place = (_of(mass, owner, low) - low) / step
            below = jnp.clip(jnp.floor(place), 0, KNOTS - 2).astype(jnp.int32)
            share = (place - below).reshape(*place.shape, *[1] * (table.ndim - 2))
            column = np.arange(len(owner))
            known = jnp.asarray(table)
            value = known[below, column] * (1 - share) + known[below + 1, column] * share
            varies = np.append(self._bodies.varies, False)[owner]
            original = jnp.asarray(getattr(self._model, name), jnp.float32)
            fields[name] = jnp.where(varies.reshape(-1, *[1] * (table.ndim - 2)), value, original)
        return fields


def _of(values: Array, owner: np.ndarray, other: float = 1.0) -> jax.Array:
    """Return each owner's value (worlds, n) out of those by slot (worlds, robots); `other` for none's."""
    values = jnp.asarray(values)
    return jnp.where(owner >= 0, values[:, np.maximum(owner, 0)], other)


GeomType = mujoco.mjtGeom
EngineState = TypeVar("EngineState")
"""All that one engine needs to go on: a PyTree of its own, with a leading axis over the worlds."""
StepArguments = ParamSpec("StepArguments")
StepOutcome = TypeVar("StepOutcome")


class PhysicsState(struct.PyTreeNode, kw_only=True):
    """What everything above the engine sees of it, in MuJoCo's layout.

    Attributes:
        qpos: Positions (worlds, nq).
        qvel: Velocities (worlds, nv).
        act: Actuator activations (worlds, na).
    """

    qpos: Array
    qvel: Array
    act: Array


class GeomPoses(struct.PyTreeNode, kw_only=True):
    """Where the arena's geoms are that are data, in the axes of the body `arena`.

    Attributes:
        pos: Centres [m] (worlds, geoms, 3).
        quat: Orientations (worlds, geoms, 4).
        size: MuJoCo sizes [m] (worlds, geoms, 3); None: as in the model.
    """

    pos: Array
    quat: Array
    size: Array | None = None


class Inputs(struct.PyTreeNode, kw_only=True):
    """What the engine is told for one control step.

    Attributes:
        ctrl: Actuator inputs (worlds, nu).
        act: Actuator activations to start from (worlds, na).
        xfrc_applied: Force [N] and torque [N m] on each body, world axes (worlds, nbody, 6).
        pinned: Which coordinates are held: qpos is set and their velocities are zero (worlds, nq).
        pinned_dof: The same for the velocities (worlds, nv).
        qpos: Positions of the pinned coordinates; the others are ignored (worlds, nq).
        geom_poses: Where the arena's geoms are that are data; None: there are none.
        varied: Numbers that differ between worlds, which lead their axes; None: there are none.
    """

    ctrl: Array
    act: Array
    xfrc_applied: Array
    pinned: Array
    pinned_dof: Array
    qpos: Array
    geom_poses: GeomPoses | None = None
    varied: RandomizedValues | None = None


class SolvedStep(NamedTuple):
    """What the solver of each world met in the last physics step, for benchmarks.

    Attributes:
        contacts: Contacts in force (worlds,).
        constraint_rows: Rows of constraints in force (worlds,).
        solver_iterations: How often the solver improved its solution (worlds,); None: not told.
    """

    contacts: Array
    constraint_rows: Array
    solver_iterations: Array | None


class Engine(ABC, Generic[EngineState]):
    """Advances many copies of one model. All arrays have a leading axis over the worlds.

    Args:
        spec: The description of the model; its bodies, joints and actuators keep their order.
        physics: Solver and time settings.
        worlds: Number of copies.
        moved_geoms: Geoms of the arena that are data: every `Inputs` tells their poses. None: there are none.
        varied_bodies: Robots that vary between worlds: every `Inputs` tells how. None: there are none.

    Raises:
        UnsupportedFeatureError: The model has a feature that this engine would ignore or refuse.
        EngineError: The engine cannot run on this machine.
    """

    name: ClassVar[str]
    traceable: ClassVar[bool]
    """Whether `advance`, `reset` and `state` can be traced by JAX and so live inside one jitted step."""
    needs_robots: ClassVar[bool] = False
    """Whether it is told which robots are in the model, by slot."""
    has_solver: ClassVar[bool] = True
    """Whether it solves for contact forces, so that robots push things and climb."""

    def __init__(
        self,
        spec: mujoco.MjSpec,
        physics: Physics,
        worlds: int,
        moved_geoms: MovedGeoms | None = None,
        varied_bodies: RandomizedBodies | None = None,
    ) -> None:
        self.physics = physics
        self.worlds = worlds
        self.moved_geoms: MovedGeoms | None = moved_geoms
        self.varied_bodies = varied_bodies
        self.model = self.compile(spec)
        self.varied_model = (
            None if varied_bodies is None else VariedModel(self.model, varied_bodies, self.name == "c")
        )
        check_features(self.model, self.name)
        # A geom that lies in its body's frame would be taken for one that always does.
        names = () if self.moved_geoms is None else self.moved_geoms.names
        self.moved_ids = [self.model.geom(name).id for name in names]
        self.model.geom_sameframe[self.moved_ids] = 0

    def compile(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Return the model as this engine wants it."""
        return spec.compile()

    @abstractmethod
    def start(self) -> EngineState:
        """Return the engine's state with every world at the model's reference configuration."""

    def waiting(self, step: Callable[StepArguments, StepOutcome]) -> Callable[StepArguments, StepOutcome]:
        """Return a function that steps as the given one does, and waits for the outcome if it must."""
        return step

    @abstractmethod
    def advance(self, engine_state: EngineState, inputs: Inputs) -> EngineState:
        """Return the state after one control step."""

    @abstractmethod
    def reset(self, engine_state: EngineState, mask: Array, qpos: Array) -> EngineState:
        """Return the state with the masked worlds (worlds,) at rest at qpos (worlds, nq)."""

    @abstractmethod
    def set_qpos(
        self, engine_state: EngineState, pinned: Array, pinned_dof: Array, qpos: Array
    ) -> EngineState:
        """Return the state with some coordinates put elsewhere, at rest; masks and qpos as in `Inputs`."""

    @abstractmethod
    def state(self, engine_state: EngineState) -> PhysicsState:
        """Return what others may see of the state."""

    @abstractmethod
    def overflow(self, engine_state: EngineState, inputs: Inputs) -> jax.Array:
        """Return how much each world's last step lost to full contact buffers (worlds,); 0 is none.

        Args:
            engine_state: The state after the step.
            inputs: What the engine was told for it.
        """

    def use_graphs(self, name: str) -> None:
        """Launch other CUDA graphs than usual, to compare them; call it before the first step.

        Args:
            name: Which, of those that `usarmjx bench step --graph` takes.

        Raises:
            UnknownNameError: No such graphs.
            UnsupportedFeatureError: The engine launches none.
        """
        raise UnsupportedFeatureError(f"engine {self.name!r} launches no CUDA graphs ({name!r}); warp does")

    def solved(self, engine_state: EngineState) -> SolvedStep | None:
        """Return what the solver met in the last physics step; None: the engine has no solver."""
        del engine_state


# What MJX-JAX and MJX-Warp accept without a word and then compute something else (found by comparing
# each feature with C MuJoCo, versions 3.17.0): attribute, what it must be, which engines ignore it.
IGNORED_FEATURES = (
    ("actuator_damping", 0.0, ("jax",)),
    ("actuator_armature", 0.0, ("jax", "warp")),
    ("dof_dampingpoly", 0.0, ("jax",)),
    ("tendon_armature", 0.0, ("jax",)),
    ("geom_adhesion", 0.0, ("jax",)),
    ("geom_surfacevel", 0.0, ("jax",)),
    ("geom_fluid", 0.0, ("jax",)),
    ("actuator_delay", 0.0, ("jax",)),
)
ROUND_TYPES = (int(GeomType.mjGEOM_CYLINDER), int(GeomType.mjGEOM_ELLIPSOID))
UNRELIABLE_WITH_ROUND = (int(GeomType.mjGEOM_SPHERE), int(GeomType.mjGEOM_CAPSULE), *ROUND_TYPES)
"""A round geom against one of these is a pair that MJX-JAX solves by a few steps of gradient descent; drops
came out 0.3 to 0.7 m wrong."""
REFUSED_WITH_ROUND = (int(GeomType.mjGEOM_MESH), int(GeomType.mjGEOM_HFIELD))
"""MJX-JAX has no contact of a round geom, such as a wheel, with these."""


def check_features(model: mujoco.MjModel, engine: str) -> None:
    """Refuse what the engine would silently ignore.

    Raises:
        UnsupportedFeatureError: Names the features and where they are used.
    """
    faults = [
        f"{name} (ignored)"
        for name, neutral, ignored_by in IGNORED_FEATURES
        if engine in ignored_by and np.any(getattr(model, name) != neutral)
    ]
    if engine == "jax":
        if model.opt.noslip_iterations:
            faults.append("noslip_iterations (ignored)")
        faults += [
            f"contact of {model.geom(a).name!r} with {model.geom(b).name!r} (unreliable)"
            for a, b in _pairs(model, UNRELIABLE_WITH_ROUND)[:4]
        ]
        faults += [
            f"contact of {model.geom(a).name!r} with {model.geom(b).name!r} (refused)"
            for a, b in _pairs(model, REFUSED_WITH_ROUND)[:4]
        ]
    if faults:
        raise UnsupportedFeatureError(f"engine {engine!r} cannot run this scene: {'; '.join(faults)}")


def _pairs(model: mujoco.MjModel, others: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return which round geoms may touch geoms of some types."""
    collides = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    round_geoms = [g for g in collides if model.geom_type[g] in ROUND_TYPES]
    pairs: list[tuple[int, int]] = []
    for a in round_geoms:
        meets = (model.geom_contype[a] & model.geom_conaffinity[collides]) | (
            model.geom_conaffinity[a] & model.geom_contype[collides]
        )
        other_body = model.geom_bodyid[collides] != model.geom_bodyid[a]
        for b in collides[(meets != 0) & other_body]:
            if model.geom_type[b] in others:
                pairs.append((int(a), int(b)))
    return pairs


ENGINES: Registry[tuple[str, str]] = Registry("engine")
"""Module and class of each engine."""
ENGINES.add("c", ("usarmjx.engines.c.batch", "CEngine"))
ENGINES.add("jax", ("usarmjx.engines.mjx", "JaxEngine"))
ENGINES.add("planar", ("usarmjx.engines.planar.engine", "PlanarEngine"))
ENGINES.add("warp", ("usarmjx.engines.mjx_warp", "WarpEngine"))


def choose_engine(name: str, purpose: Literal["serve", "train", "batch"]) -> str:
    """Resolve `auto`: warp on an NVIDIA GPU; else c to serve one world, jax for a batch that is compiled.

    What trains or tries policies takes c on a CPU, and jax on what is neither.

    Raises:
        UnknownNameError: No such engine; lists those there are.
    """
    if name.lower() != "auto":
        ENGINES.get(name)
        return name.lower()
    kinds = {device.platform for device in jax.devices()}
    if "gpu" in kinds and importlib.util.find_spec("warp") is not None:
        return "warp"
    return "c" if purpose == "serve" or (purpose == "train" and kinds == {"cpu"}) else "jax"


def engine_class(name: str) -> type[Engine[Any]]:
    """Return the class of an engine.

    Raises:
        UnknownNameError: No such engine.
    """
    module, kind = ENGINES.get(name)
    return getattr(import_module(module), kind)


def make_engine(
    name: str,
    spec: mujoco.MjSpec,
    physics: Physics,
    worlds: int,
    moved_geoms: MovedGeoms | None = None,
    varied_bodies: RandomizedBodies | None = None,
    robots: tuple[tuple[RobotSpec, RobotIndex], ...] = (),
) -> Engine[Any]:
    """Build an engine by name; the other arguments are those of `Engine`, and the robots by slot.

    Raises:
        UnknownNameError: No such engine.
        UnsupportedFeatureError: The model has a feature that the engine would ignore.
        EngineError: The engine cannot run here.
    """
    engine = engine_class(name)
    more = {"robots": robots} if engine.needs_robots else {}
    return engine(spec, physics, worlds, moved_geoms, varied_bodies, **more)
