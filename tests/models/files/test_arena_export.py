"""Arenas written as SDF and URDF: our reader and MuJoCo's loader find the same solids, masses and hinges."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

import dev
from tests.models.files.test_arena_mjcf import composed, distances, original
from usarmjx.base.errors import UsageError
from usarmjx.models.files.arena_export import export_arena
from usarmjx.models.files.load import find_arena, load_arena
from usarmjx.models.files.robot_export import rpy_of
from usarmjx.models.types.arena import ArenaSpec, Door, LooseObject, StartPose
from usarmjx.models.types.shapes import SKY, HeightField, Mesh, Shape

WORKSHOP = str(dev.ROOT / "examples" / "arenas" / "workshop.yaml")
RAYS = 200
FAR = 40.0
"""Distance up to which rays meet the floor that URDF has [m]."""
MILLIMETRE = 1e-3
SEEN = Mesh(
    np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 0.1), (0.5, 0.5, 0.5)]) * 0.4,
    np.array([(1, 0, 4), (2, 1, 4), (3, 2, 4), (0, 3, 4), (0, 1, 5), (1, 2, 5), (2, 3, 5), (3, 0, 5)]),
)
"""A tent with a hollow under it: its hull is another solid."""


def room(*shapes, **changes):
    start = StartPose(tag="a", at=(0.0, 0.0, 0.188))
    return ArenaSpec(name="room", starts=(start,), extent=((-3, 3), (-3, 3)), shapes=shapes, **changes)


def beams(arena, count=RAYS):
    """Points over the floor plan of an arena, and directions that are rather level."""
    random = np.random.default_rng(7)
    (x0, x1), (y0, y1) = arena.extent
    points = random.uniform((x0, y0, 0.05), (x1, y1, 1.5), (count, 3))
    ways = random.normal(size=(count, 3)) * (1, 1, 0.3)
    return points, ways / np.linalg.norm(ways, axis=1, keepdims=True)


def weights(model):
    """Masses of the bodies that move, in order [kg]."""
    return sorted(model.body_mass[model.body_jntnum > 0].tolist())


@pytest.mark.oracle
@pytest.mark.parametrize("name", [WORKSHOP, "factory", "soccer"])
def test_our_reader_finds_the_solids_of_an_exported_sdf(name, tmp_path):
    arena = find_arena(name)
    export_arena(arena, tmp_path / "out.sdf")
    again = load_arena(tmp_path / "out.sdf")
    ours, theirs = composed(replace(arena, floor=0.0)), composed(again)
    rays = beams(arena)
    np.testing.assert_allclose(distances(*theirs, *rays), distances(*ours, *rays), atol=MILLIMETRE)
    assert weights(theirs[0]) == pytest.approx(weights(ours[0]), rel=1e-9)
    assert again.has_floor == arena.has_floor
    assert [thing.name for thing in again.loose] == [thing.name for thing in arena.loose]
    assert len(again.lights) == len(arena.lights)
    for mine, other in zip(again.doors, arena.doors, strict=True):
        assert mine.name == f"{other.name}::{other.name}", "SDF's name of a link in a model"
        np.testing.assert_allclose(
            [*mine.at, mine.yaw, *mine.size, *mine.limits, mine.mass, mine.friction],
            [*other.at, other.yaw, *other.size, *other.limits, other.mass, other.friction],
            atol=1e-9,
        )


@pytest.mark.oracle
@pytest.mark.parametrize("name", [WORKSHOP, "factory", "soccer"])
def test_mujocos_loader_finds_the_solids_of_an_exported_urdf(name, tmp_path):
    arena = find_arena(name)
    export_arena(arena, tmp_path / "out.urdf")
    ours, theirs = composed(replace(arena, floor=0.0)), original(tmp_path / "out.urdf")
    assert weights(theirs[0]) == pytest.approx(weights(ours[0]), rel=1e-9)
    kinds = [sorted(one[0].jnt_type.tolist()) for one in (ours, theirs)]
    assert kinds[0] == kinds[1], "free bodies and hinges"
    for door in arena.doors:
        hinge = theirs[0].joint(f"{door.name} joint")
        assert hinge.range == pytest.approx(door.limits)
    rays = beams(arena)
    expected = distances(*ours, *rays)
    near = expected < FAR
    assert near.sum() > 0.8 * RAYS
    np.testing.assert_allclose(distances(*theirs, *rays)[near], expected[near], atol=MILLIMETRE)


@pytest.mark.oracle
def test_terrain_becomes_a_closed_mesh(tmp_path):
    heights = np.random.default_rng(2).uniform(0, 0.5, (4, 6))
    hill = Shape(kind="hfield", size=(2.0, 1.0, 0.3), at=(0.5, 0.0, 0.0), heights=HeightField(heights))
    arena = room(replace(hill, surface="ground"), has_floor=False)
    result = export_arena(arena, tmp_path / "out.urdf")
    mesh = trimesh.load(result.files[1])
    assert mesh.is_watertight
    x, y = 4.0 / 5, 2.0 / 3  # the squares; a prism's volume is its base times the mean of its edges
    a, b, c, d = heights[:-1, :-1], heights[:-1, 1:], heights[1:, 1:], heights[1:, :-1]
    volume = x * y / 2 * ((a + b + c) / 3 + (a + c + d) / 3).sum() + 4.0 * 2.0 * 0.3
    assert mesh.volume == pytest.approx(volume, rel=1e-5)
    points, ways = beams(arena)
    points[:, 2] += 0.5  # above it, and downwards
    ways = (ways - (0, 0, 1)) / np.linalg.norm(ways - (0, 0, 1), axis=1, keepdims=True)
    found = [distances(*one, points, ways) for one in (composed(arena), original(tmp_path / "out.urdf"))]
    assert (found[0] > 0).sum() > 20
    np.testing.assert_allclose(found[1], found[0], atol=MILLIMETRE)
    assert "terrain is a mesh, 1 times" in result.notes


@pytest.mark.oracle
def test_gentle_terrain_keeps_its_heights_in_our_reader(tmp_path):
    """Faces that differ by a degree or two are not one plane."""
    x, y = np.meshgrid(np.linspace(-6, 6, 13), np.linspace(-6, 6, 13))
    heights = 0.4 + 0.15 * np.sin(x / 2) + 0.1 * np.cos(y / 3)
    hill = Shape(kind="hfield", size=(6.0, 6.0, 0.3), heights=HeightField(heights), surface="ground")
    arena = room(hill, has_floor=False)
    export_arena(arena, tmp_path / "out.sdf")
    again = load_arena(tmp_path / "out.sdf")
    places = np.random.default_rng(4).uniform(-5.9, 5.9, (RAYS, 2))
    points = np.column_stack([places, np.full(RAYS, 2.0)])
    down = np.tile((0.0, 0.0, -1.0), (RAYS, 1))
    found = [distances(*composed(one), points, down) for one in (arena, again)]
    np.testing.assert_allclose(found[1], found[0], atol=2 * MILLIMETRE)  # FLATNESS, and of its mean


def test_a_mesh_is_touched_as_its_hull_and_seen_as_its_faces(tmp_path):
    arena = room(
        Shape(kind="mesh", mesh=SEEN, surface="wall"),
        Shape(kind="mesh", mesh=SEEN, surface="wall", at=(1.0, 0.0, 0.0)),
    )
    result = export_arena(arena, tmp_path / "out.sdf")
    root = ET.parse(tmp_path / "out.sdf").getroot()
    touched, seen = (
        {one.text for one in root.iterfind(f".//{role}//uri")} for role in ("collision", "visual")
    )
    assert len(result.files) == 3, "meshes that are equal share a file"
    hull, faces = (trimesh.load(tmp_path / name.pop()) for name in (touched, seen))
    assert len(faces.faces) == 8
    # A pyramid of 0.4 m x 0.4 m x 0.2 m, and without the flat one of 0.04 m under it.
    assert hull.volume == pytest.approx(0.16 * 0.2 / 3, rel=1e-5)
    assert faces.volume == pytest.approx(0.16 * (0.2 - 0.04) / 3, rel=1e-5)


def test_urdf_has_capsules_and_ellipsoids_of_what_it_knows(tmp_path):
    arena = room(
        Shape(kind="capsule", size=(0.1, 0.3), at=(1.0, 0.5, 0.4), rotation=(0.3, 0.2, 0.1), surface="wall"),
        Shape(kind="ellipsoid", size=(0.3, 0.2, 0.1), at=(-1.0, 0.5, 0.4), surface="wall"),
    )
    result = export_arena(arena, tmp_path / "out.urdf")
    forms = [
        one[0].tag for one in ET.parse(tmp_path / "out.urdf").getroot().iterfind(".//collision/geometry")
    ]
    assert forms == ["box", "cylinder", "sphere", "sphere", "mesh"], "the floor first"
    assert "1 ellipsoids are meshes in URDF" in result.notes
    ours, theirs = composed(arena), original(tmp_path / "out.urdf")
    points = np.array([(1.0, 0.5, 2.0), (1.1, 0.5, 2.0), (2.0, 0.5, 0.55)])
    ways = np.array([(0.0, 0.0, -1.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0)])
    np.testing.assert_allclose(distances(*theirs, points, ways), distances(*ours, points, ways), atol=1e-6)


def test_names_stay_apart_and_what_is_lost_is_listed(tmp_path):
    ball = Shape(kind="sphere", size=(0.1,), mass=0.2, surface="loose")
    arena = room(
        Shape(kind="box", size=(1, 1, 0.1), at=(0, 0, 3), surface="wall", material=SKY),
        Shape(kind="box", size=(1, 1, 0.1), surface="fixture"),
        loose=(LooseObject(name="floor", at=(0, 0, 1), shapes=(ball,)),),
        doors=(Door(name="gate", at=(1, 0, 0)),),
        floor=0.5,
    )
    result = export_arena(arena, tmp_path / "out.world")
    names = [model.get("name") for model in ET.parse(tmp_path / "out.world").getroot().iter("model")]
    assert len(set(names)) == len(names) == 4
    again = load_arena(tmp_path / "out.world")
    assert [shape.surface for shape in again.shapes] == ["fixture"], "seen, and never touched"
    assert result.notes == (
        "1 start poses, 1 solids of the sky: left out",
        "heights count from the floor, which is 0.5 m high in usarmjx",
        "surfaces are left out: friction is that of the other tool",
    )
    with pytest.raises(UsageError, match=r"out\.usd: an arena is exported as \.xml, \.urdf, \.sdf, \.world"):
        export_arena(arena, tmp_path / "out.usd")


def test_angles_of_single_precision_keep_a_rotation_at_the_lock():
    """A body that lies: roll and yaw of a pitch of 90 degrees are one rotation, and no rounding error."""
    mat = np.array([[0, 0.995, -0.0998], [0, 0.0998, 0.995], [1.0, 0, 0]])
    noise = np.random.default_rng(3).uniform(-1e-7, 1e-7, (3, 3))
    back = np.zeros(4)
    mujoco.mju_euler2Quat(back, rpy_of(mat + noise), "XYZ")
    turned = np.zeros(9)
    mujoco.mju_quat2Mat(turned, back)
    np.testing.assert_allclose(turned.reshape(3, 3), mat, atol=1e-3)  # mat has three digits
