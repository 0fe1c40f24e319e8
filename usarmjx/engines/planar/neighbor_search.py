"""All solids of a model, and how robots look around among them: by JAX, or on a GPU by kernels of Warp.

These have JAX's slope.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.accelerator import warp_in_use
from usarmjx.base.arrays import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.engines.base import GeomPoses
from usarmjx.engines.planar.bodies import FixedBodies
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.movable import MovableSolids, movable_solids
from usarmjx.engines.planar.neighbor_lists import (
    NeighborList,
    farthest_in_a_step,
    ground_of,
    look_around,
    places_of,
)
from usarmjx.engines.planar.proposed_motion import ProposedMotion, rows_of
from usarmjx.engines.planar.rolling import feet_of
from usarmjx.engines.planar.solids import (
    PlanSolids,
    SolidGeoms,
    floor_height,
    ground_under,
    joined,
    solids_of,
)

FEW = 8
"""Few are at most one of so many worlds."""

T = TypeVar("T")


def few_of(worlds: int) -> int:
    """Return how many worlds are few; 0: there are too few in all for that to be less work."""
    return worlds // FEW


def picked(tree: T, places: Array) -> T:
    """Return some worlds of all (worlds, ...); anything at places beyond the last."""
    return jax.tree.map(lambda part: jnp.take(part, places, 0, mode="clip"), tree)


def put_back(tree: T, places: Array, new: T) -> T:
    """Return all worlds with some replaced; what is for places beyond the last is dropped."""

    def written(old: Array, part: Array) -> Array:
        return jnp.asarray(old).at[places].set(part, mode="drop")

    return jax.tree.map(written, tree, new)


def where_needed(needed: Array, function: Callable[..., T], known: T, *args: Any) -> T:  # noqa: ANN401
    """Return what is known, with what a function returns in worlds that need it.

    It is the same as if it were worked out in all, but for what XLA rounds otherwise in a smaller batch.

    Args:
        needed: Which worlds do (worlds,).
        function: Of many worlds, each by itself.
        known: Arrays like those that it returns (worlds, ...).
        args: Its arguments, PyTrees of arrays (worlds, ...).
    """
    worlds = len(needed)
    few = few_of(worlds)

    def in_all() -> T:
        def chosen(new: Array, old: Array) -> Array:
            return jnp.where(needed.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        return jax.tree.map(chosen, function(*args), known)

    def in_few() -> T:
        places = jnp.nonzero(needed, size=few, fill_value=worlds)[0]
        return put_back(known, places, function(*picked(args, places)))

    count = needed.sum()
    if not few:
        return jax.lax.cond(count > 0, in_all, lambda: known)
    which = (count > 0).astype(jnp.int32) + (count > few)
    return jax.lax.switch(which, [lambda: known, in_few, in_all])


@dataclass(frozen=True, eq=False)
class AllSolids:
    """The solids of a model that robots can meet.

    Attributes:
        model: The model.
        fixed: Its bodies that are no robot's.
        movable: Its geoms that can be elsewhere.
        elsewhere: These, as they are compared.
        still: The solids that are where they are.
        floor: Height of the floor [m].
        most: At so many solids a robot looks closely.
    """

    model: mujoco.MjModel
    fixed: FixedBodies
    movable: SolidGeoms
    elsewhere: MovableSolids
    still: PlanSolids
    floor: float
    most: int

    @property
    def count(self) -> int:
        """How many there are."""
        return self.still.count + len(self.movable.ids)

    def of_world(self, qpos: Array, poses: GeomPoses | None) -> PlanSolids:
        """Return the solids of one world: only those that may be elsewhere are worked out again."""
        if not len(self.movable.ids):
            return self.still
        moved = solids_of(self.model, self.movable, self.fixed.poses(qpos), poses)
        return joined(self.still, moved)

    @cached_property
    def tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What Warp's kernels are told: kinds and shapes of solids that can be elsewhere, and the others."""
        from usarmjx.engines.planar.warp_solids import FIXED, FREE, HINGED

        geoms, fixed, model = self.movable, self.fixed, self.model
        hold = np.full(model.nbody, FIXED), np.zeros(model.nbody, int), np.zeros((model.nbody, 3))
        hold[0][fixed.free], hold[0][fixed.hinged] = FREE, HINGED
        hold[1][fixed.free] = 7 * np.arange(len(fixed.free))
        hold[1][fixed.hinged] = 7 * len(fixed.free) + np.arange(len(fixed.hinged))
        hold[2][fixed.hinged] = fixed.axis
        data = geoms.moved >= 0
        rows = np.where(data, np.cumsum(data) - 1, -1)
        kinds = np.stack([geoms.kinds, geoms.moved, hold[0][geoms.bodies], hold[1][geoms.bodies], rows], -1)
        turn = np.zeros((len(geoms.ids), 9))
        for row, geom in zip(turn, geoms.ids.tolist(), strict=True):
            mujoco.mju_quat2Mat(row, model.geom_quat[geom])
        body = fixed.pos[geoms.bodies], fixed.mat[geoms.bodies].reshape(-1, 9), hold[2][geoms.bodies]
        geom = model.geom_pos[geoms.ids], turn, model.geom_size[geoms.ids]
        still = np.stack([np.asarray(part) for part in jax.tree.leaves(self.still)], -1)
        return kinds.astype(np.int32), np.concatenate([*body, *geom], -1).astype(np.float32), still


def all_solids(model: mujoco.MjModel, geoms: SolidGeoms, fixed: FixedBodies, most: int) -> AllSolids:
    """Return the solids of a model.

    Args:
        model: The model.
        geoms: Those of its geoms that robots can meet.
        fixed: Its bodies that are no robot's.
        most: At so many solids a robot looks closely.
    """
    can_move = (geoms.moved >= 0) | np.isin(geoms.bodies, fixed.movable)
    movable, rest = geoms.where(can_move), partial(solids_of, model, geoms.where(~can_move), poses=None)
    return AllSolids(
        model=model,
        fixed=fixed,
        movable=movable,
        elsewhere=movable_solids(model, fixed, movable),
        still=jax.jit(rest)((jnp.float32(fixed.pos), jnp.float32(fixed.mat))),  # one program, not eighty
        floor=floor_height(model),
        most=most,
    )


def nothing_known(solids: AllSolids, aims: ProposedMotion) -> NeighborList:
    """Return zeros of the shapes of what is around robots: nothing is known."""
    on_warp = _fits_on_warp(solids, aims)
    shapes = jax.eval_shape(partial(_as_it_is_kept, solids, on_warp), aims)
    return jax.tree.map(lambda one: jnp.zeros(one.shape, one.dtype), shapes)


def around_robots(solids: AllSolids, known: NeighborList, aims: ProposedMotion) -> NeighborList:
    """Return what is around all robots, looked up anew where some may have come to what was far away."""
    if not solids.count:
        return known
    return (around_on_warp if _fits_on_warp(solids, aims) else around_by_jax)(solids, known, aims)


def around_by_jax(solids: AllSolids, known: NeighborList, aims: ProposedMotion) -> NeighborList:
    """As `around_robots`, by JAX: all robots of a world that needs it look."""
    reach, worlds = farthest_in_a_step(aims.left, aims.there), len(aims.moves)
    holds = known.holds(places_of(aims.left, aims.limit.max(1)), aims.scene.loose, reach)
    then, now = known.scene.geoms, aims.scene.geoms
    come_near = where_needed(
        holds & (then != now).any((1, 2)),
        jax.vmap(solids.elsewhere.came_near),
        jnp.zeros(worlds, bool),
        *(then, now, aims.left, reach.aside),
    )
    needed = jnp.logical_not(holds) | come_near
    known = known.replace(left_out=jnp.zeros_like(known.left_out))
    on_warp = not isinstance(known.near_solids, PlanSolids)
    return where_needed(needed, partial(_as_it_is_kept, solids, on_warp), known, aims)


def _as_it_is_kept(solids: AllSolids, on_warp: bool, aims: ProposedMotion) -> NeighborList:
    """As `looked_up`, as Warp's kernels keep it or not."""
    found = looked_up(solids, aims)
    return found.packed if on_warp else found


def looked_up(solids: AllSolids, aims: ProposedMotion) -> NeighborList:
    """Look up what is around the robots of all worlds."""
    reach = farthest_in_a_step(aims.left, aims.there)

    def of_world(aims: ProposedMotion, reach: Any) -> NeighborList:  # noqa: ANN401 - a world's part of a margin
        here, limit = solids.of_world(aims.qpos, aims.poses), aims.limit.max(0)
        return look_around(aims.left, limit, here, solids.floor, reach, aims.scene, solids.most)

    return jax.vmap(of_world)(aims, reach)


def ground_below(solids: AllSolids, around: NeighborList, kept: Footprints, aims: ProposedMotion) -> Array:
    """Return how high the ground is under robots where they came to [m] (worlds, 4, robots)."""
    if not solids.count:
        return jnp.full(aims.limit.shape, solids.floor)
    return (ground_on_warp if _fits_on_warp(solids, aims) else ground_by_jax)(solids, around, kept, aims)


def ground_by_jax(solids: AllSolids, around: NeighborList, kept: Footprints, aims: ProposedMotion) -> Array:
    """As `ground_below`, by JAX."""
    feet = jax.vmap(feet_of)(kept)
    known = around.knows_ground(places_of(kept, aims.limit.max(1))).all(-1)
    found = ground_of(around.under, solids.floor, feet, aims.limit)

    def everywhere(qpos: Array, poses: GeomPoses | None, feet: Array, limit: Array) -> Array:
        return ground_under(solids.of_world(qpos, poses), solids.floor, feet, limit)

    args = aims.qpos, aims.poses, feet, aims.limit
    return where_needed(jnp.logical_not(known), jax.vmap(everywhere), found, *args)


def _fits_on_warp(solids: AllSolids, aims: ProposedMotion) -> bool:
    """Return whether they are for Warp here: some robots, and as many solids as it has room for."""
    if not warp_in_use() or not aims.moves.size:
        return False
    from usarmjx.engines.planar.warp_neighbor_search import room_for

    return room_for(solids.count) is not None


def around_on_warp(solids: AllSolids, known: NeighborList, aims: ProposedMotion) -> NeighborList:
    """As `around_robots`, on Warp: one launch, in which only those robots look that need it."""
    return _around_with_slope(solids, known, aims)


def ground_on_warp(solids: AllSolids, around: NeighborList, kept: Footprints, aims: ProposedMotion) -> Array:
    """As `ground_below`, on Warp."""
    return _ground_with_slope(solids, around, kept, aims)


def _launch_look(solids: AllSolids, known: NeighborList, aims: ProposedMotion) -> NeighborList:
    from usarmjx.engines.planar.warp_neighbor_search import GROUND_THREADS, room_for

    worlds, room = len(aims.moves), room_for(solids.count)
    kept = known.at, known.room, known.left_out, known.near_numbers, known.under_numbers
    kept = *kept, known.scene.loose, known.scene.geoms
    found = _looking(solids.most, room)(
        *(rows_of(aims), *_scene(solids, aims), solids.floor),
        *(_flat(part) for part in kept),
        output_dims=1,
        launch_dims=worlds * GROUND_THREADS,
    )
    at, margins, left_out, near, under, loose, geoms = (
        new.reshape(old.shape) if old.size else old for new, old in zip(found, kept, strict=True)
    )
    scene = known.scene.replace(loose=loose, geoms=geoms)
    return known.replace(
        at=at, room=margins, left_out=left_out, near_solids=near, under_solids=under, scene=scene
    )


def _launch_ground(solids: AllSolids, around: NeighborList, kept: Footprints, aims: ProposedMotion) -> Array:
    worlds, robots = aims.moves.shape
    places = jnp.concatenate([kept.pos, kept.yaw[..., None]], -1)
    found = _grounding()(
        *(rows_of(aims), *_scene(solids, aims), _flat(places)),
        *(_flat(part) for part in (around.at, around.room, around.under_numbers)),
        solids.floor,
        output_dims=worlds * 4 * robots,
        launch_dims=worlds * robots,
    )
    return found[0].reshape(worlds, 4, robots)


def _flat(part: Array) -> Array:
    """Return all numbers of an array; one where there are none, as kernels have no empty arrays."""
    return jnp.asarray(part).reshape(-1) if part.size else jnp.zeros(1, part.dtype)


def _scene(solids: AllSolids, aims: ProposedMotion) -> tuple[Array, ...]:
    """Return what both kernels are told of solids, see `warp_solids`."""
    (kinds, shapes, still), poses = solids.tables, aims.poses
    places, sized = (0, False) if poses is None else (poses.pos.shape[1], poses.size is not None)
    if poses is None:
        kinds = kinds * [1, 0, 1, 1, 0] - [0, 1, 0, 0, 1]
        poses = GeomPoses(pos=jnp.zeros(1), quat=jnp.zeros(1))
    size = poses.pos if poses.size is None else poses.size
    data, loose = aims.scene.geoms.shape[1], aims.scene.loose
    counts = (
        aims.moves.shape[1],
        solids.still.count,
        len(kinds),
        data,
        loose.shape[1],
        places,
        sized,
        len(aims.moves),
    )
    return (
        *(jnp.asarray(counts, jnp.int32), _flat(kinds.astype(np.int32)), _flat(shapes)),
        *(_flat(jnp.asarray(part, jnp.float32)) for part in (still, loose, poses.pos, poses.quat, size)),
    )


@warp_function
def _looking(most: int, room: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return what launches the kernel that looks around."""
    import warp as wp

    from usarmjx.engines.planar.warp_neighbor_search import CHANGED, GROUND_THREADS, looking_kernel

    kernel = looking_kernel(most, room)
    return wp.jax_kernel(kernel, num_outputs=len(CHANGED), in_out_argnames=CHANGED, block_dim=GROUND_THREADS)


@warp_function
def _grounding() -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return what launches the kernel that finds the ground."""
    import warp as wp

    from usarmjx.engines.planar.warp_neighbor_search import GROUND_THREADS, ground_under_robots

    return wp.jax_kernel(ground_under_robots, block_dim=GROUND_THREADS)


def _with_slope_of(launched: Callable[..., Any], by_jax: Callable[..., Any]) -> Any:  # noqa: ANN401
    """Return a function that is worked out by Warp and has JAX's slope; its first argument is no array."""
    whole = cast(Any, jax.custom_jvp)(launched, nondiff_argnums=(0,))  # JAX leaves its types open

    def slopes(solids: AllSolids, values: tuple[Any, ...], rates: tuple[Any, ...]) -> tuple[Any, Any]:
        return whole(solids, *values), jax.jvp(partial(by_jax, solids), values, rates)[1]

    whole.defjvp(slopes)
    return whole


_around_with_slope = _with_slope_of(_launch_look, around_by_jax)
_ground_with_slope = _with_slope_of(_launch_ground, ground_by_jax)
