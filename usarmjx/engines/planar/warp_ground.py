"""The ground below robots found on Warp, a thread each: see `neighbours` and `solids`."""

import warp as wp

from usarmjx.engines.planar.rolling import STANCE
from usarmjx.engines.planar.warp_solids import scene_code

wp.set_module_options({"enable_backward": False, "fast_math": False})

GROUND = """
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
        STANCE * told(r, NUMBER_LENGTH), STANCE * told(r, NUMBER_WIDTH),
        {told(r, NUMBER_LIMIT_0), told(r, NUMBER_LIMIT_1), told(r, NUMBER_LIMIT_2), told(r, NUMBER_LIMIT_3)},
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
        const float* const q = still.data + 12 * i;
        return {q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7], q[8], q[9], q[10], q[11]};
    };
    float found[4] = {floor, floor, floor, floor};
    if (knows) {
        const int layers = min(solids, LAYERS);
        const float* const rows = under.data + (size_t)world * 12 * layers * count + r;
        const auto number = [&](int i, int k) { return rows[((size_t)i * layers + k) * count]; };
        for (int k = 0; k < layers; ++k)
            stand_on(mine, {number(0, k), number(1, k), number(2, k), number(3, k), number(4, k),
                            number(5, k), number(6, k), number(7, k), number(8, k), number(9, k),
                            number(10, k), number(11, k)}, found);
    }
#if defined(__CUDA_ARCH__)
    // Who of a warp has to look at all solids is helped by all its threads, that look at some each.
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
"""What a robot's thread does: `neighbours.ground_of`, or `solids.ground_under` where that is not known."""


ROBOT = """
    int world = (int)((unsigned)index / (unsigned)sizes.data[0]);  // that of which solids are asked
"""
WORDS = {"STANCE": f"{STANCE}f"}
THREADS = 128
"""Threads of a block."""


@wp.func_native(scene_code(ROBOT, GROUND, WORDS))
def _ground_under_robot(
    robots: wp.array[float],
    sizes: wp.array[int],
    kinds: wp.array[int],
    shapes: wp.array[float],
    still: wp.array[float],
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
    still: wp.array[float],
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
    """Find how high the ground is under the four stances of each robot."""
    # fmt: off
    _ground_under_robot(
        robots, sizes, kinds, shapes, still, loose, geom_pos, geom_quat, geom_size, kept, at, room, under,
        floor, wp.tid(), ground,
    )
    # fmt: on
