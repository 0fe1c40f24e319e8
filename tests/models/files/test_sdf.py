"""Worlds and models of Gazebo as arenas: where things stand, what moves, and what is left out."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from tests.models.files.worlds import PYRAMID, world, write
from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.check import check_arena
from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.files.load import load_arena, read_arena
from usarmjx.models.files.mesh_solids import box_of
from usarmjx.models.types.arena import START_ELEVATION

EXACT = 1e-9  # m: sums and products of a few doubles
TURNED = 1e-6  # m and rad: through rotation matrices and back

BOX = "<geometry><box><size>{}</size></box></geometry>"
STATIC = "<static>true</static>"


def solid(name, size="1 1 1", pose="", more=""):
    """A link with one box."""
    placed = f"<pose>{pose}</pose>" if pose else ""
    return f"<link name='{name}'>{placed}<collision name='c'>{BOX.format(size)}</collision>{more}</link>"


def read(folder, text, name="a.world"):
    """The arena of a world's content, and what is left out."""
    return read_arena(write(folder / name, world(text)))


@pytest.mark.parametrize(
    ("geometry", "kind", "size"),
    [
        ("<box><size>2 1 0.5</size></box>", "box", (1, 0.5, 0.25)),
        ("<sphere><radius>0.4</radius></sphere>", "sphere", (0.4,)),
        ("<cylinder><radius>0.2</radius><length>3</length></cylinder>", "cylinder", (0.2, 1.5)),
        ("<capsule><radius>0.2</radius><length>1</length></capsule>", "capsule", (0.2, 0.5)),
        ("<ellipsoid><radii>0.1 0.2 0.3</radii></ellipsoid>", "ellipsoid", (0.1, 0.2, 0.3)),
        (
            "<polyline><point>0 0</point><point>2 0</point><point>2 1</point><point>0 1</point>"
            "<height>3</height></polyline>",
            "box",
            (1, 0.5, 1.5),
        ),
    ],
)
def test_sizes_are_halved_as_mujocos_are(geometry, kind, size, tmp_path):
    text = f"<model name='m'>{STATIC}<link name='l'><collision name='c'><geometry>{geometry}</geometry>"
    arena, notes = read(tmp_path, text + "</collision></link></model>")
    (shape,) = arena.shapes
    assert shape.kind == kind
    assert shape.size == pytest.approx(size)
    assert notes == ()


FRAMES = f"""
<frame name='desk'><pose>10 0 0 0 0 {math.pi / 2}</pose></frame>
<model name='m'>{STATIC}<pose relative_to='desk'>1 0 0 0 0 0</pose>
  <frame name='a'><pose>0 0 1 0 0 0</pose></frame>
  <frame name='b' attached_to='a'><pose>0 2 0 0 0 0</pose></frame>
  <link name='l'><pose relative_to='b' degrees='true'>0 0 0 0 0 90</pose>
    <collision name='c'><pose>1 0 0 0 0 0</pose>{BOX.format("1 2 3")}</collision></link>
  <model name='inner'><pose relative_to='l'>0 0 1 0 0 0</pose>
    <link name='k'><collision name='c'>{BOX.format("1 1 1")}</collision></link></model>
</model>"""


def test_poses_count_from_the_frames_that_they_name(tmp_path):
    """The desk turns x to y; the link is at (8, 1, 1), turned by 180 degrees; its box 1 m along its x."""
    outer, inner = read(tmp_path, FRAMES)[0].shapes
    assert outer.at == pytest.approx((7, 1, 1), abs=TURNED)
    assert abs(outer.rotation[2]) == pytest.approx(math.pi, abs=TURNED)
    assert inner.at == pytest.approx((8, 1, 2), abs=TURNED)


def test_words_within_a_world_are_no_sign_of_its_kind(tmp_path):
    box = "<box><size>1 1 1</size></box>"
    text = "<plugin name='p' filename='p.so'><robotNamespace>/</robotNamespace></plugin>"
    text += f"<model name='m'>{STATIC}"
    text += f"<link name='l'><collision name='c'><geometry>{box}</geometry></collision></link></model>"
    for name in ("a.world", "a.xml"):
        arena, _ = read_arena(write(tmp_path / name, f"<?xml version='1.0'?><!-- a <robot> -->{world(text)}"))
        assert [shape.kind for shape in arena.shapes] == ["box"]


def test_a_frame_that_is_relative_to_itself_is_named(tmp_path):
    frames = "<frame name='a'><pose relative_to='b'/></frame><frame name='b'><pose relative_to='a'/></frame>"
    text = f"<model name='m'>{STATIC}{frames}<link name='l'><pose relative_to='a'>0 0 0 0 0 0</pose></link>"
    with pytest.raises(ArenaFileError, match=r"a\.world:\d+: model 'm': frame 'a' is relative to itself"):
        read(tmp_path, text + "</model>")
    text = f"<model name='m'>{STATIC}<link name='l'><pose relative_to='x'>0 0 0 0 0 0</pose></link></model>"
    with pytest.raises(ArenaFileError, match="there is no frame 'x'; known: l"):
        read(tmp_path, text)


def test_models_are_found_beside_the_world_and_placed(tmp_path):
    (tmp_path / "models/crate").mkdir(parents=True)
    (tmp_path / "worlds").mkdir()
    config = "<model><sdf version='1.5'>old.sdf</sdf><sdf version='1.7'>new.sdf</sdf></model>"
    write(tmp_path / "models/crate/model.config", config)
    frame = "<frame name='top'><pose>0 0 1 0 0 0</pose></frame>"
    text = f"<sdf><model name='crate'>{frame}{solid('l', '1 1 2')}</model></sdf>"
    write(tmp_path / "models/crate/new.sdf", text)
    write(tmp_path / "models/crate/old.sdf", text.replace("1 1 2", "5 5 5"))
    includes = """
    <include><uri>model://crate</uri><static>true</static><pose>1 2 1 0 0 0</pose></include>
    <include><uri>https://fuel.gazebosim.org/1.0/OpenRobotics/models/Crate</uri><name>b</name>
      <static>1</static><placement_frame>top</placement_frame><pose>4 0 1 0 0 0</pose></include>
    <include><uri>model://gone</uri></include>
    <include><uri>model://sun</uri></include>
    """
    arena, notes = read(tmp_path / "worlds", includes)
    assert [shape.at for shape in arena.shapes] == [
        pytest.approx((1, 2, 1), abs=EXACT),
        pytest.approx((4, 0, 0), abs=EXACT),
    ]
    assert arena.shapes[0].size == pytest.approx((0.5, 0.5, 1))
    assert arena.has_floor
    assert len(notes) == 1
    assert "a.world:" in notes[0]
    assert "model model://gone is not there and left out; --packages" in notes[0]
    ground = "<include><uri>model://ground_plane</uri><name>low</name><pose>0 0 -2 0 0 0</pose></include>"
    arena, notes = read_arena(write(tmp_path / "b.world", world(ground, "")))
    assert arena.shapes[0].at == pytest.approx((0, 0, -2.05))
    assert not arena.has_floor


def test_packages_are_searched_for_models(tmp_path):
    (tmp_path / "far/crate").mkdir(parents=True)
    (tmp_path / "near").mkdir()
    write(tmp_path / "far/crate/model.sdf", f"<sdf><model name='crate'>{STATIC}{solid('l')}</model></sdf>")
    path = write(tmp_path / "near/a.world", world("<include><uri>model://crate</uri></include>", ""))
    with pytest.raises(ArenaFileError, match=r"nothing stands in it; .*model://crate is not there"):
        load_arena(path)
    assert len(read_arena(path, packages=[tmp_path / "far"])[0].shapes) == 1
    named = write(tmp_path / "near/a.yaml", "sdf: a.world\nstarts: []\nfloor: 0")
    assert len(read_arena(named, packages=[tmp_path / "far"])[0].shapes) == 1


def test_a_model_that_includes_itself_is_refused(tmp_path):
    (tmp_path / "a").mkdir()
    include = "<include><uri>model://a</uri></include>"
    write(tmp_path / "a/model.sdf", f"<sdf><model name='a'>{include}</model></sdf>")
    with pytest.raises(ArenaFileError, match=r"model\.sdf:\d+: model://a includes itself"):
        read(tmp_path, include)


def test_what_is_not_static_is_loose_with_the_mass_of_its_links(tmp_path):
    mass = "<inertial><mass>{}</mass></inertial>"
    joint = "<joint name='j' type='fixed'><parent>a</parent><child>b</child></joint>"
    text = f"""
    <model name='pair'><pose>1 2 0.5 0 0 0</pose>{solid("a", more=mass.format(3))}
      {solid("b", "1 1 0.5", "0 0 0.75 0 0 0", mass.format(2))}{joint}</model>
    <model name='plain'>{solid("l")}</model>"""
    arena, notes = read(tmp_path, text)
    pair, plain = arena.loose
    assert (pair.name, pair.at) == ("pair::a", pytest.approx((1, 2, 0.5)))
    assert [shape.mass for shape in pair.shapes] == pytest.approx([3, 2])
    assert pair.shapes[1].at == pytest.approx((0, 0, 0.75))
    assert plain.shapes[0].mass == 1.0  # SDF's default
    assert arena.shapes == notes == ()


HINGE = """<joint name='hinge' type='revolute'><parent>{}</parent><child>leaf</child>
<pose>-0.5 0 0 0 0 0</pose><axis><xyz>0 0 {}</xyz><limit><lower>{}</lower><upper>1.5</upper></limit>
<dynamics><damping>0.7</damping></dynamics></axis></joint>"""


def test_a_loose_object_has_the_inertia_of_its_file(tmp_path):
    """Two links, whose inertias are stated at places and angles of their own, as one body."""
    moments = np.diag([0.2, 0.3, 0.4])
    inertial = (
        "<inertial><pose>0.1 0 0 0 0 0.5</pose><mass>3</mass><inertia><ixx>0.2</ixx><iyy>0.3</iyy>"
        "<izz>0.4</izz></inertia></inertial>"
    )
    joint = "<joint name='j' type='fixed'><parent>a</parent><child>b</child></joint>"
    links = solid("a", more=inertial) + solid("b", pose="0 2 0 0 0 0", more=inertial)
    arena, notes = read(tmp_path, f"<model name='m'>{links}{joint}</model>")
    assert notes == ()
    (thing,) = arena.loose
    assert [(shape.surface, shape.mass) for shape in thing.shapes] == [("loose", 0.0)] * 2
    spec = new_spec(arena, Physics())
    model = spec.compile()
    body = model.body(f"loose/{thing.name}")
    turn = mat_from_angles(0.0, 0.0, 0.5)
    # Both are alike, 2 m apart along y: Steiner's 2 x 3 kg x (1 m)^2 about x and z.
    expected = 2 * turn @ moments @ turn.T + 6 * np.diag([1.0, 0.0, 1.0])
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, body.iquat)
    axes = frame.reshape(3, 3)
    assert body.mass[0] == pytest.approx(6)
    np.testing.assert_allclose(body.ipos, [0.1, 1.0, 0.0], atol=TURNED)
    np.testing.assert_allclose(axes @ np.diag(body.inertia) @ axes.T, expected, atol=TURNED)


def test_an_inertia_of_no_body_is_named_and_that_of_the_solids_counts(tmp_path):
    inertial = "<inertial><mass>3</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>5</izz></inertia></inertial>"
    arena, (note,) = read(tmp_path, f"<model name='m'>{solid('a', more=inertial)}</model>")
    assert "link 'a' has the inertia of no body: that of its solids counts" in note
    assert "a.world:" in note
    assert (arena.loose[0].inertia, arena.loose[0].shapes[0].mass) == (None, pytest.approx(3))


def test_a_box_on_an_upright_hinge_is_a_door_and_other_joints_are_held(tmp_path):
    leaf = solid("leaf", "1 0.04 2", "0 0 1 0 0 0", "<inertial><mass>9</mass></inertial>")
    arena, notes = read(tmp_path, f"<model name='gate'>{leaf}{HINGE.format('world', 1, 0)}</model>")
    (door,) = arena.doors
    assert door.at[:2] == pytest.approx((-0.5, 0))
    assert door.size == pytest.approx((1, 0.04, 2.01), abs=0.02)
    assert (door.limits, door.mass, door.friction) == ((0, 1.5), 9, 0.7)
    assert notes == ()
    askew = HINGE.format("world", 1, 0).replace("0 0 0</pose>", "1.5708 0 0</pose>")
    askew = askew.replace("<xyz>", "<use_parent_model_frame>1</use_parent_model_frame><xyz>")
    moved = leaf.replace(
        "<collision name='c'>", "<collision name='c'><pose relative_to='__model__'>0 0 1 0 0 0</pose>"
    )
    arena, _ = read(tmp_path, f"<model name='gate'>{moved}{askew}</model>")
    assert arena.doors == (door,), "poses and axes count from the frames that they name"
    text = f"<model name='gate'>{solid('post', '0.1 0.1 2', '-0.55 0 1 0 0 0')}{leaf}{{}}</model>"
    arena, notes = read(tmp_path, text.format(HINGE.format("post", 1, 0)))
    assert not arena.doors
    assert len(arena.loose[0].shapes) == 2
    assert "joint 'hinge' of type 'revolute' is held at zero" in notes[0]


def test_a_door_with_a_handle_hangs_in_a_frame_that_a_joint_without_a_range_holds(tmp_path):
    """Doors of Gazebo's libraries: joints from the leaf to the world, the frame held by limits of 0 and 0."""
    leaf = solid("leaf", "1 0.04 2", "0 0 1 0 0 0", "<inertial><mass>9</mass></inertial>")
    post, handle = (
        solid("post", "0.1 0.1 2", "-0.55 0 1 0 0 0"),
        solid("handle", "0.2 0.03 0.03", "0.4 0 1 0 0 0"),
    )
    turns = "<joint name='knob' type='revolute'><parent>leaf</parent><child>{}</child></joint>"
    foot = (
        "<joint name='foot' type='revolute'><parent>world</parent><child>post</child><axis><xyz>0 1 0</xyz>"
    )
    foot += "<limit><lower>0</lower><upper>0</upper></limit></axis></joint>"
    joints = f"{turns.format('handle')}{HINGE.format('post', 1, 0)}{foot}"
    text = f"<model name='gate'>{post}{leaf}{handle}{joints}</model>"
    arena, notes = read(tmp_path, text)
    (door,) = arena.doors
    assert (door.at[:2], door.limits, door.mass) == (pytest.approx((-0.5, 0)), (0, 1.5), 10)
    assert (len(arena.shapes), arena.loose) == (1, ())
    assert [note.rpartition(": ")[2] for note in notes] == [
        "1 solids on the door 'gate::leaf', up to 0.3 m long, are left out",
        "joint 'knob' of type 'revolute' is held at zero",
    ]
    arena, _ = read(tmp_path, text.replace("0.2 0.03 0.03", "0.4 0.03 0.03"))
    assert not arena.doors, "no handle is as long"


def test_planes_lamps_and_colours(tmp_path):
    plane = "<plane><normal>0 0 1</normal><size>8 6</size></plane>"
    plane = f"<collision name='p'><geometry>{plane}</geometry></collision>"
    red = "<visual name='v'><material><script><name>Gazebo/Red</name></script></material></visual>"
    text = f"""
    <model name='floor'>{STATIC}<link name='l'>{plane}</link></model>
    <model name='deck'>{STATIC}<pose>20 0 1 0 0 0</pose><link name='l'>{plane}</link></model>
    <model name='m'>{STATIC}{solid("l", more=red)}</model>
    <light name='p' type='point'><pose>1 2 3 0 0 0</pose><diffuse>0.5 0.25 0 1</diffuse>
      <attenuation><constant>0.5</constant><linear>0.5</linear><quadratic>0</quadratic></attenuation></light>"""
    arena, notes = read(tmp_path, text)
    deck, box = arena.shapes
    assert arena.has_floor
    assert deck.size == pytest.approx((4, 3, 0.05))
    assert deck.at == pytest.approx((20, 0, 0.95))
    assert box.rgba == (1, 0, 0, 1)
    (lamp,) = arena.lights
    assert (lamp.at, lamp.brightness, lamp.rgb) == ((1, 2, 3), 0.5, (1, 0.5, 0))  # at 1 m: 0.5 / (0.5 + 0.5)
    assert len(notes) == 1
    assert "not the floor" in notes[0]
    sun = "<light name='sun' type='directional'/>"
    arena, notes = read(tmp_path, text + sun)
    assert arena.lights == ()
    assert any("1 lamps are left out: the sun shines" in note for note in notes)


def test_robots_become_start_poses_on_the_ground_under_them(tmp_path):
    drive = "<plugin name='d' filename='libgazebo_ros_diff_drive.so'/>"
    text = f"""
    <model name='slab'>{STATIC}<pose>3 0 0.1 0 0 0</pose>{solid("l", "2 2 0.2")}</model>
    <model name='burger'><pose>3.5 0.5 0.3 0 0 1</pose>{solid("l", "0.1 0.1 0.1")}{drive}</model>"""
    arena, notes = read(tmp_path, text)
    (start,) = arena.starts
    assert (start.tag, start.yaw) == ("burger", pytest.approx(1))
    assert start.at == pytest.approx((3.5, 0.5, 0.2 + START_ELEVATION), abs=TURNED)
    assert not arena.loose
    assert "robot 'burger' (libgazebo_ros_diff_drive.so) becomes the start pose burger" in notes[0]


def test_what_is_left_out_is_listed_once_with_its_first_line(tmp_path):
    odd = "<geometry><image><uri>a.png</uri></image></geometry>"
    text = f"""
    <actor name='walker'/>
    <population name='p'/>
    <plugin name='x' filename='libx.so'/>
    <spherical_coordinates/>
    <model name='m'>{STATIC}{solid("l", more="<sensor name='s' type='camera'/>")}
    {solid("k", more="<sensor name='t' type='imu'/>")}
    <link name='o'><collision name='i'>{odd}</collision></link>
    <link name='e'><collision name='j'/></link></model>"""
    _, notes = read(tmp_path, text)
    said = "\n".join(notes)
    for wanted in (
        r"a.world:2: 1 <actor> (settings) left out: walker",
        r"1 <population> (settings) left out: p",
        r"1 <plugin> (plugins) left out: x",
        "<spherical_coordinates> left out",
        r"2 <sensor> (in links) left out: s, t",
        "<collision> 'i' is a <image>: left out; known: box,",
        "<collision> 'j' has no geometry: left out",
    ):
        assert wanted in said
    assert all(note.startswith(str(tmp_path / "a.world:")) for note in notes)


def test_a_saved_state_places_models(tmp_path):
    state = "<state world_name='w'><model name='m'><pose>7 8 0.5 0 0 0</pose></model></state>"
    arena, _ = read(tmp_path, f"<model name='m'>{STATIC}{solid('l')}</model>{state}")
    assert arena.shapes[0].at == pytest.approx((7, 8, 0.5))


def test_a_height_map_is_terrain(tmp_path):
    Image.fromarray(np.array([[0, 255, 0], [0, 51, 0], [0, 0, 0]], np.uint8)).save(tmp_path / "hill.png")
    text = "<heightmap><uri>file://hill.png</uri><size>20 10 2</size><pos>1 2 3</pos></heightmap>"
    link = f"<link name='l'><collision name='c'><geometry>{text}</geometry></collision></link>"
    (shape,) = read(tmp_path, f"<model name='m'>{STATIC}{link}</model>")[0].shapes
    assert (shape.kind, shape.size, shape.at) == ("hfield", (10, 5, 0.1), (1, 2, 3))
    np.testing.assert_allclose(shape.heights.heights, [[0, 0, 0], [0, 0.4, 0], [0, 2, 0]], atol=EXACT)


ROOM = """v -3 -2 0\nv 3 -2 0\nv 3 2 0\nv -3 2 0\nv -3 -2 2\nv 3 -2 2\nv 3 2 2\nv -3 2 2
f 1 2 3 4\nf 2 1 5 6\nf 3 2 6 7\nf 4 3 7 8\nf 1 4 8 5\n"""


def test_a_room_of_a_mesh_is_driven_in(tmp_path):
    """Four walls and a floor, seen from inside: a hull would be a block of 6 x 4 x 2 m."""
    write(tmp_path / "room.obj", ROOM)
    mesh = "<geometry><mesh><uri>room.obj</uri><scale>1 1 0.5</scale></mesh></geometry>"
    text = f"<model name='m'>{STATIC}<link name='l'><collision name='c'>{mesh}</collision></link></model>"
    arena = load_arena(write(tmp_path / "a.world", world(text, "")))
    assert len(arena.shapes) == 5
    assert sorted(shape.surface for shape in arena.shapes) == ["ground", *["wall"] * 4]
    assert {shape.kind for shape in arena.shapes} == {"box"}
    assert max(shape.at[2] + max(shape.size[2], 0.5) for shape in arena.shapes) == pytest.approx(1)
    assert check_arena(arena, "P2AT") == []


@given(
    st.lists(st.floats(-3, 3), min_size=3, max_size=3), st.lists(st.floats(0.01, 5), min_size=3, max_size=3)
)
def test_the_corners_of_a_box_are_that_box(angles, half):
    turn = np.asarray(mat_from_angles(*np.array(angles)))
    signs = np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1
    corners = (signs * half) @ turn.T + (1, 2, 3)
    size, pose = box_of(np.random.default_rng(0).permutation(corners))
    np.testing.assert_allclose(np.sort(size), np.sort(half), atol=1e-9)
    np.testing.assert_allclose(pose.pos, (1, 2, 3), atol=1e-9)
    assert np.linalg.det(pose.mat) == pytest.approx(1)
    again = (signs * size) @ pose.mat.T + pose.pos
    away = np.linalg.norm(again[:, None] - corners[None], axis=2)
    assert away.min(0).max() < 1e-9
    bent = corners + 0.1 * np.eye(8, 3) * min(half)
    assert box_of(bent) is None


def test_convex_parts_stay_whole_and_loose_ones_are_hulls(tmp_path):
    write(tmp_path / "pyramid.obj", PYRAMID)
    mesh = "<geometry><mesh><uri>pyramid.obj</uri></mesh></geometry>"
    link = f"<link name='l'><collision name='c'>{mesh}</collision></link>"
    arena, _ = read(tmp_path, f"<model name='m'>{STATIC}{link}</model><model name='n'>{link}</model>")
    assert len(arena.shapes) == 1
    assert len(arena.shapes[0].mesh.vertices) == 5
    assert arena.loose[0].shapes[0].mass == pytest.approx(1)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<model name='m'><link name='l'><pose>1 2</pose></link></model>", r"<pose> has '1 2', expected 6"),
        ("<include/>", "<include> has no <uri>"),
    ],
)
def test_a_mistake_is_named(text, says, tmp_path):
    with pytest.raises(ArenaFileError, match=says):
        read(tmp_path, text)


def test_a_world_without_anything_is_refused(tmp_path):
    with pytest.raises(ArenaFileError, match=r"a\.world: nothing stands in it"):
        load_arena(write(tmp_path / "a.world", world("<light name='s' type='directional'/>", "")))


def test_a_wrong_size_leaves_one_solid_out(tmp_path):
    _, notes = read(tmp_path, f"<model name='m'>{STATIC}{solid('l', '1 0 1')}{solid('k')}</model>")
    assert (
        "<size> has [1.0, 0.0, 1.0], expected lengths above zero [m]; <collision> 'c' is left out" in notes[0]
    )


def test_a_model_by_itself_stands_on_a_floor(tmp_path):
    path = write(tmp_path / "model.sdf", f"<sdf><model name='m'>{STATIC}{solid('l', '2 1 1')}</model></sdf>")
    arena = load_arena(path)
    assert arena.has_floor
    assert len(arena.shapes) == 1
    yaml = write(tmp_path / "a.yaml", "sdf: {file: model.sdf, at: [1, 0, 0.5], yaml: 1}")
    with pytest.raises(ArenaFileError, match="ModelFile has no setting 'yaml'"):
        load_arena(yaml)
    write(yaml, "sdf: {file: model.sdf, at: [1, 0, 0.5], yaw: 90deg, surface: ground}")
    (shape,) = load_arena(yaml).shapes
    assert shape.at == pytest.approx((1, 0, 0.5))
    assert shape.surface == "ground"


def test_usd_is_refused_by_name(tmp_path):
    with pytest.raises(ArenaFileError, match="USD is not read: export it as OBJ"):
        load_arena(write(tmp_path / "a.usda", "#usda 1.0"))
