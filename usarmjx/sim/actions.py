"""Commands to the robots of one world as one value, and the function that applies them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from usarmjx.base.backend import Array, ArrayLike, named_scope, xp
from usarmjx.comms.mail import OutgoingMessages
from usarmjx.engines.base import PhysicsState
from usarmjx.sim.control import CommandUpdate, ControlMode, update_command
from usarmjx.sim.operate import EffecterCommand, find_operation, operate
from usarmjx.sim.radio import send
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import World


@dataclass(frozen=True, kw_only=True)
class JointAction:
    """An order to joints of a group's robots, as MULTIDRIVE.

    Attributes:
        group: Index into `scene.groups`.
        targets: Joint names and positions [rad or m], velocities [rad/s or m/s] or torques [N m or N],
            (robots,) each.
        mode: Control mode of the targets.
    """

    group: int
    targets: Mapping[str, Array]
    mode: ControlMode = ControlMode.POSITION


@dataclass(frozen=True, kw_only=True)
class EffecterAction:
    """An order to an effecter of a group's robots, as SET.

    Attributes:
        group: Index into `scene.groups`.
        name: Name of the effecter.
        opcode: Name of one of its operations.
        where: Mask of the robots that carry it out (robots,).
        value: Its parameter (robots,); None: the usual one.
    """

    group: int
    name: str
    opcode: str
    where: ArrayLike = True
    value: ArrayLike | None = None


@dataclass(frozen=True, kw_only=True)
class Actions:
    """Commands to the robots of one world; a setpoint that is not named keeps its value.

    Attributes:
        drive: Numbers for keys of DRIVE (robots,), by group [rad/s, m/s or rad].
        joint_actions: Orders to joints.
        effecter_actions: Orders to effecters.
        messages: Messages to send, in worlds with mail; None: none.
    """

    drive: Mapping[int, Mapping[str, Array]] = field(default_factory=dict[int, Mapping[str, Array]])
    joint_actions: tuple[JointAction, ...] = ()
    effecter_actions: tuple[EffecterAction, ...] = ()
    messages: OutgoingMessages | None = None


@named_scope("apply_actions")
def apply_actions(
    scene: Scene,
    world: World,
    physics: PhysicsState,
    actions: Actions,
    where: Array | None = None,
    *,
    all_send: bool = False,
) -> World:
    """Return one world with the orders given and the messages sent; old mail has been read by now.

    Args:
        scene: The scene.
        world: One world.
        physics: Its physics.
        actions: Commands to its robots.
        where: Mask of the robots that receive them, by slot (robots,); None: all.
        all_send: Let the others send their messages all the same.

    Raises:
        UnknownNameError: A DRIVE key, joint, effecter or operation that the robots do not have.
        UsageError: Messages in a scene without mail, or an operation that needs a parameter.
    """
    # In this order, so that orders to single joints and effecters win over DRIVE.
    for index, values in actions.drive.items():
        world = _update(scene, world, index, CommandUpdate(drive=values), where)
    for joints in actions.joint_actions:
        update = CommandUpdate(joints=joints.targets, mode=joints.mode)
        world = _update(scene, world, joints.group, update, where)
    for effecter in actions.effecter_actions:
        world = _operate(scene, world, physics, effecter, where)
    # Before new messages are sent, which may arrive in this step.
    if world.mail is not None:
        world = world.replace(mail=world.mail.replace(count=xp.zeros_like(world.mail.count)))
    messages = actions.messages
    if messages is not None:
        if where is not None and not all_send:
            # Rows are senders: those that receive no orders send nothing.
            messages = messages.replace(receivers=messages.receivers & where[:, None])
        world = world.replace(mail=send(scene, world, messages))
    return world


def _operate(
    scene: Scene, world: World, physics: PhysicsState, action: EffecterAction, where: Array | None
) -> World:
    group = scene.groups[action.group]
    effecter, opcode, value = find_operation(group, action.name, action.opcode, action.value)
    shape = world.groups[action.group].active.shape
    value = xp.broadcast_to(xp.asarray(value, xp.float32), shape)
    mask = xp.broadcast_to(action.where, shape)
    if where is not None:
        mask = mask & where[group.slots]
    order = EffecterCommand(group=action.group, effecter=effecter, opcode=opcode, value=value, where=mask)
    # The result is an answer for clients, which policies do not read.
    return operate(scene, world, physics, order)[0]


def _update(scene: Scene, world: World, index: int, update: CommandUpdate, where: Array | None) -> World:
    group, state = scene.groups[index], world.groups[index]
    mask = None if where is None else where[group.slots]
    command = update_command(group.plan, state.command, update, mask)
    return world.with_group(index, state.replace(command=command))
