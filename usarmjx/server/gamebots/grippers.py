"""Grippers as the later versions have them, open or closed: their orders and reports (Gripper.uc).

ACT {Name TalonArm} {Gripper 1}                             closes those on a package, or of that name
SET {Type Gripper} {Name Gripper} {Opcode Grip} {Params 0}  opens it; also {Opcode Open}, {Opcode Close}
EFF {Type Gripper} {Name Gripper} {Status OPEN}             at every report
"""

from collections.abc import Iterator

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.settings import Parameters, Setting
from usarmjx.models.compile.parts import part_name, parts_of
from usarmjx.models.effecters import Gripper, Vacuum
from usarmjx.server.protocol.arguments import read_parameters
from usarmjx.server.protocol.commands import Set
from usarmjx.server.protocol.grammar import Message
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.sim.control import ControlMode

CLOSED_TOLERANCE = 1e-4
"""Largest target of a closed finger beyond the smallest one [rad or m]."""
_GRIP = Parameters(1, 1, Setting(ge=0.0, le=1.0))


def grippers_of(robot: Robot, name: str) -> Iterator[int]:
    """Yield the indices of the grippers of that name, or on a link of the package of that name."""
    packages = [package for package in robot.spec.packages if package.name.lower() == name.lower()]
    parts = {part_name(package, link) for package in packages for link in package.links}
    for index, effecter in enumerate(robot.effecters):
        mount = effecter.mount
        is_meant = mount.name.lower() == name.lower() or mount.parent in parts
        if is_meant and isinstance(effecter, Gripper | Vacuum):
            yield index


def grip(world: ServedWorld, robot: Robot, index: int, *, closes: bool) -> str:
    """Close a gripper, or open it as far as it can; return the Status of RES."""
    effecter = robot.effecters[index]
    is_vacuum = isinstance(effecter, Vacuum)
    opcode = effecter.opcode("Grip" if is_vacuum else "Open")
    assert opcode is not None
    # A vacuum sucks at its largest value, fingers close at their smallest.
    return world.operate(robot, index, opcode, opcode.max_val if closes == is_vacuum else opcode.min_val)


def binary_order(command: Set) -> bool | None:
    """Return whether a SET closes a gripper; None if it is none of the later versions' orders.

    Raises:
        PeerError: Grip has not exactly one number from 0 to 1.
    """
    opcode = command.opcode.lower()
    if opcode == "grip":
        (value,) = read_parameters(command.params, _GRIP)
        return value != 0.0
    if opcode == "close":
        return True
    # With a number Open is the manual's own operation, by the angle between the fingers (11.1.1).
    return False if opcode == "open" and not command.params else None


def gripper_reports(world: ServedWorld, robot: Robot) -> list[Message]:
    """Return a report of each gripper by its present order."""
    messages: list[Message] = []
    with numpy_backend():
        for index, effecter in enumerate(robot.effecters):
            if isinstance(effecter, Gripper | Vacuum):
                is_vacuum = isinstance(effecter, Vacuum)
                is_closed = world.sucks(robot, index) if is_vacuum else _is_closed(robot, effecter)
                # A vacuum reports as a Gripper, too: clients of the later versions know only that type.
                head = ("Type", Gripper.kind), ("Name", effecter.mount.name)
                messages.append(Message("EFF", (*head, ("Status", "CLOSED" if is_closed else "OPEN"))))
    return messages


def _is_closed(robot: Robot, gripper: Gripper) -> bool:
    """Return whether a gripper is ordered to close, whatever its fingers hold."""
    command, least = robot.command, np.asarray(gripper.settings.min_angle)
    for part in parts_of(robot.spec):
        if part.name in gripper.joints:
            joint = robot.plan.joint_index(part.name)
            assert joint is not None
            closed = float(gripper.joint_target(part, least)) + CLOSED_TOLERANCE
            # The order decides, not the measured angle: fingers around a thick object never reach the closed
            # angle.
            if command.mode[joint] != ControlMode.POSITION or command.target[joint] > closed:
                return False
    return True
