"""The tables of sensors: they say what registries, settings and the server say."""

import dataclasses
import re
from functools import cache

import pytest
from typer.testing import CliRunner

import dev
from usarmjx.cli.app import app
from usarmjx.cli.catalogue import SAMPLES, SECTIONS, ini_value, sensors_table
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import field_name, field_names, manual_keys
from usarmjx.sensors.base import SENSORS
from usarmjx.sim.configure import settings_by_kind

PAGE = dev.ROOT / "docs" / "all-sensors.md"


@cache
def table():
    return sensors_table()


def rows(title):
    """Cells by type of the table whose head starts with these words."""
    lines = table().partition(title)[2].split("\n\n")[0].splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    return {row[0]: row[1:] for row in cells}


def test_the_page_of_all_sensors_is_the_generated_one():
    """After a change: `usarmjx list sensors --markdown > docs/all-sensors.md`."""
    assert PAGE.read_text(encoding="utf-8") == table() + "\n"


def test_the_command_prints_it():
    result = CliRunner().invoke(app, ["list", "sensors", "--markdown"])
    assert result.exit_code == 0, result.output
    assert result.output == table() + "\n"


def test_every_type_is_there_once_with_a_value_and_a_source():
    found = rows("| type | function")
    assert set(found) == set(SENSORS.names()) == set(SECTIONS) == set(SAMPLES)
    for what, value, *_ in found.values():
        assert what
        assert value


def test_rays_are_those_of_the_manuals_figures():
    """181 degrees in steps of 800 of 65536: 41 beams; 40 degrees in steps of 4, four times: 441 (10.10.2)."""
    found = {kind: cells[2] for kind, cells in rows("| type | function").items()}
    # ScanFov is half a turn, 32768 units of 800 each.
    assert int(found["RangeScanner"]) == 32768 // 800 + 1
    # 11 x 11 rays, and grids shifted by half a step, which have one column or row, or both, less.
    assert int(found["VictSensor"]) == 11 * 11 + 10 * 11 + 10 * 10 + 11 * 10
    assert (found["IR"], found["INS"], found["RFID"]) == ("1", "-", "16")


def test_robots_are_those_that_carry_it():
    for kind, (*_, carriers, _source) in rows("| type | function").items():
        have = [name for name, robot in ROBOTS if any(mount.kind == kind for mount in robot.sensors)]
        more = re.search(r" and (\d+) more", carriers)
        named = [] if carriers == "-" else re.sub(r" and \d+ more", "", carriers).split(", ")
        assert set(named) <= set(have)
        assert len(named) + int(more[1] if more else 0) == len(have), kind


@pytest.mark.parametrize("kind", SENSORS.names())
def test_keys_are_those_of_ini_files(kind):
    """Written as the manual does, they are read as the settings that they stand for."""
    settings = SENSORS.get(kind).settings_class
    keys, names = manual_keys(settings), field_names(settings)
    for field in dataclasses.fields(settings):
        assert names[field_name(keys[field.name])] == field.name


def test_options_written_as_the_table_has_them_are_read(tmp_path):
    """Every option of every type, in the section of its class (10.2.2 and others)."""
    classes = {"Sonar": "SonarSensor", "IR": "IRSensor", "GPS": "GPSSensor", "RFID": "RFIDSensor"}
    classes |= {kind: f"{kind}Sensor" for kind in ("Odometry", "Encoder", "Touch", "Sound", "HumanMotion")}
    text = []
    for kind in SENSORS.names():
        section = "CO2Sensor" if kind == "CO2Sensor" else classes.get(kind, kind)
        text.append(f"[USARBot.{section}]")
        settings = SENSORS.get(kind).settings_class
        for field in dataclasses.fields(settings):
            if field.default != ():
                text.append(f"{manual_keys(settings)[field.name]}={ini_value(field.default)}")
    path = tmp_path / "USARBot.ini"
    path.write_text("\n".join(text))
    loaded = load_robots([path], ROBOTS, settings=settings_by_kind())
    assert [warning for warning in loaded.warnings if "unknown" in warning] == []


def test_the_manuals_spelling_is_kept():
    options = {kind: cells[0] for kind, cells in rows("| type | options").items()}
    for key in (
        "dBmTXPower=36",
        "dBmRXSensibility=-88",
        "dBObstacleAttenuation=3.5",
        "bAlwaysReadRFIDmem=False",
    ):
        assert key in options["RFID"]
    assert "maxNoise=2.5" in options["GPS"]
    assert "Drifting=False, Precision=1000" in options["INS"]
    assert options["all"].startswith("HiddenSensor=True, bWithTimeStamp=False, Weight=0.4")


def test_messages_have_the_manuals_form():
    """Lines of 10.2 to 10.12 and captured ones, numbers aside."""
    lines = table().partition("```text\n")[2].splitlines()[:-1]
    assert len(lines) == len(SENSORS)
    for start in (
        "SEN {Time 62.0100} {Type Sonar} {Name Sonar Range 1.7626}",
        "SEN {Time 62.01} {Type RangeScanner} {Name RangeScanner} {Resolution 1.5707} {FOV 3.1415} ",
        "SEN {Type Odometry} {Name Odometry} {Pose 0.6168,",
        "SEN {Type INS} {Name INS} {Location 4.50,1.90,1.80} {Orientation 0.00,0.00,1.57}",
        "SEN {Type Encoder} {Name Encoder Tick 211}",
        "SEN {Type HumanMotion} {Name HumanMotion} {Prob 0.66}",
        "SEN {Type CO2Sensor} {Name CO2Sensor} {Gas CO2} {Density 0.01}",
    ):
        assert any(line.startswith(start) for line in lines), start
