"""Small files that stand for much: counted before anything is built, and read elsewhere under limits."""

import contextlib
import os
import re
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import ConvexHull

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.settings import yaml_file
from usarmjx.models.drives import NoDrive
from usarmjx.models.files import mjcf, reader_child, stage
from usarmjx.models.files.load import load_arena
from usarmjx.models.files.reader_process import ReaderProcess
from usarmjx.models.files.robot_file import robot_from_mjcf
from usarmjx.models.files.xml_file import check_model_size

BRIEFLY = 10.0
"""Seconds of a processor; what was mended here took minutes to years."""


def write(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refused(path, says, loader=load_arena):
    """Loading is refused in one line, without much work."""
    start = time.process_time()
    with pytest.raises(ArenaFileError, match=says) as caught:
        loader(path)
    assert time.process_time() - start < BRIEFLY
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


MODEL = "<mujoco>{}<worldbody>{}</worldbody></mujoco>"
BALL = '<geom size=".1"/>'
ROW = '<replicate count="{}" offset="1 0 0">{}</replicate>'
MUCH = {
    "hfield": (
        '<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>',
        "",
        r"<hfield> 'h' brings its heights to 3600000000; at most 1000000$",
    ),
    "replicate": (
        "",
        ROW.format(10_000, ROW.format(10_000, BALL)),
        r"<geom> brings its elements to 100010003; at most 50000$",
    ),
    "composite": (
        "",
        '<body><composite prefix="p" type="particle" count="900 900 900"/></body>',
        r"<composite> 'p' brings its elements to 729000003; at most 50000",
    ),
    "texture": (
        '<asset><texture name="t" type="cube" builtin="flat" width="9000" height="9000"/></asset>',
        "",
        r"<texture> 't' brings its pixels to 486000000; at most 64000000",
    ),
    "numeric": (
        '<custom><numeric name="a" size="1000000000"/></custom>',
        "",
        r'<numeric size="1000000000"> is too much; at most 1000000',
    ),
    "memory": ('<size memory="1T"/>', "", r'<size memory="1T"> is too much; at most 1000000000'),
    "user": ('<size nuser_geom="1000000000"/>', BALL, r"<size nuser_geom=.* is too much; at most 1000"),
    "mesh": (
        '<asset><mesh name="m" builtin="supersphere" params="100000 1 1"/></asset>',
        "",
        r"<mesh params=.* is too much; at most 1000",
    ),
    "deep": ("", "<body>" * 500 + "</body>" * 500, r"<body> is nested 201 deep; at most 200"),
    "itself": ('<include file="a.xml"/>', "", r"a\.xml includes itself"),
    "wide": ("", "<site/>" * 50_000, r"more than 50000 elements, <site> is the next one"),
}


@pytest.mark.parametrize("name", MUCH)
def test_what_a_model_makes_is_counted_before_it_is_built(name, tmp_path, monkeypatch):
    monkeypatch.setattr("usarmjx.models.files.mjcf.try_model", None)  # never asked
    before, world, says = MUCH[name]
    refused(write(tmp_path / "a.xml", MODEL.format(before, world)), says)


def test_robots_are_counted_too(tmp_path, monkeypatch):
    monkeypatch.setattr("usarmjx.models.files.robot_mjcf.try_model", None)
    path = write(tmp_path / "a.xml", MODEL.format("", ROW.format(10**8, BALL)))
    refused(path, "at most 50000", lambda file: robot_from_mjcf(file, name="A", drive=NoDrive()))


def test_what_is_included_or_attached_counts_as_often_as_it_is_there(tmp_path):
    write(tmp_path / "part.xml", "<mujoco><worldbody>" + BALL * 300 + "</worldbody></mujoco>")
    write(tmp_path / "list.xml", f"<mujoco>{BALL * 300}</mujoco>")
    asset = '<asset><model name="m" file="part.xml"/></asset>'
    for inside in ('<include file="list.xml"/>', '<attach model="m" prefix="x"/>'):
        few = MODEL.format(asset, ROW.format(100, inside))
        check_model_size(write(tmp_path / "few.xml", few))
        many = write(tmp_path / "many.xml", MODEL.format(asset, ROW.format(200, inside)))
        refused(many, r"many\.xml: <geom> brings its elements to 50\d\d\d; at most 50000", check_model_size)


@pytest.mark.parametrize(
    ("size", "at", "says"),
    [("1e308", "0", "geom_size up to 1e"), (".1", "nan", "contains a 'NaN'"), (".1", "1e9", "at most 1e.07")],
)
def test_numbers_that_nobody_can_compute_with_are_refused(size, at, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    body = (
        f'<body name="b" pos="0 0 {at}"><freejoint/><geom type="cylinder" size="{size} .2" mass="1"/></body>'
    )
    refused(write(tmp_path / "a.xml", MODEL.format("", body)), says)
    assert [path.name for path in tmp_path.iterdir()] == ["a.xml"]  # and no log of MuJoCo's


def test_comments_with_many_dashes_are_mujocos_business(tmp_path):
    text = MODEL.format("<!-- a -- b --->", '<geom type="plane" size="5 5 1"/>' + ROW.format(3, BALL))
    assert len(load_arena(write(tmp_path / "a.xml", text)).shapes) == 3


@pytest.mark.parametrize(
    ("name", "encoding"), [("a.xml", "utf-8"), ("a.urdf", "utf-8"), ("a.urdf", "utf-16")]
)
def test_no_document_type_is_taken(name, encoding, tmp_path):
    root = "robot" if name == "a.urdf" else "mujoco"
    text = f'<!DOCTYPE robot [<!ENTITY a "b">]>\n<{root}><link name="&a;"/></{root}>'
    refused(
        write(tmp_path / name, text.encode(encoding)),
        r"defines a document type \(<!DOCTYPE robot>\); models have none",
    )


def test_long_chains_of_links_are_no_recursion(tmp_path):
    count = 3000
    links = "".join(f"<link name='l{i}'/>" for i in range(count))
    joint = "<joint name='j{0}' type='fixed'><origin xyz='0 0 1'/><parent link='l{0}'/>"
    joint += "<child link='l{1}'/></joint>"
    last = "<link name='top'><collision><geometry><sphere radius='1'/></geometry></collision></link>"
    joints = "".join(joint.format(i, i + 1) for i in range(count - 1)) + joint.format("x", "y")
    text = f"<robot>{joints}{links}{last}</robot>".replace("'lx'", f"'l{count - 1}'").replace("'ly'", "'top'")
    yaml = f"urdf: {write(tmp_path / 'a.urdf', text).name}\nstarts: []"
    (ball,) = load_arena(write(tmp_path / "a.yaml", yaml)).shapes
    assert ball.at == pytest.approx((0, 0, count))
    wrong = text.replace("<child link='top'/>", "<child link='none'/>")
    refused(write(tmp_path / "b.urdf", wrong), "'none' is no link; known: l0, .*, ...$")


def test_meshes_that_are_named_a_thousand_times_are_too_many(tmp_path):
    mesh = "<collision><geometry><mesh filename='a.obj'/></geometry></collision>"
    refused(
        write(tmp_path / "a.urdf", f"<robot><link name='a'>{mesh * 1001}</link></robot>"), "1001 meshes; at"
    )
    refused(
        write(tmp_path / "a.yaml", "meshes: [" + "a.yaml, " * 1001 + "]"), "more than 1000 files under 'mes"
    )
    one = "- &a {kind: hfield, size: [1, 1, 1], heights: {file: a.yaml, height: 1}}\n"
    refused(
        write(tmp_path / "b.yaml", "shapes:\n" + one + "- *a\n" * 32), "more than 32 files under 'heights'"
    )


GIANT = MODEL.format("", ROW.format(20_000, BALL))


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        ({"cpu_time": 1}, "takes more than 1 s of a processor"),
        ({"patience": 0.01}, "takes longer than 0.01 s"),
    ],
)
def test_whoever_reads_too_long_is_stopped_and_the_next_file_is_read(limits, says, tmp_path):
    reader = ReaderProcess(**limits)
    try:
        assert says in reader.read("model", write(tmp_path / "a.xml", GIANT))[0]["error"]
        if "cpu_time" in limits:
            assert reader.read("model", write(tmp_path / "b.xml", MODEL.format("", BALL)))[0] == {"bytes": 0}
    finally:
        reader.close()


def children():
    """The processes that this one has started and that are there, be it as zombies."""
    stats: list[str] = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has just ended
            stats.append(file.read_text())
    fields = [text.rpartition(")")[2].split() for text in stats]
    return {
        text.split()[0]
        for text, (_, parent, *_) in zip(stats, fields, strict=True)
        if parent == str(os.getpid())
    }


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc")
def test_whoever_has_nothing_to_read_ends_and_the_next_file_is_read(tmp_path):
    reader, before = ReaderProcess(idle=0.05), children()
    path = write(tmp_path / "a.xml", MODEL.format("", BALL))
    for _ in range(2):
        assert reader.read("model", path)[0] == {"bytes": 0}
        deadline = time.monotonic() + 60
        while children() - before:
            assert time.monotonic() < deadline
            time.sleep(0.05)
    reader.close()


def test_whoever_takes_too_much_memory_is_stopped(tmp_path):
    field = '<asset><hfield name="h" nrow="9000" ncol="9000" size="1 1 1 1"/></asset>'
    path = write(tmp_path / "a.xml", MODEL.format(field, '<geom type="hfield" hfield="h"/>'))
    reader = ReaderProcess(memory=100_000_000)
    try:
        assert "100 MB of memory do not suffice" in reader.read("model", path)[0]["error"]
    finally:
        reader.close()


@pytest.mark.parametrize(
    ("program", "says"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", r"its reader crashed \(SIGSEGV\)"),
        ("import os; os.kill(os.getpid(), 9)", "was killed: is there memory enough"),
        ("raise SystemExit(3)", r"crashed \(code 3\)"),
        ("print('{\"bytes\": 9}'); raise SystemExit(4)", r"crashed \(code 4\)"),
        ("pass", "does not start"),
    ],
)
def test_a_reader_that_crashes_takes_nobody_along(program, says, tmp_path, monkeypatch):
    monkeypatch.setattr(reader_child, "__file__", str(write(tmp_path / "child.py", program)))
    reader = ReaderProcess()
    assert re.search(says, reader.read("model", tmp_path / "a.xml")[0]["error"])


def test_a_mesh_that_many_geoms_have_is_cut_into_pieces_once(tmp_path, monkeypatch):
    made = []
    true = mjcf.convex_pieces
    monkeypatch.setattr(mjcf, "convex_pieces", lambda *args, **kinds: made.append(1) or true(*args, **kinds))
    tent = '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'
    floor = '<geom type="plane" size="5 5 1"/>'
    path = write(
        tmp_path / "a.xml", MODEL.format(tent, floor + ROW.format(50, '<geom type="mesh" mesh="m"/>'))
    )
    assert len(load_arena(path).shapes) == 50
    assert len(made) == 1


def test_what_parses_with_mujoco_alone_is_counted_when_it_is_built(tmp_path):
    """MuJoCo takes entities that nobody has defined for text."""
    field = '<asset><hfield name="&h;" nrow="1001" ncol="1000" size="1 1 1 1"/></asset>'
    path = write(tmp_path / "a.xml", MODEL.format(field, '<geom type="hfield" hfield="&h;"/>'))
    check_model_size(path)
    refused(path, "it makes 1001000 of nhfielddata; at most 1000000")


def test_so_many_bodies_may_move(tmp_path):
    ball = '<body><freejoint/><geom size=".1"/></body>'
    refused(
        write(tmp_path / "a.xml", MODEL.format("", ball * 1001)), "has 1001 bodies that move; at most 1000"
    )


@pytest.mark.parametrize("name", ["/dev/zero", ".."])
def test_what_is_no_plain_file_is_no_image(name, tmp_path):
    refused(write(tmp_path / "a.yaml", f"image: {name}\nresolution: 1"), "it is no plain file")


def test_numbers_in_base_60_are_not_worked_out(tmp_path):
    refused(
        write(tmp_path / "a.yaml", "floor: 1" + ":59" * 500_000), r"a\.yaml:1: floor: a number of 1500001 ch"
    )


def test_merges_and_values_and_keys_are_counted_while_they_are_read(tmp_path, monkeypatch):
    lines = [
        "a0: &a0 {x: 1}",
        *(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}" for i in range(1, 40)),
        "<<: *a39",
    ]
    refused(
        write(tmp_path / "a.yaml", "\n".join(lines)), "ArenaFile has no setting 'x'"
    )  # which it has once, not 2^39 times
    refused(
        write(tmp_path / "b.yaml", f"? {'k' * 5000}\n: 1"),
        r"b\.yaml:1: a key of 5000 characters; at most 100",
    )
    refused(write(tmp_path / "c.yaml", "floor: " + "x" * 9000), r"floor is 'x+\.\.\.', expected a number")
    refused(write(tmp_path / "d.yaml", "&a <<: *a"), "is no YAML|contains itself|empty")
    monkeypatch.setattr(yaml_file, "MAX_VALUES", 1000)
    refused(write(tmp_path / "e.yaml", "floor: [" + "0, " * 5000 + "0]"), "more than 1000 values in one file")


@pytest.mark.parametrize(
    "word", ["!!int x", "!!int ''", "!!bool maybe", "!!float ''", "!!timestamp x", "!!set x"]
)
def test_a_value_that_is_not_what_its_tag_says_is_one_line(word, tmp_path):
    refused(write(tmp_path / "a.yaml", f"floor: {word}"), r"a\.yaml:1: ")


def test_solids_all_over_each_other_are_refused_where_a_start_is_looked_for(tmp_path):
    plate = "shapes:\n- &a {kind: box, size: [100, 100, 0.1]}\n" + "- *a\n" * 50
    refused(
        write(tmp_path / "a.yaml", plate), r"its solids stand over \d+ squares of its plan; at most 10000000"
    )
    shelf = "- {{kind: box, size: [.5, .5, .05], at: [0, 0, {}]}}\n"
    text = "extent: [[-50, 50], [-50, 50]]\nshapes:\n" + "".join(shelf.format(i) for i in range(40))
    refused(write(tmp_path / "b.yaml", text), "more than 22 surfaces one above the other on 1000000 squares")
    assert len(load_arena(write(tmp_path / "c.yaml", plate + "starts: []")).shapes) == 51
    refused(
        write(tmp_path / "d.yaml", "extent: [[-1e300, 1e300], [-1, 1]]"),
        r"1e\+300 m from the origin; at most",
    )


def test_a_map_of_specks_is_refused_before_they_are_counted(tmp_path):
    specks = (np.indices((2000, 2000)).sum(0) % 2 * 255).astype(np.uint8)
    Image.fromarray(specks).save(tmp_path / "a.png")
    refused(write(tmp_path / "a.yaml", "image: a.png\nresolution: 0.05"), "more than the 10000 boxes")


def test_pictures_that_run_programs_are_no_maps(tmp_path):
    write(tmp_path / "a.png", "%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n")
    refused(tmp_path / "a.png", "does not read as an image: cannot identify")


FACET = b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
BROKEN = [
    ("a.stl", b"", "does not read as a mesh: it is empty, it has no faces"),
    ("a.obj", b" \n", "does not read as a mesh: it is empty, it has no faces"),
    ("a.stl", b"\x80\x81\x00", "neither text nor as long as the header of a binary file, 84 bytes"),
    ("a.stl", bytes(80) + struct.pack("<I", 100) + bytes(75), "announces 100 facets and is .* in facet 2"),
    ("a.stl", bytes(80) + struct.pack("<I", 1) + bytes(60), "announces 1 facets, and 10 bytes follow them"),
    ("a.stl", bytes(84), "it has no faces"),
    (
        "a.stl",
        bytes(80) + struct.pack("<I", 1) + b"\xff" * 50,
        "facet 1 has a corner that is not finite",
    ),
    ("a.stl", b"solid a\n" + FACET, r"a\.stl:8: .*cut off after facet 1: it has no endsolid"),
    ("a.stl", b"solid a\n" + FACET + FACET[:60], r"a\.stl:1\d: .*cut off in facet 2"),
    ("a.stl", b"solid a\n" + FACET.replace(b"1 0 0\n", b"1 O 0\n"), r"a\.stl:5: .*'o' is not a number"),
    ("a.stl", b"solid a\n" + FACET.replace(b"vertex 1 0 0\n", b""), r"facet 1 has 2 corners; facets have 3"),
    ("a.stl", b"solid a\nendsolid a\n", "it has no faces"),
    ("a.obj", b"v 0 0 0\nv 1 0 x1\n", r"a\.obj:2: does not read as a mesh: 'x1' is not a number"),
    ("a.obj", b"v 0 0 0\nv 1 0 nan\n", r"a\.obj:2: .*'nan' is not a number"),
    ("a.obj", b"v 0 0\n", r"a\.obj:1: .*a vertex with 2 numbers; vertices have three"),
    ("a.obj", b"v 0 0 0\n", "it has no faces"),
    ("a.obj", b"v 0 0 0\nf 1 1\n", r"a\.obj:2: .*a face with 2 corners; a face has at least 3"),
    ("a.obj", b"v 0 0 0\nf 1 1 1\nf 1 1 7/1\n", r"a\.obj:3: .*face index 7, but the file has 1 vertices"),
    ("a.obj", b"v 0 0 0\nf 1 0 1\n", r"a\.obj:2: .*'0' is no vertex's number"),
    ("a.obj", b"v 0 0 0\nf 1 b/2 1\n", r"a\.obj:2: .*'b/2' is no vertex's number"),
    ("a.obj", b"v 1e300 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", r"reaches 1e\+300 m .*; mind `scale`"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "text", "says"), BROKEN)
def test_what_is_broken_in_a_mesh_is_said(name, text, says, tmp_path):
    refused(write(tmp_path / name, text), says)


def box_stl():
    """A cuboid as a binary STL file, as a list of bytes."""
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], "<f4")
    faces = ConvexHull(corners)
    data = bytearray(80) + struct.pack("<I", len(faces.simplices))
    for simplex, plane in zip(faces.simplices, faces.equations, strict=True):
        facet = corners[simplex]
        if np.cross(facet[1] - facet[0], facet[2] - facet[0]) @ plane[:3] < 0:
            facet = facet[::-1]
        data += np.r_[plane[:3], facet.ravel()].astype("<f4").tobytes() + bytes(2)
    return data


CORRUPT = {
    "other numbers": (
        lambda data: data.__setitem__(slice(96, 108), struct.pack("<3f", 0.3, 0.4, 0.6)),
        "facet 1 has another normal than its corners",
    ),
    "far away": (lambda data: data.__setitem__(slice(99, 100), b"\x7e"), "facet 1 has a corner .* m away"),
    "zeros": (lambda data: data.__setitem__(slice(284, 334), bytes(50)), "facet 5 has no area"),
}


@pytest.mark.parametrize(("damage", "says"), CORRUPT.values(), ids=CORRUPT)
def test_a_corrupt_stl_is_called_corrupt(damage, says, tmp_path):
    data = box_stl()
    assert len(load_arena(write(tmp_path / "fine.stl", bytes(data))).shapes) == 1
    damage(data)
    refused(write(tmp_path / "a.stl", bytes(data)), rf"a\.stl is corrupt: {says}")


def test_heights_are_not_read_from_jpeg_whatever_it_is_called(tmp_path):
    grey = Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8))
    grey.save(tmp_path / "fine.png")
    assert load_arena(tmp_path / "fine.png").shapes[0].heights is not None
    grey.save(tmp_path / "a.png", format="JPEG")
    refused(tmp_path / "a.png", r"a\.png: is a JPEG image, which is lossy")


def test_names_of_objects_need_not_be_utf_8(tmp_path):
    box = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (shape,) = load_arena(write(tmp_path / "a.obj", b"o t\xfcr\n" + box.encode())).shapes
    assert len(shape.mesh.vertices) == 4


def test_includes_of_a_world_file_are_counted_as_often_as_they_are_included(tmp_path):
    for number in range(40):
        again = f'include "{number + 1}.inc"\n'
        write(tmp_path / f"{number}.inc", 2 * again)
    write(tmp_path / "40.inc", "")
    write(tmp_path / "a.world", 'include "0.inc"')
    refused(tmp_path / "a.world", r"\d+\.inc: more than 1000 files with all that is included")


def test_words_of_a_world_file_are_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(stage, "MAX_STAGE_TOKENS", 4)
    assert load_arena(write(tmp_path / "fits.world", "model ( )")).shapes
    refused(write(tmp_path / "a.world", "model (\nsize [1 1 1] )"), r"a\.world:2: more than 4 words")
