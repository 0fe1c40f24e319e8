"""Limits of the keys of DRIVE: each key is limited by itself, whatever the others' values."""

import numpy as np
import pytest

from tests.rig import Rig
from usarmjx.base.backend import numpy_backend
from usarmjx.models.robots import ROBOTS
from usarmjx.sim.control import idle_command, set_drive

TOO_MUCH = 50.0
"""Times the largest value of a key, far beyond what any robot can do."""
SHARE = 0.4
"""Command of every other key, as a share of its largest value."""


def key_sets(drive):
    """Keys that a client may tell together: the drive's own, or the others that it converts."""
    return [keys for keys in (drive.full_scale, drive.other_keys) if len(keys) > 1]


CASES = [
    pytest.param(robot, keys, key, id=f"{name}-{key}")
    for name, robot in ROBOTS
    for keys in key_sets(robot.drive)
    for key in keys
]


def targets_of(robot, values):
    with numpy_backend():
        return np.asarray(set_drive(robot, idle_command(robot), values).setpoint)


def test_every_kind_of_drive_with_several_keys_has_cases():
    kinds = {type(robot.drive).__name__ for _, robot in ROBOTS if len(robot.drive.keys) > 1}
    assert {type(robot.drive).__name__ for _, robot in ROBOTS if key_sets(robot.drive)} == kinds
    assert {"SkidSteer", "Ackermann", "OmniDrive", "RotaryWing", "Underwater", "Blimp"} <= kinds


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("robot", "keys", "key"), CASES)
def test_a_key_told_too_much_is_as_if_told_its_largest_value(robot, keys, key, sign):
    """The oracle is the largest value that CONF and GEO state, `full_scale`; the same bits are due."""
    others = {other: SHARE * most for other, most in keys.items() if other != key}
    wild = targets_of(robot, {key: sign * TOO_MUCH * max(keys[key], 1.0), **others})
    np.testing.assert_array_equal(wild, targets_of(robot, {key: sign * keys[key], **others}))
    if keys == robot.drive.full_scale:
        rest = [robot.drive.keys.index(other) for other in others]
        np.testing.assert_array_equal(wild[rest], np.array([*others.values()], np.float32))


@pytest.mark.parametrize(("robot", "keys", "key"), CASES)
def test_order_of_keys_does_not_matter_to_their_limits(robot, keys, key):
    """The same message with its keys turned round, one of them too large."""
    values = {other: SHARE * most for other, most in keys.items()} | {key: TOO_MUCH * max(keys[key], 1.0)}
    turned = dict(reversed(values.items()))
    np.testing.assert_array_equal(targets_of(robot, values), targets_of(robot, turned))


@pytest.mark.parametrize("ahead", [1.0, TOO_MUCH])
@pytest.mark.parametrize("name", ["Passarola", "AirRobot"])
def test_who_is_told_too_much_ahead_climbs_as_told(name, ahead):
    """Physics too: its governors hold a speed up of 0.4 of the largest at full speed ahead."""
    drive = ROBOTS.get(name).drive
    most = {**drive.full_scale, **drive.other_keys}
    rig = Rig(name, height=5.0)
    rig.tell(LinearVelocity=ahead * most["LinearVelocity"], AltitudeVelocity=SHARE * most["AltitudeVelocity"])
    speed = rig.run(12.0)[-50:, 3:6].mean(0)
    # Hulls in air do not oscillate once their governors hold: 0.2 % was measured.
    np.testing.assert_allclose(
        speed[[0, 2]], [most["LinearVelocity"], SHARE * most["AltitudeVelocity"]], rtol=5e-3
    )
