"""Faces of boxes, by which MuJoCo Warp's convex collider has exact depths and normals.

If a geom's deepest point below a face of a box is in the box, and no other face is nearer, no direction parts
the two sooner: along any unit vector n the way out is at least the sum of |n_i| times the distances to the
faces.
"""

from importlib import import_module
from typing import Any

import warp as wp

# Private; the version of MJX is pinned.
_gjk: Any = import_module("mujoco.mjx.third_party.mujoco_warp._src.collision_gjk")
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
def verdict_of_faces(box: Any, other: Any, kind: int) -> int:  # noqa: ANN401
    """Return by the faces of a box whether a geom is apart (-1), in it with an exact depth (1), or 0."""
    verdict = wp.int32(0)
    depth, _face, point = nearest_face(box, other, kind)
    if depth < 0.0:
        verdict = -1
    elif is_certain(box, point, depth):
        verdict = 1
    return verdict
