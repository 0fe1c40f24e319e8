"""Upright prisms on polygons, as convex solids."""

from dataclasses import replace

import numpy as np

from usarmjx.models.types.shapes import Mesh, Shape

MAX_CORNERS = 200
"""Largest number of corners of a polygon."""
FLAT = 1e-12
"""Twice the area below which three corners are on a line [m2]."""


def convex_parts(corners: np.ndarray) -> list[np.ndarray]:
    """Cut a polygon (n, 2) without holes into convex ones, counter-clockwise; empty: it has no area.

    Raises:
        ValueError: Its edges cross, or it has too many corners.
    """
    if len(corners) > MAX_CORNERS:
        raise ValueError(f"a polygon of {len(corners)} corners; at most {MAX_CORNERS}")
    ring = _clean(corners)
    if len(ring) < 3:
        return []
    if _is_convex(ring):
        return [ring]
    parts = [list(part) for part in _triangles(ring)]
    return [ring[part] for part in _merged(ring, parts)]


def signed_area(ring: np.ndarray) -> float:
    """Return the area of a polygon (n, 2) [m2], above zero if it is counter-clockwise."""
    x, y = ring.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2


def _cross(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Return twice the signed area of a triangle."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _clean(corners: np.ndarray) -> np.ndarray:
    """Return a polygon counter-clockwise, without repeated corners and corners on a line."""
    ring = [np.asarray(corner, float) for corner in corners]
    for _ in range(len(ring)):
        kept = [
            p for i, p in enumerate(ring) if abs(_cross(ring[i - 1], p, ring[(i + 1) % len(ring)])) > FLAT
        ]
        if len(kept) == len(ring) or len(kept) < 3:
            ring = kept
            break
        ring = kept
    if len(ring) < 3:
        return np.zeros((0, 2))
    found = np.array(ring)
    return found if signed_area(found) > 0 else found[::-1]


def _is_convex(ring: np.ndarray) -> bool:
    turns = [_cross(ring[i - 2], ring[i - 1], ring[i]) for i in range(len(ring))]
    if min(turns) < -FLAT:
        return False
    way = np.diff(np.vstack([ring, ring[:1]]), axis=0)
    angles = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    return angles[-1] - angles[0] < 2 * np.pi  # a star turns several times


def _triangles(ring: np.ndarray) -> list[tuple[int, int, int]]:
    """Return the triangles of a polygon, by their corners' numbers: ears are cut off until none is left."""
    left = list(range(len(ring)))
    found: list[tuple[int, int, int]] = []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(ring, left, i)), None)
        if ear is None:
            raise ValueError("a polygon whose edges cross")
        found.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    return [*found, (left[0], left[1], left[2])]


def _is_ear(ring: np.ndarray, left: list[int], place: int) -> bool:
    before, here, after = left[place - 1], left[place], left[(place + 1) % len(left)]
    a, b, c = ring[before], ring[here], ring[after]
    if _cross(a, b, c) <= 0:
        return False
    others = ring[[i for i in left if i not in (before, here, after)]]
    inside = np.ones(len(others), bool)
    for start, end in ((a, b), (b, c), (c, a)):
        (dx, dy), away = end - start, others - start
        inside &= dx * away[:, 1] - dy * away[:, 0] >= 0
    return not inside.any()


def _merged(ring: np.ndarray, parts: list[list[int]]) -> list[list[int]]:
    """Join convex polygons over an edge that they share, edge by edge, where the joined one is convex."""
    owner = {edge: number for number, part in enumerate(parts) for edge in _edges(part)}
    for a, b in [edge for edge in owner if edge[0] < edge[1] and edge[::-1] in owner]:
        one, other = owner[a, b], owner[b, a]
        joined = _joined(parts[one], parts[other])
        if joined is not None and _is_convex(ring[joined]):
            parts[one], parts[other] = joined, []
            owner |= dict.fromkeys(_edges(joined), one)
    return [part for part in parts if part]


def _edges(part: list[int]) -> list[tuple[int, int]]:
    return [(part[k - 1], part[k]) for k in range(len(part))]


def _joined(one: list[int], other: list[int]) -> list[int] | None:
    """Return two counter-clockwise polygons that share an edge as one; None: they share none."""
    edges = {(other[k - 1], other[k]): k for k in range(len(other))}
    for k in range(len(one)):
        a, b = one[k - 1], one[k]
        if (b, a) in edges:
            place = edges[b, a]
            # The other one from behind that edge on, up to before it.
            rest = [other[(place + 1 + n) % len(other)] for n in range(len(other) - 2)]
            return [*one[:k], *rest, *one[k:]] if k else [*one, *rest]
    return None


def prism(corners: np.ndarray, low: float, high: float, like: Shape) -> Shape:
    """Return an upright prism on a convex polygon (n, 2), in the axes of `like`'s origin.

    A rectangle along the axes becomes a box.

    Args:
        corners: The polygon.
        low: Height of its foot [m].
        high: Height of its top [m].
        like: Its surface and colour; a pose is replaced.
    """
    low_corner, high_corner = corners.min(0), corners.max(0)
    middle = (low_corner + high_corner) / 2
    x, y = middle.tolist()
    at = (x, y, (low + high) / 2)
    half = (high_corner - low_corner) / 2
    if len(corners) == 4 and np.allclose(np.abs(corners - middle), half, rtol=0, atol=1e-9):
        size = (*half.tolist(), (high - low) / 2)
        return replace(like, kind="box", size=size, at=at, rotation=(0.0, 0.0, 0.0), mesh=None)
    flat = corners - middle
    rise = (high - low) / 2
    foot, top = (np.column_stack([flat, np.full(len(flat), z)]) for z in (-rise, rise))
    mesh = Mesh(np.vstack([foot, top]))
    return replace(like, kind="mesh", size=(), mesh=mesh, at=at, rotation=(0.0, 0.0, 0.0))
