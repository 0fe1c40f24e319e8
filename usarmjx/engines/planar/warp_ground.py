"""The ground below robots found on Warp, a thread each: see `neighbours` and `solids`."""

import warp as wp

from usarmjx.engines.planar.rolling import STANCE
from usarmjx.engines.planar.warp_solids import scene_code

wp.set_module_options({"enable_backward": False, "fast_math": False})

GROUND = """
    const int r = (int)((unsigned)index % (unsigned)count);
    const float* const went = kept.data + (size_t)index * 3;
    const float* const was = at.data + (size_t)index * 4;
    const float* const free = room.data + (size_t)index * 4;
    const float x = went[0], y = went[1], c = cos(went[2]), s = sin(went[2]);
    const float dx = x - was[0], dy = y - was[1];
    const float limits[4] = {told(r, NUMBER_LIMIT_0), told(r, NUMBER_LIMIT_1), told(r, NUMBER_LIMIT_2),
                             told(r, NUMBER_LIMIT_3)};
    const float limit = max(max(limits[0], limits[1]), max(limits[2], limits[3]));
    const float length = STANCE * told(r, NUMBER_LENGTH), width = STANCE * told(r, NUMBER_WIDTH);
    const bool knows = free[2] > sqrt(dx * dx + dy * dy) && free[3] > abs(limit - was[3]);
    float found[4] = {floor, floor, floor, floor};
    const auto stand_on = [&](const Solid& o) {
        for (int j = 0; j < 4; ++j) {
            const float ahead = j < 2 ? length : -length, left = j == 0 || j == 3 ? width : -width;
            const float foot_x = x + (ahead * c - left * s), foot_y = y + (ahead * s + left * c);
            found[j] = max(found[j], top_under(o, foot_x, foot_y, limits[j]));
        }
    };
    const int solids = fixed + others;
    if (knows) {
        const int layers = min(solids, LAYERS);
        const float* const rows = under.data + (size_t)world * 12 * layers * count + r;
        const auto number = [&](int i, int k) { return rows[((size_t)i * layers + k) * count]; };
        for (int k = 0; k < layers; ++k)
            stand_on({number(0, k), number(1, k), number(2, k), number(3, k), number(4, k), number(5, k),
                      number(6, k), number(7, k), number(8, k), number(9, k), number(10, k), number(11, k)});
    } else {
        for (int i = 0; i < fixed; ++i) {
            const float* const q = still.data + 12 * i;
            stand_on({q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7], q[8], q[9], q[10], q[11]});
        }
        for (int m = 0; m < others; ++m) stand_on(moved(m));
    }
    for (int j = 0; j < 4; ++j) ground.data[((size_t)world * 4 + j) * count + r] = found[j];
"""
"""What a robot's thread does: `neighbours.ground_of`, or `solids.ground_under` where that is not known."""


ROBOT = """
    const int world = (int)((unsigned)index / (unsigned)sizes.data[0]);
"""


@wp.func_native(scene_code(ROBOT, GROUND, {"STANCE": f"{STANCE}f"}))
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
