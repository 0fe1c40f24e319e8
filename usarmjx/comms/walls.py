"""Number of solids between two antennas.

A solid counts once, however thin and however close to the next one, if the open segment between the antennas
passes through its interior. A segment that starts, ends or lies inside a solid therefore counts it; one that
runs along a face or an edge, or only touches a corner, does not; a segment of zero length counts the solids
that contain its point. A plane counts if the two ends lie strictly on opposite sides and the segment meets it
within its half sizes. A terrain counts once, if the segment passes below its surface. Glass, mirrors and grid
fenders count like other solids, the sky does not.

USARSim's server (in the game engine) marched along the segment and searched again 0.2 m behind each surface,
so that a stack of thin walls counted as one there. Here each of them counts.

Kernels take a segment as its midpoint and half vector in the geom's frame, so that exchanging the two ends
changes no bit of the result. They take no square roots and divide only for round shapes, meshes and terrain.
A mesh is the intersection of the half spaces behind its triangles, a terrain the union of its columns.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.backend import Array, jit, on_numpy, xp
from usarmjx.base.errors import UnsupportedGeomError
from usarmjx.base.warp_functions import warp_in_use
from usarmjx.comms.clipping import (
    PIECE_KINDS,
    XYZ,
    components,
    count_in_pieces,
    local_segments,
    pad_to_chunks,
)
from usarmjx.models.compile.compose import materials_of, new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.ray_geoms import HFIELD, MESH, ray_primitives_of
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import OPAQUE, SKY
from usarmjx.sensors.rays.targets import GeomBlock, Geoms, make_geoms

TINY = 1e-12
"""Lower bound of divisors."""

GeomType = mujoco.mjtGeom
SOLIDS_PER_PASS = 2
"""Solids per pass over all segments: each solid is read once for all segments of a world.

The program has a copy of the kernel for each solid of a pass. More than two make it no faster on a CPU, and
with 16 the walls were a third of a radio task's program.
"""
SOLIDS_PER_PASS_ON_GPU = 16
"""The same on a GPU, where a pass is a launch."""
PADDING_DISTANCE = 1e6
"""Coordinate of the solids that pad the last chunk [m]."""


def crosses_plane(middle: XYZ, half: XYZ, size: XYZ) -> Array:
    """Return whether a segment crosses a plane with normal z; half sizes of 0 are unbounded."""
    # The ends lie on opposite sides exactly if the half vector reaches farther than the midpoint is away.
    crossed = xp.abs(middle[2]) < xp.abs(half[2])
    # A segment parallel to the plane does not cross it: the divisor is arbitrary then.
    t = -middle[2] / xp.where(half[2] == 0, 1.0, half[2])
    for axis in (0, 1):
        crossed = crossed & ((size[axis] <= 0) | (xp.abs(middle[axis] + t * half[axis]) < size[axis]))
    return crossed


def crosses_box(middle: XYZ, half: XYZ, size: XYZ) -> Array:
    """Return whether a segment crosses the interior of a box with half lengths `size`: separating axes.

    The axes are the box's own and their cross products with the segment (a box swept along a segment has no
    other faces); a vanishing cross product, for a segment parallel to the axis, separates nothing.
    """
    crossed = xp.abs(middle[0]) < size[0] + xp.abs(half[0])
    for axis in (1, 2):
        crossed = crossed & (xp.abs(middle[axis]) < size[axis] + xp.abs(half[axis]))
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        apart = xp.abs(middle[j] * half[k] - middle[k] * half[j])
        room = size[j] * xp.abs(half[k]) + size[k] * xp.abs(half[j])
        crossed = crossed & ((apart < room) | (room == 0))
    return crossed


def _nearest_squared(middle: XYZ, half: XYZ, axes: int) -> Array:
    """Return the squared distance of a segment from the origin, or, over two axes, from the z axis."""
    m, h = middle[:axes], half[:axes]
    along = sum(a * b for a, b in zip(m, h, strict=True))
    t = xp.clip(-along / xp.maximum(sum(b * b for b in h), TINY), -1.0, 1.0)
    return sum((a + t * b) ** 2 for a, b in zip(m, h, strict=True))  # type: ignore - not empty


def crosses_sphere(middle: XYZ, half: XYZ, size: XYZ) -> Array:
    """Return whether a segment crosses the interior of a sphere of radius `size[0]`."""
    return _nearest_squared(middle, half, 3) < size[0] ** 2


def crosses_ellipsoid(middle: XYZ, half: XYZ, size: XYZ) -> Array:
    """Return whether a segment crosses the interior of an ellipsoid with radii `size`, a scaled sphere."""
    # Scaled to a unit sphere, a segment stays a segment, and inside stays inside.
    scale = [1.0 / s for s in size]
    stretched = [tuple(a * s for a, s in zip(v, scale, strict=True)) for v in (middle, half)]
    return _nearest_squared(*stretched, 3) < 1.0  # type: ignore - three components each


def crosses_cylinder(middle: XYZ, half: XYZ, size: XYZ) -> Array:
    """Return whether a segment crosses a cylinder about z with radius `size[0]` and half length `size[1]`.

    The segment is clipped at the planes of the caps; its point nearest to the axis decides.
    """
    (mx, my, mz), (hx, hy, hz) = middle, half
    # A segment parallel to the caps: the tiny slope makes its interval between the caps unbounded.
    slope = xp.where(xp.abs(hz) < TINY, TINY, hz)
    centre, width = -mz / slope, size[1] / xp.abs(slope)
    low, high = xp.clip(centre - width, -1.0, 1.0), xp.clip(centre + width, -1.0, 1.0)
    t = xp.clip(-(mx * hx + my * hy) / xp.maximum(hx * hx + hy * hy, TINY), low, high)
    beside = (mx + t * hx) ** 2 + (my + t * hy) ** 2
    return (xp.abs(mz) < size[1] + xp.abs(hz)) & (beside < size[0] ** 2)


def crosses_capsule(middle: XYZ, half: XYZ, size: XYZ) -> Array:
    """Return whether a segment crosses the interior of a capsule about z: a cylinder and two balls."""
    crossed = crosses_cylinder(middle, half, size)
    for end in (-size[1], size[1]):
        crossed = crossed | crosses_sphere((middle[0], middle[1], middle[2] - end), half, size)
    return crossed


CROSSING_KERNELS: dict[int, Callable[[XYZ, XYZ, XYZ], Array]] = {
    int(GeomType.mjGEOM_PLANE): crosses_plane,
    int(GeomType.mjGEOM_BOX): crosses_box,
    int(GeomType.mjGEOM_SPHERE): crosses_sphere,
    int(GeomType.mjGEOM_CAPSULE): crosses_capsule,
    int(GeomType.mjGEOM_CYLINDER): crosses_cylinder,
    int(GeomType.mjGEOM_ELLIPSOID): crosses_ellipsoid,
}
"""Crossing test of each geom type."""
COUNTABLE_TYPES = (*CROSSING_KERNELS, MESH, HFIELD)
"""Geom types that can be counted, directly or in pieces."""


def check_wall_types(geom_types: Sequence[int]) -> None:
    """Refuse geoms that no kernel can count.

    Raises:
        UnsupportedGeomError: Names the types, and those that can be counted.
    """
    bad = sorted({GeomType(int(t)).name for t in geom_types if int(t) not in COUNTABLE_TYPES})
    if bad:
        known = ", ".join(GeomType(t).name for t in COUNTABLE_TYPES)
        raise UnsupportedGeomError(f"the radio cannot count walls of type {', '.join(bad)}; it can: {known}")


@cache
def arena_solids(arena: ArenaSpec) -> Geoms:
    """Return the solids that attenuate radio links in an arena: floor and fixed solids, no loose objects.

    Meshes and terrain are in pieces, in the form of `clipping.count_in_pieces`.

    Raises:
        UnsupportedGeomError: A solid cannot be counted.
    """
    # Links pass whatever can move: only what is the same in every step attenuates.
    fixed = replace(arena, loose=(), doors=(), victims=(), false_alarms=())
    model = new_spec(fixed, Physics()).compile()
    check_wall_types(model.geom_type.tolist())
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    # A sky box encloses the arena, and every link would cross it.
    walls = np.flatnonzero(np.array(materials_of(model, arena), object) != SKY)
    pieces = ray_primitives_of(model, walls, columns=True)
    pos, mat = pieces.world_poses(data.geom_xpos[walls], data.geom_xmat[walls].reshape(-1, 3, 3))
    # NumPy only: the result is cached, and JAX arrays made during a trace would leak tracers.
    placed = pos.astype(np.float32), mat.astype(np.float32)
    # The geom is the owner: pieces of one solid are counted once.
    geoms = make_geoms(pieces.kind, *placed, pieces.size, pieces.geom)
    blocks = [
        pad_to_chunks(block) if kind in PIECE_KINDS else block
        for kind, block in zip(geoms.kinds, geoms.blocks, strict=True)
    ]
    return geoms.replace(blocks=tuple(blocks))


@cache
def bare_floor(arena: ArenaSpec) -> ArenaSpec:
    """Return the arena with nothing but its floor."""
    return ArenaSpec(
        name=arena.name, floor=arena.floor, has_floor=arena.has_floor, starts=(), extent=arena.extent
    )


def add_boxes(solids: Geoms, pos: Array, mat: Array, size: Array) -> Geoms:
    """Add boxes to solids: centres [m] (n, 3), orientations (n, 3, 3), half lengths [m] (n, 3)."""
    # A block of no boxes would cost a kernel.
    if not len(size):
        return solids
    block = GeomBlock(pos=pos, mat=mat, size=size, owner=np.full(len(size), -1))
    box = int(GeomType.mjGEOM_BOX)
    return Geoms(
        blocks=(*solids.blocks, block),
        kinds=(*solids.kinds, box),
        materials=(*solids.materials, OPAQUE),
    )


def _chunks(block: GeomBlock, length: int) -> GeomBlock:
    """Return solids in chunks: arrays (chunks, length, ...)."""
    # Padding lies where no segment passes: 1,000 km off.
    fill = -len(block.owner) % length
    padding = GeomBlock(
        pos=np.full((fill, 3), PADDING_DISTANCE, np.float32),
        mat=np.tile(np.eye(3, dtype=np.float32), (fill, 1, 1)),
        size=np.ones((fill, 3), np.float32),
        owner=np.full(fill, -1, np.int32),
    )
    padded = jax.tree.map(lambda x, more: jnp.concatenate([jnp.asarray(x), more]), block, padding)
    return jax.tree.map(lambda x: x.reshape(-1, length, *x.shape[1:]), padded)


def _count_in_passes(kind: int, block: GeomBlock, middle: XYZ, half: XYZ) -> Array:
    """Return the number of solids of one type that each segment crosses (segments,), in chunks, on JAX."""
    per_pass = SOLIDS_PER_PASS_ON_GPU if jax.default_backend() == "gpu" else SOLIDS_PER_PASS
    chunks = _chunks(block, per_pass)

    def add_chunk(c: Array, count: Array) -> Array:
        solids: GeomBlock = jax.tree.map(
            lambda x: jax.lax.dynamic_index_in_dim(x, c, keepdims=False),  # pyright: ignore[reportUnknownLambdaType, reportUnknownMemberType] - half typed
            chunks,
        )
        for pos, mat, size in zip(solids.pos, solids.mat, solids.size, strict=True):
            # Sums of products instead of matrix products: they fuse, and avoid TensorFloat-32 on a GPU.
            offset = [middle[j] - pos[j] for j in range(3)]
            local = tuple(sum(mat[j, i] * offset[j] for j in range(3)) for i in range(3))
            along = tuple(sum(mat[j, i] * half[j] for j in range(3)) for i in range(3))
            count = count + CROSSING_KERNELS[kind](local, along, size)  # type: ignore - three components each
        return count

    return jax.lax.fori_loop(0, len(chunks.owner), add_chunk, jnp.zeros(middle[0].shape, jnp.int32))


def _count_at_once(kind: int, block: GeomBlock, middle: XYZ, half: XYZ) -> Array:
    """As `_count_in_passes`, all solids at once: few calls."""
    crossed = CROSSING_KERNELS[kind](*local_segments(block, middle, half), components(block.size))
    return crossed.sum(0, dtype=np.int32)


def _count(kind: int, block: GeomBlock, middle: XYZ, half: XYZ) -> Array:
    """Return the number of solids of one type that each segment crosses (segments,)."""
    if kind in PIECE_KINDS:
        return count_in_pieces(kind, block, middle, half)
    return (_count_at_once if on_numpy() else _count_in_passes)(kind, block, middle, half)


@jit
def count_walls(geoms: Geoms, start: Array, end: Array) -> Array:
    """Return the number of solids that each segment crosses, as the module defines it (segments,) int32.

    Args:
        geoms: Solids from `arena_solids`: those of the arena, without robots and loose objects; owners matter
            only to pieces.
        start: Start points [m] (segments, 3).
        end: End points [m] (segments, 3).
    """
    if not on_numpy() and warp_in_use() and geoms.blocks and start.size:
        from usarmjx.comms.warp_walls import count_on_warp

        return count_on_warp(geoms, start, end)
    return count_on_jax(geoms, start, end)


def count_on_jax(geoms: Geoms, start: Array, end: Array) -> Array:
    """As `count_walls`, on JAX or NumPy."""
    # A midpoint and a half vector: exchanged ends change a sign only, so both directions count alike.
    middle: XYZ = tuple(xp.moveaxis((start + end) / 2, -1, 0))
    half: XYZ = tuple(xp.moveaxis((end - start) / 2, -1, 0))
    counts = [_count(kind, b, middle, half) for kind, b in zip(geoms.kinds, geoms.blocks, strict=True)]
    return sum(counts, start=xp.zeros(start.shape[:-1], xp.int32))
