"""Pictures' colours on Warp: a warp of threads shades a bundle of camera rays, from the first hit on.

What `shading` computes in arrays of all rays, a lane keeps in registers: first hit, surface, light, shadows.
Mirrors and panes, which few bundles see, have a kernel of their own.
"""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp

from usarmjx.base.backend import Array
from usarmjx.base.errors import UsageError
from usarmjx.base.warp_functions import warp_function
from usarmjx.models.types.shapes import GLASS, MIRROR
from usarmjx.sensors.cameras import shading
from usarmjx.sensors.cameras.casters import PANE_QUERY, SOLID_QUERY
from usarmjx.sensors.cameras.lighting_warp import (
    HEADER,
    NO_OWNER,
    first_in_cone,
    light_at,
    lit_color,
)
from usarmjx.sensors.cameras.paint import SKY_LABEL, GeomAppearance
from usarmjx.sensors.cameras.surfaces_warp import WarpScene, surface_at
from usarmjx.sensors.cameras.textures_warp import sign_bits
from usarmjx.sensors.rays.raycast import IndexedBlock, indexed_blocks
from usarmjx.sensors.rays.raycast_warp import (
    GROUP_SIZE,
    MAX_BUNDLE,
    WarpBest,
    WarpCone,
    WorldGeoms,
    address_of,
    any_lane,
    cone_about,
    first_lane,
    from_lane,
    geom_row,
    integer_quotient,
    lanes,
    lanes_in_which,
    load_vec4,
    nearest_geom,
    pack,
    thread_index,
)
from usarmjx.sensors.rays.targets import merge_vmaps
from usarmjx.sensors.rays.warp_launches import MAX_THREADS, UNLIMITED_DISTANCE

if TYPE_CHECKING:
    from usarmjx.sensors.cameras.shading import RenderScene, Shaded

wp.set_module_options({"enable_backward": False, "fast_math": True})

BLOCK_DIM = 64
"""Threads of a block."""
REGISTERS = 80
"""Most registers of a thread: with 64 or 128 an H200 draws 2 and 9 % fewer pictures a second."""
UNLIMITED = wp.constant(UNLIMITED_DISTANCE)
SKY = wp.constant(float(SKY_LABEL))
SKY_RGB = wp.constant(wp.vec3(*(float(x) for x in shading.SKY_RGB)))
NIGHT_RGB = wp.constant(wp.vec3(*(float(x) for x in shading.NIGHT_RGB)))


@wp.struct
class WarpShaded:
    """Hit of a lane's ray, and its surface.

    Attributes:
        rgb: Colour, that of the sky without a hit.
        label: Label.
        share: See `WarpSurface`; 0 without a hit.
    """

    rgb: wp.vec3
    label: float
    share: float


@wp.func
def _look_at(
    hit: WarpBest,
    scene: WarpScene,
    base: int,
    look: int,
    start: wp.vec3,
    along: wp.vec3,
    shadows: bool,
) -> WarpShaded:
    """Return what a ray sees at its hit; the geoms begin at row `base`, their colours at row `look`."""
    head = load_vec4(scene.lights, scene.light)
    mood = load_vec4(scene.lights, scene.light + 1)
    out = WarpShaded()
    out.rgb = wp.where(mood[1] > 0.0, SKY_RGB, NIGHT_RGB)
    out.label = SKY
    out.share = 0.0
    met = hit.geom >= 0.0
    # By the warp and not by the lane: shadow rays below use shuffles, for which all lanes must be there.
    if any_lane(met):
        slot = int(wp.max(hit.geom, 0.0))
        reach = wp.where(met, hit.distance, 0.0)
        surface = surface_at(scene, base + geom_row(slot), look + slot, start, along, reach)
        bright = light_at(scene, met, shadows, surface.point, surface.normal)
        if met:
            out.rgb = lit_color(surface.rgb, bright, head[3], mood[0])
            out.label = surface.label
            out.share = surface.share
    return out


@wp.func
def _scene_of(  # noqa: PLR0913 - those of the kernels
    geoms: wp.array[wp.vec4],
    lights: wp.array[wp.vec4],
    signs: wp.array[float],
    world: int,
    cast: int,
    lane: int,
    wide: int,
    solids: int,
    panes: int,
    lamps: int,
    headlights: int,
) -> WarpScene:
    # Solids and panes are padded to whole groups separately.
    groups = ((solids + 31) >> 5) + ((panes + 31) >> 5)
    scene = WarpScene()
    scene.geoms = geoms
    scene.lights = lights
    scene.signs = signs
    # Each group has 32 rows more, those of its geoms' colours, which stand behind all groups of a world.
    scene.first = world * groups * (GROUP_SIZE + 32)
    scene.paint = scene.first + groups * GROUP_SIZE
    scene.wide = wide
    scene.solids = solids
    scene.light = cast * (HEADER + 2 * lamps + 2 * headlights)
    scene.lamps = lamps
    scene.headlights = headlights
    # Without a GPU a warp has one lane, number 0.
    scene.lane = lane & (lanes() - 1)
    return scene


@wp.func
def _geoms_at(geoms: wp.array[wp.vec4], first: int) -> WorldGeoms:
    """Return the geoms of a world from a row on."""
    world = WorldGeoms()
    world.own = address_of(geoms, first)
    # With an empty range of fixed geoms all are own ones.
    world.fixed = world.own
    world.begin = 0
    world.end = 0
    return world


@wp.func
def _ray_of(thread: int, cast: int, rays: int, bundles: int) -> int:
    """Return the index of a thread's ray; those past a picture's end cast its last."""
    begin = ((thread >> 5) - cast * bundles) * 32
    return cast * rays + wp.min(begin + (thread & 31), rays - 1)


@wp.kernel(enable_backward=False, grid_stride=False, cuda_max_registers=REGISTERS)
def shade_rays(  # noqa: PLR0913 - a kernel's arguments are its buffers
    geoms: wp.array[wp.vec4],
    world: wp.array[int],
    exclude: wp.array[int],
    lights: wp.array[wp.vec4],
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    signs: wp.array[float],
    wide: int,
    solids: int,
    panes: int,
    lamps: int,
    headlights: int,
    rays: int,
    bundles: int,
    rgb: wp.array[wp.vec3],
    distance: wp.array[float],
    label: wp.array[int],
    geom: wp.array[int],
) -> None:
    """Shade rays, without reflections and panes; a warp per bundle of 32 and picture.

    See `packed_scene` and `packed_lights`.
    """
    t = thread_index(wp.tid())
    cast = integer_quotient(t >> 5, bundles)
    ray = _ray_of(t, cast, rays, bundles)
    scene = _scene_of(geoms, lights, signs, world[cast], cast, t, wide, solids, panes, lamps, headlights)
    start = origin[ray]
    along = direction[ray]
    passed = float(exclude[cast])
    world_of_cast = _geoms_at(geoms, scene.first)
    hit = nearest_geom(world_of_cast, wide, solids, scene.lane, start, along, True, passed, UNLIMITED)
    distance[ray] = hit.distance
    geom[ray] = int(hit.geom)
    seen = _look_at(hit, scene, scene.first, scene.paint, start, along, True)
    rgb[ray] = seen.rgb
    label[ray] = int(seen.label)


@wp.struct
class WarpRay:
    """Ray of a lane: origin [m], unit vector and reach [m]."""

    start: wp.vec3
    along: wp.vec3
    reach: float


@wp.func
def _hit_in(
    scene: WarpScene, base: int, boxes: int, count: int, cone: WarpCone, ray: WarpRay, passed: float
) -> WarpBest:
    """Return the first hit of a lane's ray, of those with a reach, among the geoms from row `base` on."""
    asked = ray.reach > 0.0
    return first_in_cone(
        scene.geoms,
        base,
        boxes,
        count,
        scene.lane,
        cone,
        asked,
        ray.start,
        ray.along,
        passed,
        ray.reach,
        True,
    )


@wp.func
def _mirrored(scene: WarpScene, slot: int, ray: WarpRay, mirrors: wp.uint32, wanted: bool) -> WarpRay:
    """Return the reflection of a lane's ray in the geom that it hits at its reach.

    Lanes that want none get the ray of one that does, with no reach, so that the bundle stays narrow.
    """
    reach = wp.where(wanted, ray.reach, 0.0)
    at = scene.first + geom_row(slot)
    surface = surface_at(scene, at, scene.paint + slot, ray.start, ray.along, reach)
    back = ray.along - 2.0 * wp.dot(ray.along, surface.normal) * surface.normal
    point = surface.point
    leader = first_lane(mirrors)
    out = WarpRay()
    out.start = wp.vec3(from_lane(point[0], leader), from_lane(point[1], leader), from_lane(point[2], leader))
    out.along = wp.vec3(from_lane(back[0], leader), from_lane(back[1], leader), from_lane(back[2], leader))
    out.reach = 0.0
    if wanted:
        out.start = point
        out.along = back
        out.reach = UNLIMITED
    return out


@wp.kernel(enable_backward=False, grid_stride=False, cuda_max_registers=REGISTERS)
def shade_mirrors_and_panes(  # noqa: PLR0913 - as above
    geoms: wp.array[wp.vec4],
    world: wp.array[int],
    exclude: wp.array[int],
    lights: wp.array[wp.vec4],
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    signs: wp.array[float],
    before: wp.array[wp.vec3],
    distance: wp.array[float],
    geom: wp.array[int],
    wide: int,
    solids: int,
    panes: int,
    lamps: int,
    headlights: int,
    rays: int,
    bundles: int,
    rgb: wp.array[wp.vec3],
) -> None:
    """Add what mirrors reflect, and then panes, to the colours of rays; threads are those of `shade_rays`."""
    t = thread_index(wp.tid())
    cast = integer_quotient(t >> 5, bundles)
    number = _ray_of(t, cast, rays, bundles)
    scene = _scene_of(geoms, lights, signs, world[cast], cast, t, wide, solids, panes, lamps, headlights)
    colour = before[number]
    slot = wp.max(geom[number], 0)
    share = wp.where(geom[number] < 0, 0.0, load_vec4(geoms, scene.first + geom_row(slot) + 160)[3])
    mirrors = lanes_in_which(share > 0.0)
    # A loop, so that the code of both exists once.
    stage = wp.where(mirrors == wp.uint32(0), 2, 1)
    while stage < wp.where(panes > 0, 3, 2):
        ray = WarpRay()
        ray.start = origin[number]
        ray.along = direction[number]
        ray.reach = wp.min(distance[number], UNLIMITED)
        base = scene.first + ((solids + 31) >> 5) * GROUP_SIZE
        look = scene.paint + ((solids + 31) >> 5) * 32
        # All by boxes: `wide` counts solids only, and large panes have no sphere.
        boxes = panes
        count = panes
        passed = float(exclude[cast])
        if stage == 1:
            ray = _mirrored(scene, slot, ray, mirrors, share > 0.0)
            base = scene.first
            look = scene.paint
            boxes = wide
            count = solids
            passed = NO_OWNER
        # Panes are seen from the camera's one point; reflections start all over the mirror.
        cone = cone_about(ray.start, ray.along, stage == 2)
        hit = _hit_in(scene, base, boxes, count, cone, ray, passed)
        seen = _look_at(hit, scene, base, look, ray.start, ray.along, stage == 1)
        if stage == 1:
            if share > 0.0:
                colour = (1.0 - share) * colour + share * seen.rgb
        elif hit.geom >= 0.0:
            colour = (1.0 - seen.share) * seen.rgb + seen.share * colour
        stage += 1
    rgb[number] = colour


def packed_scene(
    solids: Sequence[IndexedBlock], panes: Sequence[IndexedBlock], appearance: GeomAppearance
) -> jax.Array:
    """Return a world's geoms and their colours: groups of solids, then those of panes, then colours.

    The groups are those of `raycast_warp.pack`, with the texture's code after the size, the reflectance (of a
    pane the transparency) after the half lengths of the box, and as index the geom's place among the solids
    or among the panes. A colour is followed by the label.

    Returns:
        (groups * (6 + 1) * 32, 4).
    """
    parts = [_groups(some, appearance, of_panes=bool(i)) for i, some in enumerate((solids, panes)) if some]
    return jnp.concatenate([x.reshape(-1, 4) for part in zip(*parts, strict=True) for x in part])


def _groups(
    some: Sequence[IndexedBlock], appearance: GeomAppearance, *, of_panes: bool
) -> tuple[jax.Array, jax.Array]:
    """Return the groups of some geoms, and their colours and labels, padded to whole groups."""
    numbers = np.concatenate([part.info.first_index + np.arange(part.info.num_geoms) for part in some])
    ends = np.cumsum([part.info.num_geoms for part in some])
    placed = [
        # Kernels index the packed geoms, whose order is not that of the scene.
        (part.info._replace(first_index=int(end) - part.info.num_geoms), part.block)
        for part, end in zip(some, ends, strict=True)
    ]

    def column(values: Array | None) -> jax.Array:
        if values is None:
            return jnp.zeros(len(numbers), jnp.float32)
        return jnp.asarray(values)[numbers].astype(jnp.float32)

    def whole(rows: jax.Array) -> jax.Array:
        fill = jnp.zeros((-len(numbers) % 32, *rows.shape[1:]), rows.dtype)
        return jnp.concatenate([rows, fill]).reshape(-1, 32, *rows.shape[1:])

    # One place for both: a geom is never a mirror and a pane.
    share = column(appearance.transparency if of_panes else appearance.reflectance)
    groups = pack(placed)
    groups = groups.at[:, 4, :, 3].set(whole(column(appearance.texture)))
    groups = groups.at[:, 5, :, 3].set(whole(share))
    colours = jnp.concatenate([column(appearance.rgb), column(appearance.label)[:, None]], -1)
    return groups, whole(colours)


def packed_lights(render_scene: "RenderScene") -> jax.Array:
    """Return the light of a picture, and what else is one for all its rays (3 + 2 lamps + 2 headlights, 4).

    Direction to the sun, exposure; gain, daylight, side of the checkers, whether any headlight is on; bounds
    of the checkers. Of each lamp position, brightness, and colour; of each headlight position, whether it is
    on, direction, and the label of its robot.
    """
    lamps, headlights = render_scene.lights, render_scene.headlights
    on = jnp.asarray(headlights.on)
    single = [
        *jnp.asarray(render_scene.sun_direction),
        render_scene.exposure,
        render_scene.gain,
        shading.daylight(lamps),
        render_scene.checker_size,
        on.any(),
        *jnp.asarray(render_scene.checker_bounds).reshape(-1),
    ]
    head = jnp.stack([jnp.asarray(one, jnp.float32) for one in single]).reshape(3, 4)
    total = jnp.asarray(lamps.rgb).sum(-1, keepdims=True)
    # Filled up to whole rows of four numbers, which kernels read at once.
    parts = [
        (lamps.pos, total, jnp.asarray(lamps.rgb) / jnp.maximum(total, shading.MIN_LIGHT), 0 * total),
        (headlights.pos, on[:, None], headlights.direction, jnp.asarray(headlights.label)[:, None]),
    ]
    rows = [jnp.concatenate([jnp.asarray(x, jnp.float32) for x in part], -1).reshape(-1, 4) for part in parts]
    return jnp.concatenate([head, *rows])


@warp_function
def _kernel(name: str, outputs: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    return wp.jax_kernel(globals()[name], num_outputs=outputs, block_dim=BLOCK_DIM)


def _launch(
    numbers: Sequence[int],
    clear: bool,
    geoms: Array,
    world: Array,
    exclude: Array,
    lights: Array,
    *rays: Array,
) -> tuple[jax.Array, ...]:
    """Shade the rays of all pictures; `clear`: there are neither mirrors nor panes."""
    casts, count = rays[0].shape[:2]
    bundles = -(-count // MAX_BUNDLE)
    dims = {"output_dims": casts * count, "launch_dims": casts * bundles * MAX_BUNDLE}
    # Beyond it indices of 32 bits would overflow in the kernel, silently.
    if dims["launch_dims"] > MAX_THREADS:
        raise UsageError(
            f"{casts:,} pictures of {count:,} rays each need {dims['launch_dims']:,} threads of a GPU at "
            f"once, at most {MAX_THREADS:,}: fewer worlds"
        )
    arrays = [geoms.reshape(-1, 4), world, exclude, lights.reshape(-1, 4), *(x.reshape(-1, 3) for x in rays)]
    arrays.append(sign_bits())
    numbers = [*numbers, count, bundles]
    rgb, distance, label, geom = _kernel("shade_rays", 4)(*arrays, *numbers, **dims)
    if not clear:
        seen = rgb, distance, geom
        (rgb,) = _kernel("shade_mirrors_and_panes", 1)(*arrays, *seen, *numbers, **dims)
    return tuple(x.reshape(casts, count, *x.shape[1:]) for x in (rgb, distance, label))


@jax.named_scope("shade")
def shade_on_warp(
    render_scene: "RenderScene", origin: Array, direction: Array, exclude_owner: Array
) -> "Shaded":
    """As `shading.shade`, of solids, at least one, and panes."""
    solids = indexed_blocks(render_scene.geoms, SOLID_QUERY.transparent)
    # Panes are few: all of them are culled by their boxes.
    panes = [
        part._replace(info=part.info._replace(compact=False))
        for part in indexed_blocks(render_scene.geoms, PANE_QUERY.transparent)
    ]
    wide = sum(part.info.num_geoms for part in solids if not part.info.compact)
    counts = [sum(part.info.num_geoms for part in some) for some in (solids, panes)]
    numbers = [wide, *counts, len(render_scene.lights.rgb), len(render_scene.headlights.on)]
    casts = [
        jnp.asarray(exclude_owner).astype(jnp.int32),
        packed_lights(render_scene),
        *(jnp.asarray(x, jnp.float32) for x in (origin, direction)),
    ]
    scene = packed_scene(solids, panes, render_scene.appearance)
    # Without mirrors and panes the second kernel is not launched.
    clear = not {MIRROR, GLASS} & set(render_scene.geoms.materials)
    found = merge_vmaps(partial(_launch, numbers, clear))(
        scene[None], jnp.zeros(1, jnp.int32), *(x[None] for x in casts)
    )
    rgb, distance, label = (x[0] for x in found)
    return shading.Shaded(rgb, distance, label)
