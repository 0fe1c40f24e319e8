"""Triangles as bytes of a binary glTF file, with a colour at every corner: what browsers draw."""

import json
from typing import NamedTuple

import numpy as np

MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = b"glTF", 2, b"JSON", b"BIN\0"
FLOAT, UNSIGNED = 5126, 5125
"""glTF's numbers of component types."""
ARRAYS, ELEMENTS = 34962, 34963
"""glTF's numbers of what a buffer is for."""


class Finish(NamedTuple):
    """How a surface takes light.

    Attributes:
        opacity: 1 where nothing behind it is seen.
        metallic: glTF's: 1 for metal, 0 else.
        roughness: glTF's: 0 for a mirror.
        two_sided: Whether its back is seen too.
    """

    opacity: float = 1.0
    metallic: float = 0.0
    roughness: float = 0.8
    two_sided: bool = False


class TriangleMesh(NamedTuple):
    """Triangles.

    Attributes:
        vertices: Corners [m] (v, 3).
        normals: Outward at each corner (v, 3).
        rgb: Colour at each corner, as on a screen, in [0, 1] (v, 3).
        faces: The corners of each triangle, seen counter-clockwise (f, 3).
    """

    vertices: np.ndarray
    normals: np.ndarray
    rgb: np.ndarray
    faces: np.ndarray


def glb_of(mesh: TriangleMesh, finish: Finish) -> bytes:
    """Return a mesh as a binary glTF 2.0 file with one material."""
    vertices = mesh.vertices.astype("<f4")
    blocks = [
        vertices,
        mesh.normals.astype("<f4"),
        linear_rgb(mesh.rgb).astype("<f4"),
        mesh.faces.astype("<u4").reshape(-1),
    ]
    offsets = np.cumsum([0, *(block.nbytes for block in blocks)]).tolist()
    views = [
        {
            "buffer": 0,
            "byteOffset": offset,
            "byteLength": block.nbytes,
            "target": ELEMENTS if block.ndim == 1 else ARRAYS,
        }
        for offset, block in zip(offsets, blocks, strict=False)
    ]
    accessors = [
        {
            "bufferView": place,
            "componentType": UNSIGNED if block.ndim == 1 else FLOAT,
            "count": len(block),
            "type": "SCALAR" if block.ndim == 1 else "VEC3",
        }
        for place, block in enumerate(blocks)
    ]
    accessors[0] |= {"min": vertices.min(0).tolist(), "max": vertices.max(0).tolist()}
    primitive = {
        "attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2},
        "indices": 3,
        "material": 0,
    }
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [_material(finish)],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offsets[-1]}],
    }
    return _file(json.dumps(tree, separators=(",", ":")).encode(), b"".join(map(np.ndarray.tobytes, blocks)))


def linear_rgb(rgb: np.ndarray) -> np.ndarray:
    """Return colours as shares of light (..., 3) for colours as on a screen (sRGB's transfer function)."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def _material(finish: Finish) -> dict[str, object]:
    return {
        "alphaMode": "OPAQUE" if finish.opacity >= 1.0 else "BLEND",
        "doubleSided": finish.two_sided,
        "pbrMetallicRoughness": {
            "baseColorFactor": [1.0, 1.0, 1.0, finish.opacity],
            "metallicFactor": finish.metallic,
            "roughnessFactor": finish.roughness,
        },
    }


def _file(tree: bytes, binary: bytes) -> bytes:
    tree += b" " * (-len(tree) % 4)
    chunks = b"".join(
        len(data).to_bytes(4, "little") + kind + data
        for kind, data in ((JSON_CHUNK, tree), (BINARY_CHUNK, binary))
    )
    return MAGIC + VERSION.to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks
