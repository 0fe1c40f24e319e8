"""CAMERA: the first camera turns by steps, or to angles, as bAbsoluteCamera says (manual 5.2.4, 12.1.2)."""

from dataclasses import replace

import pytest

from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.adapter import package_command, pan_tilt_of
from usarmjx.server.protocol.commands import LinkCommand, MisPkg, TurnCamera

P2AT = ROBOTS.get("P2AT")
STEP, ANGLE, RATE = 10, 0, 1


@pytest.mark.parametrize(
    ("is_absolute", "told", "links"),
    [
        (False, TurnCamera((0.0, 0.1, 0.2)), (LinkCommand(1, -0.2, STEP), LinkCommand(2, 0.1, STEP))),
        (False, TurnCamera((0.0, 0.0, 0.2)), (LinkCommand(1, -0.2, STEP),)),
        (False, TurnCamera((0.0, 0.0, 0.0), fov=1.0), ()),
        (True, TurnCamera((0.0, 0.0, 0.2)), (LinkCommand(1, -0.2, ANGLE), LinkCommand(2, 0.0, ANGLE))),
        (False, TurnCamera((0.0, 0.0, 0.2), RATE), (LinkCommand(1, -0.2, RATE), LinkCommand(2, 0.0, RATE))),
        (True, TurnCamera((0.0, 0.1, 0.0), RATE), (LinkCommand(1, -0.0, RATE), LinkCommand(2, 0.1, RATE))),
    ],
)
def test_pan_is_positive_to_the_right_and_steps_of_nothing_stop_nothing(is_absolute, told, links):
    robot = replace(P2AT, absolute_camera=is_absolute)
    assert package_command(robot, told) == MisPkg("CameraPanTilt", links)


def test_it_is_the_frame_of_the_first_camera_and_no_arm():
    framed = {name for name, robot in ROBOTS if pan_tilt_of(robot)}
    assert {"P2AT", "P2DX", "Hummer", "Zerg"} <= framed
    assert not {"QRIO", "ERS", "Soryu", "ComStation", "Kenaf"} & framed, "a Kenaf's first looks all around"
    assert package_command(ROBOTS.get("QRIO"), TurnCamera((0.0, 0.1, 0.0))) is None
    assert package_command(P2AT, TurnCamera(fov=1.0)) is None
    for name in framed:
        assert {link.number for link in pan_tilt_of(ROBOTS.get(name)).links} == {1, 2}
