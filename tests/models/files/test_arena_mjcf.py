"""Arenas from MJCF and URDF files, against C MuJoCo's own reading of the same files."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

import dev
from usarmjx.base.errors import ArenaFileError
from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.files.arena_export import export_arena
from usarmjx.models.files.load import find_arena, load_arena, read_arena
from usarmjx.models.files.mjcf import mjcf_content

EXAMPLES = dev.ROOT / "examples" / "arenas"
FLOAT = 1e-5  # m: MuJoCo keeps meshes and terrain in single precision
EXACT = 1e-9  # m
RAYS = 300


def composed(arena):
    model = new_spec(arena, Physics()).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def original(path):
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def distances(model, data, points, directions):
    geom = np.zeros((1, 1), np.int32)
    pairs = zip(points, directions, strict=True)
    return np.array([mujoco.mj_ray(model, data, p, d, None, 1, -1, geom) for p, d in pairs])


def assert_rays_agree(one, other, reach=4.0):
    """Random rays meet the same things at the same distance [m]; at the edge of something one may miss it."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-reach, reach, (RAYS, 3)) * (1, 1, 0.4) + (0, 0, 0.4 * reach)
    directions = rng.normal(size=(RAYS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ours, theirs = (distances(*pair, points, directions) for pair in (one, other))
    assert (theirs > 0).sum() > RAYS / 10  # there is something to see
    assert (np.abs(ours - theirs) > FLOAT).sum() <= RAYS / 100


def write(path, text):
    path.write_text(text)
    return path


TOWN = """
<mujoco>
  <asset>
    <mesh name="hut" vertex="0 0 0  1 0 0  0 1 0  1 1 0  .5 .5 1" refpos=".1 .2 0"/>
    <hfield name="hill" nrow="3" ncol="4" size="1 .8 .5 .2" elevation="0 0 0 0  .2 1 .4 0  0 0 .3 0"/>
  </asset>
  <default><default class="seen"><geom contype="0" conaffinity="0"/></default></default>
  <worldbody>
    <light name="sun" pos="0 0 5"/>
    <geom type="plane" size="0 0 .1"/>
    <geom type="box" size=".3 .2 .4" pos="1 2 .4" euler="10 20 30"/>
    <geom type="mesh" mesh="hut" pos="-2 1 0" euler="0 0 15"/>
    <geom type="hfield" hfield="hill" pos="2 -2 .1" euler="0 0 20"/>
    <body pos="-1 -2 .5" euler="0 90 40">
      <geom type="capsule" size=".2 .4"/>
      <body pos="0 .5 0" quat=".7 .1 0 .2"><geom type="cylinder" size=".3 .2"/></body>
      <geom type="ellipsoid" size=".2 .3 .4" pos="0 -1 0" class="seen"/>
    </body>
    <geom type="sphere" size=".3" pos="0 0 2"/>
  </worldbody>
  <sensor><clock name="watch"/></sensor>
</mujoco>"""


@pytest.mark.oracle
def test_what_mjcf_has_is_where_mujoco_has_it(tmp_path):
    path = write(tmp_path / "town.xml", TOWN)
    arena, warnings = read_arena(path)
    assert arena.has_floor
    assert [shape.kind for shape in arena.shapes] == [
        *("box", "mesh", "hfield", "sphere", "capsule", "ellipsoid", "cylinder")
    ]
    assert [shape.surface == "fixture" for shape in arena.shapes] == [False] * 5 + [True, False]
    assert_rays_agree(composed(arena), original(path))
    line = next(i for i, text in enumerate(TOWN.splitlines(), 1) if 'name="sun"' in text)
    assert warnings == (
        f"{path}:{len(TOWN.splitlines()) - 1}: 1 sensors are left out: watch",
        f"{path}:{line}: 1 lights are left out: sun",
    )


@pytest.mark.oracle
def test_terrain_and_meshes_of_mjcf_survive_being_moved(tmp_path):
    path = write(tmp_path / "town.xml", TOWN)
    moved = TOWN.replace("<worldbody>", '<worldbody><frame pos="1 -.5 0" euler="0 0 25">')
    moved = moved.replace("</worldbody>", "</frame></worldbody>")
    write(tmp_path / "moved.xml", moved)
    yaml = write(tmp_path / "a.yaml", "mjcf: {file: town.xml, at: [1, -0.5, 0], yaw: 25deg}")
    assert path.is_file()
    assert_rays_agree(composed(load_arena(yaml)), original(tmp_path / "moved.xml"))


THINGS = """
<mujoco>
  <asset><mesh name="tent" vertex="0 0 0  .3 0 0  0 .4 0  0 0 .5"/></asset>
  <worldbody>
    <body name="sledge" pos="1 2 3" euler="10 20 30">
      <freejoint/>
      <geom type="box" size=".3 .2 .1" density="200"/>
      <body pos=".2 .1 .3" euler="0 40 0"><geom type="capsule" size=".1 .2" mass="1.5"/></body>
    </body>
    <body name="tent"><joint type="free"/><geom type="mesh" mesh="tent" density="50"/></body>
    <body name="barrel" pos="-1 0 1">
      <freejoint/>
      <inertial pos="0 .1 0" mass="7" diaginertia=".3 .4 .5" euler="0 0 20"/>
      <geom type="cylinder" size=".2 .4"/>
    </body>
    <body name="gate" pos="3 0 .2" euler="0 0 50">
      <joint type="hinge" axis="0 0 -1" pos=".4 0 0" range="-30 80" damping="1.5"/>
      <geom type="box" size=".4 .02 .5" pos="0 0 .5" mass="6"/>
    </body>
  </worldbody>
</mujoco>"""


@pytest.mark.oracle
def test_loose_bodies_keep_their_mass_and_inertia(tmp_path):
    path = write(tmp_path / "things.xml", THINGS)
    arena = load_arena(
        write(tmp_path / "a.yaml", "mjcf: things.xml\nhas_floor: true\nextent: [[-9, 9], [-9, 9]]")
    )
    (ours, here), (theirs, there) = composed(arena), original(path)
    for name in ("sledge", "tent", "barrel"):
        one, other = ours.body(f"loose/{name}").id, theirs.body(name).id
        mass = theirs.body_subtreemass[other]
        assert ours.body_subtreemass[one] == pytest.approx(mass, rel=1e-5)
        np.testing.assert_allclose(here.subtree_com[one], there.subtree_com[other], atol=FLOAT)
        # The mass matrices of the free joints, whose frames are the bodies'.
        blocks = []
        for model, data, body in ((ours, here, one), (theirs, there, other)):
            full = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, full)
            dof = model.body_dofadr[body]
            blocks.append(full[dof : dof + 6, dof : dof + 6])
        np.testing.assert_allclose(*blocks, atol=1e-3 * mass)  # what arena_masses.SAME leaves
    names = [[shape.surface for shape in loose.shapes] for loose in arena.loose]
    assert names == [["loose", "loose"], ["loose"], ["loose"]], "an inertial of its own makes no solid"
    assert [loose.inertia is not None for loose in arena.loose] == [False, False, True]


@pytest.mark.oracle
def test_a_hinged_box_becomes_a_door_that_turns_as_in_the_file(tmp_path):
    path = write(tmp_path / "things.xml", THINGS)
    yaml = write(tmp_path / "a.yaml", "mjcf: things.xml\nhas_floor: true")
    (door,) = load_arena(yaml).doors
    assert (door.name, door.mass, door.friction) == ("gate", 6.0, 1.5)
    assert door.size == pytest.approx((0.8, 0.04, 1.01), abs=EXACT)  # with the gap below
    assert door.limits == pytest.approx(np.deg2rad((-80, 30)), abs=EXACT)  # the axis points down
    (ours, here), (theirs, there) = composed(load_arena(yaml)), original(path)
    for angle in (-1.0, 0.0, 0.5):
        here.joint("door/gate").qpos, there.qpos[-1] = angle, -angle
        mujoco.mj_kinematics(ours, here)
        mujoco.mj_kinematics(theirs, there)
        np.testing.assert_allclose(here.geom("door/gate").xpos, there.geom_xpos[-1], atol=EXACT)
        turn = here.geom("door/gate").xmat.reshape(3, 3).T @ there.geom_xmat[-1].reshape(3, 3)
        np.testing.assert_allclose(np.abs(turn), np.eye(3), atol=EXACT)  # one box, perhaps half a turn on


def test_a_door_has_the_colour_of_its_material(tmp_path):
    text = THINGS.replace('mass="6"', 'mass="6" material="red"')
    text = text.replace("<asset>", '<asset><material name="red" rgba="1 0 0 1"/>')
    content = mjcf_content(write(tmp_path / "things.xml", text))
    assert [door.rgba for door in content.doors] == [(1.0, 0.0, 0.0, 1.0)]


BODY = "<mujoco><worldbody>{}</worldbody>{}</mujoco>"
HINGED = '<body name="b"><joint {}/><geom type="box" size=".4 .1 .5" pos=".4 0 0"/>{}</body>'


@pytest.mark.parametrize(
    ("world", "rest", "says"),
    [
        ("<geom", "", "does not read as MJCF: XML parse error"),
        ('<geom type="cube"/>', "", "does not read as MJCF: .*invalid keyword"),
        (
            '<geom type="mesh" mesh="m"/>',
            '<asset><mesh name="m" file="gone.stl"/></asset>',
            "reading file|opening",
        ),
        (
            '<geom type="plane" size="1 1 1"/><geom name="g" type="plane" size="1 1 1" pos="0 0 1"/>',
            "",
            "plane 'g' is unbounded and not the floor",
        ),
        ('<geom type="plane" size="1 1 1" euler="5 0 0"/>', "", "plane 'number 0' is unbounded"),
        (HINGED.format('axis="1 0 0"', ""), "", "body 'b': its hinge is not upright"),
        (HINGED.format('pos=".4 0 0" axis="0 0 1"', ""), "", "'b': its hinge is not at a narrow side"),
        (HINGED.format('axis="0 0 1"', '<geom size="1"/>'), "", "body 'b' has a hinge and is not one box"),
        (HINGED.format('type="slide"', ""), "", "body 'b' has the joints slide; arenas have"),
        (
            HINGED.format('type="free"', HINGED.format("", "").replace('"b"', '"c"')),
            "",
            "'c' hangs on 'b' by a joint",
        ),
        (
            HINGED.format('type="free"', '<geom type="plane" size="1 1 1"/>'),
            "",
            "plane only allowed in static bodies|free and has a plane",
        ),
        (
            HINGED.format('name="j" axis="0 0 1"', ""),
            '<equality><joint joint1="j"/></equality>',
            "1 of kind equality constraint; arenas have none",
        ),
    ],
)
def test_what_an_arena_cannot_have_is_refused_by_name(world, rest, says, tmp_path):
    path = write(tmp_path / "a.xml", BODY.format(world, rest))
    with pytest.raises(ArenaFileError, match=f"a.xml: .*({says})"):
        load_arena(path)


SCENE = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 .1"/>
<geom name="block" type="box" size=".5 .5 .2" pos="2 0 .2"/>
<body name="rover"><freejoint/><site name="eye"/><geom name="hull" type="box" size=".3 .2 .1"/>
<body name="w"><joint name="spin"/><geom size=".1"/></body>
<body name="arm"><joint name="swing"/><geom size=".1"/></body></body>
<body name="gate" pos="0 3 .5"><joint name="turn" axis="0 0 1"/>
<geom type="box" size=".4 .02 .5" pos=".4 0 0"/></body></worldbody>
<tendon><fixed name="belt"><joint joint="swing" coef="1"/></fixed></tendon>
<equality><joint joint1="swing" joint2="spin"/></equality>
<contact><exclude body1="rover" body2="gate"/><pair geom1="hull" geom2="block"/></contact>
<actuator><motor joint="spin"/><motor tendon="belt"/><motor joint="turn"/></actuator>
<sensor><gyro site="eye"/><jointpos joint="spin"/></sensor><keyframe><key name="home"/></keyframe></mujoco>"""


def test_a_scene_that_includes_its_robot_is_an_arena_without_it(tmp_path):
    path = write(tmp_path / "scene.xml", SCENE)
    content = mjcf_content(path)
    assert len(content.shapes) == 1
    assert content.floor
    assert [door.name for door in content.doors] == ["gate"], "a motor makes no robot of a door"
    assert content.loose == ()
    assert content.warnings == (
        f"{path}:3: 1 robots are left out: rover",
        f"{path}:11: 1 actuators are left out: without name",
    )


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["workshop.yaml", "outdoor"])
def test_an_exported_arena_is_the_same_for_mujocos_own_loader(name, tmp_path):
    arena = find_arena(str(EXAMPLES / name) if name.endswith("yaml") else name)
    export_arena(arena, tmp_path / "out.xml")
    ours, theirs = composed(arena), original(tmp_path / "out.xml")
    assert theirs[0].ngeom == ours[0].ngeom
    assert theirs[0].body_mass.sum() == pytest.approx(ours[0].body_mass.sum(), rel=1e-6)
    assert [theirs[0].joint(i).name for i in range(theirs[0].njnt)] == [
        ours[0].joint(i).name for i in range(ours[0].njnt)
    ]
    assert_rays_agree(ours, theirs)


@pytest.mark.oracle
def test_urdf_stands_where_mujoco_has_it(tmp_path):
    trimesh.creation.box((0.4, 0.2, 0.6)).export(tmp_path / "block.stl")
    text = (EXAMPLES / "bench.urdf").read_text()
    text = text.replace('<sphere radius="0.05"/>', '<mesh filename="block.stl" scale="1 2 .5"/>')
    text = text.replace("visual>", "collision>").replace('<material name="wood"/>', "")
    path = write(tmp_path / "bench.urdf", text)
    arena = replace(load_arena(path), has_floor=False)  # MuJoCo's has none
    assert [shape.kind for shape in arena.shapes] == ["box"] * 4 + ["mesh"]
    assert_rays_agree(composed(arena), original(path), reach=1.2)


LINK = "<robot><link name='a'><visual><geometry>{}</geometry></visual></link></robot>"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<robot", "a.urdf:1: is no XML"),
        ("<sdf/>", "its root is <sdf>"),
        (
            "<robot><link name='a'/><joint name='j'><parent link='a'/><child link='b'/></joint></robot>",
            "'b' is no link",
        ),
        (
            LINK.format("<cone/>"),
            "link 'a': .*<cone>",
        ),
        ("<robot><link name='a'><collision/></link></robot>", "link 'a': has no geometry; allowed: box"),
        (
            LINK.format("<sphere radius='big'/>"),
            r"a.urdf:1: <sphere radius> has 'big', expected a number",
        ),
        (
            LINK.format("<mesh filename='package://x/m.stl'/>"),
            "package://x/m.stl is not there: no folder 'x'",
        ),
        (
            "<robot><link name='a'/><joint name='j'><parent link='a'/><child link='a'/></joint></robot>",
            "link 'a' hangs on itself",
        ),
    ],
)
def test_a_mistake_in_urdf_is_named(text, says, tmp_path):
    with pytest.raises(ArenaFileError, match=says):
        load_arena(write(tmp_path / "a.urdf", text))


TABLE = """<mujoco><worldbody><geom name="ground" type="plane" size="5 5 .1" pos="0 0 -.9"/>
<geom type="box" size=".5 .4 .02" pos="1 0 -.02"/>
<body name="cup" pos="1 0 .05"><freejoint/><geom type="box" size=".03 .03 .05" mass=".2"/></body>
<body pos="0 3 .1"><joint axis="0 0 1"/><geom type="box" size=".4 .02 1" pos=".4 0 0"/></body>
</worldbody></mujoco>"""


def test_a_scene_whose_floor_lies_elsewhere_moves_to_height_zero(tmp_path):
    arena, notes = read_arena(write(tmp_path / "table.xml", TABLE))
    (note,) = [note for note in notes if "floor" in note]
    assert "table.xml: the floor, plane 'ground', is at height -0.9: everything moves by 0.9 m" in note
    assert arena.has_floor
    assert arena.shapes[0].at == pytest.approx((1.0, 0.0, 0.88))
    assert arena.loose[0].at == pytest.approx((1.0, 0.0, 0.95))
    model, data = composed(arena)
    assert data.geom("door/" + arena.doors[0].name).xpos[2] == pytest.approx(1.0, abs=0.011)  # a gap below
    assert data.geom("floor").xpos[2] == 0.0
    assert model.ngeom == 4


ELL = """<mujoco><asset><mesh name="ell" vertex="{}" face="{}"/></asset><worldbody>
<geom type="plane" size="5 5 .1"/><geom name="ell" type="mesh" mesh="ell"/></worldbody></mujoco>"""


def test_a_mesh_that_is_not_convex_is_met_as_in_mujoco(tmp_path):
    """A corner of two walls, 2 x 2 m with a yard of 1 x 1 m: robots meet the hull, rays enter the yard."""
    trimesh = pytest.importorskip("trimesh")
    plan = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    corners = [(x, y, z) for z in (0.0, 1.0) for x, y in plan]
    faces = [(a, b, b + 6, a + 6) for a, b in zip(range(6), (1, 2, 3, 4, 5, 0), strict=True)]
    triangles = [half for a, b, c, d in faces for half in ((a, b, c), (a, c, d))]
    triangles += [(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 5, 4), (6, 7, 8), (6, 8, 9), (6, 9, 10), (6, 10, 11)]
    mesh = trimesh.Trimesh(corners, triangles, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(3.0)
    text = ELL.format(
        " ".join(f"{x:g}" for corner in corners for x in corner),
        " ".join(str(i) for triangle in triangles for i in triangle),
    )
    path = write(tmp_path / "ell.xml", text)
    arena, notes = read_arena(path)
    assert (
        f"{path}: geom 'ell' is not convex, not closed or too fine: robots meet its hull, rays its faces"
        in notes
    )
    (ours, here), (theirs, there) = composed(arena), original(path)
    for x, y in ((1.6, 1.6), (1.3, 1.1), (0.5, 1.5), (1.5, 0.5)):
        start, down = np.array([x, y, 3.0]), np.array([0.0, 0.0, -1.0])
        ranges = [
            mujoco.mj_ray(model, data, start, down, None, 1, -1, np.zeros(1, np.int32))
            for model, data in ((ours, here), (theirs, there))
        ]
        assert ranges[0] == pytest.approx(ranges[1], abs=1e-6)
