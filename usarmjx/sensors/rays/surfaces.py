"""The surfaces that rays meet: at which angle, and how the distance changes with where rays and geoms are."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.rotations import matvec
from usarmjx.sensors.rays.kernels import surface_normal
from usarmjx.sensors.rays.targets import GeomBlock, Geoms

FLATTEST = 1e-3
"""A ray that meets a surface at a smaller cosine counts as one that meets it at this one, for slopes."""


class GeomHits(NamedTuple):
    """What rays meet first.

    Attributes:
        distance: How far away, infinite where there is nothing [m] (rays,).
        geom_index: Which geom of all blocks, one block after the other; -1 for none (rays,).
    """

    distance: jax.Array
    geom_index: jax.Array

    def closer(self, distance: jax.Array, index: jax.Array) -> "GeomHits":
        """Return what is closer, this or something else."""
        better = distance < self.distance
        return GeomHits(jnp.where(better, distance, self.distance), jnp.where(better, index, self.geom_index))

    def met(self) -> "GeomHits":
        """Return it with an infinite distance where nothing was met."""
        return GeomHits(jnp.where(self.geom_index < 0, jnp.inf, self.distance), self.geom_index)


def concatenated(geoms: Geoms) -> GeomBlock:
    """Return all geoms as one block, one block after the other."""
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *geoms.blocks)


def normals(geoms: Geoms, first: GeomHits, origin: jax.Array, direction: jax.Array) -> jax.Array:
    """Return the unit normals of the surfaces that rays meet, in world axes and towards the rays (rays, 3).

    They are zero where nothing was met.
    """
    geom = jax.tree.map(lambda x: x[jnp.maximum(first.geom_index, 0)], concatenated(geoms))
    reach = jnp.where(first.geom_index >= 0, first.distance, 0.0)[:, None]
    offset = origin + reach * direction - geom.pos
    point = jnp.stack([sum(geom.mat[:, j, i] * offset[:, j] for j in range(3)) for i in range(3)], -1)
    normal, before = jnp.zeros_like(point), 0
    for kind, block in zip(geoms.kinds, geoms.blocks, strict=True):
        mine = (first.geom_index >= before) & (first.geom_index < before + len(block.owner))
        normal = jnp.where(mine[:, None], surface_normal(kind, point, geom.size), normal)
        before += len(block.owner)
    turned = jnp.stack([sum(geom.mat[:, i, j] * normal[:, j] for j in range(3)) for i in range(3)], -1)
    return jnp.where((turned * direction).sum(-1, keepdims=True) > 0, -turned, turned)


def sloped(
    cast: Callable[..., GeomHits],
    geoms: Geoms,
    origin: Array,
    direction: Array,
    *others: Any,  # noqa: ANN401 - of the caster
) -> GeomHits:
    """Return what `cast(geoms, origin, direction, *others)` says; its distances can be differentiated.

    In both modes, whatever casts: what is met first stays so for a small change, and the surface counts as
    its plane there. Slopes are by where rays and geoms are, not by how large geoms are.
    """
    return _cast(cast, geoms, origin, direction, *others)


def _as_it_is(cast: Callable[..., GeomHits], *values: Any) -> GeomHits:  # noqa: ANN401 - of the caster
    return cast(*values)


def _slopes(
    cast: Callable[..., GeomHits], values: tuple[Any, ...], rates: tuple[Any, ...]
) -> tuple[GeomHits, GeomHits]:
    geoms, origin, direction = values[:3]
    first = sloped(cast, *values)
    met, which = first.geom_index >= 0, jnp.maximum(first.geom_index, 0)
    reach = jnp.where(met, first.distance, 0.0)[:, None]
    normal = normals(geoms, first, origin, direction)

    def placed(seen: Geoms) -> tuple[Array, Array]:
        pos, mat = ([getattr(block, name) for block in seen.blocks] for name in ("pos", "mat"))
        return jnp.concatenate(pos)[which], jnp.concatenate(mat)[which]

    (pos, mat), (pos_rate, mat_rate) = placed(geoms), placed(rates[0])
    own = matvec(jnp.swapaxes(mat, -1, -2), normal)
    rate = rates[1] + reach * rates[2] - pos_rate
    away = (normal * rate + matvec(mat_rate, own) * (origin + reach * direction - pos)).sum(-1)
    facing = jnp.minimum((normal * direction).sum(-1), -FLATTEST)
    slope = jnp.where(met, -away / facing, 0.0)
    return first, GeomHits(slope, np.zeros(which.shape, jax.dtypes.float0))  # type: ignore - of whole numbers


_cast: Any = jax.custom_jvp(_as_it_is, nondiff_argnums=(0,))
_cast.defjvp(_slopes)
