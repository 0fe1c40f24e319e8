"""The Submarine: buoyancy, speed, turns, dives; oracles are the manual's figures and closed forms."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from tests.rig import Rig
from usarmjx.models.drives.fluid import WATER_DENSITY, added_mass, plate_force
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import Water
from usarmjx.models.types.shapes import Shape

G = 9.81
A, B, C = 6.5364 / 2, 1.1428 / 2, 1.9929 / 2  # manual 12.9: half length, half width, half height
DISPLACED = WATER_DENSITY * 4 / 3 * math.pi * A * B * C
SURFACE, DEEP = 30.0, 15.0  # heights [m]
SEA = (Water(low=(-500.0, -500.0, 0.0), high=(500.0, 500.0, SURFACE)),)
TOP = 6.28  # rad/s
PITCH = 0.3048  # m
FULL = 0.4363  # rad
SUBMARINE = ROBOTS.get("Submarine")
HULL = SUBMARINE.drive.hull
WASH = TOP * PITCH / (2 * math.pi)  # m/s: what the propeller would make without slip
MADE = 0.9 * WASH  # the chosen slip is 10 %


def boats(count=1, *solids, height=DEEP, waters=SEA, **more):
    return Rig("Submarine", *solids, places=[(0.0, 40.0 * i, 0.0) for i in range(count)],
               height=height, waters=waters, **more)  # fmt: skip


def set_going(rig, *speeds, rises=()):
    """Give each boat a speed ahead, and upward [m/s]: they take minutes to reach one by themselves."""
    for i, speed in enumerate(speeds):
        rig.data.qvel[rig.indices[i].root_dofadr] = speed
    for i, speed in enumerate(rises):
        rig.data.qvel[rig.indices[i].root_dofadr + 2] = speed
    return rig


def last(rig, seconds):
    """Position, velocity, turning rate of all boats after some time (boats, 9)."""
    rig.run(seconds)
    rows = [
        np.r_[rig.data.qpos[i.root_qposadr :][:3], rig.data.qvel[i.root_dofadr :][:6]]
        for i in rig.indices
    ]  # fmt: skip
    return np.array(rows)


def tilt_of(rig):
    return np.degrees(np.arccos(np.clip(rig.up, -1, 1)))


def drag_of(axis):
    """Drag over squared speed [N s2/m2]."""
    return WATER_DENSITY / 2 * HULL.drag[axis] * math.pi * np.array([B * C, A * C, A * B])[axis]


def test_it_weighs_what_it_displaces_and_says_so():
    assert SUBMARINE.mass == pytest.approx(DISPLACED, rel=1e-4)
    assert SUBMARINE.mass == pytest.approx(7800, rel=0.01)
    assert (SUBMARINE.drive.vehicle, SUBMARINE.drive.steering) == ("NauticVehicle", "VariableDepth")
    assert SUBMARINE.drive.full_scale == {"Propeller": TOP, "Rudder": FULL, "SternPlane": FULL}


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.7, 0.0), (0.4, 1.1), (math.pi / 2, 0.0)])
@pytest.mark.parametrize("depth", [-0.4, 0.0, 0.3, 5.0])
def test_what_is_under_water_is_what_random_points_of_the_hull_say(roll, pitch, depth):
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    up = np.array([-sp, cp * sr, cp * cr])  # third row of the matrix of roll and pitch
    share, middle = HULL.immersion(jnp.float32(depth), jnp.asarray(up, jnp.float32))
    points = np.random.default_rng(0).uniform(-1, 1, (200_000, 3))
    points = points[(points**2).sum(1) <= 1] * HULL.radii
    wet = points @ up < depth
    assert share == pytest.approx(wet.mean(), abs=0.005)  # of 105 000 points: 3 sigma
    np.testing.assert_allclose(middle, points[wet].mean(0), atol=0.04)  # likewise, 6.5 m long


def test_under_water_it_stays_where_it_is():
    rig = boats()
    for powered in (True, False):
        rig.powered = powered
        now = last(rig, 15.0)[0]
        # Forces of 76 kN are rounded to some 4 mN: 0.1 mm/s at most.
        assert np.abs(now[:3] - (0, 0, DEEP)).max() < 0.01
        assert np.abs(now[3:]).max() < 2e-4


def test_out_of_water_only_gravity_acts():
    rig = boats(waters=()).tell(Propeller=TOP, Rudder=FULL, SternPlane=FULL)
    now = last(rig, 1.0)[0]
    assert now[3:6] == pytest.approx([0, 0, -G], abs=1e-3)
    assert np.abs(now[6:]).max() < 1e-4


def test_half_out_of_water_it_sinks_by_half_its_weight():
    """The half in the water drags half of the added mass along: a = g / 2 / (1 + k / 2)."""
    rig = boats(height=SURFACE)
    carried = added_mass((A, B, C))[0][2]
    now = last(rig, 0.1)[0]
    assert now[5] == pytest.approx(-G / 2 / (1 + carried / 2) * 0.1, rel=0.05)  # it sinks 2 cm meanwhile


def test_it_rises_to_the_surface_and_stays_awash():
    rig = set_going(boats(height=SURFACE - C - 0.5), MADE).tell(Propeller=TOP, SternPlane=FULL)
    log = rig.run(60.0)
    assert log[:, 2].max() < SURFACE - C + 0.1, "its own weight holds what comes out"
    assert log[-1, 2] > SURFACE - C - 0.4
    assert tilt_of(rig)[0] < 2


def test_speed_is_the_propellers_pitch_times_its_turns_less_the_slip():
    speeds = np.array([1.0, 0.5, -1.0]) * MADE
    rig = set_going(boats(3), *(0.95 * speeds))
    for robot, spin in enumerate((TOP, TOP / 2, -99.0)):
        rig.tell(robot=robot, Propeller=spin)
    # Within 5 % at the start, and closing with 0.046 (half speed: 0.023) per second.
    assert last(rig, 60.0)[:, 3] == pytest.approx(speeds, rel=0.015)
    assert np.abs(tilt_of(rig)).max() < 0.1


def test_it_gathers_way_as_thrust_and_added_mass_say():
    """u = U tanh(t / T) for thrust c (w^2 - u^2) against drag k u^2, with T = m / ((c + k) U)."""
    rig = boats().tell(Propeller=TOP)
    grip = drag_of(0) * 0.81 / 0.19
    mass = DISPLACED * (1 + added_mass((A, B, C))[0][0])
    lag = mass / ((grip + drag_of(0)) * MADE)
    assert last(rig, 20.0)[0, 3] == pytest.approx(MADE * math.tanh(20.0 / lag), rel=0.02)


def test_with_the_propeller_stopped_or_without_power_it_slows_down():
    """u = u0 / (1 + u0 q t / m), q being drag and stopped propeller, or drag alone."""
    mass = DISPLACED * (1 + added_mass((A, B, C))[0][0])
    stopped, idle = (set_going(boats(), MADE) for _ in range(2))
    idle.powered = False
    for rig, drag in ((stopped, drag_of(0) / 0.19), (idle, drag_of(0))):
        expected = MADE / (1 + MADE * drag * 40.0 / mass)
        assert last(rig, 40.0)[0, 3] == pytest.approx(expected, rel=0.02)


def test_the_rudder_turns_it_to_its_side_in_three_lengths():
    rig = set_going(boats(4), MADE, MADE, MADE, -MADE)
    for robot, (spin, rudder) in enumerate([(TOP, 9.0), (TOP, -FULL), (TOP, FULL / 4), (-TOP, FULL)]):
        rig.tell(robot=robot, Propeller=spin, Rudder=rudder)
    now = last(rig, 80.0)
    right, left, gentle, astern = now
    assert right[8] < 0, "positive is to the right (manual 9.4): clockwise from above"
    assert left[8] == pytest.approx(-right[8], rel=1e-3)
    assert right[8] < gentle[8] < 0
    assert astern[8] > 0, "going astern the bow goes the other way"
    assert right[1] < -5 < 40 + 5 < left[1]
    speed = np.hypot(*right[3:5])
    assert 2 < speed / -right[8] / (2 * A) < 4, "turning circles of boats are some four to eight lengths wide"
    # The stern cannot go sideways faster than the rudder's angle lets the water past it.
    assert -right[8] * SUBMARINE.drive.stern_arm < math.tan(FULL) * (MADE + WASH) / 2
    assert np.abs(now[:, 2] - DEEP).max() < 0.1, "and keeps its depth"
    angles = SUBMARINE.drive.steering_angles({}, rig.commands[0].setpoint)
    assert angles == {"rudder": pytest.approx(FULL), "stern_plane": 0.0}


def steady_rise(plane):
    """Where the plane's lift is the hull's drag; the flow comes from above as the boat rises [m/s]."""
    ahead, rise = (MADE + WASH) / 2, 0.0
    for _ in range(50):
        sine = math.sin(plane - math.atan(rise / ahead))
        lift = WATER_DENSITY / 2 * 0.2152 * (ahead**2 + rise**2) * min(math.pi * sine, 1.17) * math.cos(plane)
        rise = (rise + math.sqrt(lift / drag_of(2))) / 2
    return rise


@pytest.mark.every_run("0.4363")
@pytest.mark.parametrize("plane", [FULL, 0.1])
def test_the_stern_plane_makes_it_rise_and_dive_going_ahead(plane):
    """Boats that start a bit slower and faster than the steady speed close in on it."""
    rise = steady_rise(plane)
    start = np.array([0.9, 1.1, -0.9, 0.0]) * rise
    rig = set_going(boats(4), MADE, MADE, MADE, 0.0, rises=start)
    for robot, (spin, angle) in enumerate([(TOP, plane), (TOP, plane), (TOP, -plane), (0.0, plane)]):
        rig.tell(robot=robot, Propeller=spin, SternPlane=angle)
    slow, fast, diving, stopped = last(rig, 20.0)[:, 5]
    assert 0.905 * rise < slow < 1.0 * rise < fast < 1.095 * rise
    assert diving == pytest.approx(-slow, rel=0.01)
    assert stopped == pytest.approx(0.0, abs=2e-4), "not without way on"
    assert tilt_of(rig).max() < 1


def test_full_stern_plane_changes_depth_by_a_metre_in_a_minute():
    rig = set_going(boats(), MADE).tell(Propeller=TOP, SternPlane=FULL)
    assert 0.7 < last(rig, 60.0)[0, 2] - DEEP < 60 * steady_rise(FULL)


def test_a_plate_stalls_and_works_in_both_directions():
    """Thin-plate lift at small angles (Prandtl), a square plate's drag across the flow (Hoerner)."""
    head = WATER_DENSITY / 2 * 2.0**2 * 0.5

    def force(angle):
        return float(plate_force(0.5, math.pi, jnp.float32(2.0), jnp.float32(-2.0 * math.sin(angle))))

    assert force(0.1) == pytest.approx(head * math.pi * 0.1, rel=0.01)
    assert force(-0.1) == -force(0.1)
    assert force(1.0) == force(math.pi / 2) == pytest.approx(head * 1.17, rel=1e-3)
    assert float(plate_force(0.5, math.pi, jnp.float32(0.0), jnp.float32(0.0))) == 0.0


def test_it_rights_itself():
    rig = boats(roll=1.2)
    rig.run(40.0)
    assert tilt_of(rig)[0] < 1


def test_it_lies_on_the_bottom_and_stops_at_walls():
    wall = Shape(kind="box", size=(0.1, 10.0, 10.0), at=(5.0, 0.0, 10.0), surface="wall")
    rig = set_going(boats(1, wall, height=C + 0.5), MADE, rises=[-0.05])
    log = rig.tell(Propeller=TOP, SternPlane=-FULL).run(30.0)
    assert log[:, 2].min() == pytest.approx(C, abs=0.02)
    assert log[:, 0].max() == pytest.approx(5.0 - 0.1 - A, abs=0.05)
    assert tilt_of(rig)[0] < 5
