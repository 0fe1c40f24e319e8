"""Solids in Warp kernels: twelve numbers each, and the native functions of `solids` and `neighbor_lists`."""

from collections.abc import Mapping
from functools import reduce

import mujoco

from usarmjx.engines.planar import proposed_motion
from usarmjx.engines.planar.neighbor_lists import GROUND_LIST_LENGTH
from usarmjx.engines.planar.solids import FAR_AWAY, MIN_DRIVABLE_COSINE

SHAPE_NUMBERS = 30
"""Numbers of a movable solid: origin and axes of its body at the reference pose, hinge axis, and position,
axes and size of its geom."""
KIND_NUMBERS = 5
"""Integers of a movable solid: MuJoCo geom type; index among input poses, or -1; joint type of its body
(fixed, free or hinged); offset of the body among loose coordinates; index among the solids that are
inputs, or -1."""
FIXED, FREE, HINGED = range(3)
"""Joint types of a movable solid's body."""

SOLID_CODE = """
    using wp::abs; using wp::cos; using wp::max; using wp::min; using wp::sin; using wp::sqrt;
    struct Solid { float x, y, c, s, l, w, r, low, top, slope_x, slope_y, highest; };
    struct Turn { float m[9]; };

    // rotations.mat_from_quat, matmul
    const auto turned_by = [](float w, float x, float y, float z) -> Turn {
        const float size = sqrt(w * w + x * x + y * y + z * z);
        w /= size; x /= size; y /= size; z /= size;
        return {{1.0f - 2.0f * (y * y + z * z), 2.0f * (x * y - w * z), 2.0f * (x * z + w * y),
                 2.0f * (x * y + w * z), 1.0f - 2.0f * (x * x + z * z), 2.0f * (y * z - w * x),
                 2.0f * (x * z - w * y), 2.0f * (y * z + w * x), 1.0f - 2.0f * (x * x + y * y)}};
    };
    const auto product = [](const Turn& a, const Turn& b) -> Turn {
        Turn found;
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j)
                found.m[3 * i + j] =
                    a.m[3 * i] * b.m[j] + a.m[3 * i + 1] * b.m[3 + j] + a.m[3 * i + 2] * b.m[6 + j];
        return found;
    };

    // solids.project_geoms
    const auto seen = [](int kind, const float* pos, const Turn& turn, const float* size) -> Solid {
        const float* const m = turn.m;
        const bool box = kind == BOX;
        float half[3] = {size[0], size[1], size[2]};
        if (!box && kind != ELLIPSOID) {
            half[1] = size[0];
            half[2] = kind == CAPSULE ? size[1] + size[0] : kind == SPHERE ? size[0] : size[1];
        }
        const float upright[3] = {abs(m[6]), abs(m[7]), abs(m[8])};
        int up = 0, level = -1;
        for (int j = 1; j < 3; ++j) up = upright[j] > upright[up] ? j : up;
        for (int j = 0; j < 3; ++j) level = j != up && (level < 0 || upright[j] < upright[level]) ? j : level;
        const float sign = m[6 + up] < 0.0f ? -1.0f : 1.0f;
        const float nx = m[up] * sign, ny = m[3 + up] * sign, nz = m[6 + up] * sign;
        const float height = upright[0] * half[0] + upright[1] * half[1] + upright[2] * half[2];
        Solid found;
        found.x = pos[0];
        found.y = pos[1];
        found.low = pos[2] - height;
        found.highest = pos[2] + height;
        const bool flat = box && nz >= MIN_DRIVABLE_COSINE;
        found.slope_x = flat ? -nx / max(nz, 0.1f) : 0.0f;
        found.slope_y = flat ? -ny / max(nz, 0.1f) : 0.0f;
        const float x = pos[0] + nx * half[up], y = pos[1] + ny * half[up], z = pos[2] + nz * half[up];
        found.top = flat ? z + (found.slope_x * (pos[0] - x) + found.slope_y * (pos[1] - y)) : found.highest;
        const float far = max(sqrt(m[level] * m[level] + m[3 + level] * m[3 + level]), 1e-6f);
        found.c = m[level] / far;
        found.s = m[3 + level] / far;
        float along = 0.0f, across = 0.0f;
        for (int j = 0; j < 3; ++j) {
            along += abs(found.c * m[j] + found.s * m[3 + j]) * half[j];
            across += abs(-found.s * m[j] + found.c * m[3 + j]) * half[j];
        }
        const bool round = (!box && up == 2) || kind == SPHERE;
        found.l = round ? 0.0f : along;
        found.w = round ? 0.0f : across;
        found.r = round ? half[0] : 0.0f;
        return found;
    };

    // solids.world_solids, bodies.FixedBodies.poses: a movable solid at its current pose
    const auto moved = [&](int m) -> Solid {
        const int* const k = kinds.data + m * KIND_NUMBERS;
        const float* const p = shapes.data + m * SHAPE_NUMBERS;
        float pos[3] = {p[15], p[16], p[17]}, size[3] = {p[27], p[28], p[29]};
        Turn turn, body;
        for (int i = 0; i < 9; ++i) { body.m[i] = p[3 + i]; turn.m[i] = p[18 + i]; }
        if (k[1] >= 0) {
            const size_t at = (size_t)world * places + k[1];
            const float* const q = geom_quat.data + 4 * at;
            for (int i = 0; i < 3; ++i) pos[i] = geom_pos.data[3 * at + i];
            if (sized)
                for (int i = 0; i < 3; ++i) size[i] = geom_size.data[3 * at + i];
            turn = turned_by(q[0], q[1], q[2], q[3]);
        }
        float origin[3] = {p[0], p[1], p[2]};
        const float* const q = loose.data + (size_t)world * numbers + k[3];
        if (k[2] == FREE) {
            for (int i = 0; i < 3; ++i) origin[i] = q[i];
            body = turned_by(q[3], q[4], q[5], q[6]);
        } else if (k[2] == HINGED) {
            const float c = cos(q[0] / 2.0f), s = sin(q[0] / 2.0f);
            body = product(body, turned_by(c, s * p[12], s * p[13], s * p[14]));
        }
        float at[3];
        for (int i = 0; i < 3; ++i) {
            const float* const row = body.m + 3 * i;
            at[i] = origin[i] + (row[0] * pos[0] + row[1] * pos[1] + row[2] * pos[2]);
        }
        return seen(k[0], at, product(body, turn), size);
    };

    // neighbor_lists._height_gap
    const auto height_apart = [](const Solid& o, float x, float y, float low, float high, float step) {
        const float dx = x - o.x, dy = y - o.y;
        const float ahead = min(max(dx * o.c + dy * o.s, -o.l), o.l);
        const float aside = min(max(dy * o.c - dx * o.s, -o.w), o.w);
        const float rise = (ahead * o.c - aside * o.s) * o.slope_x + (ahead * o.s + aside * o.c) * o.slope_y;
        return max(low + step - (o.top + rise), max(o.low - high, low - o.highest));
    };

    // solids.top_heights
    const auto top_under = [](const Solid& o, float x, float y, float reach) -> float {
        const float dx = x - o.x, dy = y - o.y;
        const bool inside = (abs(dx * o.c + dy * o.s) <= o.l && abs(dy * o.c - dx * o.s) <= o.w)
            || (o.r > 0.0f && dx * dx + dy * dy <= o.r * o.r);
        const float height = o.top + dx * o.slope_x + dy * o.slope_y;
        return inside && height <= reach ? height : -FAR_AWAY;
    };
"""
"""Native functions of solids; `moved` returns a movable one in the world `world`."""

SIZE_CODE = """
    const int count = sizes.data[0], fixed = sizes.data[1], others = sizes.data[2];
    const int data_geoms = sizes.data[3];
    const int numbers = sizes.data[4], places = sizes.data[5], sized = sizes.data[6];
    const size_t total = (size_t)sizes.data[7] * count;
    const size_t first = (size_t)world * count;
    const auto input = [&](int r, int number) { return robots.data[number * total + first + r]; };
"""
"""Native constants: numbers of robots, of static and movable solids, of solids that are inputs, of loose
coordinates and of input poses; whether sizes are inputs; number of worlds."""

_GEOM = mujoco.mjtGeom
MACROS: Mapping[str, object] = {
    **{name: int(getattr(_GEOM, f"mjGEOM_{name}")) for name in ("BOX", "ELLIPSOID", "CAPSULE", "SPHERE")},
    **{"KIND_NUMBERS": KIND_NUMBERS, "SHAPE_NUMBERS": SHAPE_NUMBERS, "FREE": FREE, "HINGED": HINGED},
    **{
        "MIN_DRIVABLE_COSINE": f"{MIN_DRIVABLE_COSINE:.9f}f",
        "FAR_AWAY": f"{FAR_AWAY}f",
        "GROUND_LIST_LENGTH": GROUND_LIST_LENGTH,
    },
    **proposed_motion.MACROS,
}
"""Macros of native code."""


def expand_macros(code: str, words: Mapping[str, object]) -> str:
    """Return native code with macros expanded."""
    longest_first = sorted(words, key=len, reverse=True)  # a name may be a prefix of another
    return reduce(lambda text, word: text.replace(word, str(words[word])), longest_first, code)


def scene_code(begin: str, code: str, words: Mapping[str, object]) -> str:
    """Return the native code of a kernel with robots and solids.

    Args:
        begin: Declares `world`.
        code: Body of the kernel.
        words: Further macros, besides `MACROS`.
    """
    return expand_macros(begin + SIZE_CODE + SOLID_CODE + code, {**MACROS, **words})
