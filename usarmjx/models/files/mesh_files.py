"""Vertices of any mesh file that robots and worlds name, for their hulls."""

from pathlib import Path

import numpy as np

from usarmjx.models.files.meshes import checked_mesh_file, mesh_objects


def mesh_vertices(path: Path) -> np.ndarray:
    """Return all vertices of a mesh file's faces (n, 3), z up, in the file's metres.

    Raises:
        ArenaFileError: A file that is missing, unreadable, too large or corrupt.
    """
    checked_mesh_file(path)
    return np.concatenate([vertices for _, vertices, _ in mesh_objects(path)])
