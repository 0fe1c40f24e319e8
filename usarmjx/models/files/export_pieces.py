"""Pieces of files of other tools: numbers, poses, meshes, and what an export returns."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usarmjx.base.files import atomic_write
from usarmjx.models.files.mjcf_solids import Pose

ELLIPSOID_SIDES = 16
"""Corners around an ellipsoid, which URDF has as a mesh only."""
LOCKED = 1e-6
"""Cosine of a pitch below which roll and yaw are rounding errors of single precision."""


@dataclass(frozen=True, kw_only=True)
class ExportResult:
    """An exported robot or arena.

    Attributes:
        files: The files, the main one first.
        notes: Content that the format has no place for, in words.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...]


def write_file(path: Path, data: bytes) -> None:
    """Write a file whole or not at all."""
    with atomic_write(path) as fresh:
        fresh.write_bytes(data)


def text_of(values: object) -> str:
    """Return numbers with as many digits as they need to be read back equal."""
    return " ".join(repr(float(value)) for value in np.atleast_1d(np.asarray(values, float)))


def rpy_of(mat: np.ndarray) -> np.ndarray:
    """Return roll, pitch, yaw (3,) of a rotation (3, 3): turns about fixed x, y, z, as in URDF and SDF."""
    pitch = np.arctan2(-mat[2, 0], np.hypot(mat[0, 0], mat[1, 0]))
    if np.hypot(mat[0, 0], mat[1, 0]) < LOCKED:  # gimbal lock: roll and yaw are one rotation
        return np.array([np.arctan2(-mat[1, 2], mat[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(mat[2, 1], mat[2, 2]), pitch, np.arctan2(mat[1, 0], mat[0, 0])])


def add_child(parent: ET.Element, tag: str, values: object) -> None:
    """Add an element that holds numbers."""
    ET.SubElement(parent, tag).text = text_of(values)


def add_pose(parent: ET.Element, pose: Pose) -> None:
    """Add a `<pose>` of SDF."""
    add_child(parent, "pose", [*pose.pos, *rpy_of(pose.mat)])


def ellipsoid_corners(radii: np.ndarray) -> np.ndarray:
    """Return corners on an ellipsoid (n, 3), its six ends among them."""
    turn = np.arange(ELLIPSOID_SIDES) * 2 * np.pi / ELLIPSOID_SIDES
    up = np.linspace(-np.pi / 2, np.pi / 2, ELLIPSOID_SIDES // 2 + 1)[:, None]
    x, y, z = np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up) + 0 * turn
    return np.unique(np.stack([x, y, z], -1).reshape(-1, 3).round(12), axis=0) * radii


def stl_of_hull(corners: np.ndarray) -> bytes:
    """Return the convex hull of corners (n, 3) as a binary STL file, its faces outwards."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(corners)
    faces = corners[hull.simplices]
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    inwards = (normal * hull.equations[:, :3]).sum(1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return stl_of(faces)


def stl_of(triangles: np.ndarray) -> bytes:
    """Return triangles (n, 3, 3), counter-clockwise from outside, as a binary STL file."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facets = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
    facets["normal"], facets["corners"] = normal / np.maximum(length, 1e-300), triangles
    return b"usarmjx".ljust(80, b"\0") + len(facets).to_bytes(4, "little") + facets.tobytes()
