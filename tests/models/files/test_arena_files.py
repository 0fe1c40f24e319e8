"""Arenas from YAML files and back; what is wrong with a file is said in one line that names it."""

import re
import shutil
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import dev
from usarmjx.base.errors import ArenaFileError, UnknownNameError
from usarmjx.models.arenas import ARENAS
from usarmjx.models.check import check_arena
from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.victims import BONES, POSTURES
from usarmjx.models.files.load import find_arena, load_arena, read_arena, save_arena
from usarmjx.models.types.arena import (
    ArenaSpec,
    Door,
    FalseAlarm,
    HelpSound,
    Light,
    LooseObject,
    SegmentMotion,
    StartPose,
    Tag,
    Victim,
    Water,
)
from usarmjx.models.types.shapes import MATERIALS, SURFACES, HeightField, Mesh, Shape

EXAMPLES = dev.ROOT / "examples" / "arenas"
USED_BY = {"wedge.obj": "workshop.yaml", "rubble.obj": "workshop.yaml", "office.pgm": "office-map.yaml"}
STEPS = 65535  # of a 16-bit image


def assert_same(one, other, where="arena"):
    """Equal to the last digit, but terrain: within half a step of a 16-bit image."""
    if isinstance(one, Mesh):
        np.testing.assert_array_equal(one.vertices, other.vertices, where)
    elif isinstance(one, HeightField):
        quantum = np.max(one.heights) / STEPS
        np.testing.assert_allclose(other.heights, one.heights, rtol=0, atol=0.5001 * quantum, err_msg=where)
    elif is_dataclass(one):
        assert type(one) is type(other), where
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}")
    elif isinstance(one, tuple):
        assert len(one) == len(other), where
        for i, pair in enumerate(zip(one, other, strict=True)):
            assert_same(*pair, f"{where}[{i}]")
    else:
        assert one == other, where


@pytest.mark.parametrize("name", ARENAS.names())
def test_built_in_arenas_survive_being_saved(name, tmp_path):
    arena = ARENAS.get(name)
    assert_same(arena, load_arena(save_arena(arena, tmp_path / "arena.yaml")))


number = st.floats(-1e3, 1e3, allow_nan=False)
positive = st.floats(1e-3, 1e3)
share = st.floats(0, 1)
vector = st.tuples(number, number, number)
rgba = st.tuples(share, share, share, share)
text = st.text(st.characters(codec="utf-8"), max_size=12)
name = st.text(st.characters(min_codepoint=33, max_codepoint=126, exclude_characters="{}"), min_size=1)
posed = {"at": vector, "rotation": vector}
looks = {"surface": st.sampled_from(sorted(SURFACES)), "rgba": rgba}
box = st.builds(
    Shape,
    kind=st.just("box"),
    size=st.tuples(positive, positive, positive),
    mass=st.floats(0.1, 9),
    material=st.sampled_from(MATERIALS),
    **posed,
    **looks,
)
rod = st.builds(
    Shape, kind=st.sampled_from(["capsule", "cylinder"]), size=st.tuples(positive, positive), **posed, **looks
)
corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
wedge = st.builds(
    lambda scale, **rest: Shape(kind="mesh", mesh=Mesh(corners * scale), **rest), scale=positive, **posed
)
hill = st.builds(
    lambda heights, **rest: Shape(kind="hfield", heights=HeightField(np.array(heights)), **rest),
    heights=st.lists(st.lists(share, min_size=3, max_size=3), min_size=2, max_size=3),
    size=st.tuples(positive, positive, positive),
    at=vector,
)
segment = st.builds(
    SegmentMotion,
    name=st.sampled_from(sorted(BONES)),
    initial=vector,
    final=vector,
    rates=st.tuples(positive, positive, positive),
    scale=share,
)
victim = st.builds(
    Victim,
    name=text,
    **posed,
    posture=st.sampled_from(sorted(POSTURES)),
    segments=st.lists(segment, max_size=3, unique_by=lambda one: one.name).map(tuple),
    anim_timer=share,
    help_sound=st.none() | st.builds(HelpSound, loudness=positive, duration=positive, pause=positive),
    breathes=st.booleans(),
    state=text,
)


def tuples(items, key=None):
    by = {} if key is None else {"unique_by": key}
    return st.lists(items, max_size=2, **by).map(tuple)


def name_of(record):
    return record.name


arenas = st.builds(
    ArenaSpec,
    name=text,
    aliases=tuples(text),
    about=text,
    floor=number,
    has_floor=st.booleans(),
    shapes=tuples(box | rod | wedge | hill),
    starts=tuples(st.builds(StartPose, tag=name, at=vector, yaw=number, pitch=number, roll=number)),
    extent=st.tuples(positive, positive).map(lambda ends: ((-ends[0], ends[0]), (-ends[1], ends[1]))),
    loose=tuples(st.builds(LooseObject, name=text, shapes=st.tuples(box, wedge), **posed), name_of),
    doors=tuples(
        st.builds(Door, name=text, at=vector, yaw=number, mass=positive, friction=share, rgba=rgba), name_of
    ),
    waters=tuples(st.builds(Water, low=vector, high=st.tuples(*[st.floats(1001, 2000)] * 3))),
    victims=tuples(victim, name_of),
    false_alarms=tuples(
        st.builds(FalseAlarm, part=st.sampled_from(sorted(BONES)), at=vector, scale=positive)
    ),
    tags=tuples(st.builds(Tag, at=vector, id=st.integers(-1, 9999), memory=text, single_shot=st.booleans())),
    lights=tuples(st.builds(Light, at=vector, brightness=positive, rgb=vector)),
    gps=st.none() | st.tuples(st.floats(-90, 90), st.floats(-180, 180)),
    robots=tuples(text),
)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(arena=arenas)
def test_any_arena_survives_being_saved(arena, tmp_path_factory):
    path = tmp_path_factory.mktemp("saved") / "arena.yaml"
    assert_same(arena, load_arena(save_arena(arena, path)))


def test_a_saved_arena_names_its_files_and_leaves_out_defaults(tmp_path):
    shape = Shape(kind="mesh", mesh=Mesh(corners))
    arena = ArenaSpec(
        name="two", starts=(), extent=((-1, 1), (-1, 1)), shapes=(shape, replace(shape, mass=1))
    )
    path = save_arena(arena, tmp_path / "two.yaml")
    assert path.read_text().splitlines()[1:] == [
        "name: two",
        "shapes:",
        "- {kind: mesh, mesh: two-mesh-0.obj}",
        "- {kind: mesh, mass: 1, mesh: two-mesh-0.obj}",  # the same solid: the same file
        "starts: []",
        "extent:",
        "- [-1, 1]",
        "- [-1, 1]",
    ]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["two-mesh-0.obj", "two.yaml"]


@pytest.mark.parametrize("name", ["workshop.yaml", "office.yaml", "hill.yaml", "yard.xml", "bench.urdf"])
def test_examples_load_and_nothing_is_wrong_with_them(name):
    arena = load_arena(EXAMPLES / name)
    assert check_arena(arena) == []
    new_spec(arena, Physics()).compile()


def test_the_workshop_has_everything():
    arena, warnings = read_arena(EXAMPLES / "workshop.yaml")
    assert (arena.name, arena.floor, arena.gps) == ("DM-Workshop", -1.0, (49.9007, 8.6512))
    assert arena.starts[1] == StartPose(tag="Corner", at=(3, -2, 0.188), yaw=np.pi)
    assert [shape.kind for shape in arena.shapes].count("box") == 10
    assert {shape.material for shape in arena.shapes} == {"opaque", "glass", "mirror"}
    assert arena.shapes[1].at == (0, -3, 0.6)
    assert arena.shapes[1].rgba == arena.shapes[0].rgba  # merged
    assert [loose.name for loose in arena.loose] == ["brick", "rubble"]
    assert [loose.shapes[0].mass for loose in arena.loose] == pytest.approx([2.5, 4.0])  # 8 and 4 dm3 of 6 kg
    assert arena.victims[1].segments[0].rates == (0.8, 0, 0)
    assert [tag.id for tag in arena.tags] == [1001, -1]
    assert warnings == (f"{EXAMPLES / 'bench.urdf'}:18: 1 joints are held at zero: arm",)
    for field in fields(arena):
        assert getattr(arena, field.name) not in ((), None, ""), field.name


def test_an_empty_mapping_is_a_plain_floor(tmp_path):
    (tmp_path / "plain.yaml").write_text("{}")
    arena = load_arena(tmp_path / "plain.yaml")
    assert (arena.name, arena.extent) == ("plain", ((-5, 5), (-5, 5)))
    (start,) = arena.starts
    assert start.at == pytest.approx((0, 0, 0.188), abs=0.05)  # the middle, within a square of the grid


WALL = "kind: box, size: [1, 1, 1]"
MISTAKES = [
    ("name: [", r"a\.yaml:1: is no YAML: "),
    ("name: a\n\tfloor: 1", r"a\.yaml:2: is no YAML: .*'\\t'"),
    ("", r"a\.yaml: is empty"),
    ("just words", r"a\.yaml:1: 'just words' is not a mapping"),
    ("name: a\nname: b", r"a\.yaml:2: key 'name' is there twice"),
    ("flor: 1", r"a\.yaml:1: ArenaFile has no setting 'flor'; did you mean 'floor'\? .*\brndf$"),
    ("floor: high", r"a\.yaml:1: floor is 'high', expected a number"),
    ("floor: .nan", r"a\.yaml:1: floor is nan, expected a number"),
    ("floor: true", r"floor is True, expected a number"),
    ("name: 3", r"name is 3, expected a text"),
    ("has_floor: 1", r"has_floor is 1, expected true or false"),
    ("extent: [1, 2]", r"extent\[0\] is 1, expected a list of 2 numbers"),
    ("extent: [[1, 0], [0, 1]]", r"extent \[\[1\.0, 0\.0\], .* wants \[\[x0, x1\], \[y0, y1\]\]"),
    ("starts: [{tag: a}]", r"starts\[0\] has no 'at', expected a list of 3 numbers"),
    ("starts: [{tag: a b, at: [0, 0, 0]}]", r"start 'a b': a tag is one word of ASCII without braces"),
    ("starts: {tag: a}", r"starts is a mapping, expected a list"),
    ("gps: [91, 0]", r"gps\[0\] is 91, expected a number from -90 to 90 \[degrees\]"),
    (
        "shapes:\n- {kind: ball}",
        r"a\.yaml:2: shapes\[0\]\.kind is 'ball', expected one of box, .*hfield",
    ),
    ("shapes: [{kind: box}]", r"size \[\] of a box: wants 3 above zero, half lengths"),
    ("shapes: [{kind: sphere, size: [-1]}]", r"size \[-1\.0\] of a sphere: wants 1 above zero, the radius"),
    (
        f"shapes: [{{{WALL}, surface: mud}}]",
        r"a\.yaml:1: shapes\[0\]\.surface is 'mud', expected one of ground",
    ),
    (
        f"shapes: [{{{WALL}, material: jelly}}]",
        r"\.material is 'jelly', expected one of opaque, glass",
    ),
    (
        f"shapes: [{{{WALL}, rgba: [0, 0, 0, 2]}}]",
        r"\.rgba\[3\] is 2, expected a number from 0 to 1",
    ),
    ("shapes: [{kind: mesh}]", r"kind mesh and the key 'mesh' go together"),
    ("shapes: [{kind: mesh, mesh: gone.obj}]", r"shapes\[0\]\.mesh: there is no file .*gone\.obj"),
    ("shapes: [{kind: mesh, mesh: [[0, 0, 0]]}]", r"a\.yaml:1: shapes\[0\]\.mesh is flat or has fewer"),
    ("shapes: [{kind: hfield, size: [1, 1, 1], heights: [[0, 1], [0]]}]", r"not a table of at least 2 x 2"),
    (f"loose: [{{name: a, at: [0, 0, 0], shapes: [{{{WALL}}}]}}]", r"loose object 'a' has no mass"),
    ("doors: [{name: a, at: [0, 0, 0], limits: [1, 0]}]", r"limits \[1\.0, 0\.0\]: wants lowest and highest"),
    ("doors: [&a {name: a, at: [0, 0, 0]}, *a]", r"two doors are called 'a'"),
    ("waters: [{low: [0, 0, 0], high: [1, 1, 0]}]", r"waters\[0\]: low .* is not below high"),
    ("victims: [{name: a, at: [0, 0, 0], posture: odd}]", r"unknown posture 'odd'; known: standing"),
    ("false_alarms: [{part: Tail, at: [0, 0, 0]}]", r"unknown bone 'Tail'; known: "),
    ("tags: [{at: [0, 0, 0], id: 1.5}]", r"tags\[0\]\.id is 1\.5, expected a whole number"),
    ("lights: [{at: [0, 0, 0], brightness: -1}]", r"lights\[0\]\.brightness is -1, expected a number from 0"),
    ("floor: 90deg", r"floor is '90deg', expected a number \[m\]"),
    (
        "doors: [{name: a, at: [0, 0, 0], mass: 0}]",
        r"doors\[0\]\.mass is 0, expected a number above 0",
    ),
    ("meshes: {file: a.yaml, mass: -1}", r"a\.yaml:1: meshes\.mass is -1, expected a number from 0 \[kg\]"),
    ("heightfield:\n- {file: a.yaml, size: [1, 1], height: 0}", r"a\.yaml:2: heightfield\[0\]\.height is 0"),
    ("mjcf: gone.xml", r"a\.yaml:1: mjcf: there is no file .*gone\.xml"),
    ("meshes: [{at: [0, 0, 0]}]", r"meshes\[0\] has no 'file'"),
    ("meshes:\n- {file: a.yaml, scale: 0}", r"a\.yaml:2: meshes\[0\]\.scale: a scale is not zero"),
    ("heightfield: {file: a.yaml, size: [1, 1], height: 1}", r"a\.yaml: does not read as an image"),
    ("map: a.yaml", r"a\.yaml:1: MapDescription has no setting 'map'; it has: image, resolution"),
    ("a: &a [*a]", r"a\.yaml:1: a\[0\] contains itself"),
    ("x: " + "[" * 5000, r"a\.yaml"),
    ("? [1]\n: 2", r"a\.yaml:1: a key is a word"),
    ("has_floor: false", r"no free place for a robot to start from: give `starts`, or a floor"),
]


@pytest.mark.parametrize(("words", "says"), MISTAKES, ids=[words[:40] for words, _ in MISTAKES])
def test_a_mistake_is_named_with_its_place(words, says, tmp_path):
    (tmp_path / "a.yaml").write_text(words)
    with pytest.raises(ArenaFileError) as caught:
        load_arena(tmp_path / "a.yaml")
    assert re.search(says, str(caught.value)), caught.value
    assert "\n" not in str(caught.value)


def test_few_lines_that_stand_for_many_values_are_refused(tmp_path):
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 8)]
    (tmp_path / "a.yaml").write_text("\n".join(lines))
    with pytest.raises(ArenaFileError, match="more than 500000 values in one file"):
        load_arena(tmp_path / "a.yaml")


def test_angles_may_be_degrees_and_exponents_need_no_point(tmp_path):
    (tmp_path / "a.yaml").write_text("floor: 1e-3\nstarts: [{tag: a, at: [0, 0, 0.188], yaw: -45 deg}]")
    arena = load_arena(tmp_path / "a.yaml")
    assert arena.floor == 1e-3
    assert arena.starts[0].yaw == -np.pi / 4


@pytest.mark.parametrize("name", sorted(path.name for path in EXAMPLES.iterdir()))
def test_a_file_cut_off_anywhere_loads_or_is_refused(name, tmp_path):
    shutil.copytree(EXAMPLES, tmp_path, dirs_exist_ok=True)
    whole = (EXAMPLES / name).read_bytes()
    said = []
    for end in range(0, len(whole), len(whole) // 16):
        (tmp_path / name).write_bytes(whole[:end] + b"\xff")  # and no longer UTF-8
        try:
            load_arena(tmp_path / USED_BY.get(name, name))
        except ArenaFileError as error:
            said.append(str(error))
    assert len(said) > 8
    assert not [sentence for sentence in said if "\n" in sentence]


@pytest.mark.parametrize(
    ("name", "says"),
    [("a.gltf", r"names in \.yaml, .*\.stl"), ("gone.yaml", "no such file"), (".yaml", r"names in")],
)
def test_other_files_are_refused(name, says, tmp_path):
    with pytest.raises(ArenaFileError, match=says):
        load_arena(tmp_path / name)


def test_arenas_are_saved_as_yaml_where_there_is_a_folder(tmp_path):
    arena = ARENAS.get("field")
    with pytest.raises(ArenaFileError, match=r"field\.xml: arenas are saved as \.yaml"):
        save_arena(arena, tmp_path / "field.xml")
    with pytest.raises(ArenaFileError, match=r"cannot be written: No such file"):
        save_arena(arena, tmp_path / "gone" / "field.yaml")


def test_arenas_are_found_by_name_or_file():
    assert find_arena("YELLOW") is ARENAS.get("yellow")
    assert find_arena(str(EXAMPLES / "yard.xml")).name == "yard"
    assert find_arena(Path(EXAMPLES / "hill.yaml")).name == "DM-Hill"
    with pytest.raises(
        UnknownNameError, match=r"unknown arena 'atlantis'; known: .*yellow.*; or a file: \.yaml"
    ):
        find_arena("atlantis")
    with pytest.raises(ArenaFileError, match=r"atlantis\.yaml: there is no such file"):
        find_arena("atlantis.yaml")


def test_a_loose_object_may_state_its_inertia(tmp_path):
    text = (
        "name: A\nstarts: [{tag: A, at: [2, 0, 0.2]}]\nloose: [{name: brick, at: [0, 0, 1], shapes: "
        "[{kind: box, size: [0.1, 0.1, 0.1]}], inertia: {mass: 2.5, at: [0, 0, -0.05], moments: %s}}]\n"
    )
    path = tmp_path / "a.yaml"
    path.write_text(text % [0.1, 0.2, 0.25, 0, 0, 0])
    body = new_spec(load_arena(path), Physics()).compile().body("loose/brick")
    assert (body.mass.tolist(), body.ipos.tolist()) == ([2.5], [0.0, 0.0, -0.05])
    assert body.inertia == pytest.approx([0.1, 0.2, 0.25])
    path.write_text(text % [0.1, 0.2, 0.35, 0, 0, 0])
    with pytest.raises(
        ArenaFileError, match=r"a\.yaml:3: loose\[0\]: loose object 'brick': inertia is that of"
    ):
        load_arena(path)
