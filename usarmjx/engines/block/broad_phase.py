"""Broad phase of solver `block`: bounding boxes of robots, objects and solids before those of their geoms.

MuJoCo Warp tests every pair of geoms in every world. Here a group is a kinematic tree, or a solid that does
not move; a block of threads finds the groups' boxes of a world, and the pairs of geoms of groups whose boxes
overlap.
MuJoCo Warp's own test decides on each of these. Pairs that it alone would pass are too far apart to touch.
Pairs of each kind that the convex collider handles are listed one after another, behind all others: so the
threads of a warp have the same to do.
"""

from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

import mujoco
import numpy as np
import warp as wp

from usarmjx.engines.planar.warp_solids import expand_macros

wp.set_module_options({"enable_backward": False, "fast_math": False})

DRIVER = "mujoco.mjx.third_party.mujoco_warp._src.collision_driver"
"""Private; the version of MJX is pinned."""
FAR = wp.constant(1e6)
"""Half size of the box of a plane [m]."""
SLACK = wp.constant(1e-4)
"""Slack of the boxes for roundings [m]."""
ANY = -1
"""Group of pairs that are always tested: those with margins of their own, and those with planes."""
PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
THREADS = 128
"""Most threads of a block, which handles a world: whole warps."""
THREAD_PAIRS = 16
"""Pairs of groups for each thread of a block that has fewer."""
HELD_GROUPS = 512
"""Groups of a world that a GPU's shared memory has room for; more are in global memory."""
HELD_STEP = 128
"""Groups by which the room grows, so that few kernels are compiled."""
CONVEX_APART = True
"""Whether pairs of the convex collider are behind all others; to be compared."""


@dataclass(frozen=True)
class Table:
    """Pairs of geoms by pair of groups.

    Attributes:
        geoms: Geoms by group.
        first_geom: Index of the first geom of each group, and the number of geoms (groups + 1,).
        order: Indices in MuJoCo Warp's list of pairs.
        groups: Both groups of each pair of groups (n, 2); a pair of geoms that is always tested is alone.
        first_pair: Index in `order` of the first pair of each pair of groups, and the number of all (n + 1,).
        convex: Index of each kind of pairs of the convex collider by both types of geoms, the lower type
            first; -1: others (types, types).
    """

    geoms: np.ndarray
    first_geom: np.ndarray
    order: np.ndarray
    groups: np.ndarray
    first_pair: np.ndarray
    convex: np.ndarray


def make_table(model: mujoco.MjModel, pairs: np.ndarray, own: np.ndarray) -> Table:
    """Return the table of a model.

    Args:
        model: The model.
        pairs: MuJoCo Warp's list of pairs of geoms (pairs, 2).
        own: Which of them have settings of their own (pairs,).
    """
    tree = _trees_of_geoms(model)
    # Fixed geoms have no tree: each is a group of its own, or one box would span the arena.
    group = np.where(tree >= 0, tree, int(tree.max(initial=-1)) + 1 + np.arange(model.ngeom))
    used, place = np.unique(group, return_inverse=True)
    # Stable: geoms of a group stay in the order of their ids.
    geoms = np.argsort(place, kind="stable")
    first_geom = np.searchsorted(place[geoms], np.arange(len(used) + 1))
    pairs = pairs.reshape(-1, 2)
    kinds = np.sort(model.geom_type[pairs], axis=1)
    always = own | (kinds == PLANE).any(1)
    # Sorted, so that (a, b) and (b, a) are the same pair of groups.
    both = np.where(always[:, None], ANY, np.sort(place[pairs], axis=1))
    # A number of its own keeps each always-tested pair from being merged with others.
    alone = np.where(always, np.arange(len(pairs)), -1)
    groups, of_pair = np.unique(np.column_stack([both, alone]), axis=0, return_inverse=True)
    order = np.argsort(of_pair.ravel(), kind="stable")
    first_pair = np.searchsorted(of_pair.ravel()[order], np.arange(len(groups) + 1))
    return Table(geoms, first_geom, order, groups[:, :2].reshape(-1, 2), first_pair, _convex_kinds(kinds))


def _convex_kinds(kinds: np.ndarray) -> np.ndarray:
    """Return `Table.convex`, given both types of each pair of geoms."""
    table = import_module(DRIVER).MJ_COLLISION_TABLE
    convex = {tuple(map(int, types)) for types, how in table.items() if how.name == "CONVEX"}
    size = max([int(mujoco.mjtGeom.mjGEOM_MESH), *kinds.ravel().tolist()]) + 1
    found = np.full((size, size), -1)
    for k, types in enumerate(sorted(convex & {(int(a), int(b)) for a, b in kinds})):
        found[types] = k
    return found


def _trees_of_geoms(model: Any) -> np.ndarray:  # noqa: ANN401 - more of MuJoCo than its stubs have
    """Return the kinematic tree of each geom (ngeom,), -1 for what does not move."""
    return np.asarray(model.body_treeid)[model.geom_bodyid]


NEAR_CODE = """
#if defined(__CUDA_ARCH__)
    __shared__ float held[HELD_GROUPS * 6];
    __shared__ int found;
    const int lane = (int)threadIdx.x, lanes = THREADS, world = index / THREADS;
    const auto wait = []() { __syncthreads(); };
    const auto take = [](int* at) { return atomicAdd(at, 1); };
#else
    if (index % THREADS != 0) return 0;
    int found;
    const int lane = 0, lanes = 1, world = index / THREADS;
    const auto wait = []() {};
    const auto take = [](int* at) { return (*at)++; };
#endif
// Numbers of a world, of an array whose worlds may be alike.
#define ROW(name) ((const float*)name.data + \\
    (size_t)(world % name.shape[0]) * ((size_t)name.strides[0] / sizeof(float)))
    const int groups = first.shape[0] - 1, pairs = both.shape[0];
    float* box = (float*)boxes.data + (size_t)world * groups * 6;
#if defined(__CUDA_ARCH__)
    if (groups <= HELD_GROUPS) box = held;
#endif
    if (lane == 0) found = 0;
    const float* const shapes = ROW(aabb);
    const float* const radii = ROW(rbound);
    for (int group = lane; group < groups; group += lanes) {
        float low[3] = {FAR, FAR, FAR}, high[3] = {-FAR, -FAR, -FAR};
        for (int k = first.data[group]; k < first.data[group + 1]; ++k) {
            const int geom = geoms.data[k];
            const float* const turn = ROW(xmat) + 9 * geom;
            const float* const at = ROW(xpos) + 3 * geom;
            const float* const middle = shapes + 6 * geom;
            const bool bounded = radii[geom] > 0.0f;
            const float reach = ROW(margin)[geom] + ROW(gap)[geom] + SLACK;
            for (int i = 0; i < 3; ++i) {
                float center = at[i], side = bounded ? reach : FAR;
                if (bounded) {
                    for (int j = 0; j < 3; ++j) {
                        const float part = turn[3 * i + j];
                        center += part * middle[j];
                        side += (part < 0.0f ? -part : part) * middle[3 + j];
                    }
                }
                low[i] = center - side < low[i] ? center - side : low[i];
                high[i] = center + side > high[i] ? center + side : high[i];
            }
        }
        for (int i = 0; i < 3; ++i) {
            box[6 * group + i] = low[i];
            box[6 * group + 3 + i] = high[i];
        }
    }
    wait();
    for (int which = lane; which < pairs; which += lanes) {
        const int* const two = (const int*)both.data + 2 * which;
        bool near = true;
        if (two[0] >= 0) {
            const float* const one = box + 6 * two[0];
            const float* const other = box + 6 * two[1];
            for (int i = 0; i < 3; ++i) near = near && one[i] <= other[3 + i] && other[i] <= one[3 + i];
        }
        if (near) listed.data[(size_t)world * pairs + take(&found)] = which;
    }
    wait();
#undef ROW
    return found;
"""
"""Native code of a block of threads: lists the pairs of groups of a world whose boxes overlap, and returns
their number; on a CPU to the first thread alone."""


@cache
def near_groups(threads: int, held: int) -> tuple[Any, Any]:
    """Return two functions: one of `NEAR_CODE`, and one of how many threads share a world.

    Args:
        threads: Threads of a block.
        held: Groups that shared memory has room for.
    """
    words = {"HELD_GROUPS": held, "THREADS": threads, "FAR": f"{FAR}f", "SLACK": f"{SLACK}f"}

    @wp.func_native(expand_macros(NEAR_CODE, words))
    def find(  # noqa: PLR0913 - a kernel's arguments are its buffers
        aabb: wp.array3d[wp.vec3],
        rbound: wp.array2d[float],
        margin: wp.array2d[float],
        gap: wp.array2d[float],
        geoms: wp.array[int],
        first: wp.array[int],
        both: wp.array[wp.vec2i],
        xpos: wp.array2d[wp.vec3],
        xmat: wp.array2d[wp.mat33],
        boxes: wp.array[float],
        listed: wp.array[int],
        index: int,
    ) -> int: ...

    @wp.func_native(
        expand_macros(
            "#if defined(__CUDA_ARCH__)\n    return THREADS;\n#else\n    return 1;\n#endif\n",
            {"THREADS": threads},
        )
    )
    def sharing() -> int: ...

    return find, sharing


@cache
def pairs_function(*settings: int) -> Any:  # noqa: ANN401
    """Return the function that lists those pairs of geoms of a pair of groups that may touch.

    Args:
        settings: As of MuJoCo Warp's own test.
    """
    driver = import_module(DRIVER)
    near, add = driver._broadphase_filter(*settings), driver._add_geom_pair

    # fmt: off
    def list_pairs(  # noqa: PLR0913 - as above
        world: int, which: int,
        geom_type: wp.array[int], aabb: wp.array3d[wp.vec3], rbound: wp.array2d[float],
        margin: wp.array2d[float], gap: wp.array2d[float],
        own_margin: wp.array2d[float], own_gap: wp.array2d[float],
        pairs: wp.array[wp.vec2i], ids: wp.array[wp.vec2i],
        first: wp.array[int], order: wp.array[int],
        convex: wp.array2d[int], xpos: wp.array2d[wp.vec3], xmat: wp.array2d[wp.mat33],
        room: int, convex_room: int,
        count_out: wp.array[int], pair_out: wp.array[wp.vec2i], id_out: wp.array[wp.vec2i],
        world_out: wp.array[int], convex_count: wp.array[int], convex_pair: wp.array2d[wp.vec2i],
        convex_id: wp.array2d[wp.vec2i], convex_world: wp.array2d[int],
    ) -> None:
        # fmt: on
        for k in range(first[which], first[which + 1]):
            a, b, own_id = pairs[order[k]][0], pairs[order[k]][1], ids[order[k]]
            if own_id[1] >= 0 or near(
                aabb, rbound, margin, gap, own_margin, own_gap, xpos, xmat, a, b, own_id[0], world
            ):
                kinds = wp.vec2i(geom_type[a], geom_type[b])
                kind = convex[wp.min(kinds[0], kinds[1]), wp.max(kinds[0], kinds[1])]
                # Pairs that find no room in the list of their kind go to the common one, so that none is
                # lost.
                place = int(convex_room)
                if kind >= 0:
                    place = wp.atomic_add(convex_count, kind, 1)
                if place < convex_room:
                    # MuJoCo Warp's colliders take the geom of the lower type first.
                    pair = wp.vec2i(a, b)
                    if kinds[0] > kinds[1]:
                        pair = wp.vec2i(b, a)
                    convex_pair[kind, place] = pair
                    convex_id[kind, place] = own_id
                    convex_world[kind, place] = world
                else:
                    add(room, a, b, kinds[0], kinds[1], world, own_id, count_out, pair_out, id_out, world_out)

    return wp.func(list_pairs)


@cache
def worlds_kernel(threads: int, held: int, *settings: int) -> Any:  # noqa: ANN401
    """Return the kernel that lists pairs of geoms by a block of threads for each world.

    Args:
        threads: Threads of a block.
        held: Groups that shared memory has room for.
        settings: As of MuJoCo Warp's own test.
    """
    list_pairs, (find, sharing) = pairs_function(*settings), near_groups(threads, held)

    # fmt: off
    @wp.kernel(enable_backward=False, grid_stride=False, module="unique")
    def near_pairs_of_worlds(  # noqa: PLR0913 - as above
        geom_type: wp.array[int], aabb: wp.array3d[wp.vec3], rbound: wp.array2d[float],
        margin: wp.array2d[float], gap: wp.array2d[float],
        own_margin: wp.array2d[float], own_gap: wp.array2d[float],
        pairs: wp.array[wp.vec2i], ids: wp.array[wp.vec2i], groups: wp.array[wp.vec2i],
        first: wp.array[int], order: wp.array[int],
        convex: wp.array2d[int], xpos: wp.array2d[wp.vec3], xmat: wp.array2d[wp.mat33],
        room: int, convex_room: int,
        geoms: wp.array[int], first_geom: wp.array[int], boxes: wp.array[float], listed: wp.array[int],
        count_out: wp.array[int], pair_out: wp.array[wp.vec2i], id_out: wp.array[wp.vec2i],
        world_out: wp.array[int], convex_count: wp.array[int], convex_pair: wp.array2d[wp.vec2i],
        convex_id: wp.array2d[wp.vec2i], convex_world: wp.array2d[int],
    ) -> None:
        world, lane = wp.tid()
        count = find(
            aabb, rbound, margin, gap, geoms, first_geom, groups, xpos, xmat, boxes, listed,
            world * wp.static(threads) + lane,
        )
        for k in range(lane, count, sharing()):
            which = listed[world * groups.shape[0] + k]
            list_pairs(
                world, which, geom_type, aabb, rbound, margin, gap,
                own_margin, own_gap, pairs, ids, first, order, convex, xpos, xmat, room, convex_room,
                count_out, pair_out, id_out, world_out, convex_count, convex_pair, convex_id, convex_world,
            )
    # fmt: on

    return near_pairs_of_worlds


@wp.kernel(enable_backward=False, grid_stride=False)
def append_convex_pairs(  # noqa: PLR0913 - as above
    convex_count: wp.array[int],
    convex_pair: wp.array2d[wp.vec2i],
    convex_id: wp.array2d[wp.vec2i],
    convex_world: wp.array2d[int],
    room: int,
    count: wp.array[int],
    pair_out: wp.array[wp.vec2i],
    id_out: wp.array[wp.vec2i],
    world_out: wp.array[int],
) -> None:
    """Copy the pairs of each kind behind those that are listed; the list's length stays as it is."""
    kind, k = wp.tid()
    convex_room = convex_pair.shape[1]
    if k >= wp.min(convex_count[kind], convex_room):
        return
    # The list's length is only read here: another thread that raised it would move everybody's places.
    place = count[0] + k
    for before in range(kind):
        place += wp.min(convex_count[before], convex_room)
    if place < room:
        pair_out[place] = convex_pair[kind, k]
        id_out[place] = convex_id[kind, k]
        world_out[place] = convex_world[kind, k]


@wp.kernel(enable_backward=False, grid_stride=False)
def count_convex_pairs(convex_count: wp.array[int], convex_room: int, count: wp.array[int]) -> None:
    """Add the numbers of pairs of all kinds to the list's length."""
    for kind in range(convex_count.shape[0]):
        count[0] += wp.min(convex_count[kind], convex_room)


class BroadPhase:
    """Function in place of MuJoCo Warp's broad phase of all pairs.

    Args:
        table: Pairs of geoms of the model.
        device: Device of its arrays.

    Attributes:
        threads: Threads of a block, which handles a world.
    """

    def __init__(self, table: Table, device: Any = None) -> None:  # noqa: ANN401
        array: Any = wp.array

        def put(value: np.ndarray, kind: Any = int) -> Any:  # noqa: ANN401
            return array(np.ascontiguousarray(value, np.int32), dtype=kind, device=device)

        self._geoms, self._first_geom = put(table.geoms), put(table.first_geom)
        self._order, self._first_pair = put(table.order), put(table.first_pair)
        convex = table.convex if CONVEX_APART else np.full_like(table.convex, -1)
        self._pairs, self._convex = put(table.groups, wp.vec2i), put(convex)
        self.convex_kinds = int(convex.max()) + 1
        self.groups, self.group_pairs = len(table.first_geom) - 1, len(table.groups)
        self.threads, self._room = 32, HELD_STEP
        if wp.get_device(device).is_cuda:  # on a CPU one kernel serves all models
            # A world of one robot would leave most threads of a large block idle.
            warps = -(-self.group_pairs // (32 * THREAD_PAIRS))
            self.threads = 32 * min(max(1, warps), THREADS // 32)
            self._room = min(self.groups + -self.groups % HELD_STEP, HELD_GROUPS)

    def __call__(self, m: Any, d: Any, context: Any, awake: Any = None) -> None:  # noqa: ANN401
        """List the pairs of geoms that may touch, in MuJoCo Warp's arrays."""
        assert awake is None, "no sleeping trees, see `coverage`"
        shapes = [m.geom_aabb, m.geom_rbound, m.geom_margin, m.geom_gap]
        own, poses = [m.pair_margin, m.pair_gap], [d.geom_xpos, d.geom_xmat]
        settings = m.opt.broadphase_filter, *(array.shape[0] for array in shapes + own)
        lists = [m.nxn_geom_pair_filtered, m.nxn_pairid_filtered, self._pairs, self._first_pair, self._order]
        convex = self._convex_lists(d.naccdmax)
        found = [d.ncollision, context.collision_pair, context.collision_pairid, context.collision_worldid]
        inputs = [m.geom_type, *shapes, *own, *lists, self._convex, *poses, d.naconmax, d.naccdmax]
        held = self.groups <= HELD_GROUPS and d.qpos.device.is_cuda
        # One number where shared memory holds the boxes: the kernel takes an array all the same.
        boxes = wp.empty(1 if held else 6 * d.nworld * self.groups, dtype=float)
        listed = wp.empty(d.nworld * self.group_pairs, dtype=int)
        wp.launch(
            worlds_kernel(self.threads, self._room, *settings),
            dim=(d.nworld, self.threads),
            inputs=[*inputs, self._geoms, self._first_geom, boxes, listed],
            outputs=[*found, *convex],
            block_dim=self.threads,
        )
        if not self.convex_kinds:
            return
        wp.launch(
            append_convex_pairs,
            dim=(self.convex_kinds, d.naccdmax),
            inputs=[*convex, d.naconmax],
            outputs=found,
        )
        # A launch of its own after the copy, which reads the length that this one changes.
        wp.launch(count_convex_pairs, dim=1, inputs=[convex[0], d.naccdmax], outputs=[d.ncollision])

    def _convex_lists(self, room: int) -> list[Any]:
        """Return empty lists of the convex collider's pairs: how many, geoms, own settings, worlds."""
        kinds = max(1, self.convex_kinds)
        pair, own = (wp.empty((kinds, room), dtype=wp.vec2i) for _ in range(2))
        # Only the counts need zeros: entries beyond them are never read.
        return [wp.zeros(kinds, dtype=int), pair, own, wp.empty((kinds, room), dtype=int)]
