"""COLLADA files as arenas: what others make is not closed, lacks materials, or is text of 16 bits."""

import numpy as np
import pytest

from usarmjx.base.errors import ArenaFileError
from usarmjx.models.files.load import read_arena
from usarmjx.models.files.mesh_solids import PLATE_THICKNESS

BOX = [(x, y, z) for x in (0.0, 2.0) for y in (0.0, 3.0) for z in (0.0, 1.0)]
"""Corners of a box of 2 x 3 x 1 m."""
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
"""Its faces, counter-clockwise from outside: two of each axis, the last one on top."""
HEAD = '<?xml version="1.0" encoding="utf-8"?>\n'
TEXT = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries>
<geometry id="room"><mesh>
<source id="p"><float_array id="pa" count="24">{corners}</float_array>
<technique_common><accessor source="#pa" count="8" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist material="M" count="{count}"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>{lengths}</vcount><p>{faces}</p></polylist>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="S">
<node id="n">{placed}</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#S"/></scene>
</COLLADA>
"""
PLACED = '<instance_geometry url="#room"/>'


def collada(sides=6, placed=PLACED):
    """The text of a box with its first sides."""
    return HEAD + TEXT.format(
        corners=" ".join(f"{x:g} {y:g} {z:g}" for x, y, z in BOX),
        count=sides,
        lengths="4 " * sides,
        faces=" ".join(str(i) for side in SIDES[:sides] for i in side),
        placed=placed,
    )


@pytest.fixture
def file(tmp_path):
    return tmp_path / "room.dae"


def test_a_room_without_a_ceiling_becomes_plates_along_its_five_faces(file):
    file.write_text(collada(sides=5))
    arena, notes = read_arena(file)
    assert [note for note in notes if "plates along faces stand for" in note] == [
        f"{file}: {len(arena.shapes)} plates along faces stand for parts that are not convex"
    ]
    area = 0.0
    for shape in arena.shapes:
        edges = np.ptp(shape.mesh.vertices, 0) if shape.mesh is not None else 2 * np.array(shape.size)
        area += np.sort(edges)[1:].prod()
        assert edges.min() == pytest.approx(PLATE_THICKNESS, abs=1e-9)
    assert area == pytest.approx(2 * (3 * 1) + 2 * (2 * 1) + 2 * 3)
    assert {shape.surface for shape in arena.shapes} == {"wall", "ground"}


def test_a_closed_box_stays_one_solid_without_a_note(file):
    file.write_text(collada())
    arena, notes = read_arena(file)
    assert len(arena.shapes) == 1
    assert notes == ()


def test_a_mesh_whose_material_is_missing_is_read(file):
    binding = (
        "<bind_material><technique_common>"
        '<instance_material symbol="M" target="#Blue"/>'
        "</technique_common></bind_material>"
    )
    file.write_text(collada(placed=f'<instance_geometry url="#room">{binding}</instance_geometry>'))
    arena, _ = read_arena(file)
    np.testing.assert_allclose(np.ptp(arena.shapes[0].mesh.vertices, 0), (2, 3, 1))


@pytest.mark.parametrize("codec", ["utf-16-le", "utf-16-be"])
def test_text_of_16_bits_is_read(file, codec):
    file.write_bytes(("\ufeff" + collada().replace("utf-8", "utf-16")).encode(codec))
    arena, _ = read_arena(file)
    np.testing.assert_allclose(np.ptp(arena.shapes[0].mesh.vertices, 0), (2, 3, 1))


@pytest.mark.parametrize(
    ("placed", "says"),
    [
        (
            PLACED + '\n<instance_geometry url="#sofa"/>',
            ":16: does not read as a mesh: it has no <geometry> of",
        ),
        ("", ": does not read as a mesh: its scene places no <geometry>"),
        ('<instance_controller url="#c"/>', "places no <geometry> but skins of <instance_controller>, which"),
    ],
)
def test_a_mesh_that_would_be_lost_is_refused_by_name(file, placed, says):
    file.write_text(collada(placed=placed))
    with pytest.raises(ArenaFileError, match=r"room\.dae") as refusal:
        read_arena(file)
    assert says in str(refusal.value)
