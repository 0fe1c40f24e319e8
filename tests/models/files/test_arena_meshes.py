"""Solids from mesh files, whose volumes and corners are known in closed form."""

import numpy as np
import pytest
import trimesh

import dev
from usarmjx.base.errors import ArenaFileError
from usarmjx.models.files.load import load_arena
from usarmjx.models.files.meshes import MAX_VERTICES, load_convex_pieces

EXAMPLES = dev.ROOT / "examples" / "arenas"


def write(path, text):
    path.write_text(text)
    return path


def export(path, *meshes):
    trimesh.util.concatenate(meshes).export(path)
    return path


def test_each_connected_piece_is_a_solid(tmp_path):
    box = trimesh.creation.box((1, 2, 3))
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.5).apply_translation((5, 0, 0))
    for name in ("two.stl", "two.obj"):
        found = load_convex_pieces(export(tmp_path / name, box, ball), (2, 2, 2))
        assert sorted(len(piece.corners) for piece in found) == [8, 42]
        assert sorted(p.volume for p in found) == pytest.approx(sorted([48, 8 * ball.volume]), rel=1e-5)


def test_objects_that_share_a_face_are_solids_of_their_own():
    lower, upper = load_convex_pieces(EXAMPLES / "rubble.obj")
    assert (lower.volume, upper.volume) == pytest.approx((8, 4))
    assert upper.corners.min(0).tolist() == [-1, -1, 1]


def ell():
    """A beam of 1 m whose section is an L of three squares."""
    outline = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], float)
    n = len(outline)
    vertices = np.r_[np.c_[outline, np.zeros(n)], np.c_[outline, np.ones(n)]]
    faces = [(0, i + 1, i) for i in range(1, n - 1)]
    faces += [(n, n + i, n + i + 1) for i in range(1, n - 1)]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j, n + j), (i, n + j, n + i)]
    return trimesh.Trimesh(vertices, faces, process=False)


def test_a_piece_that_is_not_convex_is_refused_unless_it_is_filled_or_cut(tmp_path):
    path = export(tmp_path / "ell.obj", ell())
    with pytest.raises(
        ArenaFileError, match=r"ell\.obj is not convex \(its hull has 3\.5 m3, itself 3\): cut it"
    ):
        load_arena(path)
    (filled,) = load_convex_pieces(path, hull=True)
    assert filled.volume == pytest.approx(3.5)
    for name, size, at in (("one", (2, 1, 1), (1, 0.5, 0.5)), ("two", (1, 1, 1), (0.5, 1.5, 0.5))):
        export(tmp_path / f"{name}.obj", trimesh.creation.box(size).apply_translation(at))
    yaml = write(tmp_path / "a.yaml", "meshes: [{file: ell.obj, decomposition: [one.obj, two.obj], mass: 3}]")
    (loose,) = load_arena(yaml).loose
    assert (loose.name, [shape.mass for shape in loose.shapes]) == ("ell", pytest.approx([2, 1]))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "it has no faces"),
        ("hello", "it has no faces"),
        ("v 0 0 0\nf 1 2 9\n", "does not read as a mesh"),
        ("v a b c\n", "does not read as a mesh"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "flat or has fewer"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n", "is not closed"),
    ],
)
def test_a_broken_mesh_is_one_line(text, says, tmp_path):
    with pytest.raises(ArenaFileError, match=says) as caught:
        load_arena(write(tmp_path / "a.obj", text))
    assert "\n" not in str(caught.value)


def test_solids_with_many_corners_are_refused(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=3)
    with pytest.raises(ArenaFileError, match=f"hull with 642 vertices, at most {MAX_VERTICES} are allowed"):
        load_arena(export(tmp_path / "ball.obj", ball))
