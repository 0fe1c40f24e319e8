"""Drawn shapes as triangle meshes for a browser: MuJoCo's solids and the raycaster's own geoms."""

import json
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np

from usarmjx.models.compile.ray_geoms import FENDER_KIND, TRIANGLE_KIND
from usarmjx.models.types.shapes import FENDER, MIRROR
from usarmjx.sensors.rays.kernels import BAR_WIDTH, GRID_PITCH
from usarmjx.view.drawing import DrawnShape

MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = b"glTF", 2, b"JSON", b"BIN\0"
FLOAT, UNSIGNED = 5126, 5125
"""glTF codes of component types."""
ARRAYS, ELEMENTS = 34962, 34963
"""glTF codes of buffer targets."""


class Finish(NamedTuple):
    """Surface properties.

    Attributes:
        opacity: 1 for an opaque surface.
        metallic: Of glTF: 1 for metal, else 0.
        roughness: Of glTF: 0 for a mirror.
        two_sided: Whether its back is visible, too.
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
        rgb: sRGB colour at each corner, in [0, 1] (v, 3).
        faces: The corners of each triangle, counter-clockwise in view (f, 3).
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
        # glTF takes colours of corners as linear, and ours are sRGB as in pictures.
        linear_rgb(mesh.rgb).astype("<f4"),
        mesh.faces.astype("<u4").reshape(-1),
    ]
    # All numbers have 4 bytes, so each block begins where glTF allows it: at a multiple of 4.
    offsets = np.cumsum([0, *(block.nbytes for block in blocks)]).tolist()
    views = [
        {
            "buffer": 0,
            "byteOffset": offset,
            "byteLength": block.nbytes,
            "target": ELEMENTS if block.ndim == 1 else ARRAYS,
        }
        # The last offset is the length of the whole buffer.
        for offset, block in zip(offsets, blocks, strict=False)
    ]
    accessors = [
        {
            "bufferView": index,
            "componentType": UNSIGNED if block.ndim == 1 else FLOAT,
            "count": len(block),
            "type": "SCALAR" if block.ndim == 1 else "VEC3",
        }
        for index, block in enumerate(blocks)
    ]
    # glTF demands the bounds of positions, and of no other attribute.
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
    """Return linear colours (..., 3) of sRGB colours."""
    # The curve of IEC 61966-2-1: a line near black, where the inverse of a power is too steep.
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def _material(finish: Finish) -> dict[str, object]:
    return {
        "alphaMode": "OPAQUE" if finish.opacity >= 1.0 else "BLEND",
        "doubleSided": finish.two_sided,
        "pbrMetallicRoughness": {
            # glTF multiplies it with the corners' colours, so only the opacity differs from 1.
            "baseColorFactor": [1.0, 1.0, 1.0, finish.opacity],
            "metallicFactor": finish.metallic,
            "roughnessFactor": finish.roughness,
        },
    }


def _file(tree: bytes, binary: bytes) -> bytes:
    # glTF aligns chunks to 4 bytes, the JSON chunk by spaces.
    tree += b" " * (-len(tree) % 4)
    chunks = b"".join(
        len(data).to_bytes(4, "little") + kind + data
        for kind, data in ((JSON_CHUNK, tree), (BINARY_CHUNK, binary))
    )
    # 12 bytes of header count too: magic word, version and this length.
    return MAGIC + VERSION.to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks


GeomType = mujoco.mjtGeom
PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX = (
    int(kind)
    for kind in (
        GeomType.mjGEOM_PLANE,
        GeomType.mjGEOM_SPHERE,
        GeomType.mjGEOM_CAPSULE,
        GeomType.mjGEOM_ELLIPSOID,
        GeomType.mjGEOM_CYLINDER,
        GeomType.mjGEOM_BOX,
    )
)
AROUND = 24
"""Number of corners of a circle."""
STACKS = 12
"""Rings of a sphere, an even number: a capsule's is cut in its middle."""
TINY_RADIUS = 1e-9
"""Radius up to which a ring is a point [m]."""
MIRROR_FINISH = Finish(metallic=0.4, roughness=0.05)
"""Finish of mirrors: they shine in the light of sun and lamps, and reflect nothing else."""
_Solid = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Corners (v, 3), normals (v, 3) and faces (f, 3) of a solid."""


def meshes_of(shape: DrawnShape) -> dict[Finish, TriangleMesh]:
    """Return the meshes of a shape, one for each finish that it has.

    Planes without bounds are left out: `stage` draws the floor.

    Args:
        shape: Solids that move together.
    """
    parts: dict[Finish, list[TriangleMesh]] = {}
    for kind in np.unique(shape.kind).tolist():
        of_kind = shape.kind == kind
        for finish, rows in _by_finish(shape, np.flatnonzero(of_kind)).items():
            if kind == TRIANGLE_KIND:
                parts.setdefault(finish, []).append(_triangles(shape, rows))
            else:
                parts.setdefault(finish, []).extend(_solids(shape, kind, rows))
    joined = {finish: join(meshes) for finish, meshes in parts.items()}
    # A plane without bounds leaves a mesh without corners, which glTF does not allow.
    return {finish: mesh for finish, mesh in joined.items() if len(mesh.faces)}


def join(meshes: list[TriangleMesh]) -> TriangleMesh:
    """Return several meshes as one."""
    if not meshes:
        nothing = np.zeros((0, 3))
        return TriangleMesh(nothing, nothing, nothing, np.zeros((0, 3), int))
    # Indices of corners count anew in each mesh.
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return TriangleMesh(
        *(np.concatenate([mesh[field] for mesh in meshes]) for field in range(3)),
        faces=np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
    )


def rectangle(low: np.ndarray, high: np.ndarray, height: float, rgb: np.ndarray) -> TriangleMesh:
    """Return a level rectangle that is visible from above.

    Args:
        low: Least x and y [m] (2,).
        high: Largest x and y [m] (2,).
        height: [m]
        rgb: Its colour (3,).
    """
    xy = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    vertices = np.column_stack([xy, np.full(4, height)])
    return TriangleMesh(
        vertices, np.tile([0.0, 0.0, 1.0], (4, 1)), np.tile(rgb, (4, 1)), np.array([[0, 1, 2], [0, 2, 3]])
    )


def _by_finish(shape: DrawnShape, rows: np.ndarray) -> dict[Finish, np.ndarray]:
    """Return rows of solids by their finish."""
    found: dict[Finish, list[int]] = {}
    for row in rows.tolist():
        found.setdefault(_finish(str(shape.material[row]), float(shape.transparency[row])), []).append(row)
    return {finish: np.array(members) for finish, members in found.items()}


def _finish(material: str, transparency: float) -> Finish:
    if transparency > 0.0:
        # Rounded, so that glass of nearly equal transparency shares one mesh.
        return Finish(opacity=round(1.0 - transparency, 3), roughness=0.1)
    if material == MIRROR:
        return MIRROR_FINISH
    return Finish(two_sided=True) if material == FENDER else Finish()


def _triangles(shape: DrawnShape, rows: np.ndarray) -> TriangleMesh:
    """Return triangles in the form of `models.compile.ray_geoms` as a mesh."""
    pos, mat, size = shape.pos[rows], shape.mat[rows], shape.size[rows]
    corners = np.zeros((len(rows), 3, 3))
    # In its own axes a triangle has corners (0, 0), (a, 0) and (b, c), and its size numbers are a, b and c.
    corners[:, 1, 0] = size[:, 0]
    corners[:, 2, :2] = size[:, 1:]
    vertices = pos[:, None] + np.einsum("nij,nkj->nki", mat, corners)
    return TriangleMesh(
        vertices.reshape(-1, 3),
        np.repeat(mat[:, :, 2], 3, axis=0),
        np.repeat(shape.rgb[rows], 3, axis=0),
        np.arange(3 * len(rows)).reshape(-1, 3),
    )


def _solids(shape: DrawnShape, kind: int, rows: np.ndarray) -> list[TriangleMesh]:
    make = SOLIDS.get(kind)
    if make is None:
        raise ValueError(f"no picture of geoms of kind {kind}; there are {sorted(SOLIDS)}, {TRIANGLE_KIND}")
    meshes: list[TriangleMesh] = []
    for row in rows.tolist():
        # Some of these arrays are cached unit solids: nothing below may change them in place.
        vertices, normals, faces = make(shape.size[row].astype(float))
        turn = shape.mat[row].T
        rgb = np.broadcast_to(shape.rgb[row], vertices.shape)
        meshes.append(TriangleMesh(shape.pos[row] + vertices @ turn, normals @ turn, rgb, faces))
    return meshes


def _plane(size: np.ndarray) -> _Solid:
    # MuJoCo's planes with a size of 0 have no bounds.
    if not (size[:2] > 0.0).all():
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), int)
    flat = rectangle(-size[:2], size[:2], 0.0, np.zeros(3))
    return flat.vertices, flat.normals, flat.faces


def _box(size: np.ndarray) -> _Solid:
    vertices, normals, faces = _unit_box()
    return vertices * size, normals, faces


@cache
def _unit_box() -> _Solid:
    quads = [_face(axis, sign, [(-1.0, 1.0, -1.0, 1.0)]) for axis in range(3) for sign in (-1.0, 1.0)]
    return _quads(quads)


def _fender(size: np.ndarray) -> _Solid:
    """Return the bars of a grid fender on the faces of its box, in the pattern of `sensors.rays.kernels`."""
    quads: list[tuple[np.ndarray, np.ndarray]] = []
    for axis in range(3):
        across = size[[(axis + 1) % 3, (axis + 2) % 3]]
        # A face smaller than the grid is one bar, or nothing of it would be seen.
        if (across < GRID_PITCH / 2).any():
            bars = [(-across[0], across[0], -across[1], across[1])]
        else:
            bars = [(low, high, -across[1], across[1]) for low, high in _bars(across[0])]
            bars += [(-across[0], across[0], low, high) for low, high in _bars(across[1])]
        for sign in (-1.0, 1.0):
            face, normal = _face(axis, sign, bars)
            face[:, :, axis] *= size[axis]
            quads.append((face, normal))
    return _quads(quads)


def _bars(half: float) -> list[tuple[float, float]]:
    """Return the limits of the bars along a side of half that length [m]."""
    last = int((half + BAR_WIDTH / 2) / GRID_PITCH)
    edges = [(k * GRID_PITCH - BAR_WIDTH / 2, k * GRID_PITCH + BAR_WIDTH / 2) for k in range(-last, last + 1)]
    return [(max(low, -half), min(high, half)) for low, high in edges]


def _face(axis: int, sign: float, patches: list[tuple[float, ...]]) -> tuple[np.ndarray, np.ndarray]:
    """Return patches (n, 4, 3) of a face a unit away along an axis, and the face's normal (3,)."""
    # In cyclic order, so that corners that turn from the first to the second are counter-clockwise.
    first, second = (axis + 1) % 3, (axis + 2) % 3
    corners = np.zeros((len(patches), 4, 3))
    low_1, high_1, low_2, high_2 = np.array(patches).T
    corners[:, :, axis] = sign
    corners[:, :, first] = np.stack([low_1, high_1, high_1, low_1], axis=1)
    corners[:, :, second] = np.stack([low_2, low_2, high_2, high_2], axis=1)
    # The order of corners is reversed on the far side: counter-clockwise is outside.
    return corners if sign > 0 else corners[:, ::-1], sign * np.eye(3)[axis]


def _quads(quads: list[tuple[np.ndarray, np.ndarray]]) -> _Solid:
    vertices = np.concatenate([corners.reshape(-1, 3) for corners, _ in quads])
    normals = np.concatenate([np.tile(normal, (4 * len(corners), 1)) for corners, normal in quads])
    # Patches share no corners: each has the normal of its own face, which keeps edges sharp.
    starts = 4 * np.arange(len(vertices) // 4)[:, None]
    faces = np.concatenate([starts + np.array([0, 1, 2]), starts + np.array([0, 2, 3])])
    return vertices, normals, faces


def _ellipsoid(size: np.ndarray) -> _Solid:
    vertices, _, faces = _unit_sphere()
    # The gradient of the ellipsoid's equation: normals stretch the other way round than corners.
    normals = vertices / size
    return vertices * size, normals / np.linalg.norm(normals, axis=1, keepdims=True), faces


def _capsule(size: np.ndarray) -> _Solid:
    """Return a sphere that is cut in its middle, with a tube in between."""
    vertices, normals, faces = _unit_sphere(cut=True)
    # Rings go from top to bottom, with the cut between the two equal middle ones.
    above = np.repeat([1.0, -1.0], len(vertices) // 2)
    moved = vertices * size[0]
    moved[:, 2] += above * size[1]
    return moved, normals, faces


@cache
def _unit_sphere(*, cut: bool = False) -> _Solid:
    """Return a sphere of rings from top to bottom; cut, it has the middle one twice."""
    angles = np.linspace(0.0, np.pi, STACKS + 1)
    if cut:
        angles = np.insert(angles, STACKS // 2, np.pi / 2)
    return _turned(np.sin(angles), np.cos(angles), np.column_stack([np.sin(angles), np.cos(angles)]))


def _cylinder(size: np.ndarray) -> _Solid:
    vertices, normals, faces = _unit_cylinder()
    return vertices * [size[0], size[0], size[1]], normals, faces


@cache
def _unit_cylinder() -> _Solid:
    """Return lid, side and bottom: their edges are sharp, so each has corners of its own."""
    out, up = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    return _turned(
        np.array([0.0, 1.0, 1.0, 1.0, 1.0, 0.0]),
        np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0]),
        np.array([up, up, out, out, -up, -up]),
    )


def _turned(radius: np.ndarray, height: np.ndarray, normal: np.ndarray) -> _Solid:
    """Return a surface of revolution about z.

    Args:
        radius: Radius of each ring, from top to bottom [m] (rings,).
        height: Height of each ring [m] (rings,).
        normal: Outward and upward part of each ring's normal (rings, 2).
    """
    # Without the full turn, which is the first corner again: the remainder below closes the ring.
    turn = np.linspace(0.0, 2 * np.pi, AROUND, endpoint=False)
    around = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(AROUND)])
    up = np.array([0.0, 0.0, 1.0])
    vertices = radius[:, None, None] * around + height[:, None, None] * up
    normals = normal[:, :1, None] * around + normal[:, 1:, None] * up
    ring, corner = np.meshgrid(np.arange(len(radius) - 1), np.arange(AROUND), indexing="ij")
    here, after = ring * AROUND + corner, ring * AROUND + (corner + 1) % AROUND
    # Two coincident rings with different normals are a sharp edge: there is no side between them.
    side = (np.diff(radius) != 0.0) | (np.diff(height) != 0.0) | (np.diff(normal, axis=0) == 0.0).all(1)
    # At a pole one of the two triangles of a quad has no area, and no normal.
    lower, upper = side & (radius[1:] > TINY_RADIUS), side & (radius[:-1] > TINY_RADIUS)
    faces = [
        np.stack([here, here + AROUND, after + AROUND], axis=-1)[lower],
        np.stack([here, after + AROUND, after], axis=-1)[upper],
    ]
    triangles = np.concatenate([part.reshape(-1, 3) for part in faces])
    return vertices.reshape(-1, 3), normals.reshape(-1, 3), triangles


SOLIDS: dict[int, Callable[[np.ndarray], _Solid]] = {
    PLANE: _plane,
    SPHERE: lambda size: _ellipsoid(np.full(3, size[0])),
    CAPSULE: _capsule,
    ELLIPSOID: _ellipsoid,
    CYLINDER: _cylinder,
    BOX: _box,
    FENDER_KIND: _fender,
}
"""Mesh of each kind of geom, from its size numbers."""
