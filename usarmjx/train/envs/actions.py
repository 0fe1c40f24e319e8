"""What the robots of one world are told to do for one step of a task."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import jax.numpy as jnp

from usarmjx.base.arrays import Array
from usarmjx.comms.mail import OutgoingMessages
from usarmjx.engines import PhysicsState
from usarmjx.sim.control import ControlMode, move_joints, set_drive
from usarmjx.sim.operate import find_operation, operate
from usarmjx.sim.radio import send
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import World


@dataclass(frozen=True, kw_only=True)
class JointAction:
    """An order to joints of a team's robots, as MULTIDRIVE.

    Attributes:
        group: Index into `scene.teams`.
        targets: Joint names and positions [rad or m], velocities [rad/s or m/s] or torques [N m or N],
            (robots,) each.
        mode: What the numbers are.
    """

    group: int
    targets: Mapping[str, Array]
    mode: ControlMode = ControlMode.POSITION


@dataclass(frozen=True, kw_only=True)
class EffecterAction:
    """An order to an effecter of a team's robots, as SET.

    Attributes:
        group: Index into `scene.teams`.
        name: Name of the effecter.
        opcode: Name of one of its operations.
        where: Which robots shall do it (robots,).
        value: Its parameter (robots,); None: the usual one.
    """

    group: int
    name: str
    opcode: str
    where: Array
    value: Array | None = None


@dataclass(frozen=True, kw_only=True)
class Actions:
    """What the robots of one world are told; what is not named stays as it was.

    Attributes:
        drive: Numbers for keys of DRIVE (robots,), by team [rad/s, m/s or rad].
        joint_actions: Orders to joints.
        effecter_actions: Orders to effecters.
        messages: Messages to send, in worlds with mail; None: none.
    """

    drive: Mapping[int, Mapping[str, Array]] = field(default_factory=dict)
    joint_actions: tuple[JointAction, ...] = ()
    effecter_actions: tuple[EffecterAction, ...] = ()
    messages: OutgoingMessages | None = None


def apply_actions(scene: Scene, world: World, physics: PhysicsState, actions: Actions) -> World:
    """Return one world with the orders given and the letters sent; old mail has been read by now.

    Raises:
        UnknownNameError: A DRIVE key, joint, effecter or operation that the robots do not have.
        UsageError: Letters in a scene without mail.
    """
    for number, values in actions.drive.items():
        team, state = scene.groups[number], world.groups[number]
        shape = state.active.shape
        told = {key: jnp.broadcast_to(value, shape) for key, value in values.items()}
        world = _with_command(world, number, set_drive(team.robot, state.command, told))
    for move in actions.joint_actions:
        team, state = scene.groups[move.group], world.groups[move.group]
        told = {key: jnp.broadcast_to(value, state.active.shape) for key, value in move.targets.items()}
        world = _with_command(world, move.group, move_joints(team.plan, state.command, told, move.mode))
    for one in actions.effecter_actions:
        place, opcode = find_operation(scene.groups[one.group], one.name, one.opcode)
        value = opcode.default_val if one.value is None else one.value
        shape = world.groups[one.group].active.shape
        told = (jnp.broadcast_to(jnp.asarray(value, jnp.float32), shape), jnp.broadcast_to(one.where, shape))
        world, _ = operate(scene, world, physics, (one.group, place), opcode, *told)
    if world.mail is not None:
        world = world.replace(mail=world.mail.replace(count=jnp.zeros_like(world.mail.count)))
    if actions.messages is not None:
        world = world.replace(mail=send(scene, world, actions.messages))
    return world


def _with_command(world: World, group: int, command: object) -> World:
    members = world.groups[group].replace(command=command)
    return world.replace(groups=(*world.groups[:group], members, *world.groups[group + 1 :]))
