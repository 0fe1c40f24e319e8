"""MJX on NVIDIA Warp's kernels (`warp`): GPUs, and slowly CPUs."""

import atexit
import copy
from collections.abc import Callable
from importlib import import_module

import jax
import jax.numpy as jnp
import mujoco
from mujoco import mjx

from usarmjx.base.arrays import Array
from usarmjx.base.errors import EngineError
from usarmjx.engines.base import (
    Inputs,
    SolvedStep,
    StepArguments,
    StepOutcome,
)
from usarmjx.engines.convex_room import convex_room
from usarmjx.engines.mjx import MjxEngine, own_device
from usarmjx.engines.sleeping import LooseSleep, make_room
from usarmjx.engines.warp_graphs import GRAPHS, CapturedGraphs, step_several
from usarmjx.models.build.compose import Physics
from usarmjx.models.build.moved import MovedGeoms
from usarmjx.models.build.variation import RandomizedBodies

# MJX-Warp's overflow word (mujoco_warp OverflowType) without the bits that only say that the solver used
# all of its iterations, which the capped CG solver does on nearly every step.
ITERATION_BITS = 512 | 1024


def finish_steps() -> None:
    """Wait for what is being computed.

    On a CPU, MuJoCo Warp's kernels are started by Python: a step still under way when the interpreter ends
    would wait for it for ever, and the end for the step.
    """
    jax.block_until_ready(jax.live_arrays())


class WarpEngine(MjxEngine):
    """NVIDIA GPUs; runs on a CPU too, slowly. Not bit-exact: its sums are atomic.

    All worlds share one contact buffer, so one that overflows can take contacts from another.
    """

    name = "warp"
    impl = "warp"
    _graphs = CapturedGraphs()
    _sleep: LooseSleep | None = None

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
        super().__init__(spec, physics, worlds, moved_geoms, varied_bodies)
        if jax.default_backend() == "cpu":
            atexit.register(finish_steps)
        masses = jnp.asarray(self.model.body_mass, jnp.float32)
        self._masses = masses if self._weight_is_applied(self.model) else None
        if self.model.nuserdata and self._masses is not None:  # MuJoCo's own gravity cannot be taken off one
            self._sleep = LooseSleep(self.model, physics.sleep_tolerance, physics.period)

    def compile(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Return the model, with room for how long loose objects have been still if they may sleep."""
        if self.physics.sleep_tolerance:
            make_room(spec)
        return super().compile(spec)

    @staticmethod
    def _weight_is_applied(model: mujoco.MjModel) -> bool:
        """Whether weight is an applied force like others instead of MuJoCo's own gravity.

        MuJoCo Warp looks for gravity compensation of all bodies and degrees of freedom wherever there is
        gravity: 5 % of a step of 4096 x 16, though no body asks for it. What sleeps must be free of force.
        """
        sleeps = model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP
        return not model.body_gravcomp.any() and not sleeps

    def _put_model(self, model: mujoco.MjModel) -> mjx.Model:
        if self._weight_is_applied(model):
            model = copy.copy(model)
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
        # Its kernels print a line per world and step when the solver uses all its iterations; that alone
        # costs half the speed. Overflow is counted below instead.
        return super()._put_model(model).tree_replace({"opt._impl.warn_overflow": 0})

    def _make_data(self) -> mjx.Data:
        contacts = int(self.model.numeric("max_contact_points").data[0])
        # Rows are counted per world, contacts over all worlds: a world has room for three times the average.
        pairs = self.mx._impl.nxn_geom_pair_filtered
        return mjx.make_data(
            self.model,
            impl=self.impl,
            device=own_device(),
            naconmax=self.worlds * contacts,
            naccdmax=self.worlds * convex_room(self.model, pairs, contacts),
            njmax=3 * self.physics.rows_per_contact * contacts,
        )

    def advance(self, engine_state: mjx.Data, inputs: Inputs) -> mjx.Data:
        """Step every world by one control step, which begins with no overflow: Warp only ever sets bits."""
        clear = jnp.zeros_like(engine_state._impl.overflow)
        engine_state = engine_state.tree_replace({"_impl.overflow": clear})
        awake: jax.Array | None = None
        if self._sleep is not None:
            still = self._sleep.still_steps(engine_state, inputs.xfrc_applied)
            engine_state, awake = engine_state.replace(userdata=still), ~self._sleep.asleep(still)
            held = jnp.asarray(inputs.pinned_dof).at[:, self._sleep.dofadr].max(~awake[..., None])
            inputs = inputs.replace(pinned_dof=held)
        if self._masses is not None:
            masses = self._fields(inputs).get("body_mass", self._masses).reshape(-1, self.model.nbody)
            if self._sleep is not None and awake is not None:
                masses = jnp.broadcast_to(masses, (self.worlds, self.model.nbody))
                masses = masses.at[:, self._sleep.bodies].multiply(awake)
            weight = masses[..., None] * jnp.asarray(self.model.opt.gravity, jnp.float32)
            inputs = inputs.replace(xfrc_applied=jnp.asarray(inputs.xfrc_applied).at[..., :3].add(weight))
        return super().advance(engine_state, inputs)

    def _fields_of_state(self, engine_state: mjx.Data) -> dict[str, jax.Array]:
        """Return margins with which what sleeps touches nothing."""
        if self._sleep is None:
            return {}
        asleep = self._sleep.asleep(engine_state.userdata)
        margin = self._sleep.margin(self.mx.geom_margin, asleep)
        return {"geom_margin": margin.reshape(self.worlds, *self.mx.geom_margin.shape)}

    def set_qpos(self, engine_state: mjx.Data, pinned: Array, pinned_dof: Array, qpos: Array) -> mjx.Data:
        """Put the pinned coordinates at qpos, at rest; loose objects that this moves are awake."""
        done = super().set_qpos(engine_state, pinned, pinned_dof, qpos)
        if self._sleep is None:
            return done
        moved = self._sleep.moved(pinned, qpos, engine_state.qpos)
        return done.replace(userdata=jnp.where(moved, 0.0, engine_state.userdata))

    def reset(self, engine_state: mjx.Data, mask: Array, qpos: Array) -> mjx.Data:
        """Put the masked worlds at rest at qpos, with all awake; the others keep every bit."""
        done = super().reset(engine_state, mask, qpos)
        return done.replace(userdata=jnp.where(mask[:, None], 0.0, engine_state.userdata))

    def use_graphs(self, name: str) -> None:
        """Capture other CUDA graphs than usual, of `GRAPHS`; what is compiled already stays."""
        self._graphs = GRAPHS.get(name)
        if jax.default_backend() != "cpu":
            mode = import_module("warp").JaxCallableGraphMode[self._graphs.mode]
            self.mx = self.mx.tree_replace({"opt._impl.graph_mode": mode})

    def _step_of_calls(self) -> tuple[Callable[[mjx.Model, mjx.Data], mjx.Data], int]:
        if self._graphs.control_step:
            return step_several(self.physics.substeps), 1
        return super()._step_of_calls()

    def waiting(self, step: Callable[StepArguments, StepOutcome]) -> Callable[StepArguments, StepOutcome]:
        """Return a function that steps and, on a CPU, waits: `finish_steps` does not see dropped outcomes."""
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
        world = jnp.where(used, impl.contact__worldid.reshape(-1), self.worlds)  # past the end: dropped
        contacts = jnp.zeros(self.worlds, jnp.int32).at[world].add(1, mode="drop")
        return SolvedStep(contacts, impl.nefc.reshape(-1), impl.solver_niter.reshape(-1))
