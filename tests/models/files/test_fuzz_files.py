"""Whatever is in a file: it loads, or one line says what is wrong with it.

`dev.py fuzz` tries many more files than a run of the tests.
"""

import io

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

import dev
from tests.kept_files import kept_files, written_files
from tests.models.files.test_collada import collada
from tests.models.files.test_import_mjcf import SEVERAL as ARM
from tests.models.files.test_robot_files import COLLADA, PLUGINS, cart
from tests.models.files.test_sdf_robots import ROBOT as ROBOT_SDF
from tests.models.ini.test_ini_later import LATER
from tests.mutations import edits, mutate
from tests.train.handmade import policy_file
from tests.valid_files import (
    ARENA,
    BINARY_STL,
    GAZEBO,
    GRID,
    INI,
    MAP,
    MISSION,
    MODEL,
    ROADS,
    STAGE,
    TEXT_STL,
    picture,
)
from usarmjx.base.errors import UsageError
from usarmjx.base.settings import describe
from usarmjx.models import load_robot
from usarmjx.models.files.load import load_arena
from usarmjx.models.files.maps import moving_ai_content
from usarmjx.models.files.meshes import load_convex_pieces
from usarmjx.models.files.mjcf import mjcf_content
from usarmjx.models.files.sdf import sdf_content
from usarmjx.models.files.stage import stage_content
from usarmjx.models.files.urdf import urdf_content
from usarmjx.models.ini.parse import read_ini
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.roads.rndf import read_mdf, read_rndf
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, Door, HelpSound, LooseObject, StartPose, Victim
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.configure import settings_by_kind
from usarmjx.train.policies.sources import load_exported

MANY = settings.default.max_examples if settings.default else 0
SOME = settings(max_examples=MANY if MANY > 100 else 20)
"""A short run where examples are always the same ones."""
EXAMPLES = dev.ROOT / "examples" / "arenas"
MOST_SAID = 4000
"""Characters of an error, which may list what is allowed."""

ROBOT, LATER_INI = cart(PLUGINS).encode(), LATER.encode()
"""A robot on wheels with plugins, and an ini file of the later versions."""

XACRO = ROBOT.replace(
    b'<robot name="cart">',
    b'<robot name="cart" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    b'<xacro:property name="w" value="${2*.3}"/>'
    b'<xacro:macro name="mast" params="n"><link name="${n}"/></xacro:macro><xacro:mast n="m$(optenv N 1)"/>',
).replace(b'size=".6 .4', b'size="${w} .4')
"""A xacro file with a property, a macro, an expression and a substitution."""

LOADERS = {
    "arena.yaml": (ARENA, load_arena),
    "model.xml": (MODEL, mjcf_content),
    "bench.urdf": ((EXAMPLES / "bench.urdf").read_bytes(), urdf_content),
    "cart.urdf": (ROBOT, load_robot),
    "cart.sdf": (ROBOT_SDF.encode(), load_robot),
    "arm.xml": (ARM.encode(), load_robot),
    "cart.urdf.xacro": (XACRO, load_robot),
    "box.dae": (COLLADA.encode(), load_convex_pieces),
    "room.dae": (collada(sides=5).encode(), load_arena),
    "roads.rndf": (ROADS, load_arena),
    "gazebo.world": (GAZEBO, sdf_content),
    "stage.world": (STAGE, stage_content),
    "grid.map": (GRID, moving_ai_content),
    "wedge.obj": ((EXAMPLES / "wedge.obj").read_bytes(), load_convex_pieces),
    "text.stl": (TEXT_STL, load_convex_pieces),
    "binary.stl": (BINARY_STL, load_convex_pieces),
    "hill.png": (picture("PNG"), load_arena),
    "robot.ini": (INI, read_ini),
    "robots.ini": (INI, lambda path: load_robots([path], ROBOTS)),
    "later.ini": (LATER_INI, lambda path: load_robots([path], ROBOTS, settings=settings_by_kind())),
    "roads.txt": (ROADS, read_rndf),
    "mission.txt": (MISSION, read_mdf),
    "policy.npz": (policy_file(io.BytesIO()).getvalue(), load_exported),
    **kept_files(),
    **written_files(),
}
"""A valid file of each kind, and what reads it."""


def read(loader, path):
    """Load a file, or be told in one line of bounded length what is wrong with it; anything else fails."""
    said = "fine"
    try:
        loader(path)
    except UsageError as error:
        said = str(error)
    assert 0 < len(said) < MOST_SAID
    assert len(said.splitlines()) == 1
    return said == "fine"


@pytest.mark.parametrize("name", LOADERS)
def test_the_files_that_are_changed_are_valid(name, tmp_path):
    whole, loader = LOADERS[name]
    (tmp_path / name).write_bytes(whole)
    assert read(loader, tmp_path / name)


@pytest.mark.parametrize("name", LOADERS)
@SOME
@given(changes=edits)
@example(changes=[("flip", 0.640625, 0, 128)])  # a body's name in MJCF that is no UTF-8
@example(changes=[("number", 0.46875, 0, 1)])  # an inertia in MJCF that is not finite
@example(changes=[("flip", 0.022, 0, 1)])  # a link in SDF without a name
@example(changes=[("number", 0.625, 0, 74)])  # a sphere in SDF whose volume no number has
def test_a_changed_file_loads_or_is_refused_in_one_line(name, changes, tmp_path_factory):
    whole, loader = LOADERS[name]
    path = tmp_path_factory.getbasetemp() / f"fuzzed-{name}"
    path.write_bytes(mutate(whole, changes))
    read(loader, path)


ODD = [0, 1, -1, 3, 1e9, -1e300, 1e-300, float("nan"), float("inf"), 10**30]
numbers = st.sampled_from(ODD) | st.floats()
scalars = st.none() | st.booleans() | st.integers() | numbers | st.text(max_size=5)
words = st.sampled_from(
    ["box", "mesh", "hfield", "wall", "mud", "glass", "90deg", "a", "fuzzed.obj", ".", "lying", "Head"]
)
KINDS = (ArenaSpec, Shape, LooseObject, Door, Victim, StartPose, HelpSound)
KEYS = sorted(
    {one.name for kind in KINDS for one in describe(kind)} | {"meshes", "file", "scale", "map", "urdf"}
)
trees = st.recursive(
    scalars | words | st.lists(numbers, max_size=4),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=6),
    max_leaves=20,
)


@SOME
@given(tree=st.dictionaries(st.sampled_from(KEYS), trees, max_size=6))
def test_any_tree_of_known_keys_is_an_arena_or_refused(tree, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "fuzzed-tree.yaml"
    path.write_text(yaml.safe_dump({"starts": [], **tree}), encoding="utf-8")
    read(load_arena, path)


INI_WORDS = [
    "class'USARBot.SonarSensor'",
    '"F1"',
    "P2ATTire",
    "KCarWheelJoint",
    "KDHinge",
    "W1",
    "HARD",
    "USARBot.P2AT",
]
INI_NAMES = [
    "X",
    "Y",
    "Z",
    "ItemName",
    "ItemClass",
    "PartName",
    "JointClass",
    "Number",
    "PkgName",
    "Size",
    "Radius",
    "Width",
    "MaxRange",
]
INI_KEYS = [
    "Sensors",
    "AddSensors",
    "Links",
    "JointParts",
    "MisPkgs",
    "Wheels(0)",
    "BaseClass",
    "Dimensions",
    "Weight",
    "MaxTorque",
    "batteryLife",
    "Payload",
    "CenterOfMass",
    "bMountByUU",
    "SteerSpeed",
    "NumTires",
    "MaxRange",
]
INI_SECTIONS = [
    "USARBot.P2AT",
    "USARBot.Cart",
    "USARBot.Own",
    "USARBot.RangeScanner",
    "USARMisPkg.Arm",
    "Engine",
    "USARBot.Hummer",
    "USARBot.TarantulaFrontTrack",
    "USARBot.MySensor",
]
ini_sections = st.sampled_from(INI_SECTIONS)
ini_values = st.recursive(
    scalars.map(str) | words | st.sampled_from(INI_WORDS),
    lambda inner: st.lists(
        st.tuples(st.sampled_from(INI_NAMES), inner).map("=".join) | inner, max_size=5
    ).map(lambda parts: f"({','.join(parts)})"),
    max_leaves=8,
)
ini_lines = st.tuples(st.sampled_from(["", "+", "-", "!"]), st.sampled_from(INI_KEYS), ini_values).map(
    lambda parts: f"{parts[0]}{parts[1]}={parts[2]}"
)


@SOME
@given(blocks=st.lists(st.tuples(ini_sections, st.lists(ini_lines, max_size=4)), max_size=4))
def test_any_lines_of_known_keys_are_robots_or_refused(blocks, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "fuzzed-robots.ini"
    text = "\n".join("\n".join([f"[{name}]", *lines]) for name, lines in blocks)
    path.write_text(text, encoding="utf-8", errors="replace")
    read(lambda file: load_robots([file], ROBOTS), path)


ROAD_WORDS = ["1", "1.1", "1.1.1", "2.0.1", "34.1", "-117", "nan", "1e9", "double_yellow", "x", "9" * 30]
road_words = st.sampled_from(ROAD_WORDS)
road_keys = st.sampled_from(sorted({line.split()[0] for line in ROADS.decode().splitlines()}))


@SOME
@given(
    rows=st.lists(st.tuples(st.integers(0, 40), road_keys, st.lists(road_words, max_size=3)), max_size=5),
    gone=st.lists(st.integers(0, 40), max_size=3),
)
def test_any_lines_of_roads_are_a_network_or_refused(rows, gone, tmp_path_factory):
    lines = ROADS.decode().splitlines()
    for place, key, values in rows:
        lines.insert(place, " ".join([key, *values]))
    for place in gone:
        del lines[place % len(lines)]
    path = tmp_path_factory.getbasetemp() / "fuzzed-roads.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    read(read_rndf, path)


SDF_TAGS = ["box", "size", "pose", "frame", "link", "joint", "model", "include", "uri", "plane", "normal"]
SDF_WORDS = ["1 2 3", "0 0 0 0 0 0", "a", "l", "nan", "-1", "1e300", "model://a", "world", "a::l", ""]
sdf_trees = st.recursive(
    st.tuples(st.sampled_from(SDF_TAGS), st.sampled_from(SDF_WORDS)).map(
        lambda p: f"<{p[0]}>{p[1]}</{p[0]}>"
    ),
    lambda inner: st.tuples(
        st.sampled_from(SDF_TAGS), st.sampled_from(SDF_WORDS), st.lists(inner, max_size=3)
    ).map(lambda p: f"<{p[0]} name='a' relative_to='{p[1]}'>{''.join(p[2])}</{p[0]}>"),
    max_leaves=8,
)


@SOME
@given(tree=st.lists(sdf_trees, max_size=4))
def test_any_tree_of_known_elements_is_a_world_or_refused(tree, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "fuzzed-tree.sdf"
    path.write_text(GAZEBO.decode().replace("<frame name", f"{''.join(tree)}<frame name"), encoding="utf-8")
    read(sdf_content, path)


STAGE_WORDS = [
    "1",
    "[1 2 3]",
    '"a"',
    "model (",
    ")",
    "block (",
    "points 3",
    "define a b (",
    "size",
    "nan",
    "a (",
]


@SOME
@given(words=st.lists(st.sampled_from(STAGE_WORDS), max_size=8), place=st.integers(0, 6))
def test_any_words_of_stage_are_a_world_or_refused(words, place, tmp_path_factory):
    lines = STAGE.decode().splitlines()
    lines.insert(place, " ".join(words))
    path = tmp_path_factory.getbasetemp() / "fuzzed-words.world"
    path.write_text("\n".join(lines), encoding="utf-8")
    read(stage_content, path)


@SOME
@given(changes=edits, pixels=edits)
def test_a_changed_map_loads_or_is_refused(changes, pixels, tmp_path_factory):
    folder = tmp_path_factory.getbasetemp()
    (folder / "fuzzed.png").write_bytes(mutate(picture("PPM"), pixels))
    (folder / "fuzzed-map.yaml").write_bytes(mutate(MAP, changes))
    read(load_arena, folder / "fuzzed-map.yaml")


def in_tag(attributes):
    """Attributes as a tag has them."""
    return " ".join(f"{key}='{value}'" for key, value in attributes.items())


SCENARIO = b"version 1\n0\tfuzzed.map\t4\t3\t1\t1\t2\t1\t3.4\n0\tfuzzed.map\t4\t3\t2\t2\t1\t1\t1\n"


@SOME
@given(rows=edits, cells=st.just([]) | edits)
def test_a_changed_scenario_loads_or_is_refused(rows, cells, tmp_path_factory):
    folder = tmp_path_factory.getbasetemp()
    (folder / "fuzzed.map").write_bytes(mutate(GRID, cells))
    (folder / "fuzzed.map.scen").write_bytes(mutate(SCENARIO, rows))
    read(moving_ai_content, folder / "fuzzed.map.scen")


JOINTS = ["hinge", "slide", "ball", "free", ""]
JOINT_WORDS = ["0 0 1", "0 0 0", "nan 0 1", "1e-320 0 0", "-1 1", "1 -1", "1e9 0 0", "0", "x", ""]
joints = st.tuples(
    st.sampled_from(JOINTS),
    st.dictionaries(st.sampled_from(["axis", "pos", "range", "ref", "name"]), st.sampled_from(JOINT_WORDS)),
)


@SOME
@given(made=st.lists(joints, max_size=4), mass=st.sampled_from(["0", "1e-12", "1", "1e30", "nan"]))
def test_any_joints_of_a_body_are_parts_or_refused(made, mass, tmp_path_factory):
    def element(number, kind, attributes):
        own = {"name": f"j{number}", **attributes} | ({"type": kind} if kind else {})
        return f"<joint {in_tag(own)}/>"

    inner = "".join(element(i, *one) for i, one in enumerate(made))
    path = tmp_path_factory.getbasetemp() / "fuzzed-joints.xml"
    path.write_text(
        f"<mujoco><worldbody><body name='b'><freejoint/><geom size='.1'/><body name='c'>{inner}"
        f"<geom size='.1' mass='{mass}'/></body></body></worldbody></mujoco>",
        encoding="utf-8",
    )
    read(load_robot, path)


URDF_TAGS = ["link", "joint", "inertial", "mass", "origin", "limit", "axis", "mimic", "gazebo", "collision"]
URDF_WORDS = ["wl", "base", "L", "0 0 1", "nan", "-1", "1e300", "1e-320", "continuous", "prismatic", ""]
URDF_KEYS = ["name", "type", "link", "value", "xyz", "rpy", "joint", "lower", "upper", "reference"]
urdf_attributes = st.dictionaries(st.sampled_from(URDF_KEYS), st.sampled_from(URDF_WORDS), max_size=3)
urdf_elements = st.recursive(
    st.tuples(st.sampled_from(URDF_TAGS), urdf_attributes).map(lambda p: f"<{p[0]} {in_tag(p[1])}/>"),
    lambda inner: st.tuples(st.sampled_from(URDF_TAGS), urdf_attributes, st.lists(inner, max_size=3)).map(
        lambda p: f"<{p[0]} {in_tag(p[1])}>{''.join(p[2])}</{p[0]}>"
    ),
    max_leaves=8,
)


@SOME
@given(tree=st.lists(urdf_elements, max_size=4), kind=st.sampled_from(["urdf", "sdf"]))
def test_any_tree_of_known_elements_is_a_robot_or_refused(tree, kind, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / f"fuzzed-tree-robot.{kind}"
    whole, end = (cart(PLUGINS), "</robot>") if kind == "urdf" else (ROBOT_SDF, "</model>")
    path.write_text(whole.replace(end, f"{''.join(tree)}{end}", 1), encoding="utf-8")
    read(load_robot, path)
