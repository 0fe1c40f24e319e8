"""MJX: the part that its two engines share, and the engine on JAX's own kernels (`jax`)."""

import sys
from collections.abc import Callable
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base import process
from usarmjx.base.backend import Array
from usarmjx.base.installation import without_notes
from usarmjx.base.rotations import mat_from_quat
from usarmjx.engines import cylinder_box
from usarmjx.engines.base import Engine, GeomPoses, Inputs, PhysicsState, SolvedStep
from usarmjx.models.compile.compose import ARENA, WORLD, split_long_boxes
from usarmjx.models.compile.geoms import MovedGeoms
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import RandomizedBodies

with without_notes():  # on the standard output: that Warp is missing
    from mujoco import mjx
    from mujoco.mjx._src import collision_driver

MORE_ITERATIONS = 30
"""Solver iterations at least, if one of the next two limits is exceeded. The solver still stops as soon as it
has converged. Engines `c` and `warp` are not affected."""
MAX_MASS_RATIO = 4.0
"""Largest ratio of the masses of free bodies for fewer iterations. MJX-JAX solves all contacts of a world as
one problem, which heavy bodies dominate: with 10 iterations a block of 0.3 kg crept at 3 mm/s and shot out of
a gripper, and a P2AT beside a car drifted 2 cm in a second."""
MAX_TREE_DOFS = 24
"""Most degrees of freedom of one robot for fewer iterations: cars have 18. Tracks that turn on the spot need
more: in 2 s a Soryu turned by 0.19 rad with 10, by 0.11 rad with 30 and with a solver that converges."""
MAX_BOX_LENGTH = 1.2
"""Longest piece of a wall on `jax` [m]: a cell of the arenas' grid."""


class ShortBoxes:
    """Boxes as a fixed number of pieces along their longest axis, which may differ between worlds.

    Args:
        moved_geoms: The boxes.
        max_length: A box that is longer in no world than this [m] stays whole.

    Attributes:
        moved_geoms: The pieces.
    """

    def __init__(self, moved_geoms: MovedGeoms, max_length: float) -> None:
        # The margin keeps a wall of exactly n cells at n pieces when its length is rounded up.
        counts = np.maximum(1, np.ceil(2 * moved_geoms.max_half_length / max_length - 1e-6)).astype(int)
        self._whole = moved_geoms.names
        self._counts = counts
        self._owner = np.repeat(np.arange(len(counts)), counts)
        piece_indices: list[np.ndarray] = [np.arange(int(count)) for count in counts]
        self._piece_index: np.ndarray = np.concatenate(piece_indices)
        whole = moved_geoms.names
        names = [f"{whole[o]}/{k}" if counts[o] > 1 else whole[o] for o, k in self._pairs()]
        self.moved_geoms = MovedGeoms(
            names=tuple(names),
            max_half_length=(moved_geoms.max_half_length / counts)[self._owner],
            resized=True,
        )

    def _pairs(self) -> list[tuple[int, int]]:
        return list(zip(self._owner.tolist(), self._piece_index.tolist(), strict=True))

    def compile(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Compile the model with the pieces in place of the boxes."""
        # A copy: the scene's own description keeps its boxes whole.
        spec = spec.copy()
        arena = spec.body("arena")
        assert arena is not None
        kept = (
            "type", "size", "pos", "quat", "rgba", "friction", "priority", "contype", "conaffinity", "condim",
            "mass", "solref", "solimp",
        )  # fmt: skip
        for name, count in zip(self._whole, self._counts.tolist(), strict=True):
            if count > 1:
                geom = spec.geom(name)
                shared = {key: getattr(geom, key) for key in kept}
                for k in range(count):
                    arena.add_geom(name=f"{name}/{k}", **shared)
                spec.delete(geom)
        return spec.compile()

    def split_poses(self, poses: GeomPoses) -> GeomPoses:
        """Return the poses and sizes of the pieces."""
        assert poses.size is not None
        size, quat = poses.size[:, self._owner], poses.quat[:, self._owner]
        count = self._counts[self._owner, None]
        # The longest axis may differ between worlds, so it is a mask instead of an index.
        along = jnp.arange(3) == jnp.argmax(size, -1, keepdims=True)
        # Sizes are half lengths: centres of n pieces lie at odd multiples of size / n from one end.
        shift = (2 * (self._piece_index[:, None] + 0.5) / count - 1) * size * along
        # An overload of einsum leaves its arguments open.
        turned = jnp.einsum("...ij,...j->...i", mat_from_quat(quat), shift)  # pyright: ignore[reportUnknownMemberType]
        pos = poses.pos[:, self._owner] + turned
        return GeomPoses(pos=pos, quat=quat, size=jnp.where(along, size / count, size))


def step_by_accelerations(model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Step one world as `mjx.step` does, but by the solver's accelerations where constraints act.

    MJX integrates the solver's forces. In single precision the solver stops while these are wrong by up to
    0.1 N, which changes accelerations little where contacts are stiff. The integration divides it by inertia
    alone, which is up to a thousand times less: robots that stood trembled by up to 0.4 rad/s2. MuJoCo Warp
    integrates accelerations, too. Without an active constraint forces are exact and accelerations are not.
    """
    # `mjx.step` is forward, then the integrator; they are called apart to change the forces in between.
    done = mjx.forward(model, data)
    force = jnp.where(done.qfrc_constraint == 0.0, done.qfrc_smooth, mjx.mul_m(model, done, done.qacc))
    # `mjx.euler` adds both forces: the whole one goes into one field, and zero into the other.
    none = jnp.zeros_like(force)
    after = mjx.euler(model, done.replace(qfrc_smooth=force, qfrc_constraint=none))
    # Sensors and statistics read these afterwards.
    return after.replace(qfrc_smooth=done.qfrc_smooth, qfrc_constraint=done.qfrc_constraint)


def local_device() -> jax.Device | None:
    """Return this process's device in a multi-process run; None: a single process.

    By default MJX takes the first process's device.
    """
    return jax.local_devices()[0] if jax.process_count() > 1 else None


class MjxEngine(Engine[mjx.Data]):
    """Common part of the MJX engines: one vectorised step of all worlds."""

    traceable = True
    impl: ClassVar[str]

    def __init__(
        self,
        spec: mujoco.MjSpec,
        physics: Physics,
        worlds: int,
        moved_geoms: MovedGeoms | None = None,
        varied_bodies: RandomizedBodies | None = None,
    ) -> None:
        super().__init__(spec, physics, worlds, moved_geoms, varied_bodies)
        self.mx = self._put_model(self.model)

    def _put_model(self, model: mujoco.MjModel) -> mjx.Model:
        return mjx.put_model(model, impl=self.impl, device=local_device())

    def _make_data(self) -> mjx.Data:
        return mjx.make_data(self.model, impl=self.impl, device=local_device())

    def start(self) -> mjx.Data:
        """Return every world in the model's reference configuration."""

        def make_data(_: jax.Array) -> mjx.Data:
            return self._make_data()

        # The numbers are not used: vmap needs an argument with an axis over the worlds.
        return jax.jit(jax.vmap(make_data))(jnp.arange(self.worlds))

    def advance(self, engine_state: mjx.Data, inputs: Inputs) -> mjx.Data:
        """Step every world by one control step."""
        data = self.set_qpos(engine_state, inputs.pinned, inputs.pinned_dof, inputs.qpos)
        data = data.replace(ctrl=inputs.ctrl, act=inputs.act, xfrc_applied=inputs.xfrc_applied)
        fields = self._fields(inputs) | self._state_fields(data)
        if not fields:
            # No field differs between worlds: vmap shares the whole model.
            model, axes = self.mx, None
        else:
            model = self.mx.tree_replace(fields)
            # Only replaced fields get an axis over the worlds: a copy of the rest per world would fill the
            # memory.
            axes = jax.tree.map(lambda _: None, self.mx).tree_replace(dict.fromkeys(fields, 0))
        step, calls = self._step_and_count()
        worlds_step = jax.vmap(step, in_axes=(axes, 0))
        # A loop of the program and not of Python: the step is compiled once, however many substeps there are.
        return jax.lax.fori_loop(0, calls, lambda _, d: worlds_step(model, d), data)

    def _step_and_count(self) -> tuple[Callable[[mjx.Model, mjx.Data], mjx.Data], int]:
        """Return the step function of a world, and the number of its calls per control step."""
        return mjx.step, self.physics.substeps

    def _fields(self, inputs: Inputs) -> dict[str, jax.Array]:
        """Return the model's fields that differ between worlds (worlds, ...)."""
        fields = {} if inputs.geom_poses is None else self._moved_fields(inputs.geom_poses)
        if self.varied_model is None or inputs.varied is None:
            return fields
        fields = self.varied_model.fields(inputs.varied, fields)
        # MJX-Warp has some fields in another shape than MuJoCo.
        shapes = {name: (self.worlds, *getattr(self.mx, name).shape) for name in fields}
        return {name: value.reshape(shapes[name]) for name, value in fields.items()}

    def _state_fields(self, engine_state: mjx.Data) -> dict[str, jax.Array]:
        """Return model fields that depend on the worlds' state (worlds, ...)."""
        del engine_state
        return {}

    def _moved_fields(self, poses: GeomPoses) -> dict[str, jax.Array]:
        """Return the fields of geoms that are inputs (worlds, ngeom, ...)."""
        ids = np.array(self.moved_ids)

        def everywhere(value: jax.Array, here: Array) -> jax.Array:
            all_worlds = jnp.broadcast_to(value, (self.worlds, *value.shape))
            return all_worlds.at[:, ids].set(here.reshape(self.worlds, len(ids), *value.shape[1:]))

        fields = {
            "geom_pos": everywhere(self.mx.geom_pos, poses.pos),
            "geom_quat": everywhere(self.mx.geom_quat, poses.quat),
        }
        if poses.size is not None:
            # Broad phases read bounds, not sizes: with stale ones they would miss contacts of grown boxes.
            box = jnp.concatenate([jnp.zeros_like(poses.size), poses.size], -1)
            fields["geom_size"] = everywhere(self.mx.geom_size, poses.size)
            fields["geom_aabb"] = everywhere(self.mx.geom_aabb, box)
            fields["geom_rbound"] = everywhere(self.mx.geom_rbound, jnp.linalg.norm(poses.size, axis=-1))
        return fields

    def set_qpos(self, engine_state: mjx.Data, pinned: Array, pinned_dof: Array, qpos: Array) -> mjx.Data:
        """Set the pinned coordinates to qpos, at rest."""
        return engine_state.replace(
            qpos=jnp.where(pinned, qpos, engine_state.qpos),
            qvel=jnp.where(pinned_dof, 0.0, engine_state.qvel),
            # The warm start belongs to the old position: kept, it would kick the body.
            qacc_warmstart=jnp.where(pinned_dof, 0.0, engine_state.qacc_warmstart),
        )

    def reset(self, engine_state: mjx.Data, mask: Array, qpos: Array) -> mjx.Data:
        """Reset the masked worlds to qpos, at rest; the others keep every bit."""

        # By `where`, not by a product: a world is also reset after its numbers became NaN, and 0 * NaN is
        # NaN.
        def clear(value: jax.Array) -> jax.Array:
            return jnp.where(mask.reshape(-1, *[1] * (value.ndim - 1)), 0.0, value)

        return engine_state.replace(
            qpos=jnp.where(mask[:, None], qpos, engine_state.qpos),
            qvel=clear(engine_state.qvel),
            act=clear(engine_state.act),
            ctrl=clear(engine_state.ctrl),
            time=clear(engine_state.time),
            xfrc_applied=clear(engine_state.xfrc_applied),
            qacc_warmstart=clear(engine_state.qacc_warmstart),
        )

    def state(self, engine_state: mjx.Data) -> PhysicsState:
        """Return positions, velocities and activations."""
        return PhysicsState(qpos=engine_state.qpos, qvel=engine_state.qvel, act=engine_state.act)


class JaxEngine(MjxEngine):
    """MJX on any XLA device; bit-exact for the same versions, device and batch.

    Only the geom pairs with the nearest bounding spheres are tested, up to a cap, and only the deepest
    contacts are kept, up to a cap. `overflow` counts possible losses: pairs with overlapping spheres beyond
    the first cap, and all active contacts if they reach the second.
    """

    name = "jax"
    impl = "jax"
    _short: ShortBoxes | None = None

    def __init__(
        self,
        spec: mujoco.MjSpec,
        physics: Physics,
        worlds: int,
        moved_geoms: MovedGeoms | None = None,
        varied_bodies: RandomizedBodies | None = None,
    ) -> None:
        process.check_pool_size()
        cylinder_box.register_collision()
        super().__init__(spec, physics, worlds, moved_geoms, varied_bodies)
        # MJX's pairing of geoms and its caps are private; `register_collision`, above, refuses every
        # version of MJX but the one in which these two functions were read.
        cap = collision_driver._numeric(  # pyright: ignore[reportPrivateUsage] - see above
            self.model, "max_geom_pairs"
        )  # -1 when there is none
        self._pair_cap = cap if cap >= 0 else sys.maxsize
        groups = collision_driver._geom_groups(self.model)  # pyright: ignore[reportPrivateUsage] - as above
        # Planes and height fields have a bounding radius of 0, so MJX never sorts their pairs out by spheres.
        unbounded = {int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)}
        self._capped = [
            np.array(pairs)[:, :2]
            for key, pairs in groups.items()
            if len(pairs) > self._pair_cap and not unbounded & set(map(int, key.types))
        ]

    def compile(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Compile the model with long walls in pieces, which bounding spheres can separate.

        Floor and arena are excluded from each other: unlike C MuJoCo, MJX makes contacts of a mocap body with
        the world, and the deep ones of walls that reach below the floor would fill the buffer.
        """
        spec = spec.copy()
        if spec.body(ARENA) is not None:
            spec.add_exclude(bodyname1=WORLD, bodyname2=ARENA)
        if self.moved_geoms is not None and self.moved_geoms.resized:
            # Splitting needs fixed numbers of pieces: the walls' lengths differ between worlds and are data.
            self._short = ShortBoxes(self.moved_geoms, MAX_BOX_LENGTH)
            self.moved_geoms = self._short.moved_geoms
            model = self._short.compile(spec)
        else:
            model = split_long_boxes(spec, MAX_BOX_LENGTH)
        free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
        # The mass of a free body includes everything that hangs on it.
        masses = model.body_subtreemass[free]
        lightest, heaviest = (
            (1.0, 1.0) if self.varied_bodies is None else self.varied_bodies.vary.mass or (1.0, 1.0)
        )
        # The worst pair under randomization: one body at its heaviest beside one at its lightest.
        uneven = len(free) and heaviest * masses.max() > MAX_MASS_RATIO * lightest * masses.min()
        if uneven or np.bincount(model.dof_treeid).max(initial=0) > MAX_TREE_DOFS:
            model.opt.iterations = max(model.opt.iterations, MORE_ITERATIONS)
        return model

    def _step_and_count(self) -> tuple[Callable[[mjx.Model, mjx.Data], mjx.Data], int]:
        return step_by_accelerations, self.physics.substeps

    def _moved_fields(self, poses: GeomPoses) -> dict[str, jax.Array]:
        return super()._moved_fields(poses if self._short is None else self._short.split_poses(poses))

    def overflow(self, engine_state: mjx.Data, inputs: Inputs) -> jax.Array:
        """Return the number of pairs and contacts that may have been dropped (worlds,)."""
        contact = engine_state._impl.contact
        in_force = (contact.dist < contact.includemargin).sum(-1)
        # A full buffer cannot tell how many contacts it lacks: all of them count as suspect.
        lost = jnp.where(in_force >= contact.dist.shape[-1], in_force, 0)
        # Pieces of walls and randomized wheels have other radii in every world.
        radius = self._fields(inputs).get("geom_rbound", jnp.asarray(self.model.geom_rbound)[None])
        # Only these types have more pairs than the cap, so only they can lose any.
        for pairs in self._capped:
            apart = engine_state.geom_xpos[:, pairs[:, 0]] - engine_state.geom_xpos[:, pairs[:, 1]]
            reach = radius[:, pairs].sum(-1)
            near = (jnp.linalg.norm(apart, axis=-1) < reach).sum(-1)
            lost += jnp.maximum(near - self._pair_cap, 0)
        return lost.astype(jnp.int32)

    def solved(self, engine_state: mjx.Data) -> SolvedStep:
        """Return active contacts and rows; MJX does not record the iterations."""
        impl = engine_state._impl
        in_force = (impl.contact.dist < impl.contact.includemargin).sum(-1)
        return SolvedStep(in_force, (impl.efc_J != 0.0).any(-1).sum(-1), None)
