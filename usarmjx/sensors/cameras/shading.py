"""Shading: the colours that rays see, for cameras and for still pictures.

A surface has ambient light, that of the sun or of the brightest lamp there, and that of the brightest
headlight there, the latter two unless blocked. Mirrors reflect once; glass and water blend their own colour
with the background, and cast no shadows. Floors have checkers, and the arena's solids a faint brick pattern,
for visible structure.

Textures are procedural: brick, tiles, wood, concrete, and signs for detectors, without image files. A texture
is a function of position: for walls and floors in the world, so that neighbouring solids match, and for signs
on the face of their box. It has a name, with a number for signs (`tag:7`), and a code in arrays.
"""

import math
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import jax
import numpy as np

from usarmjx.base.backend import Array, on_numpy, xp
from usarmjx.base.nodes import Node
from usarmjx.base.transforms import Vec3
from usarmjx.models.types.arena import Light
from usarmjx.models.types.shapes import GLASS, MIRROR, SIGNS, TEXTURES, decode_texture
from usarmjx.sensors.cameras.casters import PANE_QUERY, SOLID_QUERY, Beams, Caster, GeomCaster, RayHits
from usarmjx.sensors.cameras.paint import ARENA_LABEL, SKY_LABEL, GeomAppearance
from usarmjx.sensors.rays.targets import Geoms

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
    # Unsigned integers wrap around alike in NumPy, XLA and Warp, so pictures are the same on all of them.
    mixed = i.astype(xp.uint32) * np.uint32(374761393) + j.astype(xp.uint32) * np.uint32(668265263)
    mixed = mixed + np.uint32(salt * 974711 + 1)
    mixed = (mixed ^ (mixed >> np.uint32(13))) * np.uint32(1274126177)
    mixed = (mixed ^ (mixed >> np.uint32(16))) * np.uint32(2246822519)
    # 16 bits are exact in single precision.
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
    # Every other row is shifted by half a brick.
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
    # Rows begin at places of their own, so that no joints line up.
    along = across / PLANK[0] + noise(row, row, 5)
    column = xp.floor(along).astype(xp.int32)
    gap = ((along - column) * PLANK[0] < 0.004) | ((up / PLANK[1] - row) * PLANK[1] < 0.004)
    # A shift by row gives each plank a grain of its own.
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
        # From the sign's number: the same chart has the same gaps in every run.
        turn = xp.floor(8 * noise(xp.asarray(number), xp.full_like(number, ring), 11)) * (np.pi / 4)
        ahead = u * xp.cos(turn) + v * xp.sin(turn)
        aside = v * xp.cos(turn) - u * xp.sin(turn)
        gap = (ahead > 0) & (xp.abs(aside) < outer / 5)
        # A stroke is a fifth of the diameter: the ring ends at three fifths of its outer radius.
        dark |= (radius <= outer) & (radius >= 0.6 * outer) & ~gap
    return xp.where(dark, BLACK, WHITE)


def _hazmat(u: Array, v: Array, number: Array) -> Array:
    """Draw a diamond with a black rim: class colour and disc above, as many bars as its class below."""
    away = xp.abs(u) + xp.abs(v)
    # Hazard classes are numbered from 1.
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
    # Cells count from the top left, the highest bit first.
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
    # Clipped to valid cells; beyond the code the result is dropped.
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
    # 0.7 is just below the cosine of 45 degrees: of a box's face exactly one axis is above it.
    x, y, top = (xp.abs(one) > 0.7 for one in facing)
    # Signs by the side, or lettering on opposite faces would be mirrored.
    right = xp.where(x, xp.sign(facing[0]) * local[1], xp.where(y, -xp.sign(facing[1]) * local[0], -local[1]))
    right = xp.where(top, -xp.sign(facing[2]) * local[1], right)
    up = xp.where(top, local[0], local[2])
    wide = xp.where(y & ~top, size[:, 0], size[:, 1])
    # Rays that met nothing read some geom, which may have a size of 0.
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
        # Textures that do not occur cost nothing: `names` is known while a program is compiled.
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


AMBIENT, DIFFUSE = 0.45, 0.6
"""Ambient daylight, and sunlight on a surface that faces the sun."""
INDOOR_AMBIENT = 0.3
"""Ambient light in an arena with lamps."""
INDOOR_GAIN = 2.5
"""Gain of cameras on dark colours in arenas with lamps (chosen); see `tone_mapped`."""
SUN_DIRECTION: Vec3 = (0.45, 0.35, 0.82)
"""Direction to the sun, not normalised."""
AMBIENT_GRADIENT = np.array([0.12, -0.08, 0.2], np.float32) / AMBIENT
"""Relative change of ambient light with a surface's normal, so that faces in shadow differ."""
MIN_LIGHT_DISTANCE = 0.25
"""Lower bound of a light's distance [m]."""
SPOT_OUTER_ANGLE, SPOT_INNER_ANGLE = math.radians(30.0), math.radians(20.0)
"""Half angles of a headlight's cone and of its bright core (chosen) [rad]."""
HEADLIGHT_BRIGHTNESS = 2.0
"""Brightness of a headlight at 1 m, as `Light.brightness` (chosen)."""
SKY_RGB = np.array([0.93, 0.95, 0.97], np.float32)
"""Colour of the sky by day."""
NIGHT_RGB = np.array([0.1, 0.11, 0.14], np.float32)
"""Colour of the sky above arenas with lamps."""
CHECKER_RGB = np.array([[0.86, 0.86, 0.84], [0.78, 0.78, 0.76]], np.float32)
"""Colours of the floor's checkers."""
FLOOR_RGB = np.array([0.87, 0.88, 0.88], np.float32)
"""Colour of the floor beyond the checkers."""
BRICK_CONTRAST = 0.03
"""Relative brightness change of the brick pattern on the arena's solids."""
RAY_BIAS, RAY_BIAS_PER_METRE = 5e-4, 3e-5
"""Offset of secondary rays from their surface [m], and its increase per metre of the primary ray."""
MIN_LIGHT = 1e-3
"""Brightness below which light is ignored."""
Darkness = Callable[[Beams], Array]
"""Shadow test, as `Caster.is_dark`."""


class PointLights(Node, kw_only=True):
    """Lamps of an arena.

    Attributes:
        pos: World positions [m] (n, 3).
        rgb: Colour times brightness at 1 m; zero for padding (n, 3).
    """

    pos: Array
    rgb: Array


class Headlights(Node, kw_only=True):
    """Headlights of the robots.

    Attributes:
        pos: Positions [m] (n, 3).
        direction: Directions, unit vectors (n, 3).
        on: Which are on (n,).
        label: Label of the robot, which casts no shadow in its own light (n,).
    """

    pos: Array
    direction: Array
    on: Array
    label: Array


def no_headlights() -> Headlights:
    """Return an empty set of headlights."""
    none = np.zeros((0, 3), np.float32)
    return Headlights(pos=none, direction=none, on=np.zeros(0, bool), label=np.zeros(0, np.int32))


def point_lights(lights: Sequence[Light], floor: float) -> PointLights:
    """Return the lamps of an arena; NumPy arrays."""
    pos = [np.add(light.at, (0.0, 0.0, floor)) for light in lights]
    rgb = [np.multiply(light.rgb, light.brightness) for light in lights]
    return PointLights(
        pos=np.array(pos, np.float32).reshape(-1, 3), rgb=np.array(rgb, np.float32).reshape(-1, 3)
    )


def daylight(lamps: PointLights) -> Array:
    """Return 1 if the sun lights the arena, 0 if it has lamps ()."""
    # By the values, not by the number of lamps: arenas of a batch are padded with dark ones.
    return 1.0 - (xp.asarray(lamps.rgb) > 0).any().astype(xp.float32)


def shadow_gain(lamps: PointLights) -> Array:
    """Return the gain of cameras on dark colours in an arena's light ()."""
    return xp.where(daylight(lamps) > 0, 1.0, INDOOR_GAIN)


def tone_mapped(rgb: Array, gain: Array | float) -> Array:
    """Return colours with a gain of `gain` near black and 1 at white; arguments and result in [0, 1]."""
    return gain * rgb / (1 + (gain - 1) * rgb)


def distance_falloff(distance: Array) -> Array:
    """Return a light's brightness at a distance [m], relative to 1 m."""
    return 1.0 / xp.square(xp.maximum(distance, MIN_LIGHT_DISTANCE))


def spot_falloff(cosine: Array) -> Array:
    """Return a headlight's brightness off its axis, from 1 in its core to 0 at the edge of its cone."""
    edge, core = math.cos(SPOT_OUTER_ANGLE), math.cos(SPOT_INNER_ANGLE)
    share = xp.clip((cosine - edge) / (core - edge), 0.0, 1.0)
    return share * share * (3 - 2 * share)


class RenderScene(Node, kw_only=True):
    """Everything visible in one world.

    Attributes:
        geoms: The geoms; for whole worlds with the owners of `paint.robot_geom_owner`.
        appearance: Their appearance.
        sun_direction: Direction to the sun, a unit vector (3,).
        lights: The arena's lamps; with any, there is no sun.
        headlights: The robots' headlights.
        checker_size: Side of the floor's checkers [m] ().
        checker_bounds: Area of the checkers: least and largest x and y [m] (2, 2).
        exposure: Factor on all reflected light ().
        gain: Gain on dark colours, see `tone_mapped` ().
        seed: Seed of the noise of pictures, different for each world and moment ().
    """

    geoms: Geoms
    appearance: GeomAppearance
    sun_direction: Array
    lights: PointLights
    headlights: Headlights
    checker_size: Array
    checker_bounds: Array
    exposure: Array | float = 1.0
    gain: Array | float = 1.0
    seed: Array | int = 0


class Shaded(NamedTuple):
    """Shaded rays.

    Attributes:
        rgb: Colours in [0, 1] (rays, 3).
        distance: Distances, infinite for the sky; glass does not count [m] (rays,).
        label: Labels, see `paint` (rays,).
    """

    rgb: Array
    distance: Array
    label: Array


class _Surface(NamedTuple):
    """Surfaces at the hits of rays.

    Vectors have their components first, for vectorisation: (3, rays).

    Attributes:
        hits: Whether the ray hits anything (rays,).
        geom_index: Index of the geom (rays,).
        point: Point just off the surface [m] (3, rays).
        normal: Surface normal, towards the ray (3, rays).
        rgb: Colour of the surface (3, rays).
    """

    hits: Array
    geom_index: Array
    point: Array
    normal: Array
    rgb: Array


def shade(
    render_scene: RenderScene,
    origin: Array,
    direction: Array,
    exclude_owner: Array,
    caster: Caster | None = None,
) -> Shaded:
    """Shade rays.

    Args:
        render_scene: The scene.
        origin: Origins [m] (rays, 3).
        direction: Unit vectors (rays, 3).
        exclude_owner: Owner whose geoms the rays pass; `EXCLUDE_NONE`: none ().
        caster: Ray caster with the geoms' appearance; None: JAX, on those of `render_scene`.
    """
    caster = caster or GeomCaster(render_scene.geoms, render_scene.appearance, exclude_owner)
    appearance = caster.appearance
    first = caster.from_camera(origin, direction, SOLID_QUERY)
    surface = _surface(render_scene, caster, first, origin, direction)
    rgb = _lit(render_scene, caster, surface)
    # Static: an arena without mirrors compiles no second set of rays.
    if MIRROR in caster.materials:
        gloss = xp.where(surface.hits, xp.asarray(appearance.reflectance)[surface.geom_index], 0.0)
        rgb = _change_if(
            (gloss > 0).any(),
            lambda rgb: _reflected(render_scene, caster, surface, direction, gloss, rgb),
            rgb,
        )
    if GLASS in caster.materials:
        pane = caster.from_camera(origin, direction, PANE_QUERY)
        # Panes behind the first solid surface are hidden.
        pane = pane._replace(geom_index=xp.where(pane.distance < first.distance, pane.geom_index, -1))
        rgb = _change_if(
            (pane.geom_index >= 0).any(),
            lambda rgb: _behind_panes(render_scene, caster, pane, origin, direction, rgb),
            rgb,
        )
    label = xp.where(surface.hits, xp.asarray(appearance.label)[surface.geom_index], SKY_LABEL)
    return Shaded(rgb.T, first.distance, label)


def _change_if(needed: Array | np.bool, change: Callable[[Array], Array], value: Array) -> Array:
    """Apply a change if needed; on JAX by `lax.cond`."""
    if on_numpy():
        return change(value) if needed else value
    return jax.lax.cond(needed, change, lambda value: value, value)


def _dot(a: Array, b: Array) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _reflected(
    render_scene: RenderScene, caster: Caster, surface: _Surface, along: Array, gloss: Array, rgb: Array
) -> Array:
    """Return colours with mirror reflections, in which a camera sees all of its robot."""
    ahead, start = along.T, surface.point.T
    back = (ahead - 2 * _dot(ahead, surface.normal) * surface.normal).T
    first = caster.from_surfaces(start, back, gloss > 0)
    mirrored = _lit(render_scene, caster, _surface(render_scene, caster, first, start, back))
    return xp.where(gloss > 0, (1 - gloss) * rgb + gloss * mirrored, rgb)


def _behind_panes(
    render_scene: RenderScene, caster: Caster, pane: RayHits, start: Array, along: Array, rgb: Array
) -> Array:
    """Return colours blended with the panes in front of them, which are lit without shadows."""
    surface = _surface(render_scene, caster, pane, start, along)
    clear = xp.asarray(caster.appearance.transparency)[surface.geom_index]
    seen = (1 - clear) * _lit(render_scene, caster, surface, shadows=False) + clear * rgb
    return xp.where(surface.hits, seen, rgb)


def _surface(
    render_scene: RenderScene, caster: Caster, first: RayHits, start: Array, along: Array
) -> _Surface:
    # Misses read the first geom, since arrays have no entry for none; their values are dropped.
    hits, which = first.geom_index >= 0, xp.maximum(first.geom_index, 0)
    reach = xp.where(hits, first.distance, 0.0)
    point, normal = start.T + reach * along.T, caster.normals(first, start, along).T
    appearance = caster.appearance
    of_floor = xp.asarray(caster.is_plane)[which]
    bricks = (xp.asarray(appearance.label)[which] == ARENA_LABEL) & ~of_floor
    shade = xp.where(bricks, 1 + BRICK_CONTRAST * _bricks(render_scene, point, normal), 1.0)
    rgb = xp.asarray(appearance.rgb).T[:, which] * shade
    rgb = xp.where(of_floor, _checkers(render_scene, point), rgb)
    if appearance.texture is not None:
        rgb = _with_textures(caster, first, point, normal, rgb)
    # Off the surface, or its own rounding errors would shade it; these grow with the distance.
    return _Surface(hits, which, point + (RAY_BIAS + RAY_BIAS_PER_METRE * reach) * normal, normal, rgb)


def _with_textures(caster: Caster, first: RayHits, point: Array, normal: Array, rgb: Array) -> Array:
    """Return colours (3, rays) with textures instead of bricks."""
    appearance, which = caster.appearance, xp.maximum(first.geom_index, 0)
    code = xp.where(first.geom_index >= 0, xp.asarray(appearance.texture)[which], 0)
    plain = xp.asarray(appearance.rgb).T[:, which]
    # 0.7 as in `on_face`: faces steeper than 45 degrees are walls.
    level = xp.abs(normal[2]) > 0.7
    side = point[1] * normal[0] - point[0] * normal[1]  # along a wall
    place = xp.where(level, point[0], side), xp.where(level, point[1], point[2])
    sign = on_face(*caster.frames(which), point, normal) if SIGNS.keys() & appearance.textures else place
    return xp.where(code > 0, apply_textures(appearance.textures, code, plain, place, sign), rgb)


def _checkers(render_scene: RenderScene, point: Array) -> Array:
    """Return the floor's colour at points (3, rays)."""
    x, y = point[0], point[1]
    odd = (xp.floor(x / render_scene.checker_size) + xp.floor(y / render_scene.checker_size)).astype(
        xp.int32
    ) % 2 == 1
    (x0, x1), (y0, y1) = render_scene.checker_bounds
    within = (x > x0) & (x < x1) & (y > y0) & (y < y1)
    light, dark = CHECKER_RGB[:, :, None]
    return xp.where(within, xp.where(odd, dark, light), FLOOR_RGB[:, None])


def _bricks(render_scene: RenderScene, point: Array, normal: Array) -> Array:
    """Return -1 or 1 alternating along a surface: bricks half as high as long on walls, squares on ground."""
    level = xp.abs(normal[2]) > 0.7
    side = point[1] * normal[0] - point[0] * normal[1]  # along a wall
    across = xp.where(level, point[0], side) / render_scene.checker_size
    up = xp.where(level, point[1], 2 * point[2]) / render_scene.checker_size
    return 1.0 - 2.0 * ((xp.floor(across) + xp.floor(up)).astype(xp.int32) % 2)


def _lit(render_scene: RenderScene, caster: Caster, surface: _Surface, *, shadows: bool = True) -> Array:
    """Return the colours of lit surfaces (3, rays), and of the sky without a hit."""
    day = daylight(render_scene.lights)
    everywhere = xp.where(day > 0, AMBIENT, INDOOR_AMBIENT) * (
        1 + _dot(surface.normal, xp.asarray(AMBIENT_GRADIENT))
    )
    dark = caster.is_dark if shadows else None
    light = everywhere + _main_light(render_scene, surface, day, dark)
    if len(render_scene.headlights.on):
        on = xp.asarray(render_scene.headlights.on).any()
        light = _change_if(on, lambda light: light + _headlight(render_scene, surface, dark), light)
    sky = xp.where(day > 0, SKY_RGB, NIGHT_RGB)[:, None]
    # Clipped before tone mapping, which is defined on [0, 1] only.
    lit = xp.clip(surface.rgb * (light * render_scene.exposure), 0, 1)
    return xp.where(surface.hits, tone_mapped(lit, render_scene.gain), sky)


def _main_light(render_scene: RenderScene, surface: _Surface, day: Array, dark: Darkness | None) -> Array:
    """Return the light of the sun, or of the brightest lamp at each surface (3, rays)."""
    sun, lights = xp.asarray(render_scene.sun_direction), render_scene.lights
    # A face turned away from the light gets none, where the product would be negative.
    facing = xp.maximum(_dot(surface.normal, sun), 0.0)
    best = DIFFUSE * 3 * day * facing  # of all three colours together
    colour = xp.broadcast_to(xp.ones((3, 1)) / 3, surface.point.shape)
    toward = xp.broadcast_to(sun[:, None], surface.point.shape)
    away, source = xp.full(len(best), xp.inf), xp.full(len(best), -1)
    for number, (pos, rgb) in enumerate(zip(lights.pos, lights.rgb, strict=True)):
        way, distance = _way(surface.point, pos)
        total = rgb.sum()
        lamp = total * xp.maximum(_dot(surface.normal, way), 0.0) * distance_falloff(distance)
        # Only the brightest lamp casts a shadow: a ray to each of them would cost as much as the picture.
        more = lamp > best
        best, toward = xp.where(more, lamp, best), xp.where(more, way, toward)
        away, source = xp.where(more, distance, away), xp.where(more, number, source)
        # Padding lamps are black, and their colour would be 0 / 0.
        colour = xp.where(more, rgb[:, None] / xp.maximum(total, MIN_LIGHT), colour)
    if dark is not None:
        wanted = surface.hits & (best > MIN_LIGHT)
        best = best * ~dark(Beams(wanted, surface.point, toward, away, source, lights.pos, sun))
    return best * colour


def _headlight(render_scene: RenderScene, surface: _Surface, dark: Darkness | None) -> Array:
    """Return the light of the brightest headlight at each surface (rays,), not blocked by its own robot."""
    best, toward = xp.zeros(len(surface.hits)), xp.zeros_like(surface.point)
    away, source = xp.zeros(len(surface.hits)), xp.zeros(len(surface.hits), xp.int32)
    lights = render_scene.headlights
    for number, (pos, along, on) in enumerate(zip(lights.pos, lights.direction, lights.on, strict=True)):
        way, distance = _way(surface.point, pos)
        # The light shines away from the lamp, `way` points to it.
        own = xp.maximum(_dot(surface.normal, way), 0.0) * spot_falloff(-_dot(way, along))
        own = own * HEADLIGHT_BRIGHTNESS * distance_falloff(distance) * on
        more = own > best
        best, away = xp.where(more, own, best), xp.where(more, distance, away)
        toward, source = xp.where(more, way, toward), xp.where(more, number, source)
    if dark is not None:
        wanted, sun = surface.hits & (best > MIN_LIGHT), render_scene.sun_direction
        beams = Beams(wanted, surface.point, toward, away, source, lights.pos, sun, lights.label)
        best = best * (wanted & ~dark(beams))
    return best


def _way(point: Array, to: Array) -> tuple[Array, Array]:
    """Return unit vectors from points (3, rays) to a position (3,), and the distances [m] (rays,)."""
    way = xp.asarray(to)[:, None] - point
    distance = xp.sqrt(_dot(way, way))
    return way / xp.maximum(distance, 1e-9), distance
