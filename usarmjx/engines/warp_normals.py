"""Depths and normals of MuJoCo Warp's convex collider where a face of a box has them exactly.

The collider takes the difference of two points as the normal. Single precision places these to a tenth of a
micrometre, so a contact that is ten micrometres deep leans by half a degree, and EPA adds its tolerance. For
one of 100 wheels that stand on a slope it fails or points elsewhere. A face often is certain; see
`warp_faces`.

The collider reads the middle and the direction of its two points alone: they are put a metre apart.
"""

from importlib import import_module
from typing import Any

import warp as wp

from usarmjx.engines.warp_faces import is_certain, nearest_face
from usarmjx.sensors.rays.warp_kinds import BOX

# Private; the version of MJX is pinned.
_gjk: Any = import_module("mujoco.mjx.third_party.mujoco_warp._src.collision_gjk")
_epa_phase: Any = _gjk.epa_phase
_multicontact: Any = _gjk.multicontact


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
