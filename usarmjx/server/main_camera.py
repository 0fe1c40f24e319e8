"""CAMERA, which V3.1.3 names (12.1.2, 14.4.3) and does not describe: it turns the first camera."""

from usarmjx.models.build.parts import part_name
from usarmjx.models.spec.robot import MissionPackage, RobotSpec
from usarmjx.server.protocol.commands import LinkCommand, MisPkg, TurnCamera

PAN_LINK, TILT_LINK = 1, 2
"""The links of a pan-tilt frame."""
RELATIVE_ANGLE = 10
"""The order that adds to the present angle (KRobot.uc)."""


def pan_tilt_of(robot: RobotSpec) -> MissionPackage | None:
    """Return the pan-tilt frame that carries a robot's first camera; None: it has none such."""
    for package in robot.packages:
        parts = {part_name(package, link) for link in package.links}
        is_frame = {link.number for link in package.links} == {PAN_LINK, TILT_LINK}
        if is_frame and robot.cameras and robot.cameras[0].parent in parts:
            return package
    return None


def package_command(robot: RobotSpec, command: TurnCamera) -> MisPkg | None:
    """Return the MISPKG that turns a robot's first camera as a CAMERA says; None: nothing does.

    Angles are relative unless bAbsoluteCamera is True; what shall not turn goes on as it does.
    """
    frame = pan_tilt_of(robot)
    if frame is None or command.rotation is None:
        return None
    _, tilt, pan = command.rotation
    is_relative = command.order == 0 and not robot.absolute_camera
    order = RELATIVE_ANGLE if is_relative else command.order
    turns = (
        (PAN_LINK, -pan),
        (TILT_LINK, tilt),
    )  # yaw is positive to the right on the wire, link 1 to the left
    links = tuple(LinkCommand(link, turn, order) for link, turn in turns if turn or not is_relative)
    return MisPkg(frame.name, links)
