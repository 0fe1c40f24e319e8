"""Procedural textures: brick, tiles, wood and concrete, and signs for detectors, without image files.

A texture is a function of position: for walls and floors in the world, so that neighbouring solids match, and
for signs on the face of their box. It has a name, with a number for signs (`tag:7`), and a code in arrays.
"""

from collections.abc import Callable, Collection

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import on_numpy, xp
from usarmjx.models.types.shapes import SIGNS, TEXTURES, decode_texture

QR_SIDE = 21
"""Cells along a side of a QR code."""
QR_RIM = 4
"""White cells around it, as the standard requires."""
QR_HEX = (
    "1fd97f822a0dd1d76eaebb7425d82320ff55fc000005d889150d5fdf565c64defdc9b00c167f2b4a0b3cd75a4bba0b35d6716098a7fc861",
    "1fd27f82ca0dd0576ea4bb75e5d82aa0ff55fc00c0024d3b5c33595682f848cc67d5b009977f136e08fcd74899bad37dd051609803fca28",
    "1fde7f82420dd3576eaebb7445d822a0ff55fc012005d989119359bf46527c5fb445b00af67f33ca0b0cd7534bba2b35d5e16099a7fc8e1",
    "1fd57f82a20dd2d76ea4bb7585d82b20ff55fc01e0024c3b58ad5f3692f6504d2e59b00f777f0bee08ccd74199baf37dd3c1609903fcaa8",
    "1fca7f828a0dd5976eaabb75b5d82b20ff55fc004004f8bec9560f137ccd790aa72f100e637f63a20bb9974e61ba1a65d79be09573fca8b",
    "1fdb7f821a0dd2176eb4bb7495d826a0ff55fc014005d589d53d5979267524de9799b00cfe7f380a0b2cd7528bba0535d7116089a7fc021",
    "1fc37f82ea0dd3576e96bb7435d82a20ff55fc02a001e7622c46367f1d047dfbd640900860ff7c3e0a4e975959ba345dd07a208803fc433",
    "1fc87f82aa0dd2576e9cbb74b5d82aa0ff55fc02e001e062657832bfed29757b4c5c900fa8ff4d3e0b8e975f19ba7e5dd25a208183fc433",
    "1fd57f82b20dd0176ea2bb7575d829a0ff55fc0000024f3bf98f5c35b2fd30cc95c5b00cdf7f316e0908d74319bafb7dd151609c83fce28",
    "1fca7f828a0dd3576e80bb74f5d82da0ff55fc024001ee62046a371abd0b55fa9d90900ce8ff64fe0a5a975559ba785dd1aa209503fc8f3",
)
"""Cells of the QR codes of the texts USARMJX 0 to USARMJX 9, row by row from the top left, dark as 1."""
BRICK, MORTAR, MORTAR_SHADE = (0.24, 0.08), 0.01, 0.55
"""Length and height of a brick with its joint, width of a joint [m], and brightness of the joint."""
TILE, GROUT, GROUT_SHADE = 0.3, 0.008, 0.45
"""Side of a tile with its joint, width of a joint [m], and brightness of the joint."""
PLANK = (1.2, 0.12)
"""Length and width of a plank [m]."""
GRAIN = (0.25, 0.008)
"""Length and width of wood grain [m]."""
STAINS = (0.4, 0.06)
"""Widths of coarse and fine stains of concrete [m]."""
WHITE, BLACK = np.ones((3, 1), np.float32), np.full((3, 1), 0.02, np.float32)
LANDOLT_RINGS = 5
"""Rings of a chart, each half as large as the one around it."""
HAZARD_RGB = np.array(
    [[0.95, 0.45, 0.05], [0.1, 0.55, 0.2], [0.85, 0.1, 0.1], [0.1, 0.3, 0.75], [0.95, 0.85, 0.1]], np.float32
)
"""Colours of the upper half of a hazmat label, by number: explosives, gas, fire, wet, oxidiser."""
TAG_BITS = np.array(
    [46386, 3994, 13101, 39238, 21662, 31181, 40494, 50418, 65242, 53078],
)
"""16 bits of each of the first ten markers of OpenCV's ArUco dictionary DICT_4X4_50, row by row."""
TAG_SIDE = 6
"""Cells along a side of a marker, black border included; one white cell is around it."""


def qr_cells() -> np.ndarray:
    """Return which cells are dark (codes, 21, 21), bool."""
    rows = [f"{int(digits, 16):0{QR_SIDE**2}b}" for digits in QR_HEX]
    return np.array([[bit == "1" for bit in row] for row in rows]).reshape(-1, QR_SIDE, QR_SIDE)


QR_CELLS = qr_cells()


def noise(i: Array, j: Array, salt: int) -> Array:
    """Return a hash of integers i and j in [0, 1) (...)."""
    mixed = i.astype(xp.uint32) * np.uint32(374761393) + j.astype(xp.uint32) * np.uint32(668265263)
    mixed = mixed + np.uint32(salt * 974711 + 1)
    mixed = (mixed ^ (mixed >> np.uint32(13))) * np.uint32(1274126177)
    mixed = (mixed ^ (mixed >> np.uint32(16))) * np.uint32(2246822519)
    return ((mixed >> np.uint32(8)) & np.uint32(0xFFFF)).astype(xp.float32) / np.float32(65536)


def smooth_noise(x: Array, y: Array, salt: int) -> Array:
    """Return value noise: hashes of the integer lattice, linearly interpolated (...)."""
    i, j = xp.floor(x).astype(xp.int32), xp.floor(y).astype(xp.int32)
    dx, dy = x - i, y - j
    low = noise(i, j, salt) * (1 - dx) + noise(i + 1, j, salt) * dx
    high = noise(i, j + 1, salt) * (1 - dx) + noise(i + 1, j + 1, salt) * dx
    return low * (1 - dy) + high * dy


def _brick(across: Array, up: Array) -> Array:
    row = xp.floor(up / BRICK[1]).astype(xp.int32)
    shifted = across / BRICK[0] + 0.5 * (row % 2)
    column = xp.floor(shifted).astype(xp.int32)
    joint = ((shifted - column) * BRICK[0] < MORTAR) | ((up / BRICK[1] - row) * BRICK[1] < MORTAR)
    grain = 0.92 + 0.16 * smooth_noise(across / 0.02, up / 0.02, 1)
    return xp.where(joint, MORTAR_SHADE, (0.7 + 0.45 * noise(column, row, 2)) * grain)


def _tiles(across: Array, up: Array) -> Array:
    i, j = xp.floor(across / TILE).astype(xp.int32), xp.floor(up / TILE).astype(xp.int32)
    joint = ((across / TILE - i) * TILE < GROUT) | ((up / TILE - j) * TILE < GROUT)
    veins = 0.9 + 0.2 * smooth_noise(across / 0.07, up / 0.07, 3)
    return xp.where(joint, GROUT_SHADE, (0.75 + 0.3 * noise(i, j, 4)) * veins)


def _wood(across: Array, up: Array) -> Array:
    row = xp.floor(up / PLANK[1]).astype(xp.int32)
    along = across / PLANK[0] + noise(row, row, 5)
    column = xp.floor(along).astype(xp.int32)
    gap = ((along - column) * PLANK[0] < 0.004) | ((up / PLANK[1] - row) * PLANK[1] < 0.004)
    grain = smooth_noise(across / GRAIN[0] + 7.0 * row, up / GRAIN[1], 6)
    return xp.where(gap, 0.35, (0.7 + 0.3 * noise(column, row, 7)) * (0.75 + 0.4 * grain))


def _concrete(across: Array, up: Array) -> Array:
    coarse = smooth_noise(across / STAINS[0], up / STAINS[0], 8)
    fine = smooth_noise(across / STAINS[1], up / STAINS[1], 9)
    pores = noise(xp.floor(across / 0.015).astype(xp.int32), xp.floor(up / 0.015).astype(xp.int32), 10)
    return (0.7 + 0.3 * coarse) * (0.8 + 0.3 * fine) * xp.where(pores > 0.97, 0.5, 1.0)


PATTERNS: dict[str, Callable[[Array, Array], Array]] = {
    "brick": _brick,
    "tiles": _tiles,
    "wood": _wood,
    "concrete": _concrete,
}
"""Factors on a surface's colour, by positions along it and up it [m] (rays,)."""


def _chart(u: Array, v: Array, number: Array) -> Array:
    """Draw nested Landolt rings: five strokes wide, ring and gap one stroke, in one of 8 directions."""
    dark, radius = xp.zeros(u.shape, bool), xp.hypot(u, v)
    for ring in range(LANDOLT_RINGS):
        outer = 0.95 * 0.5**ring
        turn = xp.floor(8 * noise(xp.asarray(number), xp.full_like(number, ring), 11)) * (np.pi / 4)
        ahead = u * xp.cos(turn) + v * xp.sin(turn)
        aside = v * xp.cos(turn) - u * xp.sin(turn)
        gap = (ahead > 0) & (xp.abs(aside) < outer / 5)
        dark |= (radius <= outer) & (radius >= 0.6 * outer) & ~gap
    return xp.where(dark, BLACK, WHITE)


def _hazmat(u: Array, v: Array, number: Array) -> Array:
    """Draw a diamond with a black rim: class colour and disc above, as many bars as its class below."""
    away = xp.abs(u) + xp.abs(v)
    colour = xp.asarray(HAZARD_RGB).T[:, (number - 1) % len(HAZARD_RGB)]
    disc = xp.hypot(u, v - 0.35) < 0.2
    bar = xp.floor((u + 0.3) / 0.12)
    bars = (bar >= 0) & (bar < number) & (u + 0.3 - 0.12 * bar < 0.07) & (xp.abs(v + 0.35) < 0.12)
    inner = xp.where(v > 0, xp.where(disc, BLACK, colour), xp.where(bars, BLACK, WHITE))
    return xp.where(away > 0.95, 0.8 * WHITE, xp.where(away > 0.88, BLACK, inner))


def _tag(u: Array, v: Array, number: Array) -> Array:
    """Draw an ArUco marker of 4 x 4 cells with its black border and a white one around it."""
    cells = TAG_SIDE + 2
    column = xp.clip(xp.floor((u + 1) / 2 * cells), 0, cells - 1).astype(xp.int32) - 2
    row = xp.clip(xp.floor((1 - v) / 2 * cells), 0, cells - 1).astype(xp.int32) - 2
    inside = (column >= 0) & (column < 4) & (row >= 0) & (row < 4)
    place = xp.clip(15 - (4 * row + column), 0, 15)
    bit = (xp.asarray(TAG_BITS)[number % len(TAG_BITS)] >> place) & 1
    rim = (column < -1) | (column > 4) | (row < -1) | (row > 4)
    return xp.where(rim | (inside & (bit == 1)), WHITE, BLACK)


def _qr(u: Array, v: Array, number: Array) -> Array:
    """Draw a QR code with a white rim."""
    cells = QR_SIDE + 2 * QR_RIM
    column = xp.floor((u + 1) / 2 * cells).astype(xp.int32) - QR_RIM
    row = xp.floor((1 - v) / 2 * cells).astype(xp.int32) - QR_RIM
    inside = (column >= 0) & (column < QR_SIDE) & (row >= 0) & (row < QR_SIDE)
    place = (number % len(QR_CELLS), xp.clip(row, 0, QR_SIDE - 1), xp.clip(column, 0, QR_SIDE - 1))
    return xp.where(inside & xp.asarray(QR_CELLS)[place], BLACK, WHITE)


DRAWINGS: dict[str, Callable[[Array, Array, Array], Array]] = {
    "chart": _chart,
    "hazmat": _hazmat,
    "tag": _tag,
    "qr": _qr,
}
"""Colours of signs (3, rays), by positions on them from -1 to 1, right and up, and numbers (rays,)."""


def on_face(pos: Array, mat: Array, size: Array, point: Array, normal: Array) -> tuple[Array, Array]:
    """Return positions of points on the largest centred square of a box's face: right and up, -1 to 1.

    Up is the box's z on its sides, its x on its top and bottom; right is as seen by a viewer in front.

    Args:
        pos: Positions of the boxes [m] (rays, 3).
        mat: Orientations (rays, 3, 3).
        size: Half lengths [m] (rays, 3).
        point: The points [m] (3, rays).
        normal: Normals there (3, rays).
    """
    local = [sum(mat[:, j, i] * (point[j] - pos[:, j]) for j in range(3)) for i in range(3)]
    facing = [sum(mat[:, j, i] * normal[j] for j in range(3)) for i in range(3)]
    x, y, top = (xp.abs(one) > 0.7 for one in facing)
    right = xp.where(x, xp.sign(facing[0]) * local[1], xp.where(y, -xp.sign(facing[1]) * local[0], -local[1]))
    right = xp.where(top, -xp.sign(facing[2]) * local[1], right)
    up = xp.where(top, local[0], local[2])
    wide = xp.where(y & ~top, size[:, 0], size[:, 1])
    half = xp.maximum(xp.minimum(wide, xp.where(top, size[:, 0], size[:, 2])), 1e-6)
    return right / half, up / half


def apply_textures(
    names: Collection[str], code: Array, rgb: Array, place: tuple[Array, Array], sign: tuple[Array, Array]
) -> Array:
    """Return the colours of surfaces with their textures (3, rays).

    Args:
        names: Textures that occur.
        code: Texture code of each surface, see `models.types.shapes` (rays,).
        rgb: Their own colours (3, rays).
        place: Positions along and up the surfaces [m], both (rays,).
        sign: Positions on the largest centred square of their face, from -1 to 1, both (rays,).
    """
    kind, number = decode_texture(code)
    for index, name in enumerate(TEXTURES, start=1):
        if name not in names:
            continue
        at, there = place, kind == index
        if name in SIGNS:
            at, there = sign, there & (xp.abs(sign[0]) <= 1) & (xp.abs(sign[1]) <= 1)
        if on_numpy():  # compute each texture only at its own rays
            rays = np.flatnonzero(there)
            rgb = np.array(rgb)
            rgb[:, rays] = _drawn(name, rgb[:, rays], (at[0][rays], at[1][rays]), number[rays])
        else:
            rgb = xp.where(there, _drawn(name, rgb, at, number), rgb)
    return rgb


def _drawn(name: str, rgb: Array, at: tuple[Array, Array], number: Array) -> Array:
    """Return the colours of surfaces (3, rays) that all have one texture."""
    if name in SIGNS:
        return DRAWINGS[name](*at, number)
    return xp.clip(rgb * PATTERNS[name](*at), 0, 1)
