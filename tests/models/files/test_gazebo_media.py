"""Test arenas as others build them for Gazebo: COLLADA elements in a media folder, placed by a world."""

import math

import mujoco
import numpy as np
import pytest

from tests.models.files.worlds import write
from tests.rig import Rig
from usarmjx.models.files.load import read_arena
from usarmjx.models.files.mesh_solids import MIN_THICKNESS
from usarmjx.sim.scene import build_scene

CELL = 1.2
"""Side of a cell of such arenas [m]."""
HALF, RISE = 0.55, 0.2
"""Half the side of a ramp and its height [m]."""
SLOPE = math.atan2(RISE, 2 * HALF)
BLOCKS = np.array(
    [[0.0, 0.05, 0.1, 0.05], [0.05, 0.1, 0.15, 0.1], [0.1, 0.15, 0.1, 0.0], [0.0, 0.1, 0.05, 0.1]]
)
"""Heights of the blocks of a field [m], x by y."""
SIDE = 0.25
"""Side of a block [m]."""
COLLADA = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_images><image id="ply"><init_from>plywood.jpg</init_from></image></library_images>
<library_effects><effect id="wood"><profile_COMMON>
<newparam sid="skin"><surface type="2D"><init_from>ply</init_from></surface></newparam>
<newparam sid="sampler"><sampler2D><source>skin</source></sampler2D></newparam>
<technique sid="common"><phong><diffuse><texture texture="sampler" texcoord="UV"/></diffuse></phong>
</technique>
</profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#wood"/></material></library_materials>
<library_geometries><geometry id="g" name="Plane"><mesh>
<source id="p"><float_array id="pa" count="{numbers}">{corners}</float_array><technique_common>
<accessor source="#pa" count="{count}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist material="M" count="{faces}"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>{threes}</vcount><p>{triangles}</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">
<node id="Camera" type="NODE"><matrix>1 0 0 7 0 1 0 -6 0 0 1 5 0 0 0 1</matrix></node>
<node id="Plane" type="NODE">{placed}<instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
PLACED = """<translate sid="location">0 0 0</translate><rotate sid="rotationZ">0 0 1 {yaw}</rotate>
<rotate sid="rotationY">0 1 0 0</rotate><rotate sid="rotationX">1 0 0 {roll}</rotate>
<scale sid="scale">{scale} {scale} {scale}</scale>"""
FLOOR = """<model name="plane_model"><static>true</static><link name="l"><collision name="c"><geometry><plane>
<normal>0 0 1</normal></plane></geometry><surface><friction><ode><mu>10.0</mu></ode></friction></surface>
</collision><visual name="v"><geometry><mesh><uri>file://ground_plane.dae</uri></mesh></geometry></visual>
</link></model>"""


def collada(corners, triangles, placed):
    """A COLLADA file of one object of triangles with a transform."""
    corners, triangles = np.asarray(corners, float), np.asarray(triangles)
    return COLLADA.format(
        numbers=corners.size,
        corners=" ".join(map(repr, corners.ravel().tolist())),
        count=len(corners),
        faces=len(triangles),
        threes="3 " * len(triangles),
        triangles=" ".join(map(str, triangles.ravel().tolist())),
        placed=placed,
    )


def quads(*corners):
    """Two triangles for each four corners."""
    return [t for a, b, c, d in corners for t in ((a, b, c), (a, c, d))]


def ramp():
    """A slope with its sides and its back and without a bottom, in units of 0.5 m, turned by a quarter."""
    x, z = HALF / 0.5, RISE / 0.5
    corners = [(-x, -x, 0), (-x, x, 0), (x, x, z), (x, -x, z), (x, x, 0), (x, -x, 0)]
    sides = [(0, 5, 3), (1, 2, 4)]
    back = quads((5, 4, 2, 3))
    return collada(corners, [*quads((0, 3, 2, 1)), *sides, *back], PLACED.format(yaw=-90, roll=0, scale=0.5))


def wall(height):
    """A panel at the far edge of a cell, drawn lying and set upright by its node."""
    x, y = 0.6, height
    corners = [(s * x, -t * y, z) for z in (0.59, 0.61) for t in (0, 1) for s in (-1, 1)]
    faces = quads((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return collada(corners, faces, PLACED.format(yaw=0, roll=-90, scale=1))


def field():
    """Blocks of several heights as one surface that shares its corners."""
    numbers: dict = {}
    corner = lambda i, j, z: numbers.setdefault((SIDE * (i - 2), SIDE * (j - 2), z), len(numbers))  # noqa: E731
    faces = []
    for (i, j), z in np.ndenumerate(BLOCKS):
        top = (corner(i, j, z), corner(i + 1, j, z), corner(i + 1, j + 1, z), corner(i, j + 1, z))
        low = (corner(i, j, 0), corner(i, j + 1, 0), corner(i + 1, j + 1, 0), corner(i + 1, j, 0))
        faces += quads(top, low) if z > 0 else quads(top)
        for (a, b), (c, d) in (((0, 0), (1, 0)), ((1, 0), (1, 1)), ((1, 1), (0, 1)), ((0, 1), (0, 0))):
            if z > 0:
                foot, end = (corner(i + a, j + b, 0), corner(i + c, j + d, 0))
                faces += quads((foot, end, corner(i + c, j + d, z), corner(i + a, j + b, z)))
    return collada([*numbers], faces, PLACED.format(yaw=0, roll=0, scale=1))


def element(name, pose):
    """A static model whose link has the pose: a name of its own by the pose."""
    mesh = f"<geometry><mesh><uri>file://{name}.dae</uri><scale>1 1 1</scale></mesh></geometry>"
    number = f"{name}_{pose.replace(' ', '_')}"
    return (
        f"<model name='{number}'><static>1</static><link name='{number}_link'><pose>{pose}</pose>"
        f"<collision name='c'>{mesh}<max_contacts>10</max_contacts></collision>"
        f"<visual name='v'><cast_shadows>0</cast_shadows>{mesh}</visual></link></model>"
    )


TURN = math.pi / 2
COURSE = [
    *(element("panel", f"{CELL * k} 0 0 0 0 {turn}") for k in range(-1, 4) for turn in (0, 2 * TURN)),
    element("tall_panel", f"{3 * CELL} 0 0 0 0 {-TURN}"),
    element("ramp", f"{CELL} 0 0 0 0 {TURN}"),
    element("blocks", f"{-CELL} 0 0 0 0 0"),
]


@pytest.fixture
def course(tmp_path):
    """A package of elements and one of worlds, side by side: a lane with a ramp that rises along x."""
    models = tmp_path / "arena_elements" / "Media" / "models"
    worlds = tmp_path / "arena_worlds" / "worlds"
    models.mkdir(parents=True)
    worlds.mkdir(parents=True)
    for name, text in (
        ("ramp", ramp()),
        ("panel", wall(1.2)),
        ("tall_panel", wall(2.4)),
        ("blocks", field()),
    ):
        write(models / f"{name}.dae", text)
    text = f"<sdf version='1.4'><world name='default'>{FLOOR}{''.join(COURSE)}</world></sdf>"
    return write(worlds / "lane.world", text)


def heights(model, points):
    """Height of the ground under points (n, 2) [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hit, down = np.zeros(1, np.int32), np.array([0.0, 0.0, -1.0])
    return [3 - mujoco.mj_ray(model, data, np.array([*p, 3.0]), down, None, 1, -1, hit, None) for p in points]


def test_elements_of_a_media_folder_stand_where_gazebo_has_them(course):
    arena, notes = read_arena(course)
    assert not [note for note in notes if "is not there" in note or "left out: mesh" in note]
    model = build_scene(arena, ()).model
    along = np.linspace(-0.5, 0.5, 11)
    got = heights(model, [(CELL + s, 0.2) for s in along])
    np.testing.assert_allclose(got, RISE * (along + HALF) / (2 * HALF), atol=1e-6)
    middles = SIDE * (np.arange(4) - 1.5)
    got = heights(model, [(-CELL + x, y) for x in middles for y in middles])
    np.testing.assert_allclose(np.reshape(got, (4, 4)), BLOCKS, atol=MIN_THICKNESS / 2 + 1e-6)
    assert heights(model, [(3 * CELL + 0.6, 0.0)]) == pytest.approx([2.4])
    (x0, x1), (y0, y1) = arena.extent
    assert (x0, x1) == pytest.approx((-CELL - 1.6, 3 * CELL + 1.61), abs=0.02)
    assert (y0, y1) == pytest.approx((-1.61, 1.61), abs=0.02), "1 m around the solids"


def test_a_p2at_drives_up_a_ramp_of_such_an_arena_between_its_walls(course):
    arena, _ = read_arena(course)
    rig = Rig("P2AT", arena=arena, places=[(0.0, 0.0, 0.0)])
    rig.run(0.5)
    level = rig.data.qpos[rig.indices[0].root_qposadr + 2]
    rows = rig.tell(Left=3.0, Right=3.0).run(4.2)
    assert rows[:, 0].max() > CELL
    middle = rows[np.argmin(np.abs(rows[:, 0] - CELL))]
    lift = RISE / 2 + (1 / math.cos(SLOPE) - 1) * level
    assert middle[2] - level == pytest.approx(lift, abs=0.01)
    assert np.abs(rows[:, 1]).max() < 0.1, "between the walls"
    assert rig.up[0] > 0.9


def test_a_p2at_bumps_over_blocks_and_stops_at_a_wall(course):
    arena, _ = read_arena(course)
    rig = Rig("P2AT", arena=arena, places=[(2.0 * CELL, 0.0, 0.0)])
    rows = rig.tell(Left=3.0, Right=3.0).run(4.0)
    nose = rows[-1, 0] + 0.26
    assert nose < 3 * CELL + 0.6
    assert nose == pytest.approx(3 * CELL + 0.59, abs=0.03)
    rig = Rig("P2AT", arena=arena, places=[(0.0, 0.0, math.pi)])
    rows = rig.tell(Left=3.0, Right=3.0).run(6.0)
    assert rows[-1, 0] < -CELL + 0.5, "on the blocks"
    assert rows[:, 2].max() - rows[10, 2] > 0.03


def test_folders_of_media_are_found_by_gazebos_variable(course, tmp_path, monkeypatch):
    away = tmp_path / "a" / "b" / "c" / "d" / "lane.world"
    away.parent.mkdir(parents=True)
    course.rename(away)
    _, notes = read_arena(away)
    missing = [note for note in notes if "is not there" in note]
    assert len(missing) == len(COURSE)
    assert "file://panel.dae" in missing[0]
    monkeypatch.setenv("GAZEBO_RESOURCE_PATH", str(tmp_path / "arena_elements"))
    arena, notes = read_arena(away)
    assert not [note for note in notes if "is not there" in note]
    assert len(read_arena(away, packages=[tmp_path])[0].shapes) == len(arena.shapes)
