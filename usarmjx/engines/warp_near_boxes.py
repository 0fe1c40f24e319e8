"""MuJoCo Warp's convex collider with boxes cut to what is near the other geom.

The collider computes in single precision. Beside a box of 20 m its distances are wrong by micrometres, and
wheels that stand on such a ramp slip a hundredth of a metre a second. The distance of two geoms depends on
the near part of a box alone, so the collider gets a box of that. A box stays whole beside a mesh, and where
the other geom is so deep in it that a cut would be nearer than the box's own faces.
"""

from functools import cache
from importlib import import_module
from typing import Any

import warp as wp

from usarmjx.base.warp_functions import with_globals
from usarmjx.engines.warp_gjk import unstalled_phase
from usarmjx.engines.warp_normals import contacts_with_exact_normal, epa_with_exact_normal
from usarmjx.sensors.rays.warp_kinds import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE

# Private; the version of MJX is pinned.
_core: Any = import_module("mujoco.mjx.third_party.mujoco_warp._src.collision_core")
_convex: Any = import_module("mujoco.mjx.third_party.mujoco_warp._src.collision_convex")
_pair_of_types: Any = _core.geom_collision_pair_from_types

NEAR = wp.constant(1.0)
"""Farthest that the middle of a box cut at both ends is from the other geom's cell, along each axis [m].

At this size single precision suffices.
"""
REACH_RADII = wp.constant(5.0)
"""Least distance from the other geom's middle to a cut, in radii of that geom."""
MOST_DEPTH_RADII = wp.constant(4.0)
"""Depth of the other geom's middle up to which a box is cut, in radii of that geom.

Such a geom leaves by a face of the box after five radii at most, the least distance of a cut.
"""
CELL = wp.constant(0.5)
"""Edge of the cells in which cuts stay as they are [m]."""


@wp.func
def bounding_radius(kind: int, size: wp.vec3) -> float:
    """Return the radius of a sphere around a geom's middle [m]; of a mesh -1, which has none here."""
    radius = wp.float32(-1.0)
    if kind == SPHERE:
        radius = size[0]
    elif kind == CAPSULE:
        radius = size[0] + size[1]
    elif kind == CYLINDER:
        radius = wp.sqrt(size[0] * size[0] + size[1] * size[1])
    elif kind == BOX:
        radius = wp.length(size)
    elif kind == ELLIPSOID:
        radius = wp.max(wp.max(size[0], size[1]), size[2])
    return radius


@wp.func
def cut_box(box: Any, kind: int, other: wp.vec3, radius: float) -> Any:  # noqa: ANN401 - Warp's
    """Return a geom cut to what is near another's middle, if it is a box and reaches farther."""
    near = box
    half = NEAR + REACH_RADII * radius + CELL
    place = wp.transpose(box.rot) @ (other - box.pos)
    depth, reach = box.size[0] - wp.abs(place[0]), box.size[0]
    for i in range(1, 3):
        depth, reach = wp.min(depth, box.size[i] - wp.abs(place[i])), wp.max(reach, box.size[i])
    if kind == BOX and radius >= 0.0 and reach > half and depth <= MOST_DEPTH_RADII * radius:
        middle, size = wp.vec3(0.0, 0.0, 0.0), box.size
        for i in range(3):
            # The collider begins at the middles: where these move, it ends at another point of an edge that
            # lies on a face. So a middle stays, or moves no farther than it must, and in cells.
            cell = wp.round(place[i] / CELL) * CELL
            near_middle = wp.clamp(0.0, cell - NEAR, cell + NEAR)
            low, high = wp.max(-box.size[i], near_middle - half), wp.min(box.size[i], near_middle + half)
            if high > low:
                middle[i] = 0.5 * (high + low)
                size[i] = 0.5 * (high - low)
        near.pos = box.pos + box.rot @ middle
        near.size = size
    return near


@wp.func
def near_pair(  # noqa: ANN201 - Warp takes an annotation as the type in C
    geom_dataid: wp.array2d[int],
    geom_size: wp.array2d[wp.vec3],
    mesh_vertadr: wp.array[int],
    mesh_vertnum: wp.array[int],
    mesh_graphadr: wp.array[int],
    mesh_vert: wp.array[wp.vec3],
    mesh_graph: wp.array[int],
    mesh_polynum: wp.array[int],
    mesh_polyadr: wp.array[int],
    mesh_polynormal: wp.array[wp.vec3],
    mesh_polyvertadr: wp.array[int],
    mesh_polyvertnum: wp.array[int],
    mesh_polyvert: wp.array[int],
    mesh_polymapadr: wp.array[int],
    mesh_polymapnum: wp.array[int],
    mesh_polymap: wp.array[int],
    geom_xpos_in: wp.array2d[wp.vec3],
    geom_xmat_in: wp.array2d[wp.mat33],
    geom_type1: int,
    geom_type2: int,
    geoms: wp.vec2i,
    worldid: int,
):
    """Return two geoms as `geom_collision_pair_from_types` does, each cut to what is near the other."""
    one, other = _pair_of_types(
        geom_dataid,
        geom_size,
        mesh_vertadr,
        mesh_vertnum,
        mesh_graphadr,
        mesh_vert,
        mesh_graph,
        mesh_polynum,
        mesh_polyadr,
        mesh_polynormal,
        mesh_polyvertadr,
        mesh_polyvertnum,
        mesh_polyvert,
        mesh_polymapadr,
        mesh_polymapnum,
        mesh_polymap,
        geom_xpos_in,
        geom_xmat_in,
        geom_type1,
        geom_type2,
        geoms,
        worldid,
    )
    here, there = one.pos, other.pos
    one_radius = bounding_radius(geom_type1, one.size)
    other_radius = bounding_radius(geom_type2, other.size)
    return cut_box(one, geom_type1, there, other_radius), cut_box(other, geom_type2, here, one_radius)


@cache
def near_collider(*args: int) -> Any:  # noqa: ANN401 - Warp's
    """Return the kernel that MuJoCo Warp's builder returns for the same arguments, with our changes."""
    changed = {
        "geom_collision_pair_from_types": near_pair,
        "gjk_phase": unstalled_phase,
        "epa_phase": epa_with_exact_normal,
        "multicontact": contacts_with_exact_normal,
    }
    return with_globals(_convex.ccd_kernel_builder.__wrapped__, **changed)(*args)
