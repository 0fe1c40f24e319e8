"""Ini files of the later versions on the Unreal Development Kit, and Unreal's signs of lists."""

import numpy as np
import pytest

from tests.models.ini.texts import load_texts
from usarmjx.base.errors import SpecError
from usarmjx.models.effecters import effecters_of
from usarmjx.models.robots.flippers import TARANTULA
from usarmjx.models.robots.pioneer import P2AT, P2DX
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots.sensors import configuration, geometry
from usarmjx.server.protocol.dialects import UDK
from usarmjx.server.protocol.grammar import format_message

PLACE = "Position=(X=0.2,Y=0,Z=-0.2),Direction=(x=0,y=0,z=0)"


@pytest.fixture
def load(tmp_path):
    return lambda *texts: load_texts(tmp_path, texts, (P2AT, P2DX, TARANTULA))


def names(robot):
    return [(mount.kind, mount.name) for mount in robot.sensors]


def of(loaded, name="P2AT"):
    return next(robot for robot in loaded.robots if robot.name == name)


def part(item, name, more="", package="USARSensor"):
    called = f'ItemName="{name}",' if name else ""
    return f"AddParts=(ItemClass=class'{package}.{item}',{called}{PLACE}{more})\n"


LATER = f"""[USARBotAPI.BotController]
DeltaTime=0.1
[USARSensor.Sensor]
Noise=0.001
[USARSensor.RangeScanner]
MaxRange=4.0
bWithTimeStamp=true
[USARSensor.SICK]
MaxRange=20.0
HiddenSensor=false
[USARSensor.SonarSensor]
MaxRange=5.0
maxAngleOfIncidence=0.5
[USARSensor.BumperArray]
ScanInterval=0.2
[USARBot.P3AT]
{part("SICK", "lms200", ',Parent="USARbot.P3AT"')}{part("Odometry", "Odometer")}{part("IMU", "IMU")}\
{part("USARCamera", "")}{part("BumperArray", "B1")}{part("BumperArray", "B2")}{part("Tachometer", "Tach")}\
{part("P3ATBatteryPack", "Pack", package="USARDeco")}[USARBot.Nao]
{part("GroundTruth", "Truth")}[UTGame.UTGame]
BotRatio=1
""".replace("\\\n", "")


def test_a_file_of_the_later_versions_mounts_what_means_the_same(load):
    loaded = load(LATER)
    robot = of(loaded)
    added = names(robot)[len(P2AT.sensors) :]
    assert added == [
        ("RangeScanner", "lms200"),
        ("Odometry", "Odometer"),
        ("AHRS", "IMU"),
        ("Tachometer", "Tach"),
    ]
    lms = robot.sensors[len(P2AT.sensors)]
    assert dict(lms.all_options)["MaxRange"] == 20.0
    assert (lms.at, lms.parent) == ((0.2, 0.0, -0.2), "HARD")
    assert robot.cameras[-1].name == "USARCamera"
    scanner = next(mount for mount in robot.sensors if mount.name == "Scanner1")
    assert dict(scanner.all_options)["MaxRange"] == 4.0
    sonar = next(mount for mount in robot.sensors if mount.kind == "Sonar")
    assert dict(sonar.all_options)["MaxIncidence"] == 0.5


def test_a_vacuum_is_an_effecter_with_the_suction_length_of_its_class(load):
    """Vacuum.uc: 0.125 m."""
    robot = of(load("[USARBot.P3AT]\n" + part("Vacuum", "Cup", package="USARActuator")))
    mount = robot.effecters[-1]
    assert (mount.kind, mount.name, mount.at) == ("Vacuum", "Cup", (0.2, 0.0, -0.2))
    assert effecters_of(robot)[-1].settings.suction_length == 0.125


def test_an_ir2_sensor_is_an_ir_sensor(load):
    robot = of(load("[USARBot.P3AT]\n" + part("IR2Sensor", "Eye")))
    assert names(robot)[-1] == ("IR", "Eye")


def test_a_section_about_a_scanner_keeps_its_other_figures(load):
    """MaxRange and ScanFov of the later versions' SICK; of a second file too, and of a class on it."""
    on_it = "[USARBot.Mine]\nBaseClass=SICK\nResolution=0.1\n[USARBot.P2AT]\n"
    on_it += "AddSensors=(ItemClass=class'USARBot.Mine',ItemName=Own)\n"
    text = "[USARSensor.SICK]\nMinRange=0.1\n[USARBot.P2AT]\n"
    text += part("sick", "lms200") + part("usarcamera", "Eye")
    robot = of(load(text, "[USARSensor.SICK]\nScanInterval=0.1\n", on_it))
    scanner, own = (dict(mount.all_options) for mount in robot.sensors[-2:])
    assert scanner == {
        "MaxRange": 20.0,
        "ScanFov": 3.14159,
        "Resolution": 0.01745,
        "MinRange": 0.1,
        "ScanInterval": 0.1,
    }
    assert own == {**scanner, "Resolution": 0.1}
    assert robot.cameras[-1].name == "Eye"


@pytest.mark.parametrize(
    "says",
    [
        "a.ini:2: section [USARBotAPI.BotController] is not about robots: the server's settings are options",
        "a.ini:4: [USARSensor.Sensor] is left out: each class of sensors has its own defaults",
        "a.ini:7: bWithTimeStamp is ignored: the dialect of the connection decides",
        "a.ini:10: HiddenSensor is ignored: robots look as their solids do",
        "a.ini:15: USARSensor.BumperArray is left out, 3 lines: usarmjx has no such class",
        "a.ini:17: P3AT is the later versions' name of P2AT",
        "a.ini:24: USARDeco.P3ATBatteryPack is left out: usarmjx has no such class",
        "a.ini:26: [USARBot.Nao] is left out: no robot and no item of usarmjx has that class",
        "a.ini:28: section [UTGame.UTGame] is not about robots: it is about the Unreal game",
    ],
)
def test_the_rest_is_named_once_with_its_reason(load, says):
    found = [text for text in load(LATER).warnings if says in text]
    assert len(found) == 1, load(LATER).warnings


def test_an_unknown_class_refuses_no_file_about_others(load):
    text = "[USARBot.P2AT]\nWeight=20\n[USARBot.Dalek]\nWeight=3\n[USARBot.Davros]\nBaseClass=Dalek\n"
    loaded = load(text)
    assert [robot.name for robot in loaded.robots] == ["P2AT"]
    assert [text.partition("a.ini:")[2][:24] for text in loaded.warnings] == [
        "4: [USARBot.Dalek] is le",
        "6: [USARBot.Davros] is l",
    ]
    with pytest.raises(SpecError, match="neither a robot nor an item class"):
        load("[USARBot.P2TA]\nWeight=20\n")


SONAR = (
    "(ItemClass=class'USARBot.SonarSensor',ItemName=\"{}\",Position=(X=0,Y=0,Z=0),Direction=(X=0,Y=0,Z=0))"
)
ALL = names(P2AT)
WITHOUT_F1 = [item for item in ALL if item != ("Sonar", "F1")]
NEW = ("Sonar", "Z1")


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        (["!Sensors=ClearArray"], []),
        (["!Sensors=", f"+Sensors={SONAR.format('Z1')}"], [NEW]),
        ([f"!Sensors=\n+Sensors={SONAR.format('Z1')}"], [NEW]),
        ([f"+Sensors={SONAR.format('Z1')}\n!Sensors="], []),
        ([f"+Sensors={SONAR.format('Z1')}"], [*ALL, NEW]),
        ([f".Sensors={SONAR.format('Z1')}"], [*ALL, NEW]),
        ([f"Sensors={SONAR.format('Z1')}"], [NEW]),
        ([f"-Sensors={SONAR.format('F1')}"], WITHOUT_F1),
        (["-Sensors=(ItemName=F1)"], WITHOUT_F1),
        ([f"Sensors={SONAR.format('Z1')}\n+Sensors={SONAR.format('Z2')}", "-Sensors=(ItemName=Z2)"], [NEW]),
        (
            [f"-Sensors={SONAR.format('F1')}", f"+Sensors={SONAR.format('F1')}"],
            [*WITHOUT_F1, ("Sonar", "F1")],
        ),
    ],
)
def test_signs_of_lists_mean_what_they_mean_in_unreal(load, files, expected):
    loaded = load(*(f"[USARBot.P2AT]\n{text}\n" for text in files))
    assert names(of(loaded)) == expected
    assert loaded.warnings == ()


def test_a_package_is_taken_away(load):
    name = P2AT.packages[0].name
    on_it = "!Cameras=\n" + "".join(
        f"-{key}=(ItemName={mount.name})\n"
        for key, mounts in (("Sensors", P2AT.sensors), ("Effecters", P2AT.effecters))
        for mount in mounts
        if mount.parent.startswith(name)
    )
    loaded = load(f"[USARBot.P2AT]\n-MisPkgs=(PkgName={name})\n{on_it}")
    assert of(loaded).packages == P2AT.packages[1:]


def test_a_sign_without_effect_is_a_warning(load):
    loaded = load("[USARBot.P2AT]\n-Sensors=(ItemName=Zoo)\n-JointParts=(A=1)\n[USARBot.Dalek]\n!Sensors=\n")
    said = [text.partition("a.ini:")[2] for text in loaded.warnings]
    assert "2: -Sensors removes nothing: P2AT has no such item" in said
    assert "3: -JointParts removes nothing: no line before has that" in said
    assert "5: section [USARBot.Dalek] removes nothing" in said


def test_an_encoder_counts_the_wheel_whose_number_is_in_its_name(load):
    """Encoder.uc; the order of P3AT.uc: front right, front left, back right, back left."""
    names = ("EncTestW1", "EncTestW2", "Other", "W9")
    loaded = load("[USARBot.P3AT]\n" + "".join(part("Encoder", name) for name in names))
    robot = of(loaded)
    own = [(mount.name, mount.parent) for mount in robot.sensors if mount.kind == "Encoder"]
    assert own == [("EncTestW1", "LeftFWheel"), ("EncTestW2", "RightRWheel")]
    assert any(
        "USARSensor.Encoder of no known wheel is left out, 2 lines" in text for text in loaded.warnings
    )
    encoder = suite_of(robot).sensors[suite_of(robot).index("Encoder")]
    joints, signs = encoder._joints
    assert [encoder.plan.parts[1 + joint] for joint in joints] == ["LeftFWheel", "RightRWheel"]
    np.testing.assert_allclose(signs, 1.0, atol=1e-6, err_msg="ahead is positive")


def test_a_battery_is_an_item_with_a_place_and_options(load):
    """The line of P3AT in the later versions' DefaultUSAR.ini."""
    robot = of(load("[USARBot.P3AT]\n" + part("Battery", "battery")))
    suite = suite_of(robot)
    (geo,) = geometry(suite.plan, "Battery", "battery")
    (line,) = UDK.translate(geo, "P3AT")
    assert format_message(line) == (
        "GEO {Type Battery} {Name battery} {Location 0.2000,0.0000,-0.2000}"
        " {Orientation 0.0000,0.0000,0.0000} {Mount P3AT}"
    )
    (conf,) = configuration(robot, suite.sensors, [1.0] * len(robot.cameras), "Battery", "battery")
    assert format_message(conf).startswith("CONF {Type Battery} {Name battery} {")


@pytest.mark.parametrize(
    ("figures", "life"),
    [
        ("batteryLife=600.0\n", 600.0),
        ("maxEnergy=1000000.0\ncurrentEnergy=250000.0\nbatteryLife=1200.0\n", 300.0),
        ("currentEnergy=5000000.0\n", 1200.0),  # it holds no more than its most: Battery.uc, AddEnergy
    ],
)
def test_a_battery_lasts_as_long_as_its_energy_does(load, figures, life):
    """ExpectedLifeTime of Battery.uc: the present energy over the full one that goes in a life."""
    loaded = load(f"[USARSensor.Battery]\n{figures}[USARBot.P3AT]\n" + part("Battery", "battery"))
    assert of(loaded).battery_life == life
    assert not [text for text in loaded.warnings if "Energy" in text or "batteryLife" in text]


def test_a_life_of_the_robots_own_section_comes_first(load):
    own = "[USARBot.P3AT]\nbatteryLife=77\n" + part("Battery", "battery")
    assert of(load("[USARSensor.Battery]\nbatteryLife=600.0\n" + own)).battery_life == 77.0
    with pytest.raises(SpecError, match="maxEnergy is 0; expected a number above 0"):
        load("[USARSensor.Battery]\nmaxEnergy=0\n" + own)


def test_one_reason_for_several_lines_is_one_warning(load):
    sections = (f"[USARSensor.{name}]\nHiddenSensor=true\n" for name in ("SICK", "Odometry", "Tachometer"))
    (warning,) = load("".join(sections)).warnings
    assert "a.ini:2: HiddenSensor is ignored: " in warning
    assert warning.endswith(" (also in lines 4, 6)")
