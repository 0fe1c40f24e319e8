"""MJX on JAX's own kernels (`jax`) or on NVIDIA Warp's (`warp`)."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco
from mujoco import mjx

from usarmjx import threads
from usarmjx.engines import cylinder_box
from usarmjx.engines.base import Engine, Inputs, PhysicsState
from usarmjx.errors import EngineError
from usarmjx.models.compose import Physics
from usarmjx.transforms import Array

# MJX-Warp's overflow word (mujoco_warp OverflowType) without the bits that only say that the solver used
# all of its iterations, which the capped CG solver does on nearly every step.
ITERATION_BITS = 512 | 1024


class MjxEngine(Engine):
    """What both have in common: one mapped step over all worlds."""

    traceable = True
    impl: ClassVar[str]

    def __init__(self, model: mujoco.MjModel, physics: Physics, worlds: int) -> None:
        super().__init__(model, physics, worlds)
        self._c_model = model
        self.mx = self._put_model(model)

    def _put_model(self, model: mujoco.MjModel) -> mjx.Model:
        return mjx.put_model(model, impl=self.impl)

    def _make_data(self) -> mjx.Data:
        return mjx.make_data(self._c_model, impl=self.impl)

    def start(self) -> mjx.Data:
        """Return every world at the model's reference configuration."""
        return jax.jit(jax.vmap(lambda _: self._make_data()))(jnp.arange(self.worlds))

    def advance(self, own: mjx.Data, inputs: Inputs) -> mjx.Data:
        """Step every world by one control step."""
        data = self.place(own, inputs.pinned, inputs.pinned_dof, inputs.qpos)
        data = data.replace(ctrl=inputs.ctrl, act=inputs.act, xfrc_applied=inputs.xfrc_applied)
        step = jax.vmap(mjx.step, in_axes=(None, 0))
        return jax.lax.fori_loop(0, self.physics.substeps, lambda _, d: step(self.mx, d), data)

    def place(self, own: mjx.Data, pinned: Array, pinned_dof: Array, qpos: Array) -> mjx.Data:
        """Put the pinned coordinates at qpos, at rest."""
        return own.replace(
            qpos=jnp.where(pinned, qpos, own.qpos),
            qvel=jnp.where(pinned_dof, 0.0, own.qvel),
            qacc_warmstart=jnp.where(pinned_dof, 0.0, own.qacc_warmstart),
        )

    def reset(self, own: mjx.Data, mask: Array, qpos: Array) -> mjx.Data:
        """Put the masked worlds at rest at qpos; the others keep every bit."""

        def clear(value: jax.Array) -> jax.Array:
            return jnp.where(mask.reshape(-1, *[1] * (value.ndim - 1)), 0.0, value)

        return own.replace(
            qpos=jnp.where(mask[:, None], qpos, own.qpos),
            qvel=clear(own.qvel),
            act=clear(own.act),
            ctrl=clear(own.ctrl),
            time=clear(own.time),
            xfrc_applied=clear(own.xfrc_applied),
            qacc_warmstart=clear(own.qacc_warmstart),
        )

    def state(self, own: mjx.Data) -> PhysicsState:
        """Return positions, velocities and activations."""
        return PhysicsState(qpos=own.qpos, qvel=own.qvel, act=own.act)


class JaxEngine(MjxEngine):
    """Any XLA device; bit-exact for the same versions, device and batch.

    It computes every geom pair that may touch, up to the caps that the composer sets; `overflow` is the
    number of contacts in force when that reached the cap, that is, when some may have been dropped.
    """

    name = "jax"
    impl = "jax"

    def __init__(self, model: mujoco.MjModel, physics: Physics, worlds: int) -> None:
        threads.check()
        cylinder_box.register()
        super().__init__(model, physics, worlds)

    def overflow(self, own: mjx.Data) -> jax.Array:
        """Return the contacts in force where they fill the buffer, else 0 (worlds,)."""
        contact = own._impl.contact
        in_force = (contact.dist < contact.includemargin).sum(-1)
        return jnp.where(in_force >= contact.dist.shape[-1], in_force, 0).astype(jnp.int32)


class WarpEngine(MjxEngine):
    """NVIDIA GPUs; runs on a CPU too, slowly. Not bit-exact: its sums are atomic.

    All worlds share one contact buffer, so one that overflows can take contacts from another.
    """

    name = "warp"
    impl = "warp"

    def __init__(self, model: mujoco.MjModel, physics: Physics, worlds: int) -> None:
        try:
            import warp  # noqa: F401 - optional
        except ImportError as missing:
            raise EngineError(
                "engine 'warp' needs warp-lang: install usarmjx[cuda] or usarmjx[warp]"
            ) from missing
        super().__init__(model, physics, worlds)

    def _put_model(self, model: mujoco.MjModel) -> mjx.Model:
        # Its kernels print a line per world and step when the solver uses all its iterations; that alone
        # costs half the speed. Overflow is counted below instead.
        return super()._put_model(model).tree_replace({"opt._impl.warn_overflow": 0})

    def _make_data(self) -> mjx.Data:
        robots = max(1, sum(self._c_model.jnt_type == mujoco.mjtJoint.mjJNT_FREE))
        contacts = robots * self.physics.contacts_per_robot
        # A contact of the elliptic cone with sliding friction has three constraint rows. Rows are counted
        # per world, contacts over all worlds, so a world has room for twice the average.
        return mjx.make_data(
            self._c_model, impl=self.impl, naconmax=self.worlds * contacts, njmax=2 * 3 * contacts
        )

    def overflow(self, own: mjx.Data) -> jax.Array:
        """Return the overflow bits of the last step (worlds,)."""
        return (own._impl.overflow & ~ITERATION_BITS).reshape(self.worlds, -1).max(-1).astype(jnp.int32)
