"""Warp kernels of the neighbor search: lists of near solids, and ground heights.

A block of threads handles one world: it finds the robots whose lists are invalid, and only if there are any
computes the movable solids; then its warps handle some of those robots each, its lanes some solids. On a CPU,
in tests, the first thread handles the whole world. The steps are those of `neighbor_lists`, `proposed_motion`
and `solids`, except that robots with valid lists keep them.
"""

from functools import cache
from typing import Any

import warp as wp

from usarmjx.engines.planar import neighbor_lists
from usarmjx.engines.planar.rolling import STANCE
from usarmjx.engines.planar.warp_solids import scene_code

wp.set_module_options({"enable_backward": False, "fast_math": False})

GROUND_THREADS = 128
"""Threads of a block of the ground kernel."""
THREADS = 128
"""Most threads of a block, which handles one world: a warp for each robot."""
WIDE_THREADS = 512
"""The same where solids are in global memory.

Shared memory has no room for the keys of more warps; without it, large teams of few worlds would leave most
of a GPU idle while all robots of a world search, after a reset.
"""
IN_OUT_ARRAYS = ("at", "room", "omitted", "near", "under", "known_loose", "known_geoms", "scratch")
"""Outputs that the search kernel changes in place."""
SHARED_CAPACITIES = (64, 128, 256, 416, 600)
"""Capacities for solids in shared memory; the smallest sufficient one is used."""
GLOBAL_CAPACITIES = (1024, 2048, 4096, 8192)
"""Capacities for solids in global memory, where shared memory does not suffice."""

GROUND_CODE = """
#if defined(__CUDA_ARCH__)
    const unsigned together = __activemask();
#endif
    struct Stance { float x, y, c, s, length, width, limits[4]; };
    const int own = world, r = (int)((unsigned)index % (unsigned)count);
    const float* const went = kept.data + (size_t)index * 3;
    const float* const was = at.data + (size_t)index * 4;
    const float* const free = room.data + (size_t)index * 4;
    const Stance mine = {
        went[0], went[1], cos(went[2]), sin(went[2]),
        STANCE * input(r, FIELD_LENGTH), STANCE * input(r, FIELD_WIDTH),
        {input(r, FIELD_LIMIT_0), input(r, FIELD_LIMIT_1), input(r, FIELD_LIMIT_2), input(r, FIELD_LIMIT_3)},
    };
    const float dx = mine.x - was[0], dy = mine.y - was[1];
    const float limit = max(max(mine.limits[0], mine.limits[1]), max(mine.limits[2], mine.limits[3]));
    const bool knows = free[2] > sqrt(dx * dx + dy * dy) && free[3] > abs(limit - was[3]);
    const auto stand_on = [&](const Stance& a, const Solid& o, float* most) {
        for (int j = 0; j < 4; ++j) {
            const float ahead = j < 2 ? a.length : -a.length, left = j == 0 || j == 3 ? a.width : -a.width;
            const float foot_x = a.x + (ahead * a.c - left * a.s), foot_y = a.y + (ahead * a.s + left * a.c);
            most[j] = max(most[j], top_under(o, foot_x, foot_y, a.limits[j]));
        }
    };
    const int solids = fixed + others;
    const auto solid = [&](int i) -> Solid {
        if (i >= fixed) return moved(i - fixed);
        const float* const q = static_solids.data + 12 * i;
        return {q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7], q[8], q[9], q[10], q[11]};
    };
    float found[4] = {floor, floor, floor, floor};
    if (knows) {
        const int layers = min(solids, GROUND_LIST_LENGTH);
        const float* const rows = under.data + (size_t)world * 12 * layers * count + r;
        const auto number = [&](int i, int k) { return rows[((size_t)i * layers + k) * count]; };
        for (int k = 0; k < layers; ++k)
            stand_on(mine, {number(0, k), number(1, k), number(2, k), number(3, k), number(4, k),
                            number(5, k), number(6, k), number(7, k), number(8, k), number(9, k),
                            number(10, k), number(11, k)}, found);
    }
#if defined(__CUDA_ARCH__)
    // A thread of the warp that must search all solids is helped by the others, which take some each.
    const int lane = (int)(threadIdx.x % 32u), helpers = __popc(together);
    const int place = __popc(together & ((1u << lane) - 1u));
    for (unsigned left = __ballot_sync(together, !knows); left != 0u; left &= left - 1u) {
        const int who = __ffs((int)left) - 1;
        const auto its = [&](auto value) { return __shfl_sync(together, value, who); };
        const auto its_limit = [&](int j) { return its(mine.limits[j]); };
        const Stance a = {its(mine.x), its(mine.y), its(mine.c), its(mine.s), its(mine.length),
                          its(mine.width), {its_limit(0), its_limit(1), its_limit(2), its_limit(3)}};
        world = its(own);
        float most[4] = {floor, floor, floor, floor};
        for (int i = place; i < solids; i += helpers) stand_on(a, solid(i), most);
        for (unsigned one = together; one != 0u; one &= one - 1u)
            for (int j = 0; j < 4; ++j) {
                const float other = __shfl_sync(together, most[j], __ffs((int)one) - 1);
                if (lane == who) found[j] = max(found[j], other);
            }
    }
#else
    for (int i = 0; i < solids && !knows; ++i) stand_on(mine, solid(i), found);
#endif
    for (int j = 0; j < 4; ++j) ground.data[((size_t)own * 4 + j) * count + r] = found[j];
"""
"""Native code of a robot's thread: `neighbor_lists.ground_from_list`, or `solids.ground_heights` for an
invalid list."""


ROBOT_CODE = """
    int world = (int)((unsigned)index / (unsigned)sizes.data[0]);  // that of which solids are asked
"""
MACROS = {"STANCE": f"{STANCE}f"}


@wp.func_native(scene_code(ROBOT_CODE, GROUND_CODE, MACROS))
def _ground_under_robot(
    robots: wp.array[float],
    sizes: wp.array[int],
    kinds: wp.array[int],
    shapes: wp.array[float],
    static_solids: wp.array[float],
    loose: wp.array[float],
    geom_pos: wp.array[float],
    geom_quat: wp.array[float],
    geom_size: wp.array[float],
    kept: wp.array[float],
    at: wp.array[float],
    room: wp.array[float],
    under: wp.array[float],
    floor: float,
    index: int,
    ground: wp.array[float],
) -> None: ...


@wp.kernel(enable_backward=False, grid_stride=False)
def ground_under_robots(
    robots: wp.array[float],
    sizes: wp.array[int],
    kinds: wp.array[int],
    shapes: wp.array[float],
    static_solids: wp.array[float],
    loose: wp.array[float],
    geom_pos: wp.array[float],
    geom_quat: wp.array[float],
    geom_size: wp.array[float],
    kept: wp.array[float],
    at: wp.array[float],
    room: wp.array[float],
    under: wp.array[float],
    floor: float,
    ground: wp.array[float],
) -> None:
    """Find the ground heights under the four feet of each robot."""
    # fmt: off
    _ground_under_robot(
        robots, sizes, kinds, shapes, static_solids, loose, geom_pos, geom_quat, geom_size, kept, at, room,
        under, floor, wp.tid(), ground,
    )
    # fmt: on


SEARCH_CODE = """
#if defined(__CUDA_ARCH__)
    const int thread = (int)((unsigned)index % THREADS);
    const int lane = thread % 32, lanes = 32, warp = thread / 32, warps = THREADS / 32;
#if IN_GLOBAL_MEMORY
    Solid* const here = reinterpret_cast<Solid*>(scratch.data + (size_t)world * SCRATCH_NUMBERS);
    int* const held_keys = reinterpret_cast<int*>(here + ROOM);
#else
    __shared__ Solid here[ROOM];
    __shared__ int held_keys[THREADS / 32 * ROOM * 2];
#endif
    int* const near_keys = held_keys + warp * ROOM * 2;
    const auto wait = []() { __syncwarp(); };
    const auto wait_for_all = []() { __syncthreads(); };
    const auto any_of_all = [](bool x) { return __syncthreads_or(x) != 0; };
    const auto any = [](bool x) { return __any_sync(0xffffffffu, x) != 0; };
    const auto least = [](auto x) {
        for (int step = 16; step > 0; step /= 2) x = min(x, __shfl_xor_sync(0xffffffffu, x, step));
        return x;
    };
    const auto sum = [](int x) {
        for (int step = 16; step > 0; step /= 2) x += __shfl_xor_sync(0xffffffffu, x, step);
        return x;
    };
#else
    if ((unsigned)index % THREADS != 0) return;
    const int thread = 0, lane = 0, lanes = 1, warp = 0, warps = 1;
    Solid here[ROOM];
    int near_keys[2 * ROOM];
    const auto wait = []() {};
    const auto wait_for_all = []() {};
    const auto any_of_all = [](bool x) { return x; };
    const auto any = [](bool x) { return x; };
    const auto least = [](auto x) { return x; };
    const auto sum = [](int x) { return x; };
#endif
    const int threads = lanes * warps;
    int* const ground_keys = near_keys + ROOM;
    float* const was = at.data + (size_t)world * count * 4;
    float* const free = room.data + (size_t)world * count * 4;
    const auto limit_of = [&](int r) {
        return max(max(input(r, FIELD_LIMIT_0), input(r, FIELD_LIMIT_1)),
                   max(input(r, FIELD_LIMIT_2), input(r, FIELD_LIMIT_3)));
    };
    const auto size_of = [&](int r) {
        const float length = input(r, FIELD_LENGTH), width = input(r, FIELD_WIDTH);
        return sqrt(length * length + width * width);
    };

    // neighbor_lists.max_displacement
    const auto way_of = [&](int r) {
        const float x = input(r, FIELD_THERE_X) - input(r, FIELD_BEFORE_X);
        const float y = input(r, FIELD_THERE_Y) - input(r, FIELD_BEFORE_Y);
        return sqrt(x * x + y * y);
    };
    const auto up_of = [&](int r) {
        return max(input(r, FIELD_BEFORE_LOW) - input(r, FIELD_THERE_LOW),
                   input(r, FIELD_THERE_HIGH) - input(r, FIELD_BEFORE_HIGH));
    };
    float farthest = 0.0f;
    for (int r = lane; r < count; r += lanes) farthest = max(farthest, way_of(r));
    farthest = -least(-farthest);

    // NeighborList.lists_stay_valid, of one robot
    const auto is_lost = [&](int r) -> bool {
        const float x = input(r, FIELD_BEFORE_X) - was[4 * r], y = input(r, FIELD_BEFORE_Y) - was[4 * r + 1];
        const float aside = sqrt(x * x + y * y) + (way_of(r) + farthest + SEPARATION_SLACK), up = up_of(r);
        const float sank = abs(input(r, FIELD_BEFORE_LOW) - was[4 * r + 2]) + up;
        const float tilted = abs(limit_of(r) - was[4 * r + 3]) + up;
        return !(free[4 * r] > aside && free[4 * r + 1] > sank && free[4 * r + 2] > aside
            && free[4 * r + 3] > tilted);
    };
    bool lost = false;
    for (int r = lane; r < count; r += lanes) lost = lost || is_lost(r);
    lost = any(lost);
    float* const loose_was = known_loose.data + (size_t)world * numbers;
    const float* const loose_now = loose.data + (size_t)world * numbers;
    bool other_world = false;
    for (int i = thread; i < numbers; i += threads)
        other_world = other_world || !(loose_was[i] == loose_now[i]);

    // MovableSolids.placement, moved_nearby
    float* const geoms_were = known_geoms.data + (size_t)world * data_geoms * 10;
    const auto row_of = [&](int m) { return kinds.data[m * KIND_NUMBERS + 4]; };
    const auto geom_now = [&](int m, int i) -> float {
        const size_t place = (size_t)world * places + kinds.data[m * KIND_NUMBERS + 1];
        if (i < 3) return geom_pos.data[3 * place + i];
        if (i < 7) return geom_quat.data[4 * place + i - 3];
        return sized ? geom_size.data[3 * place + i - 7] : shapes.data[m * SHAPE_NUMBERS + 20 + i];
    };
    const auto meets = [&](int m, const float* ten) -> bool {
        const float* const p = shapes.data + m * SHAPE_NUMBERS;
        const float x = p[0] + (p[3] * ten[0] + p[4] * ten[1] + p[5] * ten[2]);
        const float y = p[1] + (p[6] * ten[0] + p[7] * ten[1] + p[8] * ten[2]);
        for (int r = 0; r < count; ++r) {
            const float far =
                size_of(r) + (way_of(r) + farthest + SEPARATION_SLACK) + (ten[7] + ten[8] + ten[9]);
            const float dx = input(r, FIELD_BEFORE_X) - x, dy = input(r, FIELD_BEFORE_Y) - y;
            if (dx * dx + dy * dy < far * far) return true;
        }
        return false;
    };
    for (int m = thread; m < others && !other_world; m += threads) {
        if (row_of(m) < 0) continue;
        const float* const then = geoms_were + row_of(m) * 10;
        float now[10];
        bool other = false;
        for (int i = 0; i < 10; ++i) {
            now[i] = geom_now(m, i);
            other = other || now[i] != then[i];
        }
        // `scene` is shared by all robots: one that searches with moved solids makes all of them search.
        other_world = other && (lost || meets(m, then) || meets(m, now));
    }
    other_world = any_of_all(other_world);
    for (int r = thread; r < count; r += threads) omitted.data[(size_t)world * count + r] = 0;
    if (!lost && !other_world) return;

    for (int i = thread; i < numbers; i += threads) loose_was[i] = loose_now[i];
    for (int m = thread; m < others; m += threads) {
        here[m] = moved(m);
        if (row_of(m) >= 0)
            for (int i = 0; i < 10; ++i) geoms_were[row_of(m) * 10 + i] = geom_now(m, i);
    }
    wait_for_all();
    const int solids = fixed + others;
    const auto number_of = [&](int i, int n) -> float {
        return i < fixed ? static_solids.data[12 * i + n]
                         : reinterpret_cast<const float*>(here + (i - fixed))[n];
    };
    const auto solid = [&](int i) -> Solid {
        if (i >= fixed) return here[i - fixed];
        const float* const p = static_solids.data + 12 * i;
        return {p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11]};
    };
    const float last_step = (float)(1073741824 / solids - 1);
    const auto key_of = [&](float rank, int i) -> int {
        return (int)min(max((rank + MAX_RANKED_DEPTH) / RANK_RESOLUTION, 0.0f), last_step) * solids + i;
    };
    for (int r = warp; r < count; r += warps) {
        if (!other_world && !is_lost(r)) continue;
        wait();  // until all lanes have asked
        const float x = input(r, FIELD_BEFORE_X), y = input(r, FIELD_BEFORE_Y), step = input(r, FIELD_STEP);
        const float low = input(r, FIELD_BEFORE_LOW), high = input(r, FIELD_BEFORE_HIGH);
        const float limit = limit_of(r), size = size_of(r);
        const float aside_reach = way_of(r) + farthest + SEPARATION_SLACK, up_reach = up_of(r);
        // neighbor_lists.build_neighbor_list: horizontal, vertical and ground distances
        float apart, higher, deep, steep;
        const auto measure = [&](const Solid& o) {
            const float dx = x - o.x, dy = y - o.y;
            const float ahead = max(abs(dx * o.c + dy * o.s) - o.l, 0.0f);
            const float aside = max(abs(dy * o.c - dx * o.s) - o.w, 0.0f);
            apart = sqrt(ahead * ahead + aside * aside) - o.r - size;
            higher = height_apart(o, x, y, low, high, step);
            steep = abs(o.slope_x) + abs(o.slope_y);
            deep = o.top + dx * o.slope_x + dy * o.slope_y - size * steep - limit;
        };
        int stopping = 0;
        for (int i = lane; i < solids; i += lanes) {
            const Solid o = solid(i);
            measure(o);
            stopping += higher < 0.0f && apart < aside_reach;
            near_keys[i] = key_of(higher < 0.0f ? apart : max(apart, higher) + OTHER_HEIGHT_RANK, i);
            ground_keys[i] = key_of(o.highest < floor ? FAR_AWAY : max(apart, deep), i);
        }
        stopping = sum(stopping);

        // neighbor_lists._first_by_rank: repeated minimum above the last one, then index order
        const auto keep = [&](const int* keys, int most, float* rows) -> int {
            int chosen[MOST], last = -1;
            for (int j = 0; j < most; ++j) {
                int next = 0x7fffffff;
                for (int i = lane; i < solids; i += lanes) next = keys[i] > last ? min(next, keys[i]) : next;
                last = least(next);
                chosen[j] = last % solids;
            }
            for (int j = 0; j < most; ++j) {
                int place = 0;
                for (int i = 0; i < most; ++i) place += chosen[i] < chosen[j];
                for (int n = lane; n < 12; n += lanes)
                    rows[((size_t)n * most + place) * count + r] = number_of(chosen[j], n);
            }
            return last;
        };
        const int near_count = min(solids, MOST), under_count = min(solids, GROUND_LIST_LENGTH);
        float* const near_rows = near.data + (size_t)world * 12 * near_count * count;
        float* const under_rows = under.data + (size_t)world * 12 * under_count * count;
        const int near_last = keep(near_keys, near_count, near_rows);
        const int under_last = keep(ground_keys, under_count, under_rows);

        // neighbor_lists._margin, of what may stop it and of what may be ground
        float aside[2] = {FAR_AWAY, FAR_AWAY}, height[2] = {FAR_AWAY, FAR_AWAY};
        for (int pass = 0; pass < 2; ++pass) {
            for (int i = lane; i < solids; i += lanes) {
                const Solid o = solid(i);
                measure(o);
                for (int n = 0; n < 2; ++n) {
                    const bool other = n == 0 ? near_keys[i] > near_last
                                              : ground_keys[i] > under_last && o.highest >= floor;
                    if (!other) continue;
                    const float up = n == 0 ? higher : deep;
                    const bool by_height = apart * (up_reach + HEIGHT_SLACK) < up * aside_reach;
                    const float until = by_height ? max(apart, up / (2.0f * max(steep, 1e-6f))) : apart;
                    if (pass == 0)
                        aside[n] = min(aside[n], until);
                    else if (by_height && apart < aside[n])
                        height[n] = min(height[n], steep > 0.0f ? up / 2.0f : up);
                }
            }
            for (int n = 0; n < 2; ++n) {
                if (pass == 0) aside[n] = least(aside[n]);
                else height[n] = least(height[n]);
            }
        }
        if (lane == 0) {
            was[4 * r] = x; was[4 * r + 1] = y; was[4 * r + 2] = low; was[4 * r + 3] = limit;
            for (int n = 0; n < 2; ++n) {
                free[4 * r + 2 * n] = aside[n];
                free[4 * r + 2 * n + 1] = height[n];
            }
            omitted.data[(size_t)world * count + r] = max(stopping - MOST, 0);
        }
    }
"""
"""Native code of a world's block: `neighbor_lists.build_neighbor_list` for robots with invalid lists."""

WORLD_CODE = """
    const int world = (int)((unsigned)index / THREADS);
"""


def threads_for(robots: int, capacity: int) -> int:
    """Return the threads of a block for some robots and a capacity for solids: no warp without a robot."""
    return min(32 * max(robots, 1), THREADS if capacity in SHARED_CAPACITIES else WIDE_THREADS)


def _code(most: int, room: int, threads: int = THREADS) -> str:
    """Return the native code for lists of `most` solids, with room for `room` solids, of a block."""
    measures = (
        "SEPARATION_SLACK",
        "HEIGHT_SLACK",
        "MAX_RANKED_DEPTH",
        "RANK_RESOLUTION",
        "OTHER_HEIGHT_RANK",
    )
    # With an f: a literal without it would make C++ compute in double precision.
    words: dict[str, object] = {name: f"{getattr(neighbor_lists, name)}f" for name in measures}
    words |= {"MOST": most, "ROOM": room, "THREADS": f"{threads}u"}
    scratch = scratch_numbers(room, threads)
    words |= {"IN_GLOBAL_MEMORY": int(scratch > 0), "SCRATCH_NUMBERS": scratch}
    return scene_code(WORLD_CODE, SEARCH_CODE, words)


def solid_capacity(solids: int) -> int | None:
    """Return the smallest capacity for `solids` solids; None: there is none."""
    capacities = *SHARED_CAPACITIES, *GLOBAL_CAPACITIES
    return next((capacity for capacity in capacities if capacity >= solids), None)


def scratch_numbers(capacity: int, threads: int = THREADS) -> int:
    """Return the count of numbers in global memory that a world needs for its solids and their keys."""
    return capacity * (12 + threads // 32 * 2) if capacity > max(SHARED_CAPACITIES) else 0


@cache
def search_kernel(most: int, places: int, threads: int = THREADS) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the search kernel for lists of `most` solids, a capacity of `places` and blocks of `threads`."""

    @wp.func_native(_code(most, places, threads))
    def look_in_world(
        robots: wp.array[float],
        sizes: wp.array[int],
        kinds: wp.array[int],
        shapes: wp.array[float],
        static_solids: wp.array[float],
        loose: wp.array[float],
        geom_pos: wp.array[float],
        geom_quat: wp.array[float],
        geom_size: wp.array[float],
        floor: float,
        index: int,
        at: wp.array[float],
        room: wp.array[float],
        omitted: wp.array[int],
        near: wp.array[float],
        under: wp.array[float],
        known_loose: wp.array[float],
        known_geoms: wp.array[float],
        scratch: wp.array[float],
    ) -> None: ...

    def look_around_robots(
        robots: wp.array[float],
        sizes: wp.array[int],
        kinds: wp.array[int],
        shapes: wp.array[float],
        static_solids: wp.array[float],
        loose: wp.array[float],
        geom_pos: wp.array[float],
        geom_quat: wp.array[float],
        geom_size: wp.array[float],
        floor: float,
        at: wp.array[float],
        room: wp.array[float],
        omitted: wp.array[int],
        near: wp.array[float],
        under: wp.array[float],
        known_loose: wp.array[float],
        known_geoms: wp.array[float],
        scratch: wp.array[float],
    ) -> None:
        # fmt: off
        look_in_world(
            robots, sizes, kinds, shapes, static_solids, loose, geom_pos, geom_quat, geom_size, floor,
            wp.tid(), at, room, omitted, near, under, known_loose, known_geoms,
            scratch,
        )
        # fmt: on

    # XLA finds the kernel by this name, so it must be unique and independent of the order of creation.
    look_around_robots.__qualname__ = f"look_around_robots_{most}_{places}_{threads}"
    kernel: Any = wp.kernel
    # A multiprocessor has 65,536 registers, and a block needs all of its threads there at once.
    limit = {"cuda_max_registers": 65536 // threads} if threads > THREADS else {}
    return kernel(look_around_robots, enable_backward=False, grid_stride=False, module="unique", **limit)
