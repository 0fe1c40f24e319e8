"""Fields of an engine's model that differ between worlds: domain randomisation (`models.build.variation`)."""

import copy
from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.models.build.variation import RandomizedBodies, RandomizedValues

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
