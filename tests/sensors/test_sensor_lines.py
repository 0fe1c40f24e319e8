"""The exact line of a given reading, of sensors whose lines no other test here has.

Readings are in MuJoCo's axes (z up, y to the left, turns to the left positive); lines in USARSim's (z down,
y to the right, turns to the right positive). The forms are captured ones.
"""

import math

import numpy as np
import pytest

from usarmjx.server.gamebots.sensors import sensor_report
from usarmjx.server.protocol.grammar import format_message

TIME = 5608.85


def line(bench, kind, name, value):
    sensor = bench.suite.sensors[bench.suite.find(kind, name)]
    return format_message(sensor_report(sensor, np.array(value, np.float32), TIME))


def test_all_sonars_come_in_one_line(bench):
    sensor = bench.suite.sensors[bench.suite.find("Sonar", "Clean")]
    ranges = 0.25 * np.arange(1, len(sensor.mounts) + 1)
    pairs = " ".join(f"{{Name {m.name} Range {r:.4f}}}" for m, r in zip(sensor.mounts, ranges, strict=True))
    told = line(bench, "Sonar", "Clean", ranges)
    assert told == f"SEN {{Time 5608.8500}} {{Type Sonar}} {pairs}"
    assert told.startswith("SEN {Time 5608.8500} {Type Sonar} {Name F1 Range 0.2500} {Name F2 Range 0.5000}")


def test_a_scan_tells_resolution_field_of_view_and_every_beam(bench):
    sensor = bench.suite.sensors[bench.suite.find("RangeScanner", "Clean")]
    ranges = 0.125 * np.arange(1, sensor.settings[0].beams + 1)
    told = line(bench, "RangeScanner", "Clean", ranges)
    start = "SEN {Time 5608.85} {Type RangeScanner} {Name Clean} {Resolution 0.0174} {FOV 3.1415} {Range "
    assert told.startswith(start)
    beams = told.removeprefix(start).removesuffix("}").split(",")
    assert beams == [f"{distance:.4f}" for distance in ranges]
    assert len(beams) == 181


def test_odometry_turns_to_the_right(bench):
    told = line(bench, "Odometry", "Timed", (0.2415, -0.0029, 0.5157))
    assert told == "SEN {Type Odometry} {Name Timed} {Pose 0.2415,0.0029,-0.5157}"


@pytest.mark.parametrize(
    ("kind", "name", "time"), [("INS", "Quiet", ""), ("GroundTruth", "Chassis", "{Time 5608.8500} ")]
)
def test_poses_have_z_down_and_angles_from_0_to_a_turn(bench, kind, name, time):
    told = line(bench, kind, name, (12.614, 2.684, -1.844, 0.5, -0.25, math.pi / 2))
    pose = "{Location 12.61,-2.68,1.84} {Orientation 0.50,0.25,4.71}"
    assert told == f"SEN {time}{{Type {kind}}} {{Name {name}}} {pose}"


def test_encoders_tell_whole_ticks(bench):
    told = line(bench, "Encoder", "Right", (-61.0, 282.0, 0.0, -5.0))
    assert told == (
        "SEN {Type Encoder} {Name Right Tick -61} {Name Left Tick 282} {Name Pan Tick 0} {Name Noisy Tick -5}"
    )
