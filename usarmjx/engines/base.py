"""The interface that all engines have, and the check that a model means the same to all of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, Generic, NamedTuple, ParamSpec, TypeVar

import jax
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.engines.varied import VariedModel
from usarmjx.models.build.compose import Physics
from usarmjx.models.build.moved import MovedGeoms
from usarmjx.models.build.variation import RandomizedBodies, RandomizedValues

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
