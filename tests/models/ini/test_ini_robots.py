"""Robots from ini files. Oracles: the manual's excerpts, captured messages, stock robots, closed forms."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.models.ini.texts import load_texts
from usarmjx.base.errors import SpecError, UsageError
from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.flippers import TARANTULA
from usarmjx.models.robots.lisa import LISA
from usarmjx.models.robots.pioneer import P2AT, P2DX
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import CHASSIS, Motor, options
from usarmjx.sensors.cameras.mounts import carried_weight, overload
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.configure import configure

EXACT = 1e-9  # float64 arithmetic on the file's numbers
PRINTED = 4e-3  # m: captured mounts of the excerpt's items differ from it by rounding to whole and half UU

# Manual 12.1.2, its line breaks mended.
EXCERPT = """
[USARBot.P2AT]
msgTimer=0.200000
bAbsoluteCamera=true
bMountByUU=True
Weight=14
Payload=40
batteryLife=3600
Sensors=(ItemClass=class'USARBot.SonarSensor',ItemName="F1",Position=(X=7.6125,Y=-6.825,Z=0),Direction=(Y=0,Z=-16384,X=0))
Sensors=(ItemClass=class'USARBot.SonarSensor',ItemName="F8",Position=(X=7.6125,Y=6.825,Z=0),Direction=(Y=0,Z=16384,X=0))
Cameras=(ItemClass=class'USARBot.RobotCamera',ItemName="Camera",Parent="CameraTilt",Position=(Y=0,X=4.2,Z=-3.36),Direction=(Y=0,Z=0,X=0))
"""


@pytest.fixture
def load(tmp_path):
    """Load texts as the files a.ini, b.ini, ... on a registry of some stock robots."""

    def from_texts(*texts, **options):
        plain = [text.lstrip("\n") for text in texts]
        return load_texts(tmp_path, plain, (P2AT, P2DX, TARANTULA, LISA), **options)

    return from_texts


def named(loaded, name):
    return {robot.name: robot for robot in loaded.robots}[name]


def items(mounts):
    return {mount.name: mount for mount in mounts}


def compiled(robot):
    spec = new_spec(ArenaSpec(name="nowhere", starts=(), extent=((0, 0), (0, 0))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


# Mounts


def test_the_manuals_excerpt_in_its_own_scale_puts_things_where_captures_have_them(load):
    robot = named(load(EXCERPT, scale=52.5), "P2AT")
    sonars, stock = items(robot.sensors), items(P2AT.sensors)
    assert list(sonars) == ["F1", "F8"]
    for name, sonar in sonars.items():
        np.testing.assert_allclose(sonar.at, stock[name].at, atol=EXACT)
        np.testing.assert_allclose(sonar.direction, stock[name].direction, atol=EXACT)
        assert (sonar.kind, sonar.parent) == ("Sonar", CHASSIS)
    (camera,) = robot.cameras
    assert (camera.kind, camera.parent) == ("Camera", "CameraPanTilt_Link2")
    # Captured GEO: 0.0820,0.0002,0.0613, z down; the excerpt has Unreal's z, up.
    np.testing.assert_allclose(camera.at, (0.0820, 0.0002, 0.0613), atol=PRINTED)
    assert (robot.msg_timer, robot.battery_life, robot.payload, robot.mass) == (0.2, 3600.0, 40.0, 14.0)


def test_250_unreal_units_are_a_metre_and_32768_half_a_turn_and_z_points_up(load):
    line = "ItemClass=class'USARBot.SonarSensor',ItemName=A,Position=(X=250,Y=-125,Z=25)"
    turn = "Direction=(X=8192,Y=4096,Z=32768)"
    in_uu = named(load(f"[USARBot.P2AT]\nSensors=({line},{turn})\nbMountByUU=True"), "P2AT").sensors[0]
    assert in_uu.at == pytest.approx((1.0, -0.5, -0.1), abs=EXACT)
    assert in_uu.direction == pytest.approx((math.pi / 4, math.pi / 8, math.pi), abs=EXACT)
    metres = "Position=(X=1,Y=-0.5,Z=-0.1),Direction=(X=0.78539816,Y=0.39269908,Z=3.14159265)"
    text = f"[USARBot.P2AT]\nSensors=(ItemClass=class'USARBot.SonarSensor',ItemName=A,{metres})"
    plain = named(load(text), "P2AT").sensors[0]
    np.testing.assert_allclose(plain.at, in_uu.at, atol=EXACT)
    np.testing.assert_allclose(plain.direction, in_uu.direction, atol=1e-8)  # 8 digits above


INS = "ItemClass=class'USARBot.INS'"


def test_a_list_replaces_the_class_and_a_later_file_replaces_it_again(load):
    first = (
        f"[USARBot.P2AT]\nSensors=({INS},ItemName=A)\nSensors=({INS},ItemName=B)\n[USARBot.p2at]\nPayload=7"
    )
    second = f"[USARBOT.P2AT]\nSensors=({INS},ItemName=C)"
    assert list(items(named(load(first), "P2AT").sensors)) == ["A", "B"]
    both = named(load(first, second), "P2AT")
    assert list(items(both.sensors)) == ["C"]
    assert both.payload == 7.0
    assert both.cameras == P2AT.cameras


def test_added_items_come_last_or_in_place_of_their_namesakes(load):
    text = f"""
[USARBot.P2AT]
AddSensors=({INS},ItemName=Second)
AddSensors=(ItemClass=class'USARBot.SonarSensor',ItemName=f2,Position=(X=0.5))
AddEffecters=(ItemClass=class'USARBot.RFIDReleaser',ItemName=Gun)
"""
    robot = named(load(text), "P2AT")
    before, after = items(P2AT.sensors), items(robot.sensors)
    assert list(after) == [*("f2" if name == "F2" else name for name in before), "Second"]
    assert after["f2"].at == (0.5, 0.0, 0.0)
    assert after["F1"] == before["F1"]
    assert [mount.kind for mount in robot.effecters] == ["RFIDReleaser"]


def test_scanners_of_the_later_versions_are_range_scanners_with_their_figures(load):
    """DefaultUSAR.ini of the later versions; what stands within the brackets wins."""
    text = """
[USARBot.P2AT]
AddSensors=(ItemClass=class'USARSensor.HokuyoURG04LX',ItemName=hokuyo)
AddSensors=(ItemClass=class'USARSensor.SICK',ItemName=lms200,MaxRange=8.0)
AddCameras=(ItemClass=class'USARSensor.USARCamera',ItemName=Eye)
"""
    robot = named(load(text), "P2AT")
    found = {mount.name: mount for mount in (*robot.sensors, *robot.cameras)}
    assert [found[name].kind for name in ("hokuyo", "lms200", "Eye")] == [
        "RangeScanner",
        "RangeScanner",
        "Camera",
    ]
    settings = {
        sensor.mounts[0].name: sensor.settings[0]
        for sensor in suite_of(robot).sensors
        if sensor.kind == "RangeScanner"
    }
    small, large = settings["hokuyo"], settings["lms200"]
    assert (small.max_range, small.scan_fov, small.scan_interval) == (4.0, 4.189, 0.3)
    assert small.resolution == pytest.approx(0.0184086914)
    assert (large.max_range, large.scan_fov) == (8.0, 3.14159)


def test_class_defaults_yield_to_the_section_and_both_to_the_mount(load):
    text = f"""
[USARBot.SonarSensor]
MaxRange=3.5
Noise=0
[USARBot.P2AT]
AddSensors=(ItemClass=class'USARBot.SonarSensor',ItemName=Own,MaxRange=2.0)
AddSensors=({INS},ItemName=INS,Sigma=0.2)
"""
    loaded = load(text)
    assert {robot.name for robot in loaded.robots} == {"P2AT", "P2DX"}, "those with sonars"
    (sonar,) = (sensor for sensor in suite_of(named(loaded, "P2AT")).sensors if sensor.kind == "Sonar")
    ranges = {m.name: s.max_range for m, s in zip(sonar.mounts, sonar.settings, strict=True)}
    assert ranges == {**{m.name: 3.5 for m in P2AT.sensors if m.kind == "Sonar"}, "Own": 2.0}
    assert {settings.noise for settings in sonar.settings} == {0.0}
    assert sonar.settings[0].beam_angle == 0.3491, "the manual's default (10.2.2), which nothing changed"
    assert loaded.warnings[-1].endswith("a.ini:2: MaxRange leaves alone those that have their own: P2AT Own")


def test_values_of_settings_are_read_as_the_manual_writes_them(load):
    text = """
[USARBot.RangeScanner]
Resolution=800
ScanFov=32768
OutputCurve=(Points=((InVal=0.000000,OutVal=0.000000),(InVal=1000.000000,OutVal=500.0)))
[USARBot.GPSSensor]
ZeroZeroLocation=(LatitudeDegree=39,LatitudeMinute=8.0273,LongitudeDegree=-359,LongitudeMinute=59.9996)
maxNoise=1.5
"""
    loaded = load(text)
    scanner, gps = (dict(dict(loaded.defaults)[kind]) for kind in ("RangeScanner", "GPS"))
    # 800 UU are 0.0767 rad (manual 10.3.2, 9.3's units); a whole number is in UU.
    assert scanner["Resolution"] == pytest.approx(800 * math.pi / 32768, abs=EXACT)
    assert scanner["ScanFov"] == pytest.approx(math.pi, abs=EXACT)
    assert scanner["OutputCurve"] == ((0.0, 0.0), (1000.0, 500.0))
    assert gps["ZeroZeroLocation"] == options(
        LatitudeDegree=39, LatitudeMinute=8.0273, LongitudeDegree=-359, LongitudeMinute=59.9996
    )
    assert gps["maxNoise"] == 1.5
    radians = dict(load("[USARBot.RangeScanner]\nResolution=0.0174").defaults)["RangeScanner"]
    assert radians == (("Resolution", 0.0174),)


# Keys

MANUAL_KEYS = (
    *("msgTimer", "bAbsoluteCamera", "Weight", "Payload", "batteryLife"),  # 12.1.2
    *("MotorTorque", "MaxTorque", "MotorSpeed", "ChassisMass", "StaticMesh", "DrawScale", "DrawScale3D"),
    *("KParams", "ConverterClass", "HingePropGap", "SteerPropGap", "SteerTorque", "SteerSpeed"),
    *("SuspStiffness", "SuspDamping", "SuspHighLimit", "SuspLowLimit", "TireRollFriction"),
    *("TireLateralFriction", "TireRollSlip", "TireLateralSlip", "TireMinSlip", "TireSlipRate"),
    *("TireSoftness", "TireAdhesion", "TireRestitution"),  # 14.4.2.3
)


@pytest.mark.parametrize("key", MANUAL_KEYS)
def test_every_key_of_the_manual_changes_the_robot_or_says_why_not(load, key):
    loaded = load(f"[USARBot.P2AT]\n{key}={True if key[0] == 'b' and key[1].isupper() else 7.5}")
    assert "unknown" not in "".join(loaded.warnings)
    changed = any(robot.name == "P2AT" for robot in loaded.robots)
    told = [text for text in loaded.warnings if f"a.ini:2: {key} " in text]
    assert changed != bool(told)
    assert all(len(text.split(": ")[-1]) > 20 for text in told), "a reason"


def test_what_is_not_known_is_reported_with_its_place(load):
    text = """
[USARBot.P2AT]
Wheight=15
[USARBot.SonarSensor]
MaxRnage=3
[USARBot.MultiView]
CameraNum=2
[Engine.GameEngine]
CacheSizeMegs=32
"""
    loaded = load(text)
    assert loaded.robots == ()
    found = [warning.partition("a.ini:")[2] for warning in loaded.warnings]
    assert found[0].startswith("2: unknown key Wheight")
    assert found[1].startswith("4: unknown key: Sonar: SonarSettings has no setting 'MaxRnage'; did you")
    assert found[2].startswith("8: section [Engine.GameEngine] is not about robots")


def motors(robot, *names):
    return [part.motor for part in robot.parts if part.name in names]


def test_torques_scale_what_they_are_about(load):
    wheel, flipper = "LeftFWheel", "FRFlipper"
    weak = named(load("[USARBot.Tarantula]\nMaxTorque=30"), "Tarantula")
    assert weak.max_torque == 30.0
    (before,), (after,) = motors(TARANTULA, wheel), motors(weak, wheel)
    assert after == replace(before, torque=before.torque / 2)
    assert motors(weak, flipper) == motors(TARANTULA, flipper), "20, the default MotorTorque, is below 30"
    cut = named(load("[USARBot.Tarantula]\nMaxTorque=10\nMotorTorque=40\nMotorSpeed=0.5"), "Tarantula")
    (before,), (after,) = motors(TARANTULA, flipper), motors(cut, flipper)
    assert after.torque == pytest.approx(before.torque * 10 / 20, abs=EXACT), "cut to MaxTorque"
    assert after.max_speed == 0.5
    assert motors(cut, wheel)[0].max_speed == motors(TARANTULA, wheel)[0].max_speed


def test_weight_is_reported_and_chassis_mass_weighs(load):
    heavy = named(load("[USARBot.P2AT]\nWeight=99\nChassisMass=2"), "P2AT")
    chassis = sum(shape.mass for shape in P2AT.chassis)
    model, _ = compiled(heavy)
    assert heavy.mass == 99.0
    assert model.body("chassis").subtreemass[0] == pytest.approx(14.0 + chassis, abs=EXACT)


def test_the_centre_of_mass_goes_where_it_is_put(load):
    moved = named(load("[USARBot.P2AT]\nCenterOfMass=(X=-0.05,Y=0.02,Z=0.1)"), "P2AT")
    model, _ = compiled(moved)
    np.testing.assert_allclose(model.body("chassis").ipos, (-0.05, -0.02, -0.1), atol=EXACT)
    assert model.body("chassis").subtreemass[0] == pytest.approx(14.0, abs=EXACT)
    stock, share = compiled(P2AT)[0].body("chassis"), sum(shape.mass for shape in P2AT.chassis) / 14.0
    centres = [kinematic_tree_of(robot).centre_of_mass for robot in (P2AT, moved)]
    shift = share * ((-0.05, -0.02, -0.1) - stock.ipos)
    np.testing.assert_allclose(np.subtract(*reversed(centres)), shift, atol=EXACT, err_msg="GEO's COG")


def test_spin_speed_is_that_of_drive_and_wheels(load):
    fast = named(load("[USARBot.P2AT]\nmaxSpinSpeed=10"), "P2AT")
    assert (fast.drive.max_speed, fast.drive.top_speed) == (10.0, pytest.approx(1.3, abs=EXACT))
    assert {motor.max_speed for motor in motors(fast, *joint_names(P2AT)[:4])} == {10.0}


# Parts


def pair(name, x, y, z, *more, joint="KCarWheelJoint"):
    place = f"ParentPos=(X={x},Y={y},Z={z})"
    return f"(PartName={name},JointClass=class'{joint}',{','.join((place, *more))})"


LOCKED = "bSteeringLocked=True,bSuspensionLocked=true"
AXES = "ParentAxis=(Z=1),ParentAxis2=(Y=1),SelfAxis=(Z=1),SelfAxis2=(Y=1)"


def wheels(names, *more, x=0.16, y=0.2, z=0.05):
    places = ((x, -y), (x, y), (-x, -y), (-x, y))
    pairs = [pair(name, *place, z, *more) for name, place in zip(names, places, strict=True)]
    return "\n".join(f"JointParts({i})={text}" for i, text in enumerate(pairs))


def test_a_wheel_whose_own_axes_are_turned_is_the_same_round_wheel(load):
    def car(axes):
        return named(
            load(
                "[USARBot.P2AT]\n" + wheels(NAMES, SIZE, LOCKED, "ParentAxis=(Z=1),ParentAxis2=(Y=1)", axes)
            ),
            "P2AT",
        ).parts

    turned = car("SelfAxis=(X=1,Y=0,Z=0),SelfAxis2=(X=0,Y=0,Z=-2)")
    assert turned == car("SelfAxis=(X=0,Y=0,Z=1),SelfAxis2=(X=0,Y=1,Z=0)")


def test_a_p2ats_own_wheels_as_pairs_in_unreal_units_are_the_p2ats(load):
    text = "[USARBot.P2AT]\nbMountByUU=True\n"
    for i, part in enumerate(P2AT.parts):
        x, y, z = (250 * value for value in part.at)
        tire = f"PartClass=class'USARBot.P2ATTire',{LOCKED},{AXES}"
        text += f"JointParts({i})={pair(part.name, x, y, -z, tire)}\n"
    robot = named(load(text), "P2AT")
    assert (robot.drive, robot.chassis, robot.mass) == (P2AT.drive, P2AT.chassis, P2AT.mass)
    for built, stock in zip(robot.parts, P2AT.parts, strict=True):
        np.testing.assert_allclose(built.at, stock.at, atol=EXACT)
        assert replace(built, at=stock.at) == stock
    # GETGEO's figures are measured: the tyres' outer faces, and the captured wheel figures.
    assert robot.wheel_separation == pytest.approx(0.4712, abs=1e-6)
    assert robot.wheel_base == pytest.approx(0.2884, abs=1e-6)


def test_a_wheel_is_drawn_around_its_own_middle_and_of_another_size_otherwise_than_its_class(load):
    tire = f"PartClass=class'USARBot.P2ATTire',{LOCKED},{AXES},SelfPos=(X=-0.01,Y=-0.02,Z=-0.03)"
    text = f"[USARBot.P2AT]\nJointParts(0)={pair('Own', 0.1, 0.2, 0.05, tire)}\n"
    text += f"JointParts(1)={pair('Large', 0.1, -0.2, 0.05, tire + ',Radius=0.2')}\n"
    own, large = named(load(text), "P2AT").wheels
    (right,) = (part for part in P2AT.parts if part.name == "RightFWheel")
    assert [replace(shape, at=()) for shape in own.looks] == [replace(s, at=()) for s in right.looks]
    for built, stock in zip(own.looks, right.looks, strict=True):
        np.testing.assert_allclose(built.at, np.add(stock.at, own.shapes[0].at), atol=EXACT)
    np.testing.assert_allclose(own.shapes[0].at, (0.01, 0.02, 0.03), atol=EXACT)
    assert large.looks[0].size[0] == 0.2


NAMES = ("LeftFWheel", "RightFWheel", "LeftRWheel", "RightRWheel")
SIZE = "Radius=0.1,Width=0.05"
ROVER = f"[USARBot.Rover]\nDimensions=(X=0.5,Y=0.3,Z=0.12)\nWeight=12\n{wheels(NAMES, SIZE, LOCKED)}\n"


def test_a_new_robot_weighs_and_measures_what_its_section_says(load):
    robot = named(load(ROVER), "Rover")
    model, _ = compiled(robot)
    assert model.body("chassis").subtreemass[0] == pytest.approx(12.0, abs=EXACT)
    assert robot.mass == 12.0
    # Length: from wheel to wheel. Height: from the wheels' lowest point, 0.15 below the origin, to the deck.
    assert robot.dimensions == pytest.approx((2 * (0.16 + 0.1), 2 * (0.2 + 0.025), 0.15 + 0.06), abs=1e-6)
    assert robot.origin_height == pytest.approx(0.15, abs=1e-6)
    assert (robot.wheel_radius, robot.wheel_separation, robot.wheel_base) == (0.1, 0.4, 0.32)
    assert (robot.drive.left, robot.drive.right) == (NAMES[::2], NAMES[1::2])
    assert "Rover" not in ROBOTS, "nothing is changed by loading"


def test_smaller_wheels_of_a_side_turn_faster(load):
    text = ROVER.replace("Radius=0.1", "Radius=0.05", 1)
    drive = named(load(text), "Rover").drive
    small = drive.radius
    assert small == 0.05
    speeds = dict(zip((*drive.left, *drive.right), drive.targets(np.array([4.0, 4.0])), strict=True))
    assert speeds["LeftFWheel"] == pytest.approx(4.0)
    assert speeds["RightRWheel"] == pytest.approx(2.0), "twice the radius"


def test_wheels_lines_choose_sides_and_what_is_driven(load):
    text = (
        ROVER + "Wheels(0)=(Number=0,PowerType=Right_Powered)\nWheels(3)=(Number=3,PowerType=Not_Powered);\n"
    )
    robot = named(load(text), "Rover")
    assert robot.drive.left == ("LeftRWheel",)
    assert robot.drive.right == ("LeftFWheel", "RightFWheel")
    assert motors(robot, "RightRWheel") == [None]


def test_the_manuals_omni_wheels_are_told_their_speeds_and_angles_by_number(load):
    """Manual 12.18.2: wheels 0 and 1 are powered and steered up to 3.14, 2 and 3 passive."""
    lines = [pair(f"W{i}", 0.2 - 0.4 * (i % 2), -0.2, 0.1, SIZE, "bSuspensionLocked=True") for i in range(4)]
    text = "[USARBot.MyLisa]\nDimensions=(X=0.6,Y=0.5,Z=0.2)\nWeight=20\n"
    text += "\n".join(f"JointParts({i})={line}" for i, line in enumerate(lines))
    for i in range(4):
        holo = "PowerType=Holo_Powered,SteerType=Holo_Steered,MaxSteerAngle=3.14"
        text += f"\nWheels({i})=(Number={i},{holo if i < 2 else 'PowerType=Not_Powered'});"
    drive = named(load(text), "MyLisa").drive
    assert drive.steering == "OmniDrive"
    assert list(drive.full_scale) == ["WheelSpeed0", "WheelSteer0", "WheelSpeed1", "WheelSteer1"]
    assert drive.full_scale["WheelSteer1"] == 3.14


LISA_WHEELS = """
[USARBot.Lisa]
Wheels(0)=(Number=0,PowerType=Holo_Powered,SteerType=Holo_Steered,MaxSteerAngle=3.14);
Wheels(1)=(Number=1,PowerType=Holo_Powered,SteerType=Holo_Steered,MaxSteerAngle=3.14);
Wheels(2)=(Number=2,PowerType=Not_Powered);
Wheels(3)=(Number=3,PowerType=Not_Powered);
"""


def test_the_manuals_wheels_of_lisa_are_those_it_has_and_others_change_them(load):
    """Manual 12.18.2."""
    assert load(LISA_WHEELS).robots == ()
    other = LISA_WHEELS.replace("1,PowerType=Holo_Powered", "1,PowerType=Not_Powered").replace("3.14", "1.5")
    drive = named(load(other), "Lisa").drive
    assert drive.full_scale == {"WheelSpeed0": LISA.drive.max_spin, "WheelSteer0": 1.5, "WheelSteer1": 1.5}
    with pytest.raises(SpecError, match=r"a\.ini:4: Lisa drives no wheel 2; expected 0 to 1"):
        load(LISA_WHEELS.replace("2,PowerType=Not", "2,PowerType=Holo"))


def test_a_hinge_turns_its_part_about_the_joint_between_parent_and_self(load):
    """ParentPos and SelfPos say where the joint is, in the axes of the parent's and the part's middle."""
    arm = "ParentAxis=(Y=1),SelfPos=(X=-0.15),Size=(X=0.3,Y=0.05,Z=0.04),Mass=0.4,MinRange=-1,MaxRange=1"
    hand = "Parent=Arm,ParentAxis=(X=1),SelfAxis=(Z=1),ParentAxis2=(Y=1),SelfAxis2=(Y=1)"
    hand += ",Size=(X=0.1,Y=0.1,Z=0.1)"
    text = ROVER + f"JointParts(4)={pair('Arm', 0.2, 0, -0.06, arm, joint='KDHinge')}\n"
    text += f"JointParts(5)={pair('Hand', 0.15, 0, 0, hand, joint='KDHinge')}\n"
    text += f"Sensors=({INS},ItemName=Tip,Parent=arm,Position=(X=0.15,Y=0,Z=0))\n"
    robot = named(load(text), "Rover")
    model, data = compiled(robot)
    data.joint("Arm").qpos = angle = 0.3
    mujoco.mj_kinematics(model, data)
    # The axis points to the right: a positive turn, right-handed with z down, lifts what is ahead.
    joint, reach = np.array((0.2, 0, 0.06)), np.array((math.cos(angle), 0, math.sin(angle)))
    np.testing.assert_allclose(data.body("Hand").xpos, joint + 0.3 * reach, atol=EXACT)
    np.testing.assert_allclose(data.geom("Arm/0").xpos, joint + 0.15 * reach, atol=EXACT)
    # The hand's own z, up as in Unreal, lies along its parent's x.
    np.testing.assert_allclose(data.body("Hand").xmat.reshape(3, 3)[:, 2], reach, atol=1e-7)
    # An item on a part counts from its middle: 0.15 ahead of that is the far end, 0.3 from the joint.
    assert robot.sensors[0].parent == "Arm"
    assert robot.sensors[0].at == pytest.approx((0.3, 0.0, 0.0), abs=EXACT)
    arm_part = robot.parts[4]
    assert arm_part.limits == (-1.0, 1.0)
    assert arm_part.motor.max_speed == 0.1745, "MotorSpeed of manual 14.4.2.3"


def test_unlocked_joints_are_suspension_and_steering(load):
    front = wheels(NAMES, SIZE).splitlines()[:2]
    rear = wheels(NAMES, SIZE, "bSteeringLocked=True").splitlines()[2:]
    text = "[USARBot.Car]\nDimensions=(X=0.5,Y=0.3,Z=0.12)\nWeight=12\n" + "\n".join([*front, *rear])
    car = named(load(text), "Car")
    joints = joint_names(car)
    assert joints[:3] == ("LeftFWheel_Suspension", "LeftFWheel_Steer", "LeftFWheel")
    assert "LeftRWheel_Steer" not in joints
    assert "LeftRWheel_Suspension" in joints
    assert car.drive.steering == "AckermanSteered"
    limits = "\nSuspHighLimit=0.5\nSuspLowLimit=-0.25\nSuspStiffness=300\nSuspDamping=30\nSteerSpeed=7500"
    stiff = named(load(text + limits), "Car")
    soft_part, hard_part = (next(p for p in r.parts if p.spring is not None) for r in (car, stiff))
    assert hard_part.spring.stiffness == pytest.approx(2 * soft_part.spring.stiffness)
    assert hard_part.spring.damping == pytest.approx(2 * soft_part.spring.damping)
    # Manual 14.4.2.3: limits are in Karma's scale, 50 UU, of which 250 are a metre.
    assert soft_part.limits == pytest.approx((-0.2, 0.2))
    assert hard_part.limits == pytest.approx((-0.05, 0.1))
    (steer,) = motors(stiff, "LeftFWheel_Steer")
    assert steer.max_speed == pytest.approx(7500 * math.pi / 32768)


def test_a_class_can_be_based_on_another_that_the_files_change(load):
    text = """
[USARBot.Child]
BaseClass=P2AT
Payload=3
[USARBot.P2AT]
msgTimer=0.5
Payload=9
"""
    loaded = load(text)
    child, base = named(loaded, "Child"), named(loaded, "P2AT")
    assert child == replace(base, name="Child", payload=3.0)
    assert base.msg_timer == 0.5


# Mission packages


def test_a_package_section_overrides_what_it_names_in_every_robot_that_has_the_package(load):
    text = """
[USARMisPkg.CameraPanTilt]
Links=(Number=1,MaxSpeed=0.5)
Links=(LinkNumber=2,ParentLinkNumber=1,MinRange=-0.5,MaxRange=0.9,Location=(X=0,Y=0,Z=0.1))
"""
    for robot in (P2AT, P2DX):
        (before,), (after,) = robot.packages, named(load(text), robot.name).packages
        pan, tilt = before.links
        assert after.links[0] == replace(pan, max_speed=0.5)
        assert after.links[1] == replace(tilt, min_range=-0.5, max_range=0.9, location=(0.0, 0.0, 0.1))


def test_a_link_of_another_size_is_drawn_as_its_box(load):
    text = """
[USARMisPkg.CameraPanTilt]
Links=(Number=1,Size=(X=0.1,Y=0.1,Z=0.1))
Links=(Number=2,Parent=1,Mass=1)
"""
    (before,), (after,) = P2AT.packages, named(load(text), "P2AT").packages
    assert [link.looks for link in after.links] == [(), before.links[1].looks]
    assert before.links[0].looks
    assert before.links[1].looks


def test_a_package_of_ones_own_is_mounted_in_metres_whatever_the_units(load):
    text = """
[USARMisPkg.Mast]
Links=(Number=1,Parent=-1,JointType=Prismatic,Orientation=(X=3.14159265),MinRange=0,MaxRange=0.4,Mass=0.5,Size=(X=0.04,Y=0.04,Z=0.3))
Links=(Number=2,Parent=1,Location=(X=0,Y=0,Z=0.2),MaxSpeed=1.0,MaxTorque=5)
[USARBot.P2AT]
bMountByUU=True
AddMisPkgs=(PkgName=Pole,Location=(X=-0.1,Y=0,Z=-0.1),PkgClass=Class'USARMisPkg.Mast')
Cameras=(ItemClass=class'USARBot.RobotCamera',ItemName=Camera,Parent=Pole_Link2)
"""
    robot = named(load(text), "P2AT")
    assert [package.name for package in robot.packages] == ["CameraPanTilt", "Pole"]
    model, data = compiled(robot)
    data.joint("Pole_Link1").qpos = 0.3
    mujoco.mj_kinematics(model, data)
    # Half a turn about x makes the first link's z point up; the second is 0.2 along it, and it rises by 0.3.
    np.testing.assert_allclose(data.body("Pole_Link2").xpos, (-0.1, 0.0, 0.1 + 0.2 + 0.3), atol=1e-7)
    assert kinematic_tree_of(robot).mass == pytest.approx(14.0 + 0.5 + 0.2, abs=1e-6)


# Tracks


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize(("end", "other"), [("Front", "Rear"), ("Rear", "Front")])
def test_the_number_of_tires_of_a_track_can_be_set_at_each_end(load, end, other, count):
    loaded = load(f"[USARBot.Tarantula{end}Track]\nNumTires={count}")
    robot = named(loaded, "Tarantula")
    arms = {"Front": ("FRFlipper", "FLFlipper"), "Rear": ("RRFlipper", "RLFlipper")}
    rows, stock = (
        {arm: [p for p in one.parts if p.is_wheel and p.parent == arm] for arm in sum(arms.values(), ())}
        for one in (robot, TARANTULA)
    )
    for arm in arms[other]:
        assert rows[arm] == stock[arm], "the other end is another section's"
    for arm in arms[end]:
        row, tip = rows[arm], stock[arm][-1]
        assert len(row) == count
        assert row[-1].at == pytest.approx(tip.at)
        assert row[-1].shapes[0].size == pytest.approx(tip.shapes[0].size)
    assert robot.drive.left != TARANTULA.drive.left
    speeds = dict(zip((*robot.drive.left, *robot.drive.right), robot.drive.ratios, strict=True))
    for part in robot.wheels:  # one belt speed
        assert speeds[part.name] * part.shapes[0].size[0] == pytest.approx(robot.drive.radius)
    assert kinematic_tree_of(robot).mass == pytest.approx(kinematic_tree_of(TARANTULA).mass, abs=1e-5)


# Payload


def test_the_payload_is_the_sum_of_the_weights_of_all_items(load):
    """Manual 10: 0.4 kg for a sensor or camera by default, 0.1 kg for an INS, here 1 kg for a sonar."""
    light = sum(m.kind not in ("INS", "Sonar") for m in (*P2AT.sensors, *P2AT.cameras))
    assert carried_weight(P2AT) == pytest.approx(0.1 + 0.4 * (light + 16), abs=EXACT)
    text = """
[USARBot.SonarSensor]
Weight=1.0
[USARBot.RFIDReleaser]
Weight=0,5
[USARBot.P2AT]
Payload=10
Effecters=(ItemClass=class'USARBot.RFIDReleaser',ItemName=Gun)
"""
    robot = named(load(text), "P2AT")
    expected = 0.1 + 0.4 * light + 16 * 1.0 + 0.5
    assert carried_weight(robot) == pytest.approx(expected, abs=EXACT)
    assert f"carries {expected:.2f} kg" in overload(robot)
    assert "payload is 10.00 kg" in overload(robot)
    assert overload(P2AT) == ""
    assert kinematic_tree_of(robot).mass == kinematic_tree_of(P2AT).mass, (
        "weights are for the payload only (footnote 3)"
    )


# Mistakes

WRONG = [
    ("msgTimer=fast", "2: msgTimer is 'fast'; expected a number"),
    ("msgTimer=0", "2: msgTimer is 0; expected a number above 0"),
    ("bMountByUU=maybe", "2: bMountByUU is 'maybe'; expected True or False"),
    ("Sensors=F1", r"2: Sensors is 'F1'; expected \(Name=value"),
    ("Sensors=(ItemName=A)", "2: ItemClass is not given; expected a class"),
    ("Sensors=(ItemClass=class'USARBot.Rader',ItemName=A)", "2: unknown ItemClass 'Rader'; expected one of"),
    (f"Sensors=({INS})", "2: ItemName is not given; expected a name"),
    (f"Sensors=({INS},ItemName=\"My INS\")", "2: ItemName is 'My INS'; expected a name: one word of"),
    (f"Sensors=({INS},ItemName=A,Parent=Mast)", "2: A has an unknown Parent 'Mast'; expected one of HARD"),
    (f"Sensors=({INS},ItemName=A,Position=(X=1,W=2))", "2: Position has X, W; expected X, Y and Z"),
    (f"Sensors=({INS},ItemName=A,Position=3)", r"2: Position is '3'; expected \(X=number"),
    (f"Sensors=({INS},ItemName=A,Sigma=low)", "2: INS: Sigma is 'low', expected a number"),
    (f"Sensors=({INS},ItemName=A)\nAddSensors=({INS},ItemName=a)", "3: there is a INS a already; expected"),
    ("MisPkgs=(PkgName=A,PkgClass=class'USARMisPkg.Arm')", "2: unknown PkgClass 'Arm'; expected one of Cam"),
    ("MisPkgs=(PkgName=A,Place=(X=1))", "2: MisPkgs has no Place; expected some of PkgName, Loc"),
    ("BaseClass=P2DX", "2: P2AT exists already; expected BaseClass in a new class' section only"),
    ("Wheels(0)=(Number=0)", "2: Wheels are for an OmniDrive, P2AT has SkidSteered; expected JointParts too"),
    (f"JointParts={pair('A', 0, 0.1, 0, LOCKED)}", "2: the size of wheel A .* Radius= and .* P2ATTire"),
    (f"JointParts={pair('A', 0, 0.1, 0, SIZE, joint='KBall')}", "2: unknown JointClass 'KBall'; expected K"),
    (f"JointParts={pair('A', 0, 0, 0, 'Parent=B')}", "2: Parent B is not defined before; expected one"),
    (f"JointParts={pair('A', 0, 0.1, 0, SIZE, LOCKED)}", "2: no driven wheel is on the left; expected"),
    (f"JointParts={pair('A', 0, 1, 0, SIZE, 'ParentAxis2=(X=1)')}", "2: ParentAxis2 of wheel A is .*Y=1"),
    (f"JointParts={pair('A', 0, 1, 0, LOCKED, SIZE, 'SelfAxis=(X=0,Y=0,Z=1),SelfAxis2=(X=0,Y=1,Z=1)')}",
     "2: SelfAxis and SelfAxis2 of wheel A stand at 45.0 degrees; expected 90.0 as ParentAxis"),
    (f"JointParts={pair('A', 0, 0.1, 0, joint='KDHinge')}", r"2: JointParts has no Size; expected Size=\(X="),
    (f"JointParts={pair('A', 0, 1, 0, 'Colour=3')}", "2: JointParts has no Colour; expected some of Part"),
    ("MisPkgs=(PkgName=Pole,PkgClass=class'USARMisPkg.CameraPanTilt')", "Camera sits on CameraPanTilt_Link2"),
]  # fmt: skip


@pytest.mark.parametrize(("lines", "says"), WRONG, ids=[says[:40] for _, says in WRONG])
def test_a_mistake_names_its_place_and_what_is_allowed(load, lines, says):
    with pytest.raises(SpecError, match=rf"a\.ini:(.*){says}" if says[0] != "2" else rf"a\.ini:{says}"):
        load(f"[USARBot.P2AT]\n{lines}")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[USARBot.Dalek]\nWeight=3", r"a\.ini:2: \[USARBot\.Dalek\] is neither .* JointParts or a Base"),
        ("[USARBot.A]\nBaseClass=Dalek", r"a\.ini:2: unknown BaseClass 'Dalek'; expected one of Lisa, P2AT"),
        ("[USARBot.A]\nBaseClass=B\n[USARBot.B]\nBaseClass=A", r"a\.ini:4: A is based on itself"),
        (ROVER.replace("Weight=12\n", ""), r"a\.ini:2: new robot Rover has no Weight"),
        (ROVER.replace("Weight=12", "Weight=1").replace(SIZE, SIZE + ",Mass=1"), r"a\.ini:3: .*parts alone"),
        ("[USARMisPkg.Arm]\nLinks=(Number=1,Parent=4)", r"a\.ini:2: Parent 4 is no link before this one"),
        ("[USARMisPkg.Arm]\nLinks=(Number=1,JointType=Ball)", r"a\.ini:2: JointType is Ball; expected Rev"),
        ("[USARBot.P2DXFrontTrack]\nNumTires=3", r"a\.ini:2: P2DX has no tires on FRFlipper"),
        ("[USARBot.TarantulaRearTrack]\nNumTires=2.5", r"a\.ini:2: NumTires is 2.5; expected a whole number"),
        ("[USARBot.P2AT]\nSensors=(", r"a\.ini:2: the '\(' in column 9 is never closed"),
    ],
)  # fmt: skip
def test_a_section_that_makes_no_robot_says_why(load, text, says):
    with pytest.raises(SpecError, match=says):
        load(text)


def test_a_scale_must_be_positive(load):
    with pytest.raises(UsageError, match="Unreal units per metre are 0, expected a number above 0"):
        load("", scale=0.0)


# In force


@pytest.fixture
def own_robots(monkeypatch):
    """What a test puts into the registry of robots leaves with it."""
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    return ROBOTS


def test_configuring_replaces_classes_in_the_registry_or_nothing(own_robots, tmp_path):
    good, bad = tmp_path / "good.ini", tmp_path / "bad.ini"
    good.write_text(f"{ROVER}Payload=0.2\nSensors=({INS},ItemName=INS,Weight=0.5)\n[USARBot.p2at]\nPayload=1")
    bad.write_text("[USARBot.P2AT]\nPayload=much")
    before = dict(own_robots)
    with pytest.raises(SpecError, match=r"bad\.ini:2: Payload is 'much'; expected a number"):
        configure([good, bad])
    assert dict(own_robots) == before
    warnings = configure([good]).warnings
    assert own_robots.get("ROVER").sensors[0].kind == "INS"
    assert own_robots.get("P2AT") == replace(P2AT, payload=1.0)
    assert own_robots.names().count("P2AT") == 1
    assert sorted(text.partition("good.ini:")[2] for text in warnings) == [
        f"11: P2AT carries {carried_weight(P2AT):.2f} kg of {len(P2AT.sensors) + len(P2AT.cameras)} items, "
        "its payload is 1.00 kg",
        "2: Rover carries 0.50 kg of 1 items, its payload is 0.20 kg",
    ]


def test_a_robot_whose_sensors_cannot_be_built_is_refused_before_anything_changes(own_robots, tmp_path):
    path = tmp_path / "a.ini"
    odometry = "Sensors=(ItemClass=class'USARBot.OdometrySensor',ItemName=Odometry)"
    path.write_text(ROVER.replace("LeftFWheel", "FL") + odometry)
    with pytest.raises(SpecError, match=r"a\.ini:2: robot Rover: .* no wheel 'LeftFWheel'; wheels: FL"):
        configure([path])
    assert "Rover" not in own_robots


@pytest.fixture
def rig(own_robots, tmp_path):
    """Put a robot of an ini text on a floor. Imported here: the rig needs JAX's pool set up by conftest."""
    from tests.rig import Rig

    def on_floor(text, name):
        path = tmp_path / "a.ini"
        path.write_text(text)
        configure([path])
        return Rig(name)

    return on_floor


ROLLING_RTOL = 0.05


def test_a_robot_made_of_pairs_drives_and_turns(rig):
    """A wheel of 0.1 m at 2 rad/s rolls 0.2 m/s; skidding in place it turns at v b / (a2 + b2)."""
    from tests.rig import steady_speed, steady_spin

    rover = rig(ROVER, "Rover").tell(Left=2.0, Right=2.0)
    assert steady_speed(rover) == pytest.approx(0.2, rel=ROLLING_RTOL)
    assert abs(rover.data.qpos[1]) < 0.02, "straight ahead"
    rover.tell(Left=-4.0, Right=4.0)
    v, a, b = 0.4, 0.16, 0.2  # as in tests/sim/test_drive.py: rigid wheels with Coulomb friction
    assert steady_spin(rover) == pytest.approx(v * b / (a * a + b * b), rel=0.25), "skid is not that exact"


def test_a_car_made_of_pairs_stands_on_its_springs_and_steers_as_a_bicycle_does(rig):
    front = wheels(NAMES, "Radius=0.3,Width=0.15", x=0.9, y=0.6, z=0.3).splitlines()[:2]
    rear = wheels(NAMES, "Radius=0.3,Width=0.15,bSteeringLocked=True", x=0.9, y=0.6, z=0.3).splitlines()[2:]
    text = "[USARBot.Car]\nDimensions=(X=2.5,Y=1.0,Z=0.6)\nWeight=600\nmaxSpinSpeed=20\n"
    car = rig(text + "\n".join([*front, *rear]), "Car")
    car.run(1.0)
    unsprung = 4 * 0.07 * 600 * 1.3  # chosen: 7 % a wheel, 30 % of that for its hub
    stiffness = 4 * 150 * (2 * math.pi * 2.0) ** 2
    # The springs carry a quarter of the weight each as drawn, the wheels' own share of it lifts the rest.
    lift = unsprung * 9.81 / stiffness
    assert car.data.qpos[2] == pytest.approx(0.6 + lift, abs=3e-3), "tyres sink by up to 1 mm"
    car.tell(Speed=10.0, FrontSteer=0.3)
    log = car.run(5.0)
    speed = np.linalg.norm(log[-1, 3:5])
    assert speed == pytest.approx(3.0, rel=ROLLING_RTOL)
    assert log[-1, 8] == pytest.approx(speed * math.tan(0.3) / 1.8, rel=ROLLING_RTOL)
    assert car.joint("LeftFWheel_Steer") > 0.3 > car.joint("RightFWheel_Steer"), "the inner wheel more"


@pytest.mark.parametrize(("front", "rear"), [(0.3, -0.3), (0.2, 0.2), (0.0, 0.25)])
def test_a_car_that_steers_at_both_ends_turns_as_its_bicycle_does(rig, front, rear):
    """DRIVE {RearSteer} (manual 9.4): v cos(b) (tan front - tan rear) / base, tan(b) their mean."""
    text = "[USARBot.Crab]\nDimensions=(X=2.5,Y=1.0,Z=0.6)\nWeight=600\nmaxSpinSpeed=20\n"
    pairs = wheels(NAMES, "Radius=0.3,Width=0.15,bSuspensionLocked=True", x=0.9, y=0.6, z=0.3)
    car = rig(text + pairs, "Crab").tell(Speed=6.0, FrontSteer=front, RearSteer=rear)
    log = car.run(4.0)
    ahead, behind = math.tan(front), math.tan(rear)
    slant = math.atan((ahead + behind) / 2)
    assert log[-1, 8] == pytest.approx(
        1.8 * math.cos(slant) * (ahead - behind) / 1.8, rel=ROLLING_RTOL, abs=1e-3
    )
    assert np.linalg.norm(log[-1, 3:5]) == pytest.approx(1.8, rel=ROLLING_RTOL)
    if front == rear:  # a crab
        assert math.atan2(log[-1, 4], log[-1, 3]) == pytest.approx(front, rel=ROLLING_RTOL)


def test_motors_of_known_tires_are_those_of_their_robot(load):
    robot = named(load(ROVER.replace(SIZE, "PartClass=class'USARBot.P2DXTire',Torque=1.0")), "Rover")
    (stock,) = motors(P2DX, "LeftFWheel")
    assert motors(robot, "LeftFWheel") == [replace(stock, torque=1.0, stall_torque=None)]
    assert isinstance(stock, Motor)
