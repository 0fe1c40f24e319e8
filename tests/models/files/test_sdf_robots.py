"""Robots in SDF files: frames, masses, drive and sensors."""

import math

import numpy as np
import pytest

from tests.models.files.worlds import write
from usarmjx.base.errors import ArenaFileError, SpecError
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models import load_robot
from usarmjx.models.drives import SkidSteer
from usarmjx.models.files.load import read_arena

TURNED = 1e-6  # m and rad: through rotation matrices and back

WHEEL = """<link name="{0}"><pose relative_to="hub_{0}">0 0 0 {1} 0 0</pose>
<inertial><mass>0.5</mass><inertia><ixx>0.002</ixx><iyy>0.002</iyy><izz>0.003</izz></inertia></inertial>
<collision name="c"><geometry><cylinder><radius>0.1</radius><length>0.04</length></cylinder></geometry>
</collision></link><frame name="hub_{0}"><pose>{2} {3} 0.1 0 0 0</pose></frame>
<joint name="{0}_joint" type="revolute"><parent>base</parent><child>{0}</child>
<axis><xyz expressed_in="__model__">0 1 0</xyz><limit><velocity>8</velocity><effort>5</effort></limit></axis>
</joint>"""
PLACED = """<link name="{0}">
<inertial><mass>0.5</mass><inertia><ixx>0.002</ixx><iyy>0.002</iyy><izz>0.003</izz></inertia></inertial>
<collision name="c"><pose>{2} {3} 0.1 {1} 0 0</pose>
<geometry><cylinder><radius>0.1</radius><length>0.04</length></cylinder></geometry></collision></link>
<joint name="{0}_joint" type="revolute"><pose>{2} {3} 0.1 {1} 0 0</pose>
<parent>base</parent><child>{0}</child>
<axis><xyz>0 0 1</xyz><limit><velocity>8</velocity><effort>5</effort></limit></axis></joint>"""
"""A wheel whose link is at the model's origin: the poses of joint and collision place it."""


def robot_with(wheel):
    """The file of a robot with four wheels."""
    places = (("fl", 0.2, 0.2), ("rl", -0.2, 0.2), ("fr", 0.2, -0.2), ("rr", -0.2, -0.2))
    wheels = "".join(wheel.format(name, -math.pi / 2, x, y) for name, x, y in places)
    return ROBOT_WITHOUT.replace("WHEELS", wheels)


ROBOT_WITHOUT = """<sdf version="1.9"><model name="cart"><pose>5 5 0 0 0 0</pose>
<link name="base"><pose>0 0 0.2 0 0 0</pose>
<inertial><mass>6</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.15</izz></inertia></inertial>
<collision name="c"><geometry><box><size>0.5 0.3 0.1</size></box></geometry></collision>
<sensor name="front" type="gpu_lidar"><pose>0.2 0 0.1 0 0 0</pose><lidar><scan><horizontal>
<samples>181</samples><min_angle>-1.5</min_angle><max_angle>1.5</max_angle></horizontal></scan><range><min>0.1</min><max>8</max></range>
</lidar></sensor></link>WHEELS
<plugin filename="gz-sim-diff-drive-system" name="gz::sim::systems::DiffDrive">
<left_joint>fl_joint</left_joint><left_joint>rl_joint</left_joint><right_joint>fr_joint</right_joint>
<right_joint>rr_joint</right_joint><wheel_separation>0.4</wheel_separation><wheel_radius>0.1</wheel_radius>
<robotNamespace>/</robotNamespace></plugin></model></sdf>"""


ROBOT = robot_with(WHEEL)


@pytest.mark.parametrize("wheel", [WHEEL, PLACED])
def test_a_robot_of_sdf_has_the_files_mass_wheels_and_sensors(wheel, tmp_path):
    loaded = load_robot(write(tmp_path / "cart.sdf", robot_with(wheel)))
    robot = loaded.robot
    assert robot.mass == pytest.approx(8)
    assert isinstance(robot.drive, SkidSteer)
    parts = {part.name: part for part in robot.parts}
    assert sorted(parts) == ["fl_joint", "fr_joint", "rl_joint", "rr_joint"]
    for name, (x, y) in {"fl": (0.2, 0.2), "rr": (-0.2, -0.2)}.items():
        part = parts[f"{name}_joint"]
        # On the base, whose frame is 0.2 m above the model's; y to the right and z down here.
        assert part.at == pytest.approx((x, -y, 0.1), abs=TURNED)
        (wheel,) = part.shapes
        assert (wheel.kind, wheel.size) == ("cylinder", pytest.approx((0.1, 0.02)))
        assert wheel.at == pytest.approx((0, 0, 0), abs=TURNED)
        along = np.asarray(mat_from_angles(*np.array(part.rotation))) @ part.axis
        np.testing.assert_allclose(np.abs(along), (0, 1, 0), atol=TURNED)
    assert robot.dimensions == pytest.approx((0.6, 0.44, 0.25), abs=TURNED)
    (scanner,) = (sensor for sensor in robot.sensors if sensor.kind == "RangeScanner")
    np.testing.assert_allclose(np.array(scanner.at), (0.2, 0, -0.1), atol=TURNED)
    assert loaded.notes == ()


def test_what_a_robot_leaves_out_of_its_world_is_named(tmp_path):
    """The drive of a model within the robot counts; lamps and other models do not."""
    plugin = ROBOT[ROBOT.index("<plugin") : ROBOT.index("</model>")]
    text = ROBOT.replace(plugin, f"<model name='pilot'><link name='box'/>{plugin}</model>")
    text = text.replace("</sensor>", "</sensor><light name='lamp' type='point'/>\n")
    text = text.replace('<sdf version="1.9">', "<sdf version='1.9'><world name='w'>\n<model name='hut'/>\n")
    loaded = load_robot(write(tmp_path / "cart.sdf", text.replace("</sdf>", "</world></sdf>")))
    assert isinstance(loaded.robot.drive, SkidSteer)
    said = [note.rpartition("cart.sdf:")[2] for note in loaded.notes]
    assert "2: beside the robot 'cart' is left out: hut" in said
    assert "9: 1 <light> of links left out" in said


def test_a_file_without_a_robot_is_refused_by_name(tmp_path):
    two = ROBOT.replace('<sdf version="1.9">', '<sdf version="1.9"><world name="w">')
    two = two.replace("</sdf>", "</world></sdf>")
    two = two.replace("<plugin", "<nothing").replace("</plugin", "</nothing")
    two = two.replace("</world>", "<model name='b'><link name='l'/></model></world>")
    with pytest.raises(SpecError, match="one with the plugin of a drive; it has: cart, b"):
        load_robot(write(tmp_path / "two.sdf", two))


def test_a_robot_alone_is_no_arena(tmp_path):
    with pytest.raises(ArenaFileError, match="nothing stands in it but the robot 'cart': load it as a robot"):
        read_arena(write(tmp_path / "cart.sdf", ROBOT))


def test_a_mistake_in_a_sensor_is_named_with_its_line(tmp_path):
    text = ROBOT.replace("<pose>0.2 0 0.1 0 0 0</pose>", "<pose>0.2 x</pose>")
    with pytest.raises(ArenaFileError, match=r"cart\.sdf:5: <pose> "):
        load_robot(write(tmp_path / "cart.sdf", text))
