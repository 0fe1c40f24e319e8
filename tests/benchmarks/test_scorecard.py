"""What the fast settings do to a robot, beside the reference's, and how numbers are compared."""

import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from benchmarks.cases import RecordOptions, ScorecardCase
from benchmarks.fidelity.conditions import OPEN, BatchTrack, Conditions, SingleTrack
from benchmarks.fidelity.manoeuvres import (
    drive_all,
    flipper_lift,
    gripper_hold,
    manoeuvres_on,
    oblique_wall,
    push,
    ramp_hold,
    speed,
    spin,
    stop,
    top_speed,
    turning_rate,
)
from benchmarks.fidelity.scorecard import differences, engine_summary, write_scorecard
from benchmarks.fidelity.track import Orders, orders_of
from tests.benchmarks.records import faults
from usarmjx.base.errors import SpecError, UnknownNameError
from usarmjx.engines.planar.responses import packaged_responses
from usarmjx.models.compile.physics import PHYSICS, Physics
from usarmjx.models.effecters import standard
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.shapes import SURFACES

P2AT = ROBOTS.get("P2AT")


@pytest.mark.every_run("P2DX")
@pytest.mark.parametrize("name", ["P2AT", "P2DX", "Zerg"])
def test_what_these_classes_do_under_the_fast_settings_is_what_they_do_under_the_reference(name):
    """docs/evidence/speed.md lists no differences of theirs."""
    reference, fast = (
        {name: drive_all(Conditions(one), ROBOTS.get(name))} for one in (Physics(), Physics.fast())
    )
    assert list(differences(reference, fast)) == []
    assert len(reference[name]) == 9  # nothing to lift or to grip with


@pytest.mark.parametrize(("name", "lever"), [("Tarantula", 0.148), ("kenaf", 0.180), ("TeleMax", 0.209)])
def test_flippers_lift_as_the_page_of_robots_says(name, lever):
    """Measured there at 1.5 rad (docs/robots.md), as their lever says (test_tracked.py)."""
    robot = ROBOTS.get(name)
    orders = orders_of(robot)
    assert orders is not None
    assert flipper_lift(Conditions(), robot, orders) == pytest.approx(lever, abs=0.001)


def test_a_gripper_holds_no_more_than_the_friction_of_its_fingers_carries(monkeypatch):
    """Two fingers carry 2 mu times their force; a block creeps out of them before it slips.

    The weaker ones press with 8 N: the trembling of tracks alone shakes a block out of 5 N.
    """
    held = []
    for force in (60.0, 8.0):
        monkeypatch.setattr(standard, "FINGER_MOTOR", replace(standard.FINGER_MOTOR, torque=force))
        robot = replace(ROBOTS.get("Talon"), name=f"Talon{force:g}")
        orders = orders_of(robot)
        assert orders is not None
        held.append(gripper_hold(Conditions(), robot, orders))
        assert 0.0 < held[-1] <= 2 * force * SURFACES["finger"].friction / 9.81
    assert held[0] > held[1]


def test_the_top_speed_is_that_of_its_wheels():
    """Wheel speed times radius, less what 4 s from a standing start and the slip cost: a tenth at most."""
    orders = orders_of(P2AT)
    assert orders is not None
    distance = top_speed(Conditions(), P2AT, orders)
    assert 0.9 * 4.0 * P2AT.drive.top_speed < distance < 4.0 * P2AT.drive.top_speed


def test_whole_turns_are_counted():
    """A P2AT spins at 140 degrees a second (manual 12.1.1): more than two turns in 6 s, with its start."""
    orders = orders_of(P2AT)
    assert orders is not None
    assert spin(Conditions(), P2AT, orders) == pytest.approx(6 * math.radians(140), rel=0.05)


def test_on_planar_speed_and_turning_rate_are_those_of_the_wheels_times_the_gains_of_the_class():
    """Rolling at w r, and turning on the spot at 2 w r / track, each times its packaged gain."""
    orders, gains = orders_of(P2AT), packaged_responses()["P2AT"]["response"]
    assert orders is not None
    planar, rim = Conditions(engine="planar"), P2AT.drive.max_spin * P2AT.drive.radius
    assert speed(planar, P2AT, orders) == pytest.approx(gains["gain"] * rim, rel=1e-3)
    wanted = gains["turn_gain"] * 2 * rim / P2AT.wheel_separation
    assert turning_rate(planar, P2AT, orders) == pytest.approx(wanted, rel=1e-3)
    assert 0.0 < stop(planar, P2AT, orders) < 0.5 * rim


def test_a_batch_of_one_drives_and_pushes_as_a_single_world(monkeypatch):
    """Both are C MuJoCo, within the way of a control step at top speed, 14 mm, and a third of that.

    The batch begins standing, the single world is put on its floor, so they push from other moments.
    """
    orders = orders_of(P2AT)
    assert orders is not None
    alone = [drive(Conditions(), P2AT, orders) for drive in (top_speed, push)]
    monkeypatch.setattr(Conditions, "track", lambda own, robot, ground=OPEN: BatchTrack(own, robot, ground))
    assert [drive(Conditions(), P2AT, orders) for drive in (top_speed, push)] == pytest.approx(
        alone, abs=5e-3
    )


class Started(Exception):
    """A manoeuvre has put its robots in place, and nothing has moved yet."""


@pytest.mark.every_run("ramp_hold-Cooper", "oblique_wall-Cooper")
@pytest.mark.parametrize("name", ["Cooper", "Hummer", "Sedan", "SnowStorm", "P2AT", "Talon"])
@pytest.mark.parametrize("manoeuvre", [ramp_hold, oblique_wall])
def test_every_engine_begins_at_the_same_place_in_which_there_is_room(name, manoeuvre, monkeypatch):
    """Within single precision of a metre, 1e-6 m; the weight presses wheels in by 0.5 mm at most."""
    robot, tracks = ROBOTS.get(name), []

    def note(track, steps):
        tracks.append(track)
        raise Started

    for kind in (SingleTrack, BatchTrack):
        monkeypatch.setattr(kind, "advance", note)
    for condition in (Conditions(), Conditions(engine="planar")):
        with pytest.raises(Started):
            manoeuvre(condition, robot, orders_of(robot))
    single, batch = tracks
    np.testing.assert_allclose(single.root(), batch.root(), atol=1e-6)
    engine = single.world.engine
    mujoco.mj_forward(engine.model, engine.data)
    assert min(contact.dist for contact in engine.data.contact[: engine.data.ncon]) > -5e-4


def test_the_card_of_an_engine_has_what_it_can_do_and_figures_of_data_sheets():
    assert "speed" not in manoeuvres_on("c")
    assert (
        {"speed", "turning rate", "stop", "push"}
        <= manoeuvres_on("jax").keys()
        == manoeuvres_on("warp").keys()
    )
    assert {"push", "flipper lift", "gripper hold"}.isdisjoint(manoeuvres_on("planar"))
    text = engine_summary({"P2AT": {"speed": 0.7, "climb": 0.06}}, {"P2AT": {"speed": 0.71, "climb": 0.02}})
    assert [line.endswith("*") for line in text.splitlines()] == [False, True]


def test_a_difference_is_one_beyond_a_tenth_and_beyond_what_counts_for_nothing():
    reference = {"P2AT": {"top speed": 2.0, "ramp hold": 0.001, "spin": 10.0, "wall": 1.0}}
    other = {"P2AT": {"top speed": 2.3, "ramp hold": 0.015, "spin": 10.9, "wall": math.nan}}
    assert [row[1] for row in differences(reference, other)] == ["top speed", "wall"]


def test_the_record_has_both_numbers_of_every_manoeuvre(tmp_path):
    file = tmp_path / "physics.jsonl"
    text = write_scorecard(ScorecardCase(robot=["passarola"]), RecordOptions(json=file))
    record = json.loads(file.read_text())
    reference, fast = record["numbers"]["Passarola"]["top speed"]
    assert fast == pytest.approx(reference, rel=0.02)  # in the air there is no contact to differ by
    assert record["settings"]["timestep"] == 0.01
    assert faults(record) == []
    assert "1 of 1 numbers" in text


def test_a_manoeuvre_whose_physics_went_bad_has_no_number(monkeypatch, tmp_path):
    """A wheel's speed that is no number puts the robot back, and what it did then tells nothing."""
    tell = SingleTrack.tell

    def break_one_wheel(self, order, slot=0):
        tell(self, order, slot)
        self.world.engine.data.qvel[6] = math.nan

    monkeypatch.setattr(SingleTrack, "tell", break_one_wheel)
    numbers = drive_all(Conditions(), P2AT)
    assert math.isnan(numbers["spin"])
    assert math.isfinite(numbers["ramp hold"])  # nobody tells it anything there
    file = tmp_path / "physics.jsonl"
    write_scorecard(ScorecardCase(robot=["P2AT"]), RecordOptions(json=file))
    record = json.loads(file.read_text(), parse_constant=pytest.fail)
    assert record["numbers"]["P2AT"]["spin"] == [None, None]
    assert ["P2AT", "spin"] in record["differing"]


def test_who_has_no_drive_has_no_numbers():
    assert orders_of(ROBOTS.get("ComStation")) is None
    assert drive_all(Conditions(), ROBOTS.get("ComStation")) == {}
    assert isinstance(orders_of(ROBOTS.get("Sedan")), Orders)


def test_settings_have_names_that_an_error_lists():
    assert PHYSICS.get("Fast") == Physics.fast()
    assert PHYSICS.get("reference") == Physics()
    with pytest.raises(UnknownNameError, match="known: coarse, fast, reference"):
        PHYSICS.get("quick")
    with pytest.raises(SpecError, match="cone is 'round', expected one of elliptic, pyramidal"):
        Physics(cone="round")
    with pytest.raises(SpecError, match="solver is 'PGS', expected one of auto, CG, Newton, block"):
        Physics(solver="PGS")
    with pytest.raises(SpecError, match=r"sleep_tolerance is -1, expected a number from 0 \[m/s\]"):
        Physics(sleep_tolerance=-1)
