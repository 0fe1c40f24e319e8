"""Textures of surfaces on Warp, one ray per call; with the arithmetic of `shading`."""

import numpy as np
import warp as wp

from usarmjx.models.types.shapes import CODE_STRIDE, TEXTURES
from usarmjx.sensors.cameras import shading

wp.set_module_options({"enable_backward": False, "fast_math": True})

STRIDE = wp.constant(CODE_STRIDE)
BRICKS = wp.constant(TEXTURES.index("brick") + 1)
TILES = wp.constant(TEXTURES.index("tiles") + 1)
WOOD = wp.constant(TEXTURES.index("wood") + 1)
CONCRETE = wp.constant(TEXTURES.index("concrete") + 1)
CHART = wp.constant(TEXTURES.index("chart") + 1)
HAZMAT = wp.constant(TEXTURES.index("hazmat") + 1)
TAG = wp.constant(TEXTURES.index("tag") + 1)
BRICK_LENGTH, BRICK_HEIGHT = (wp.constant(side) for side in shading.BRICK)
MORTAR = wp.constant(shading.MORTAR)
MORTAR_SHADE = wp.constant(shading.MORTAR_SHADE)
TILE = wp.constant(shading.TILE)
GROUT = wp.constant(shading.GROUT)
GROUT_SHADE = wp.constant(shading.GROUT_SHADE)
PLANK_LENGTH, PLANK_WIDTH = (wp.constant(side) for side in shading.PLANK)
GRAIN_LENGTH, GRAIN_WIDTH = (wp.constant(side) for side in shading.GRAIN)
COARSE, FINE = (wp.constant(side) for side in shading.STAINS)
LANDOLT_RINGS = wp.constant(shading.LANDOLT_RINGS)
QUARTER = wp.constant(np.pi / 4)
BLACK = wp.constant(float(shading.BLACK[0, 0]))
HAZARDS = wp.constant(len(shading.HAZARD_RGB))
CODES = wp.constant(len(shading.QR_CELLS))
QR_SIDE = wp.constant(shading.QR_SIDE)
QR_RIM = wp.constant(shading.QR_RIM)
TAGS = wp.constant(len(shading.TAG_BITS))
TAG_SIDE = wp.constant(shading.TAG_SIDE)


def sign_bits() -> np.ndarray:
    """Return the cells of QR codes, row by row, and those of markers, a number each; and hazards' colours.

    Returns:
        float32 (codes * side + markers + 3 * hazards,): whole numbers below 2^24 are exact.
    """
    # A row of 21 cells is a number below 2^24.
    rows = shading.QR_CELLS.reshape(-1, shading.QR_SIDE) @ (1 << np.arange(shading.QR_SIDE))
    return np.concatenate([rows, shading.TAG_BITS, shading.HAZARD_RGB.ravel()]).astype(np.float32)


@wp.func
def lattice_noise(i: int, j: int, salt: int) -> float:
    """As `shading.noise`."""
    mixed = wp.uint32(i) * wp.uint32(374761393) + wp.uint32(j) * wp.uint32(668265263)
    mixed = mixed + wp.uint32(salt * 974711 + 1)
    mixed = (mixed ^ (mixed >> wp.uint32(13))) * wp.uint32(1274126177)
    # The number 2246822519 of `shading.noise`, which as a literal would not fit into Warp's int.
    mixed = (mixed ^ (mixed >> wp.uint32(16))) * wp.uint32(wp.int32(-2048144777))
    return wp.float32((mixed >> wp.uint32(8)) & wp.uint32(65535)) / 65536.0


@wp.func
def smooth_noise(x: float, y: float, salt: int) -> float:
    """As `shading.smooth_noise`."""
    i = int(wp.floor(x))
    j = int(wp.floor(y))
    dx = x - wp.float32(i)
    dy = y - wp.float32(j)
    low = lattice_noise(i, j, salt) * (1.0 - dx) + lattice_noise(i + 1, j, salt) * dx
    high = lattice_noise(i, j + 1, salt) * (1.0 - dx) + lattice_noise(i + 1, j + 1, salt) * dx
    return low * (1.0 - dy) + high * dy


@wp.func
def _brick(across: float, up: float) -> float:
    row = int(wp.floor(up / BRICK_HEIGHT))
    # `& 1` and no `%`, whose sign is that of a negative row here.
    shifted = across / BRICK_LENGTH + 0.5 * wp.float32(row & 1)
    column = int(wp.floor(shifted))
    joint = (shifted - wp.float32(column)) * BRICK_LENGTH < MORTAR
    joint = joint or (up / BRICK_HEIGHT - wp.float32(row)) * BRICK_HEIGHT < MORTAR
    grain = 0.92 + 0.16 * smooth_noise(across / 0.02, up / 0.02, 1)
    return wp.where(joint, MORTAR_SHADE, (0.7 + 0.45 * lattice_noise(column, row, 2)) * grain)


@wp.func
def _tiles(across: float, up: float) -> float:
    i = int(wp.floor(across / TILE))
    j = int(wp.floor(up / TILE))
    joint = (across / TILE - wp.float32(i)) * TILE < GROUT or (up / TILE - wp.float32(j)) * TILE < GROUT
    veins = 0.9 + 0.2 * smooth_noise(across / 0.07, up / 0.07, 3)
    return wp.where(joint, GROUT_SHADE, (0.75 + 0.3 * lattice_noise(i, j, 4)) * veins)


@wp.func
def _wood(across: float, up: float) -> float:
    row = int(wp.floor(up / PLANK_WIDTH))
    along = across / PLANK_LENGTH + lattice_noise(row, row, 5)
    column = int(wp.floor(along))
    gap = (along - wp.float32(column)) * PLANK_LENGTH < 0.004
    gap = gap or (up / PLANK_WIDTH - wp.float32(row)) * PLANK_WIDTH < 0.004
    # Another part of the noise for each row of planks, or the grain would go on across their gaps.
    grain = smooth_noise(across / GRAIN_LENGTH + 7.0 * wp.float32(row), up / GRAIN_WIDTH, 6)
    return wp.where(gap, 0.35, (0.7 + 0.3 * lattice_noise(column, row, 7)) * (0.75 + 0.4 * grain))


@wp.func
def _concrete(across: float, up: float) -> float:
    coarse = smooth_noise(across / COARSE, up / COARSE, 8)
    fine = smooth_noise(across / FINE, up / FINE, 9)
    pores = lattice_noise(int(wp.floor(across / 0.015)), int(wp.floor(up / 0.015)), 10)
    return (0.7 + 0.3 * coarse) * (0.8 + 0.3 * fine) * wp.where(pores > 0.97, 0.5, 1.0)


@wp.func
def _chart(u: float, v: float, number: int) -> float:
    # Declared as Warp's types: a plain literal would be a constant, which a loop may not change.
    dark = wp.bool(False)
    radius = wp.sqrt(u * u + v * v)
    outer = wp.float32(0.95)
    ring = wp.int32(0)
    while ring < LANDOLT_RINGS:
        turn = wp.floor(8.0 * lattice_noise(number, ring, 11)) * QUARTER
        ahead = u * wp.cos(turn) + v * wp.sin(turn)
        aside = v * wp.cos(turn) - u * wp.sin(turn)
        gap = ahead > 0.0 and wp.abs(aside) < outer / 5.0
        dark = dark or (radius <= outer and radius >= 0.6 * outer and not gap)
        outer = 0.5 * outer
        ring += 1
    return wp.where(dark, BLACK, 1.0)


@wp.func
def _hazmat(u: float, v: float, number: int, signs: wp.array[float]) -> wp.vec3:
    away = wp.abs(u) + wp.abs(v)
    # HAZARDS is added since the remainder of a negative number is negative here, unlike in Python.
    place = (number + HAZARDS - 1) % HAZARDS * 3 + CODES * QR_SIDE + TAGS
    bar = wp.floor((u + 0.3) / 0.12)
    bars = bar >= 0.0 and bar < wp.float32(number) and u + 0.3 - 0.12 * bar < 0.07 and wp.abs(v + 0.35) < 0.12
    inner = wp.vec3(signs[place], signs[place + 1], signs[place + 2])
    disc = wp.sqrt(u * u + (v - 0.35) * (v - 0.35)) < 0.2
    black = wp.vec3(BLACK, BLACK, BLACK)
    inner = wp.where(disc, black, inner)
    inner = wp.where(v > 0.0, inner, wp.where(bars, black, wp.vec3(1.0, 1.0, 1.0)))
    inner = wp.where(away > 0.88, black, inner)
    return wp.where(away > 0.95, wp.vec3(0.8, 0.8, 0.8), inner)


@wp.func
def _cell(x: float, cells: int) -> int:
    """Return the cell of a position from -1 to 1."""
    return wp.min(wp.max(int(wp.floor((x + 1.0) / 2.0 * wp.float32(cells))), 0), cells - 1)


@wp.func
def _tag(u: float, v: float, number: int, signs: wp.array[float]) -> float:
    column = _cell(u, TAG_SIDE + 2) - 2
    row = _cell(-v, TAG_SIDE + 2) - 2
    inside = column >= 0 and column < 4 and row >= 0 and row < 4
    bits = int(signs[CODES * QR_SIDE + number % TAGS])
    # Clamped: outside of the cells the shift would be undefined, and its result is dropped.
    bit = (bits >> wp.min(wp.max(15 - (4 * row + column), 0), 15)) & 1
    rim = column < -1 or column > 4 or row < -1 or row > 4
    return wp.where(rim or (inside and bit == 1), 1.0, BLACK)


@wp.func
def _qr(u: float, v: float, number: int, signs: wp.array[float]) -> float:
    column = _cell(u, QR_SIDE + 2 * QR_RIM) - QR_RIM
    row = _cell(-v, QR_SIDE + 2 * QR_RIM) - QR_RIM
    inside = column >= 0 and column < QR_SIDE and row >= 0 and row < QR_SIDE
    cells = int(signs[number % CODES * QR_SIDE + wp.min(wp.max(row, 0), QR_SIDE - 1)])
    dark = ((cells >> wp.min(wp.max(column, 0), QR_SIDE - 1)) & 1) == 1
    return wp.where(inside and dark, BLACK, 1.0)


@wp.func
def _scaled(rgb: wp.vec3, factor: float) -> wp.vec3:
    return wp.vec3(
        wp.clamp(rgb[0] * factor, 0.0, 1.0),
        wp.clamp(rgb[1] * factor, 0.0, 1.0),
        wp.clamp(rgb[2] * factor, 0.0, 1.0),
    )


@wp.func
def textured(
    code: int, rgb: wp.vec3, across: float, up: float, u: float, v: float, signs: wp.array[float]
) -> wp.vec3:
    """Return the colour of a surface with its texture; see `shading.apply_textures`.

    Args:
        code: Texture code, see `models.types.shapes`.
        rgb: Its own colour.
        across: Position along the surface [m].
        up: Position up it [m].
        u: Position on the largest centred square of its face, from -1 to 1, to the right.
        v: The same, upwards.
        signs: Cells and colours of signs, see `sign_bits`.
    """
    kind = code % STRIDE
    number = code // STRIDE
    out = rgb
    if kind == BRICKS:
        out = _scaled(rgb, _brick(across, up))
    elif kind == TILES:
        out = _scaled(rgb, _tiles(across, up))
    elif kind == WOOD:
        out = _scaled(rgb, _wood(across, up))
    elif kind == CONCRETE:
        out = _scaled(rgb, _concrete(across, up))
    elif wp.abs(u) <= 1.0 and wp.abs(v) <= 1.0:
        if kind == HAZMAT:
            out = _hazmat(u, v, number, signs)
        else:
            grey = wp.float32(1.0)
            if kind == CHART:
                grey = _chart(u, v, number)
            elif kind == TAG:
                grey = _tag(u, v, number, signs)
            else:
                grey = _qr(u, v, number, signs)
            out = wp.vec3(grey, grey, grey)
    return out


@wp.func
def sign_position(local: wp.vec3, facing: wp.vec3, size: wp.vec3) -> wp.vec2:
    """Return the position on the largest centred square of a box's face: right and up; see `shading.on_face`.

    Args:
        local: The point in the box's frame [m].
        facing: The normal there, in the box's frame.
        size: Half lengths [m].
    """
    # Normals of a box are along one axis: the bound is between 0 and 1, with room for rounding.
    x = wp.abs(facing[0]) > 0.7
    y = wp.abs(facing[1]) > 0.7
    top = wp.abs(facing[2]) > 0.7
    right = wp.where(y, -wp.sign(facing[1]) * local[0], -local[1])
    right = wp.where(x, wp.sign(facing[0]) * local[1], right)
    right = wp.where(top, -wp.sign(facing[2]) * local[1], right)
    # Of a top seen from above, the box's x axis points up, and its y axis to the left.
    up = wp.where(top, local[0], local[2])
    wide = wp.where(y and not top, size[0], size[1])
    half = wp.max(wp.min(wide, wp.where(top, size[0], size[2])), 1.0e-6)
    return wp.vec2(right / half, up / half)
