"""Shapes as triangles, against volumes and areas in closed form."""

import json
import math

import mujoco
import numpy as np
import pytest

from usarmjx.models.compile.ray_geoms import FENDER_KIND, TRIANGLE_KIND
from usarmjx.models.types.shapes import FENDER, GLASS, MIRROR, OPAQUE
from usarmjx.sensors.rays.kernels import in_hole
from usarmjx.view.drawing import DrawnShape
from usarmjx.view.mesh import AROUND, MIRROR_FINISH, SOLIDS, Finish, TriangleMesh, glb_of, meshes_of

GeomType = mujoco.mjtGeom
EXACT = 1e-9
"""Relative tolerance of what is exact but for rounding."""
FACETTED = 0.04
"""A sphere of our facets has less volume than a round one by no more than this share."""
SIZE = (0.3, 0.2, 0.1)
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
DISC = AROUND / 2 * math.sin(2 * math.pi / AROUND)
"""Area of the polygon that a disc of radius 1 is."""


def shape(kind: int, size=SIZE, material: str = OPAQUE, transparency: float = 0.0, pos=(1.0, 2.0, 3.0)):
    return DrawnShape(
        kind=np.array([kind]),
        pos=np.array([pos]),
        mat=TURN[None],
        size=np.array([size]),
        rgb=np.array([[0.2, 0.5, 1.0]]),
        transparency=np.array([transparency]),
        material=np.array([material]),
    )


def only_mesh(drawn: DrawnShape) -> TriangleMesh:
    (mesh,) = meshes_of(drawn).values()
    return mesh


def corners(mesh: TriangleMesh) -> np.ndarray:
    return mesh.vertices[mesh.faces]


def volume(mesh: TriangleMesh) -> float:
    return float(np.linalg.det(corners(mesh) - [1.0, 2.0, 3.0]).sum() / 6)


def areas(mesh: TriangleMesh) -> np.ndarray:
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


@pytest.mark.parametrize(
    ("kind", "expected", "rel"),
    [
        (GeomType.mjGEOM_BOX, 8 * 0.3 * 0.2 * 0.1, EXACT),
        (GeomType.mjGEOM_CYLINDER, DISC * 0.3**2 * 0.4, EXACT),
        (GeomType.mjGEOM_SPHERE, 4 / 3 * math.pi * 0.3**3, FACETTED),
        (GeomType.mjGEOM_ELLIPSOID, 4 / 3 * math.pi * 0.3 * 0.2 * 0.1, FACETTED),
        (GeomType.mjGEOM_CAPSULE, 4 / 3 * math.pi * 0.3**3 + math.pi * 0.3**2 * 0.4, FACETTED),
    ],
)
def test_a_solid_has_its_volume_and_faces_outward(kind, expected, rel):
    mesh = only_mesh(shape(int(kind)))
    assert volume(mesh) == pytest.approx(expected, rel=rel)
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    facing = np.einsum("nj,nkj->nk", np.cross(b - a, c - a), mesh.normals[mesh.faces])
    assert (facing > 0).all()
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("kind", sorted(SOLIDS))
def test_a_solid_is_as_large_as_it_is_and_turned(kind):
    mesh = only_mesh(shape(kind))
    half = {
        int(GeomType.mjGEOM_CAPSULE): (0.3, 0.3, 0.5),
        int(GeomType.mjGEOM_CYLINDER): (0.3, 0.3, 0.2),
        int(GeomType.mjGEOM_SPHERE): (0.3, 0.3, 0.3),
        int(GeomType.mjGEOM_PLANE): (0.2, 0.3, 0.0),
    }.get(kind, (0.2, 0.3, 0.1))
    assert np.abs(mesh.vertices - [1.0, 2.0, 3.0]).max(0) == pytest.approx(half)


def test_a_plane_without_bounds_is_left_to_who_draws_the_floor():
    assert meshes_of(shape(int(GeomType.mjGEOM_PLANE), size=(0.0, 0.0, 0.05))) == {}


def test_a_triangle_has_the_corners_that_it_tells():
    mesh = only_mesh(shape(TRIANGLE_KIND, size=(2.0, 0.5, 1.5)))
    assert corners(mesh)[0] == pytest.approx(np.array([[1, 2, 3], [1, 4, 3], [-0.5, 2.5, 3]]))
    assert mesh.normals == pytest.approx(np.tile([0.0, 0.0, 1.0], (3, 1)))


def test_a_fender_is_solid_where_rays_meet_it_and_open_where_they_do_not():
    mesh = only_mesh(shape(FENDER_KIND, size=(0.01, 0.6, 0.3), material=FENDER))
    rng = np.random.default_rng(1)
    points = np.column_stack([np.full(200, 0.01), rng.uniform(-0.6, 0.6, 200), rng.uniform(-0.3, 0.3, 200)])
    world = points @ TURN.T + [1.0, 2.0, 3.0]
    on_face = mesh.normals @ TURN[:, 0] > 0.5
    faces = corners(mesh)[on_face[mesh.faces[:, 0]]][:, :, [0, 2]]
    covered = [any(_is_inside(point, face) for face in faces) for point in world[:, [0, 2]]]
    assert covered == (~np.asarray(in_hole(points.T, (0.01, 0.6, 0.3)))).tolist()
    assert 0 < sum(covered) < 200


def _is_inside(point: np.ndarray, corner: np.ndarray) -> bool:
    sides = np.roll(corner, -1, axis=0) - corner
    ahead = point - corner
    turns = sides[:, 0] * ahead[:, 1] - sides[:, 1] * ahead[:, 0]
    return bool((turns >= 0).all() or (turns <= 0).all())


def test_glass_mirrors_and_walls_are_meshes_of_their_own():
    box = int(GeomType.mjGEOM_BOX)
    parts = [shape(box), shape(box, material=GLASS, transparency=0.65), shape(box, material=MIRROR)]
    fields = {name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])}
    finishes = set(meshes_of(DrawnShape(**fields)))
    assert finishes == {Finish(), Finish(opacity=0.35, roughness=0.1), MIRROR_FINISH}


def test_a_kind_that_nobody_draws_is_named():
    with pytest.raises(ValueError, match="kind 77"):
        meshes_of(shape(77))


def test_a_file_of_triangles_says_what_it_holds():
    mesh = only_mesh(shape(int(GeomType.mjGEOM_BOX)))
    data = glb_of(mesh, Finish(opacity=0.5))
    assert data[:4] == b"glTF"
    assert int.from_bytes(data[8:12], "little") == len(data)
    length = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + length])
    binary = data[28 + length :]
    assert tree["materials"][0]["alphaMode"] == "BLEND"
    assert tree["buffers"][0]["byteLength"] == len(binary)
    arrays = [
        np.frombuffer(
            binary,
            "<u4" if accessor["componentType"] == 5125 else "<f4",
            offset=view["byteOffset"],
            count=view["byteLength"] // 4,
        )
        for accessor, view in zip(tree["accessors"], tree["bufferViews"], strict=True)
    ]
    assert arrays[0].reshape(-1, 3) == pytest.approx(mesh.vertices)
    assert (arrays[3].reshape(-1, 3) == mesh.faces).all()
    # Colours are shares of light: half as bright on a screen is 0.214 of it (sRGB).
    assert arrays[2][:3] == pytest.approx([0.0331, 0.2140, 1.0], abs=1e-4)
