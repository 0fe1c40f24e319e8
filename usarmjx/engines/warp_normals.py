"""Depths and normals of MuJoCo Warp's convex collider where a face of a box has them exactly.

The collider takes the difference of two points as the normal. Single precision places these to a tenth of a
micrometre, so a contact that is ten micrometres deep leans by half a degree, and EPA adds its tolerance. For
one of 100 wheels that stand on a slope it fails or points elsewhere. But if a geom's deepest point below a
face of a box is in the box, and no other face is nearer, no direction parts the two sooner: along any unit
vector n the way out is at least the sum of |n_i| times the distances to the faces.

The collider reads the middle and the direction of its two points alone: they are put a metre apart.
"""

from importlib import import_module
from typing import Any

import warp as wp

from usarmjx.engines.warp_gjk import BOX

# Private; the version of MJX is pinned.
_gjk: Any = import_module("mujoco.mjx.third_party.mujoco_warp._src.collision_gjk")
_epa_phase: Any = _gjk.epa_phase
_multicontact: Any = _gjk.multicontact
_support: Any = _gjk.support

ROUNDING = wp.constant(2e-7)
"""Of places of some metres in single precision [m]."""


@wp.func
def nearest_face(  # noqa: ANN201 - Warp takes an annotation as the type in C
    box: Any,  # noqa: ANN401 - Warp's
    other: Any,  # noqa: ANN401
    kind: int,
):
    """Return by which face of a box a geom leaves first: depth [m], normal, the geom's deepest point.

    Args:
        box: The box.
        other: The geom.
        kind: Its type.
    """
    least, normal, deepest = wp.float32(1.0e30), wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0)
    i = wp.int32(0)
    while i < 3:
        face = wp.vec3(box.rot[0, i], box.rot[1, i], box.rot[2, i])
        # Of two faces the one on the geom's side is nearer.
        if wp.dot(face, other.pos - box.pos) < 0.0:
            face = -face
        point = _support(other, kind, -face).point
        depth = box.size[i] + 0.5 * box.margin + wp.dot(face, box.pos - point)
        if depth < least:
            least, normal, deepest = depth, face, point
        i += 1
    return least, normal, deepest


@wp.func
def is_certain(box: Any, point: wp.vec3, depth: float) -> bool:  # noqa: ANN401
    """Return whether a geom's deepest point below a face is in the box, and no other face nearer to it."""
    place = wp.transpose(box.rot) @ (point - box.pos)
    left = box.size - wp.vec3(wp.abs(place[0]), wp.abs(place[1]), wp.abs(place[2]))
    least = wp.min(wp.min(left[0], left[1]), left[2]) + 0.5 * box.margin
    return depth > 0.0 and least >= 0.999 * depth - ROUNDING


@wp.func
def epa_with_exact_normal(  # noqa: ANN201
    tolerance: float,
    iterations: int,
    result: Any,  # noqa: ANN401
    geom1: Any,  # noqa: ANN401
    geom2: Any,  # noqa: ANN401
    kind1: int,
    kind2: int,
    vert: wp.array[wp.vec3],
    vert_index: wp.array[int],
    faces: wp.array[int],
    face_pr: wp.array[wp.vec3],
    face_norm2: wp.array[float],
    horizon: wp.array[int],
    warn_overflow: bool,
    worldid: int,
    overflow_out: wp.array[int],
):
    """Return depth and points of a contact as MuJoCo Warp's EPA does, the points one metre apart."""
    dist, count, x1, x2, index = _epa_phase(
        tolerance,
        iterations,
        result,
        geom1,
        geom2,
        kind1,
        kind2,
        vert,
        vert_index,
        faces,
        face_pr,
        face_norm2,
        horizon,
        warn_overflow,
        worldid,
        overflow_out,
    )
    epa, normal, middle, limit = dist, geom2.pos - geom1.pos, 0.5 * (x1 + x2), wp.float32(0.0)
    if dist < 0.0:
        normal = wp.normalize(x1 - x2)
        if index >= 0:
            normal = wp.normalize(face_pr[index])
        # EPA may stop as far from the depth as its tolerance.
        limit = tolerance - dist
    beneath = middle
    if kind1 == BOX:
        depth, face, point = nearest_face(geom1, geom2, kind2)
        if depth <= limit or is_certain(geom1, point, depth):
            limit, normal, dist, beneath = depth, face, -depth, point + 0.5 * depth * face
    if kind2 == BOX:
        depth, face, point = nearest_face(geom2, geom1, kind1)
        if depth <= limit or is_certain(geom2, point, depth):
            normal, dist, beneath = -face, -depth, point + 0.5 * depth * face
    if dist < 0.0:
        if wp.abs(dist - epa) > 2.0 * tolerance:
            # EPA has failed, and its points are as wrong as its depth.
            count, index, middle = 1, -1, beneath
        x1, x2 = middle + 0.5 * normal, middle - 0.5 * normal
    return dist, count, x1, x2, index


@wp.func
def contacts_with_exact_normal(  # noqa: ANN201
    polygon: wp.array[wp.vec3],
    clipped: wp.array[wp.vec3],
    plane_normal: wp.array[wp.vec3],
    plane_dist: wp.array[float],
    idx1: wp.array[int],
    idx2: wp.array[int],
    n1: wp.array[wp.vec3],
    n2: wp.array[wp.vec3],
    endvert: wp.array[wp.vec3],
    face1: wp.array[wp.vec3],
    face2: wp.array[wp.vec3],
    epa_vert: wp.array[wp.vec3],
    epa_vert_index: wp.array[int],
    epa_face: int,
    x1: wp.vec3,
    x2: wp.vec3,
    geom1: Any,  # noqa: ANN401
    geom2: Any,  # noqa: ANN401
    kind1: int,
    kind2: int,
):
    """Return the contacts of two faces as MuJoCo Warp does, in the direction of the given points."""
    count, witness1, witness2, dists = _multicontact(
        polygon,
        clipped,
        plane_normal,
        plane_dist,
        idx1,
        idx2,
        n1,
        n2,
        endvert,
        face1,
        face2,
        epa_vert,
        epa_vert_index,
        epa_face,
        x1,
        x2,
        geom1,
        geom2,
        kind1,
        kind2,
    )
    # The first pair gives all contacts their normal.
    middle, half = 0.5 * (witness1[0] + witness2[0]), 0.5 * (x1 - x2)
    witness1[0] = middle + half
    witness2[0] = middle - half
    return count, witness1, witness2, dists
