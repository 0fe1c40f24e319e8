"""Neighbor search among all solids of a model: on JAX, or on a GPU by Warp kernels with JAX's gradients."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.warp_functions import warp_function, warp_in_use
from usarmjx.engines.base import GeomPoses
from usarmjx.engines.planar.bodies import FixedBodies
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.neighbor_lists import (
    NeighborList,
    build_neighbor_list,
    ground_from_list,
    list_poses,
    max_displacement,
)
from usarmjx.engines.planar.proposed_motion import MovableSolids, ProposedMotion, movable_solids, pack_motion
from usarmjx.engines.planar.rolling import foot_positions
from usarmjx.engines.planar.solids import (
    PlanSolids,
    SolidGeoms,
    concatenate_solids,
    floor_height,
    ground_heights,
    world_solids,
)

SUBSET_DIVISOR = 8
"""Divisor of the number of worlds that gives the size of a subset."""

T = TypeVar("T")


def subset_size(worlds: int) -> int:
    """Return the number of worlds in a subset; 0: too few worlds for a subset to be faster."""
    return worlds // SUBSET_DIVISOR


def take_worlds(tree: T, places: Array) -> T:
    """Gather some worlds of all (worlds, ...); arbitrary values for indices past the end."""
    return jax.tree.map(lambda part: jnp.take(part, places, 0, mode="clip"), tree)


def scatter_worlds(tree: T, places: Array, new: T) -> T:
    """Scatter some worlds into all; indices past the end are dropped."""

    def write(old: Array, part: Array) -> Array:
        return jnp.asarray(old).at[places].set(part, mode="drop")

    return jax.tree.map(write, tree, new)


def masked_update(needed: Array, function: Callable[..., T], known: T, *args: Any) -> T:  # noqa: ANN401
    """Return known values, recomputed by a function in the worlds that need it.

    The result equals a computation in all worlds, except for XLA's rounding in another batch size.

    Args:
        needed: Mask of the worlds to recompute (worlds,).
        function: Function of many worlds, independent of each other.
        known: Known values, arrays like the function's result (worlds, ...).
        args: Its arguments, PyTrees of arrays (worlds, ...).
    """
    worlds = len(needed)
    few = subset_size(worlds)

    def in_all() -> T:
        def chosen(new: Array, old: Array) -> Array:
            return jnp.where(needed.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        return jax.tree.map(chosen, function(*args), known)

    def in_few() -> T:
        # Unused places index past the end: reads are clipped there, writes dropped.
        places = jnp.nonzero(needed, size=few, fill_value=worlds)[0]
        # The number of places is static, whatever the number of worlds in need: shapes must not depend on
        # data.
        return scatter_worlds(known, places, function(*take_worlds(args, places)))

    count = needed.sum()
    if not few:
        # Of a few worlds a subset would be empty.
        return jax.lax.cond(count > 0, in_all, lambda: known)
    # switch runs one branch only: nothing, a subset of the worlds, or all.
    which = (count > 0).astype(jnp.int32) + (count > few)
    return jax.lax.switch(which, [lambda: known, in_few, in_all])


@dataclass(frozen=True, eq=False)
class SceneSolids:
    """Solids of a model that robots can touch.

    Attributes:
        model: The model.
        fixed: Its bodies other than robots.
        movable: Its movable geoms.
        movable_set: These, as tested for motion.
        static_solids: Static solids.
        floor: Height of the floor [m].
        most: Length of the obstacle lists.
    """

    model: mujoco.MjModel
    fixed: FixedBodies
    movable: SolidGeoms
    movable_set: MovableSolids
    static_solids: PlanSolids
    floor: float
    most: int

    @property
    def count(self) -> int:
        """Number of solids."""
        return self.static_solids.count + len(self.movable.ids)

    def of_world(self, qpos: Array, poses: GeomPoses | None) -> PlanSolids:
        """Return the solids of one world; only the movable ones are recomputed."""
        if not len(self.movable.ids):
            return self.static_solids
        moved = world_solids(self.model, self.movable, self.fixed.poses(qpos), poses)
        return concatenate_solids(self.static_solids, moved)

    @cached_property
    def tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tables for the Warp kernels: kinds and shapes of movable solids, and the static solids."""
        from usarmjx.engines.planar.warp_solids import FIXED, FREE, HINGED

        geoms, fixed, model = self.movable, self.fixed, self.model
        hold = np.full(model.nbody, FIXED), np.zeros(model.nbody, int), np.zeros((model.nbody, 3))
        hold[0][fixed.free], hold[0][fixed.hinged] = FREE, HINGED
        # Places among the loose coordinates: seven of each free body, then one of each hinge.
        hold[1][fixed.free] = 7 * np.arange(len(fixed.free))
        hold[1][fixed.hinged] = 7 * len(fixed.free) + np.arange(len(fixed.hinged))
        hold[2][fixed.hinged] = fixed.axis
        data = geoms.moved >= 0
        rows = np.where(data, np.cumsum(data) - 1, -1)
        kinds = np.stack([geoms.kinds, geoms.moved, hold[0][geoms.bodies], hold[1][geoms.bodies], rows], -1)
        # In double precision on the host: a kernel would turn quaternions into matrices in every step.
        turn = np.zeros((len(geoms.ids), 9))
        for row, geom in zip(turn, geoms.ids.tolist(), strict=True):
            mujoco.mju_quat2Mat(row, model.geom_quat[geom])
        # In the order of `SHAPE_NUMBERS`: the native code reads these numbers by place.
        body = fixed.pos[geoms.bodies], fixed.mat[geoms.bodies].reshape(-1, 9), hold[2][geoms.bodies]
        geom = model.geom_pos[geoms.ids], turn, model.geom_size[geoms.ids]
        static_solids = np.stack([np.asarray(part) for part in jax.tree.leaves(self.static_solids)], -1)
        return kinds.astype(np.int32), np.concatenate([*body, *geom], -1).astype(np.float32), static_solids


def scene_solids(model: mujoco.MjModel, geoms: SolidGeoms, fixed: FixedBodies, most: int) -> SceneSolids:
    """Return the solids of a model.

    Args:
        model: The model.
        geoms: Its geoms that robots can touch.
        fixed: Its bodies other than robots.
        most: Length of the obstacle lists.
    """
    can_move = (geoms.moved >= 0) | np.isin(geoms.bodies, fixed.movable)
    movable, rest = geoms.where(can_move), partial(world_solids, model, geoms.where(~can_move), poses=None)
    return SceneSolids(
        model=model,
        fixed=fixed,
        movable=movable,
        movable_set=movable_solids(model, fixed, movable),
        static_solids=jax.jit(rest)(
            (jnp.float32(fixed.pos), jnp.float32(fixed.mat))
        ),  # one program, not eighty
        floor=floor_height(model),
        most=most,
    )


def invalid_neighbor_list(solids: SceneSolids, proposed: ProposedMotion) -> NeighborList:
    """Return invalid neighbor lists: zeros of the right shapes."""
    on_warp = _fits_on_warp(solids, proposed)
    shapes = jax.eval_shape(partial(_stored_form, solids, on_warp), proposed)
    return jax.tree.map(lambda one: jnp.zeros(one.shape, one.dtype), shapes)


def update_neighbors(solids: SceneSolids, known: NeighborList, proposed: ProposedMotion) -> NeighborList:
    """Return valid neighbor lists, rebuilt where robots may have come near other solids."""
    if not solids.count:
        return known
    return (update_neighbors_on_warp if _fits_on_warp(solids, proposed) else update_neighbors_on_jax)(
        solids, known, proposed
    )


def update_neighbors_on_jax(
    solids: SceneSolids, known: NeighborList, proposed: ProposedMotion
) -> NeighborList:
    """As `update_neighbors`, on JAX: rebuilds the lists of all robots of a world if one needs it."""
    reach, worlds = max_displacement(proposed.left, proposed.there), len(proposed.moves)
    stays_valid = known.stays_valid(
        list_poses(proposed.left, proposed.limit.max(1)), proposed.scene.loose, reach
    )
    then, now = known.scene.geoms, proposed.scene.geoms
    come_near = masked_update(
        stays_valid & (then != now).any((1, 2)),
        jax.vmap(solids.movable_set.moved_nearby),
        jnp.zeros(worlds, bool),
        *(then, now, proposed.left, reach.aside),
    )
    needed = jnp.logical_not(stays_valid) | come_near
    # Only rebuilt lists count what they omit, once and not in every step.
    known = known.replace(omitted=jnp.zeros_like(known.omitted))
    # The form of the kept list decides, and not the device: a list made in one form stays in it.
    on_warp = not isinstance(known.obstacles, PlanSolids)
    return masked_update(needed, partial(_stored_form, solids, on_warp), known, proposed)


def _stored_form(solids: SceneSolids, on_warp: bool, proposed: ProposedMotion) -> NeighborList:
    """As `search_neighbors`, packed for the Warp kernels if required."""
    found = search_neighbors(solids, proposed)
    return found.packed if on_warp else found


def search_neighbors(solids: SceneSolids, proposed: ProposedMotion) -> NeighborList:
    """Build the neighbor lists of all worlds."""
    reach = max_displacement(proposed.left, proposed.there)

    def of_world(proposed: ProposedMotion, reach: Any) -> NeighborList:  # noqa: ANN401 - a world's part of a margin
        here, limit = solids.of_world(proposed.qpos, proposed.poses), proposed.limit.max(0)
        return build_neighbor_list(
            proposed.left, limit, here, solids.floor, reach, proposed.scene, solids.most
        )

    return jax.vmap(of_world)(proposed, reach)


def ground_below_robots(
    solids: SceneSolids, neighbors: NeighborList, kept: Footprints, proposed: ProposedMotion
) -> Array:
    """Return the ground heights under the robots' resolved poses [m] (worlds, 4, robots)."""
    if not solids.count:
        return jnp.full(proposed.limit.shape, solids.floor)
    return (ground_on_warp if _fits_on_warp(solids, proposed) else ground_on_jax)(
        solids, neighbors, kept, proposed
    )


def ground_on_jax(
    solids: SceneSolids, neighbors: NeighborList, kept: Footprints, proposed: ProposedMotion
) -> Array:
    """As `ground_below_robots`, on JAX."""
    feet = jax.vmap(foot_positions)(kept)
    known = neighbors.ground_is_valid(list_poses(kept, proposed.limit.max(1))).all(-1)
    found = ground_from_list(neighbors.under, solids.floor, feet, proposed.limit)

    def everywhere(qpos: Array, poses: GeomPoses | None, feet: Array, limit: Array) -> Array:
        return ground_heights(solids.of_world(qpos, poses), solids.floor, feet, limit)

    args = proposed.qpos, proposed.poses, feet, proposed.limit
    return masked_update(jnp.logical_not(known), jax.vmap(everywhere), found, *args)


def _fits_on_warp(solids: SceneSolids, proposed: ProposedMotion) -> bool:
    """Return whether Warp is used: there are robots, and no more solids than a kernel has room for."""
    if not warp_in_use() or not proposed.moves.size:
        return False
    from usarmjx.engines.planar.warp_neighbor_search import solid_capacity

    return solid_capacity(solids.count) is not None


def update_neighbors_on_warp(
    solids: SceneSolids, known: NeighborList, proposed: ProposedMotion
) -> NeighborList:
    """As `update_neighbors`, on Warp: one launch, in which only robots with invalid lists search."""
    return _search_with_gradient(solids, known, proposed)


def ground_on_warp(
    solids: SceneSolids, neighbors: NeighborList, kept: Footprints, proposed: ProposedMotion
) -> Array:
    """As `ground_below_robots`, on Warp."""
    return _ground_with_gradient(solids, neighbors, kept, proposed)


def _launch_search(solids: SceneSolids, known: NeighborList, proposed: ProposedMotion) -> NeighborList:
    from usarmjx.engines.planar.warp_neighbor_search import scratch_numbers, solid_capacity, threads_for

    (worlds, robots), room = proposed.moves.shape, solid_capacity(solids.count)
    assert room is not None, "_fits_on_warp"
    threads = threads_for(robots, room)
    # Scratch memory is an argument: kernels of Warp cannot allocate any.
    scratch = jnp.zeros(max(worlds * scratch_numbers(room, threads), 1))
    kept = known.at, known.room, known.omitted, known.packed_obstacles, known.packed_ground
    kept = *kept, known.scene.loose, known.scene.geoms
    found = _search_kernel(solids.most, room, threads)(
        *(pack_motion(proposed), *_scene(solids, proposed), solids.floor),
        *(_flat(part) for part in kept),
        scratch,
        output_dims=1,
        launch_dims=worlds * threads,
    )
    # Empty arrays went in as one number (`_flat`), which is not taken back.
    at, margins, omitted, near, under, loose, geoms = (
        new.reshape(old.shape) if old.size else old for new, old in zip(found[:-1], kept, strict=True)
    )
    scene = known.scene.replace(loose=loose, geoms=geoms)
    return known.replace(
        at=at, room=margins, omitted=omitted, obstacles=near, ground_solids=under, scene=scene
    )


def _launch_ground(
    solids: SceneSolids, neighbors: NeighborList, kept: Footprints, proposed: ProposedMotion
) -> Array:
    worlds, robots = proposed.moves.shape
    places = jnp.concatenate([kept.pos, kept.yaw[..., None]], -1)
    found = _ground_kernel()(
        *(pack_motion(proposed), *_scene(solids, proposed), _flat(places)),
        *(_flat(part) for part in (neighbors.at, neighbors.room, neighbors.packed_ground)),
        solids.floor,
        output_dims=worlds * 4 * robots,
        launch_dims=worlds * robots,
    )
    return found[0].reshape(worlds, 4, robots)


def _flat(part: Array) -> Array:
    """Return the flattened array; one element for an empty array, as kernels take no empty arrays."""
    return jnp.asarray(part).reshape(-1) if part.size else jnp.zeros(1, part.dtype)


def _scene(solids: SceneSolids, proposed: ProposedMotion) -> tuple[Array, ...]:
    """Return the arguments about solids that both kernels take, see `warp_solids`."""
    (kinds, shapes, static_solids), poses = solids.tables, proposed.poses
    places, sized = (0, False) if poses is None else (poses.pos.shape[1], poses.size is not None)
    if poses is None:
        # No poses are inputs, so no geom is one: -1 as its index and as its row.
        kinds = kinds * [1, 0, 1, 1, 0] - [0, 1, 0, 0, 1]
        poses = GeomPoses(pos=jnp.zeros(1), quat=jnp.zeros(1))
    # Any array does where sizes are no inputs: `sized` tells the kernel not to read it.
    size = poses.pos if poses.size is None else poses.size
    data, loose = proposed.scene.geoms.shape[1], proposed.scene.loose
    # In the order of `warp_solids.SIZE_CODE`, which reads them by place.
    counts = (
        proposed.moves.shape[1],
        solids.static_solids.count,
        len(kinds),
        data,
        loose.shape[1],
        places,
        sized,
        len(proposed.moves),
    )
    return (
        *(jnp.asarray(counts, jnp.int32), _flat(kinds.astype(np.int32)), _flat(shapes)),
        *(
            _flat(jnp.asarray(part, jnp.float32))
            for part in (static_solids, loose, poses.pos, poses.quat, size)
        ),
    )


@warp_function
def _search_kernel(most: int, room: int, threads: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel that builds neighbor lists."""
    import warp as wp

    from usarmjx.engines.planar.warp_neighbor_search import IN_OUT_ARRAYS, search_kernel

    kernel = search_kernel(most, room, threads)
    return wp.jax_kernel(
        kernel, num_outputs=len(IN_OUT_ARRAYS), in_out_argnames=IN_OUT_ARRAYS, block_dim=threads
    )


@warp_function
def _ground_kernel() -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel that finds the ground."""
    # Here, as Warp belongs to an extra.
    import warp as wp

    from usarmjx.engines.planar.warp_neighbor_search import GROUND_THREADS, ground_under_robots

    return wp.jax_kernel(ground_under_robots, block_dim=GROUND_THREADS)


def _with_gradient_of(launched: Callable[..., Any], by_jax: Callable[..., Any]) -> Any:  # noqa: ANN401
    """Return a function computed by Warp with JAX's gradient; its first argument is static."""
    whole = cast(Any, jax.custom_jvp)(launched, nondiff_argnums=(0,))  # JAX leaves its types open

    def slopes(solids: SceneSolids, values: tuple[Any, ...], rates: tuple[Any, ...]) -> tuple[Any, Any]:
        return whole(solids, *values), jax.jvp(partial(by_jax, solids), values, rates)[1]

    whole.defjvp(slopes)
    return whole


_search_with_gradient = _with_gradient_of(_launch_search, update_neighbors_on_jax)
_ground_with_gradient = _with_gradient_of(_launch_ground, ground_on_jax)
