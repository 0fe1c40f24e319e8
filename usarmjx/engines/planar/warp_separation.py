"""Warp kernel of the separation: `footprints.separate_footprints` of all worlds in one launch.

Some lanes of a warp handle one world, one or more robots each, with as many iterations as that world needs;
a world of more robots has a block of its own. Data that robots share are in shared memory. On a CPU, in
tests, the first lane handles the whole world. The steps are those of `footprints` and `overlap`.
"""

from functools import cache
from typing import Any

import warp as wp

from usarmjx.engines.planar import footprints, overlap, proposed_motion
from usarmjx.engines.planar.solids import FAR_AWAY
from usarmjx.engines.planar.warp_solids import expand_macros

wp.set_module_options({"enable_backward": False, "fast_math": False})

BLOCK_THREADS = 128
"""Threads of a block that handles several worlds."""
WARP_LANES = 32
"""Lanes of a warp."""
TEST_DISTANCE = 0.5
"""Distance from a robot's proposed pose beyond which solids are not tested in any iteration [m]: pushes are
of centimetres."""
WARP_ROBOTS = 128
"""Largest number of robots of a world that lanes of one warp handle."""
MAX_ROBOTS = 1024
"""Largest number of robots of a world for which shared memory suffices."""
OUTLINE_CODE = """
    using wp::abs; using wp::cos; using wp::max; using wp::min; using wp::sin; using wp::sqrt;
    struct Outline { float x, y, c, s, l, w, r; };
    struct Way { float depth, x, y; };
    struct Span { float low, high; };

    // overlap.rectangle_overlap
    const auto side_depth = [](const Outline& a, const Outline& b) -> Way {
        const float dx = a.x - b.x, dy = a.y - b.y;
        const float c = abs(a.c * b.c + a.s * b.s), s = abs(a.c * b.s - a.s * b.c);
        Way found = {0.0f, 0.0f, 0.0f};
        for (int n = 0; n < 4; ++n) {
            const Outline& mine = n < 2 ? a : b;
            const Outline& other = n < 2 ? b : a;
            const bool ahead = n % 2 == 0;
            const float apart = ahead ? dx * mine.c + dy * mine.s : dy * mine.c - dx * mine.s;
            const float reach = ahead ? mine.l + other.l * c + other.w * s
                                      : mine.w + other.l * s + other.w * c;
            const float sign = apart < 0.0f ? -1.0f : 1.0f;
            const float depth = reach - abs(apart);
            if (n == 0 || depth < found.depth) {
                found.depth = depth;
                found.x = sign * (ahead ? mine.c : -mine.s);
                found.y = sign * (ahead ? mine.s : mine.c);
            }
        }
        return found;
    };

    // overlap.disc_overlap
    const auto disc_depth = [](const Outline& a, const Outline& b) -> Way {
        const float dx = b.x - a.x, dy = b.y - a.y;
        const float ahead = dx * a.c + dy * a.s, left = dy * a.c - dx * a.s;
        const float out_x = ahead - min(max(ahead, -a.l), a.l), out_y = left - min(max(left, -a.w), a.w);
        const float square = out_x * out_x + out_y * out_y;
        const float gap_x = a.l - abs(ahead), gap_y = a.w - abs(left);
        float x, y, depth;
        if (square < 1e-18f) {
            const bool by_x = gap_x <= gap_y;
            x = by_x ? (ahead < 0.0f ? -1.0f : 1.0f) : 0.0f;
            y = by_x ? 0.0f : (left < 0.0f ? -1.0f : 1.0f);
            depth = b.r + min(gap_x, gap_y);
        } else {
            const float far = sqrt(square);
            x = out_x / far;
            y = out_y / far;
            depth = b.r - far;
        }
        return {depth, -(x * a.c - y * a.s), -(x * a.s + y * a.c)};
    };
    const auto depth_in = [&](const Outline& a, const Outline& b) -> Way {
        return b.r > 0.0f ? disc_depth(a, b) : side_depth(a, b);
    };

    // overlap.contact_point
    const auto corner = [](const Outline& a, int n, float& x, float& y) {
        const float i = n < 2 ? 1.0f : -1.0f, j = n == 0 || n == 3 ? 1.0f : -1.0f;
        x = a.x + i * a.l * a.c - j * a.w * a.s;
        y = a.y + i * a.l * a.s + j * a.w * a.c;
    };
    const auto least_along = [&](const Outline& a, float wx, float wy) -> float {
        float least = 0.0f;
        for (int n = 0; n < 4; ++n) {
            float x, y;
            corner(a, n, x, y);
            const float value = x * wx + y * wy;
            least = n == 0 || value < least ? value : least;
        }
        return least;
    };
    const auto span_of = [&](const Outline& a, float wx, float wy, float least) -> Span {
        Span found = {LARGE_DISTANCE, -LARGE_DISTANCE};
        for (int n = 0; n < 4; ++n) {
            float x, y;
            corner(a, n, x, y);
            if (x * wx + y * wy < least + FLAT_TOLERANCE) {
                const float place = y * wx - x * wy;
                found.low = min(found.low, place);
                found.high = max(found.high, place);
            }
        }
        return found;
    };
    const auto meet = [&](const Outline& a, const Outline& b, const Way& way, float& x, float& y) {
        if (b.r > 0.0f) {
            const float dx = b.x - a.x, dy = b.y - a.y;
            const float ahead = min(max(dx * a.c + dy * a.s, -a.l), a.l);
            const float left = min(max(dy * a.c - dx * a.s, -a.w), a.w);
            x = a.x + ahead * a.c - left * a.s;
            y = a.y + ahead * a.s + left * a.c;
            return;
        }
        const float bottom = least_along(a, way.x, way.y), top = -least_along(b, -way.x, -way.y);
        const Span mine = span_of(a, way.x, way.y, bottom);
        const Span turned = span_of(b, -way.x, -way.y, -top);  // seen from the other side
        const float along = (bottom + top) / 2.0f;
        const float middle = (max(mine.low, -turned.high) + min(mine.high, -turned.low)) / 2.0f;
        x = along * way.x - middle * way.y;
        y = along * way.y + middle * way.x;
    };
"""
"""Native functions of two outlines: the first leaves the second."""

WORLD_CODE = """
    constexpr int WORDS = (COUNT + 31) / 32;
    const int world = (int)((unsigned)index / LANES);
    const size_t total = (size_t)worlds * COUNT;
    const size_t first = (size_t)world * COUNT;
    const auto input = [&](int r, int number) { return robots.data[number * total + first + r]; };
    const float* const around = near.data + (size_t)world * 12 * solids * COUNT;
    const int* const over = stacked.data + (flies ? (size_t)world * COUNT * COUNT : 0);
#if defined(__CUDA_ARCH__)
    constexpr int SLOTS = (COUNT + LANES - 1) / LANES;
    const int lane = (int)((unsigned)index % LANES);
    const int lanes = LANES;
    __shared__ float held[BLOCK_THREADS / LANES * COUNT * 9];
    float* const here = held + threadIdx.x / LANES * COUNT * 9;
    const unsigned group = LANES >= 32 ? 0xffffffffu : (1u << LANES % 32) - 1u;
    const unsigned mask = group << (threadIdx.x % 32 / LANES * LANES);
    const auto wait = [&]() { if (LANES > 32) __syncthreads(); else __syncwarp(mask); };
    const auto any = [&](bool x) { return (LANES > 32 ? __syncthreads_or(x) : __any_sync(mask, x)) != 0; };
    const auto first_bit = [](unsigned x) { return __ffs((int)x) - 1; };
#else
    if ((unsigned)index % LANES != 0) return;
    constexpr int SLOTS = COUNT;
    const int lane = 0;
    const int lanes = 1;
    float here[COUNT * 9];
    const auto wait = []() {};
    const auto any = [](bool x) { return x; };
    const auto first_bit = [](unsigned x) { int n = 0; while (!(x >> n & 1u)) ++n; return n; };
#endif
    // Of each robot in shared memory: the outline that is looked at, and from where to where up it reaches.
    const auto robot = [&](int r) -> Outline {
        const float* const p = here + r * 9;
        return {p[0], p[1], p[2], p[3], p[4], p[5], 0.0f};
    };
    // A solid's numbers are as in `solids.pack_solids`, one after those of all robots and solids.
    const auto number = [&](int i, int k, int r) { return around[((size_t)i * solids + k) * COUNT + r]; };
    const auto solid = [&](int k, int r) -> Outline {
        return {number(0, k, r), number(1, k, r), number(2, k, r), number(3, k, r),
                number(4, k, r), number(5, k, r), number(6, k, r)};
    };
    // neighbor_lists.obstacle_outlines
    const auto stops = [&](const Outline& o, int k, int r) -> bool {
        const float dx = input(r, FIELD_BEFORE_X) - o.x, dy = input(r, FIELD_BEFORE_Y) - o.y;
        const float low = input(r, FIELD_BEFORE_LOW), high = input(r, FIELD_BEFORE_HIGH);
        const float ahead = min(max(dx * o.c + dy * o.s, -o.l), o.l);
        const float aside = min(max(dy * o.c - dx * o.s, -o.w), o.w);
        const float rise = (ahead * o.c - aside * o.s) * number(9, k, r)
            + (ahead * o.s + aside * o.c) * number(10, k, r);
        return max(low + input(r, FIELD_STEP) - (number(8, k, r) + rise),
                   max(number(7, k, r) - high, low - number(11, k, r))) < 0.0f;
    };
    const auto apart_by_more = [](const Outline& a, const Outline& b, float gap) -> bool {
        const float dx = a.x - b.x, dy = a.y - b.y, reach = a.l + a.w + b.l + b.w + b.r + gap;
        return dx * dx + dy * dy >= reach * reach;
    };
    const auto show = [&](int r, float x, float y, float c, float s) {
        float* const p = here + r * 9;
        p[0] = x; p[1] = y; p[2] = c; p[3] = s;
    };
    const auto show_heights = [&](int r, int from) {
        here[r * 9 + 6] = input(r, from + FIELD_BEFORE_LOW);
        here[r * 9 + 7] = input(r, from + FIELD_BEFORE_HIGH);
    };

    float x[SLOTS], y[SLOTS], c[SLOTS], s[SLOTS], yaw[SLOTS];  // where the robots come to
    float allowed[SLOTS], depth[SLOTS], size[SLOTS], way_x[SLOTS], way_y[SLOTS], at_x[SLOTS], at_y[SLOTS];
    int which[SLOTS];
    bool touched[SLOTS], stuck[SLOTS];
    unsigned near_solids[SLOTS], near_robots[SLOTS * WORDS];  // a bit each
    for (int i = 0, r = lane; r < COUNT; ++i, r += lanes) {
        x[i] = input(r, FIELD_THERE_X);
        y[i] = input(r, FIELD_THERE_Y);
        c[i] = input(r, FIELD_THERE_COS);
        s[i] = input(r, FIELD_THERE_SIN);
        yaw[i] = input(r, FIELD_THERE_YAW);
        here[r * 9 + 4] = input(r, FIELD_LENGTH);
        here[r * 9 + 5] = input(r, FIELD_WIDTH);
        here[r * 9 + 8] = input(r, FIELD_MOVES) != 0.0f ? input(r, FIELD_MASS) : 1e9f;  // else a wall
        show(r, x[i], y[i], c[i], s[i]);
        show_heights(r, FIELD_THERE_X);
        touched[i] = false;
        allowed[i] = OVERLAP_TOLERANCE;
        depth[i] = 0.0f;
        size[i] = 0.0f;
    }
    wait();
    for (int i = 0, r = lane; r < COUNT; ++i, r += lanes) {
        const Outline a = robot(r);
        near_solids[i] = 0u;
        for (int k = 0; k < solids; ++k) {
            const Outline b = solid(k, r);
            if (b.x < FAR_AWAY && !apart_by_more(a, b, TEST_DISTANCE) && stops(b, k, r))
                near_solids[i] |= 1u << k;
        }
        for (int w = 0; w < WORDS; ++w) {
            unsigned found = 0u;
            for (int o = 32 * w; o < COUNT && o < 32 * w + 32; ++o) {
                const bool passes = o == r || (flies && over[o * COUNT + r] != 0);
                if (!passes && !apart_by_more(a, robot(o), TEST_DISTANCE)) found |= 1u << (o - 32 * w);
            }
            near_robots[i * WORDS + w] = found;
        }
    }
    for (int turn = 0; turn < 2 + PUSH_ITERATIONS + RESTORE_ITERATIONS; ++turn) {
        bool one_is_stuck = false;
        for (int i = 0, r = lane; r < COUNT; ++i, r += lanes) {
            const Outline a = robot(r);
            float push = -1.0f, deepest = -1.0f;
            int from = -1;
            for (unsigned left = near_solids[i]; left != 0u; left &= left - 1u) {
                const int k = first_bit(left);
                const float found = depth_in(a, solid(k, r)).depth;
                if (found > push) { push = found; from = k; }
            }
            const float low = here[r * 9 + 6], high = here[r * 9 + 7], mass = input(r, FIELD_MASS);
            for (int w = 0; w < WORDS; ++w) {
                for (unsigned left = near_robots[i * WORDS + w]; left != 0u; left &= left - 1u) {
                    const int o = 32 * w + first_bit(left);
                    if (low >= here[o * 9 + 7] || here[o * 9 + 6] >= high) continue;
                    const Outline b = robot(o);
                    if (apart_by_more(a, b, 0.0f)) continue;
                    const float found = side_depth(a, b).depth;
                    deepest = max(deepest, found);
                    const float other = here[o * 9 + 8];
                    const float part = found > 0.0f ? found * (other / (other + mass)) : found;
                    if (part > push) { push = part; from = solids + o; }
                }
            }
            deepest = max(deepest, push);
            if (turn == 1) {
                allowed[i] = max(deepest, OVERLAP_TOLERANCE);
            } else {
                depth[i] = deepest;
                size[i] = max(push, 0.0f);
                which[i] = from;
            }
            touched[i] = touched[i] || depth[i] > 0.0f;
            stuck[i] = depth[i] > allowed[i];
            one_is_stuck = one_is_stuck || stuck[i];
        }
        if (!any(one_is_stuck)) break;
        if (turn != 1 && turn <= PUSH_ITERATIONS) {
            for (int i = 0, r = lane; r < COUNT; ++i, r += lanes) {
                if (size[i] <= 0.0f) continue;
                const Outline a = robot(r);
                const Outline b = which[i] < solids ? solid(which[i], r) : robot(which[i] - solids);
                const Way way = depth_in(a, b);
                way_x[i] = way.x;
                way_y[i] = way.y;
                meet(a, b, way, at_x[i], at_y[i]);
            }
        }
        wait();
        for (int i = 0, r = lane; r < COUNT; ++i, r += lanes) {
            const bool all_back = turn > PUSH_ITERATIONS + RESTORE_ITERATIONS;
            if (turn == 0 || (turn > PUSH_ITERATIONS && (stuck[i] || all_back))) {
                const float was_x = input(r, FIELD_BEFORE_X), was_y = input(r, FIELD_BEFORE_Y);
                const float was_c = input(r, FIELD_BEFORE_COS), was_s = input(r, FIELD_BEFORE_SIN);
                if (turn == 0) {
                    show(r, was_x, was_y, was_c, was_s);
                    show_heights(r, FIELD_BEFORE_X);
                    continue;
                }
                x[i] = was_x; y[i] = was_y; c[i] = was_c; s[i] = was_s; yaw[i] = input(r, FIELD_BEFORE_YAW);
            } else if (turn <= PUSH_ITERATIONS && size[i] > 0.0f && input(r, FIELD_MOVES) != 0.0f) {
                const float lever = (at_x[i] - x[i]) * way_y[i] - (at_y[i] - y[i]) * way_x[i];
                const float length = input(r, FIELD_LENGTH), width = input(r, FIELD_WIDTH);
                const float spread = (length * length + width * width) / 3.0f;
                const float go = size[i] / (1.0f + lever * lever / spread);
                x[i] += go * way_x[i];
                y[i] += go * way_y[i];
                yaw[i] += go * lever / spread;
                c[i] = cos(yaw[i]);
                s[i] = sin(yaw[i]);
            }
            show(r, x[i], y[i], c[i], s[i]);
            if (turn == 1) show_heights(r, FIELD_THERE_X);
        }
        wait();
    }
    for (int i = 0, r = lane; r < COUNT; ++i, r += lanes) {
        float* const out = kept.data + ((size_t)world * COUNT + r) * 4;
        const bool moved = x[i] != input(r, FIELD_THERE_X) || y[i] != input(r, FIELD_THERE_Y)
            || yaw[i] != input(r, FIELD_THERE_YAW);
        out[0] = x[i];
        out[1] = y[i];
        out[2] = yaw[i];
        out[3] = touched[i] || moved ? 1.0f : 0.0f;
    }
"""
"""Native code of a world's lanes."""


def lanes_for(robots: int) -> int:
    """Return the number of threads for a world of `robots` robots: a power of two."""
    # A power of two: groups of lanes then divide a warp evenly.
    enough = 1 << (robots - 1).bit_length()
    # Large worlds get a block of their own, with two robots a lane.
    return min(enough, WARP_LANES) if robots <= WARP_ROBOTS else enough // 2


def block_threads_for(robots: int) -> int:
    """Return the number of threads of a block for worlds of `robots` robots."""
    return max(BLOCK_THREADS, lanes_for(robots))


def _code(robots: int) -> str:
    """Return the native code for worlds of `robots` robots."""
    words: dict[str, object] = {
        **proposed_motion.MACROS,
        **{
            "COUNT": robots,
            "LANES": f"{lanes_for(robots)}",
            "BLOCK_THREADS": block_threads_for(robots),
            "TEST_DISTANCE": f"{TEST_DISTANCE}f",
        },
        **{
            "PUSH_ITERATIONS": footprints.PUSH_ITERATIONS,
            "RESTORE_ITERATIONS": footprints.RESTORE_ITERATIONS,
            "OVERLAP_TOLERANCE": f"{footprints.OVERLAP_TOLERANCE}f",
        },
        **{
            "FAR_AWAY": f"{FAR_AWAY}f",
            "LARGE_DISTANCE": f"{overlap.LARGE_DISTANCE}f",
            "FLAT_TOLERANCE": f"{overlap.FLAT_TOLERANCE}f",
        },
    }
    return expand_macros(OUTLINE_CODE + WORLD_CODE, words)


@cache
def separation_kernel(robots: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel for worlds of `robots` robots."""

    @wp.func_native(_code(robots))
    def keep_world_apart(
        robots: wp.array[float],
        near: wp.array[float],
        stacked: wp.array[int],
        worlds: int,
        solids: int,
        flies: int,
        index: int,
        kept: wp.array[float],
    ) -> None: ...

    def keep_robots_apart(
        robots: wp.array[float],
        near: wp.array[float],
        stacked: wp.array[int],
        worlds: int,
        solids: int,
        flies: int,
        kept: wp.array[float],
    ) -> None:
        keep_world_apart(robots, near, stacked, worlds, solids, flies, wp.tid(), kept)

    # XLA finds the kernel by this name, so it must be unique and independent of the order of creation.
    keep_robots_apart.__qualname__ = f"keep_robots_apart_of_{robots}"
    kernel: Any = wp.kernel
    return kernel(keep_robots_apart, enable_backward=False, grid_stride=False, module="unique")
