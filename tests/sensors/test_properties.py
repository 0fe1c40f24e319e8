"""What holds of sensors' formulas and rays whatever their settings."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from usarmjx.sensors.gps import MAX_SATELLITES, MIN_FIX_SATELLITES, GpsSettings, largest_error
from usarmjx.sensors.ranging import (
    Scanner3DSettings,
    ScannerSettings,
    beam_directions,
    fan_directions,
    grid_directions,
)
from usarmjx.sensors.rfid import RfidSettings, signal_strength
from usarmjx.sensors.touch import button_ray_origins
from usarmjx.sensors.victim import VictSensorSettings, human_motion_probability, shifted_grids

UNIT = 1e-6  # of a float32 vector's length
ANGLE = 1e-3  # rad: of an arc cosine of float32 near 1
usual = settings(deadline=None)
positive = st.floats(1e-3, 1e3)


def tilt(lines):
    """Angle of unit vectors to the x axis [rad]."""
    return np.arccos(np.clip(lines[..., 0], -1.0, 1.0))


@usual
@given(angle=st.floats(0.0, math.pi))
def test_a_beams_lines_fill_its_cone_evenly(angle):
    lines = beam_directions(angle)
    np.testing.assert_allclose(np.linalg.norm(lines, axis=-1), 1.0, atol=UNIT)
    assert len(lines) >= 9
    assert tilt(lines).max() <= angle / 2 + ANGLE
    np.testing.assert_allclose(lines.sum(0)[1:], 0.0, atol=1e-5)  # no side is preferred


@usual
@given(fov=st.floats(0.02, 2 * math.pi), resolution=st.floats(0.005, 3.0), yaw=st.booleans())
def test_a_scans_beams_lie_in_its_plane_a_step_apart_and_within_its_field_of_view(fov, resolution, yaw):
    mine = ScannerSettings(scan_fov=fov, resolution=resolution, yaw=yaw, pitch=not yaw)
    lines = fan_directions(mine)
    assert len(lines) == mine.beams
    assert not lines[:, 2 if yaw else 1].any()
    angle = np.unwrap(np.arctan2(lines[:, 1 if yaw else 2], lines[:, 0]))
    np.testing.assert_allclose(np.diff(angle), resolution, atol=1e-4)
    assert angle[-1] - angle[0] <= fov + 1e-3 * resolution + 1e-4
    assert fov - (angle[-1] - angle[0]) < resolution + 1e-4


@usual
@given(vertical=st.floats(0.05, math.pi), horizontal=st.floats(0.05, 2 * math.pi), step=st.floats(0.05, 0.5))
def test_a_3d_scan_has_as_many_lines_as_its_shape_says_all_of_length_one(vertical, horizontal, step):
    mine = Scanner3DSettings(
        vertical_fov=vertical, horizontal_fov=horizontal, vertical_resolution=step, horizontal_resolution=step
    )
    lines = grid_directions(mine)
    assert lines.shape == (*mine.shape, 3)
    np.testing.assert_allclose(np.linalg.norm(lines, axis=-1), 1.0, atol=UNIT)
    assert (np.diff(lines[..., 2], axis=0) < UNIT).all(), "rows go down"


@usual
@given(horizontal=st.floats(0.1, 3.0), vertical=st.floats(0.1, 3.0), step=st.floats(0.05, 0.5))
def test_the_grids_of_a_victim_sensor_stay_in_its_field_of_view(horizontal, vertical, step):
    mine = VictSensorSettings(
        horizontal_fov=horizontal, vertical_fov=vertical, horizontal_step=step, vertical_step=step
    )
    first, *_ = every = shifted_grids(mine)
    assert len(first) > 0
    for lines in filter(len, every):  # a grid that is shifted by more than the field of view has none
        np.testing.assert_allclose(np.linalg.norm(lines, axis=-1), 1.0, atol=UNIT)
        assert np.abs(np.arctan2(lines[:, 1], lines[:, 0])).max() <= horizontal / 2 + ANGLE
        assert np.abs(np.arcsin(np.clip(lines[:, 2], -1, 1))).max() <= vertical / 2 + ANGLE


@usual
@given(diameter=st.floats(1e-3, 1.0))
def test_a_buttons_lines_stand_on_it(diameter):
    spots = button_ray_origins(diameter)
    assert np.hypot(spots[:, 1], spots[:, 2]).max() <= diameter / 2 * (1 + 1e-5)
    np.testing.assert_allclose(spots[:, 1:].sum(0), 0.0, atol=1e-5)


@usual
@given(
    power=st.floats(-100, 100),
    loss=st.floats(0, 50),
    distances=st.tuples(st.floats(2e-3, 1e3), st.floats(2e-3, 1e3)),
)
def test_a_tags_signal_falls_with_the_distance_and_by_one_obstacle_at_most(power, loss, distances):
    mine = RfidSettings(tx_power_dbm=power, obstacle_attenuation_db=loss)
    near, far = sorted(distances)
    free = [float(signal_strength(mine, np.float64(d), np.bool_(False), np)) for d in (near, far)]
    assert free[0] >= free[1]
    behind = float(signal_strength(mine, np.float64(near), np.bool_(True), np))
    assert math.isclose(free[0] - behind, loss, abs_tol=1e-9)
    # Twice the distance costs 12 dB there and back: 2 * 20 log10 2 (manual 10.9.3.3).
    twice = float(signal_strength(mine, np.float64(2 * near), np.bool_(False), np))
    assert math.isclose(free[0] - twice, 40 * math.log10(2), abs_tol=1e-9)


@usual
@given(distance=st.floats(0, 1e3), speed=st.floats(0, 100), swing=st.floats(0, 10), more=positive)
def test_a_motions_probability_is_one_and_grows_with_what_it_depends_on(distance, speed, swing, more):
    def likely(*what):
        return float(human_motion_probability(*map(np.float64, what), np))

    here = likely(distance, speed, swing)
    assert 0.0 <= here <= 1.0
    assert likely(distance + more, speed, swing) <= here
    assert likely(distance, speed + more, swing) >= here
    assert likely(distance, speed, swing + more) >= here


@usual
@given(
    least=st.floats(0, 10), span=st.floats(0, 10), satellites=st.integers(MIN_FIX_SATELLITES, MAX_SATELLITES)
)
def test_a_positions_error_lies_between_its_limits(least, span, satellites):
    mine = GpsSettings(min_noise=least, max_noise=least + span)
    error = largest_error(mine, satellites)
    assert least - 1e-9 <= error <= least + span + 1e-9
    assert largest_error(mine, MIN_FIX_SATELLITES) >= error >= largest_error(mine, MAX_SATELLITES) - 1e-9
