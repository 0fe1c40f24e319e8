"""Engine interface, check of unsupported model features, per-world model fields and engine registry."""

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

from usarmjx.base.backend import Array
from usarmjx.base.errors import UnknownNameError, UnsupportedFeatureError
from usarmjx.base.nodes import Node
from usarmjx.base.registry import Registry, unknown_name
from usarmjx.models.compile.compose import RobotIndex
from usarmjx.models.compile.geoms import MovedGeoms
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import RandomizedBodies, RandomizedValues
from usarmjx.models.types.robot import RobotSpec

MASS_KNOTS = 9
"""Mass factors at which MuJoCo computes the derived constants; they are interpolated between."""
BODY_FIELDS = ("body_mass", "body_inertia", "body_subtreemass", "body_invweight0")
"""Model fields per body that depend on the mass."""
DOF_FIELDS = ("dof_invweight0", "dof_M0")
"""Model fields per degree of freedom that depend on the mass."""
CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
GeomType = mujoco.mjtGeom
EngineState = TypeVar("EngineState")
"""State of one engine: a PyTree of its own with a leading axis over the worlds."""
StepArguments = ParamSpec("StepArguments")
StepOutcome = TypeVar("StepOutcome")
# Features that MJX-JAX or MJX-Warp accept silently and compute wrongly (found by comparing each feature
# with C MuJoCo, versions 3.17.0): attribute, neutral value, engines that ignore it.
IGNORED_FEATURES = (
    ("actuator_damping", 0.0, ("jax",)),
    ("actuator_armature", 0.0, ("jax", "warp")),
    ("dof_dampingpoly", 0.0, ("jax",)),
    ("tendon_armature", 0.0, ("jax",)),
    ("geom_adhesion", 0.0, ("jax",)),
    ("geom_surfacevel", 0.0, ("jax", "warp", "planar")),  # of warp, solver block ignores it
    ("geom_fluid", 0.0, ("jax",)),
    ("actuator_delay", 0.0, ("jax",)),
)
ROUND_TYPES = (int(GeomType.mjGEOM_CYLINDER), int(GeomType.mjGEOM_ELLIPSOID))
UNRELIABLE_WITH_ROUND = (int(GeomType.mjGEOM_SPHERE), int(GeomType.mjGEOM_CAPSULE), *ROUND_TYPES)
"""Geom types whose contact with a round geom MJX-JAX solves by a few steps of gradient descent; drop tests
ended 0.3 to 0.7 m off."""
REFUSED_WITH_ROUND = (int(GeomType.mjGEOM_MESH), int(GeomType.mjGEOM_HFIELD))
"""Geom types for which MJX-JAX has no contact with a round geom, such as a wheel."""
ENGINES: Registry[tuple[str, str]] = Registry("engine")
"""Module and class of each engine."""
ENGINES.add("c", ("usarmjx.engines.c.batch", "CEngine"))
ENGINES.add("jax", ("usarmjx.engines.mjx", "JaxEngine"))
ENGINES.add("planar", ("usarmjx.engines.planar.engine", "PlanarEngine"))
ENGINES.add("warp", ("usarmjx.engines.mjx_warp", "WarpEngine"))


class VariedModel:
    """Model fields that differ between worlds (domain randomization).

    Args:
        model: The engine's model. Its bodies and joints are in the scene's order, its geoms need not be.
        bodies: The randomized robots.
        with_dof_m0: Whether to include `dof_M0`, which only C MuJoCo reads.

    Raises:
        UnsupportedFeatureError: A wheel of randomized radius is not a cylinder.
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
            # `mj_setConst` cannot be traced: it runs at a few masses here, and the traced step interpolates.
            tables = [self._derived(factor) for factor in np.linspace(*vary.mass, MASS_KNOTS)]
            self._tables = {name: np.stack([t[name] for t in tables]) for name in self._mass_names}
        joints = model.jnt_bodyid
        # Torque varies by its limit, which only some joints have.
        self._joint_owner = np.where(model.jnt_actfrclimited != 0, bodies.owner[joints], -1)

    def _derived(self, factor: float) -> dict[str, np.ndarray]:
        """Return MuJoCo's derived constants for chassis of `factor` times their mass."""
        # mj_setConst writes into the model; the original must keep its constants.
        model, own = copy.copy(self._model), self._bodies.chassis[self._bodies.varies]
        model.body_mass[own] *= factor
        model.body_inertia[own] *= factor
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return {name: getattr(model, name).astype(np.float32) for name in self._mass_names}

    def fields(
        self, varied: RandomizedValues, here: dict[str, jax.Array] | None = None
    ) -> dict[str, jax.Array]:
        """Return the fields that differ between worlds (worlds, ...).

        Args:
            varied: Randomized values of the worlds.
            here: Fields that differ for another reason.
        """
        fields = dict(here or {})

        def base(name: str, worlds: int) -> jax.Array:
            value = jnp.asarray(getattr(self._model, name), jnp.float32)
            # MJX-Warp has some of these in another shape.
            shape = (worlds, *value.shape)
            return fields[name].reshape(shape) if name in fields else jnp.broadcast_to(value, shape)

        if varied.friction is not None:
            worlds = varied.friction.shape[0]
            fields["geom_friction"] = (
                # Column 0 is sliding friction; torsional and rolling friction stay as described.
                base("geom_friction", worlds).at[..., 0].multiply(varied.friction[:, None])
            )
        if varied.torque is not None:
            factor = _of(varied.torque, self._joint_owner)[..., None]
            fields["jnt_actfrcrange"] = base("jnt_actfrcrange", len(factor)) * factor
        if varied.wheel is not None:
            fields |= self._resized(varied.wheel, base)
        if varied.mass is not None:
            fields |= self._loaded(varied.mass)
        return fields

    def _resized(self, wheel: Array, base: Callable[[str, int], jax.Array]) -> dict[str, jax.Array]:
        """Return the geom sizes for wheels of other radii."""
        ids, factor = self._wheels, _of(wheel, self._wheel_owner)
        size = base("geom_size", len(factor)).at[:, ids, 0].multiply(factor)
        # Boxes are (centre, half extents): 3 and 4 lie across the wheel's axis, and 5, its width, stays.
        box = base("geom_aabb", len(factor)).at[:, ids, 3:5].multiply(factor[..., None])
        # A cylinder's sizes are (radius, half length, 0): its bounding sphere reaches the rim.
        rbound = base("geom_rbound", len(factor)).at[:, ids].set(jnp.linalg.norm(size[:, ids, :2], axis=-1))
        return {"geom_size": size, "geom_aabb": box, "geom_rbound": rbound}

    def _loaded(self, mass: Array) -> dict[str, jax.Array]:
        """Return masses and derived constants, interpolated between the tables' knots."""
        low, high = self._span
        # A range of one value has knots at no distance: the bound avoids 0 / 0.
        step = max((high - low) / (MASS_KNOTS - 1), 1e-9)
        dof_owner = self._bodies.owner[self._model.dof_bodyid]
        fields: dict[str, jax.Array] = {}
        for name, table in self._tables.items():
            owner = self._bodies.owner if name in BODY_FIELDS else dof_owner
            # Bodies without an owner are put at the first knot, within the table; `original` replaces their
            # values.
            place = (_of(mass, owner, low) - low) / step
            # At the upper end of the range `floor` gives the last knot, which has no neighbour above.
            below = jnp.clip(jnp.floor(place), 0, MASS_KNOTS - 2).astype(jnp.int32)
            # Tables of inertia and of `body_invweight0` have an axis more than those of mass.
            share = (place - below).reshape(*place.shape, *[1] * (table.ndim - 2))
            column = np.arange(len(owner))
            known = jnp.asarray(table)
            value = known[below, column] * (1 - share) + known[below + 1, column] * share
            # Owner -1 (no robot) reads the appended False. Bodies of no randomized robot keep MuJoCo's exact
            # numbers.
            varies = np.append(self._bodies.varies, False)[owner]
            original = jnp.asarray(getattr(self._model, name), jnp.float32)
            fields[name] = jnp.where(varies.reshape(-1, *[1] * (table.ndim - 2)), value, original)
        return fields


def _of(values: Array, owner: np.ndarray, other: float = 1.0) -> jax.Array:
    """Return the owners' values (worlds, n), given values by slot (worlds, robots); `other` if no owner."""
    values = jnp.asarray(values)
    # The index is clamped because -1 would read the last robot; `where` throws that value away.
    return jnp.where(owner >= 0, values[:, np.maximum(owner, 0)], other)


class PhysicsState(Node, kw_only=True):
    """Engine state as seen by the layers above, in MuJoCo's layout.

    Attributes:
        qpos: Positions (worlds, nq).
        qvel: Velocities (worlds, nv).
        act: Actuator activations (worlds, na).
    """

    qpos: Array
    qvel: Array
    act: Array


class GeomPoses(Node, kw_only=True):
    """Poses of the arena geoms that are inputs (data), in the frame of the body `arena`.

    Attributes:
        pos: Centres [m] (worlds, geoms, 3).
        quat: Orientations (worlds, geoms, 4).
        size: MuJoCo sizes [m] (worlds, geoms, 3); None: as in the model.
    """

    pos: Array
    quat: Array
    size: Array | None = None


class Inputs(Node, kw_only=True):
    """Engine inputs of one control step.

    Attributes:
        ctrl: Actuator inputs (worlds, nu).
        act: Initial actuator activations (worlds, na).
        xfrc_applied: Force [N] and torque [N m] on each body, world axes (worlds, nbody, 6).
        pinned: Which coordinates are held: qpos is set and their velocities are zero (worlds, nq).
        pinned_dof: The same for the velocities (worlds, nv).
        qpos: Positions of the pinned coordinates; the others are ignored (worlds, nq).
        geom_poses: Poses of the arena geoms that are inputs; None: no such geoms.
        varied: Randomized values of the worlds; None: no randomization.
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
    """Solver statistics of each world's last physics step, for benchmarks.

    Attributes:
        contacts: Active contacts (worlds,).
        constraint_rows: Active constraint rows (worlds,).
        solver_iterations: Solver iterations (worlds,); None: unknown.
    """

    contacts: Array
    constraint_rows: Array
    solver_iterations: Array | None


class Engine(ABC, Generic[EngineState]):
    """Physics of many copies of one model. All arrays have a leading axis over the worlds.

    Args:
        spec: Description of the model; its bodies, joints and actuators keep their order.
        physics: Solver and time settings.
        worlds: Number of copies.
        moved_geoms: Arena geoms whose poses are part of every `Inputs`. None: no such geoms.
        varied_bodies: Robots whose randomized values are part of every `Inputs`. None: no randomization.

    Raises:
        UnsupportedFeatureError: The model has a feature that this engine would ignore or refuse.
        EngineError: The engine cannot run on this machine.
    """

    name: ClassVar[str]
    traceable: ClassVar[bool]
    """Whether JAX can trace `advance`, `reset` and `state`, so that they can be part of a jitted step."""
    needs_robots: ClassVar[bool] = False
    """Whether the constructor takes the model's robots, by slot."""
    has_solver: ClassVar[bool] = True
    """Whether contact forces are solved for, so that robots push objects and climb."""

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
        # MuJoCo skips the pose of a geom whose frame equals its body's at compile time; these geoms move.
        names = () if self.moved_geoms is None else self.moved_geoms.names
        self.moved_ids = [self.model.geom(name).id for name in names]
        self.model.geom_sameframe[self.moved_ids] = 0

    def compile(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Compile the model in this engine's form."""
        return spec.compile()

    @abstractmethod
    def start(self) -> EngineState:
        """Return the engine's state with every world at the model's reference configuration."""

    def blocking(self, step: Callable[StepArguments, StepOutcome]) -> Callable[StepArguments, StepOutcome]:
        """Return a step function that blocks until the result is ready, for engines that need it."""
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
        """Return the state with the pinned coordinates at qpos, at rest; masks and qpos as in `Inputs`."""

    @abstractmethod
    def state(self, engine_state: EngineState) -> PhysicsState:
        """Return positions, velocities and activations."""

    @abstractmethod
    def overflow(self, engine_state: EngineState, inputs: Inputs) -> jax.Array:
        """Return the number of contacts that each world's last step lost to full buffers (worlds,); 0: none.

        Args:
            engine_state: State after the step.
            inputs: Inputs of the step.
        """

    def select_graphs(self, name: str) -> None:
        """Select another CUDA graph mode, for benchmarks; call it before the first step.

        Args:
            name: A mode of `usarmjx bench step --graph`.

        Raises:
            UnknownNameError: No such mode.
            UnsupportedFeatureError: The engine launches no graphs.
        """
        raise UnsupportedFeatureError(f"engine {self.name!r} launches no CUDA graphs ({name!r}); warp does")

    def solved(self, engine_state: EngineState) -> SolvedStep | None:
        """Return the solver statistics of the last physics step; None: the engine has no solver."""
        del engine_state


def check_features(model: mujoco.MjModel, engine: str) -> None:
    """Refuse features that the engine would silently ignore.

    Raises:
        UnsupportedFeatureError: Names the features and the geoms or joints that use them.
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
    """Return pairs of round geoms and geoms of some types that can collide."""
    collides = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    round_geoms = [g for g in collides if model.geom_type[g] in ROUND_TYPES]
    pairs: list[tuple[int, int]] = []
    for a in round_geoms:
        meets = (model.geom_contype[a] & model.geom_conaffinity[collides]) | (
            model.geom_conaffinity[a] & model.geom_contype[collides]
        )
        # Geoms of one body never collide.
        other_body = model.geom_bodyid[collides] != model.geom_bodyid[a]
        for b in collides[(meets != 0) & other_body]:
            if model.geom_type[b] in others:
                pairs.append((int(a), int(b)))
    return pairs


def choose_engine(name: str, purpose: Literal["serve", "train", "batch"]) -> str:
    """Resolve `auto`: warp on an NVIDIA GPU; otherwise c for one served world, jax for a compiled batch.

    Training and evaluation take c on a CPU, and jax on other devices.

    Raises:
        UnknownNameError: No such engine; lists the known ones.
    """
    if name.lower() != "auto":
        if name not in ENGINES:
            raise UnknownNameError(unknown_name("engine", name, ["auto", *ENGINES.names()]))
        return name.lower()
    # Only for `auto`: looking up devices starts JAX's backend.
    kinds = {device.platform for device in jax.devices()}
    if "gpu" in kinds and importlib.util.find_spec("warp") is not None:
        return "warp"
    return "c" if purpose == "serve" or (purpose == "train" and kinds == {"cpu"}) else "jax"


def choose_solver(physics: Physics, engine: str) -> str:
    """Resolve solver `auto`: `block` on engine `warp` with a GPU, for scenes that it covers; otherwise CG."""
    if physics.solver != "auto":
        return physics.solver
    return "block" if engine == "warp" and jax.default_backend() != "cpu" else "CG"


def engine_class(name: str) -> type[Engine[Any]]:
    """Return the class of an engine.

    Raises:
        UnknownNameError: No such engine.
    """
    module, kind = ENGINES.get(name)
    # Imported by its name and only now: a run needs one engine.
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
    # Only `planar` moves robots by their classes; the others know joints and bodies alone.
    more = {"robots": robots} if engine.needs_robots else {}
    return engine(spec, physics, worlds, moved_geoms, varied_bodies, **more)
