"""What the robots of one world are told to do for one step of a task."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import jax.numpy as jnp

from usarmjx.base.transforms import Array
from usarmjx.comms.mail import Letters
from usarmjx.engines import PhysicsState
from usarmjx.sim.control import Order, move_joints, steer
from usarmjx.sim.operate import find_operation, operate
from usarmjx.sim.radio import send
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import World


@dataclass(frozen=True, kw_only=True)
class Move:
    """An order to joints of a team's robots, as MULTIDRIVE.

    Attributes:
        team: Index into `scene.teams`.
        targets: Joint names and positions [rad or m], velocities [rad/s or m/s] or torques [N m or N],
            (robots,) each.
        order: What the numbers are.
    """

    team: int
    targets: Mapping[str, Array]
    order: Order = Order.POSITION


@dataclass(frozen=True, kw_only=True)
class Operate:
    """An order to an effecter of a team's robots, as SET.

    Attributes:
        team: Index into `scene.teams`.
        name: Name of the effecter.
        opcode: Name of one of its operations.
        where: Which robots shall do it (robots,).
        value: Its parameter (robots,); None: the usual one.
    """

    team: int
    name: str
    opcode: str
    where: Array
    value: Array | None = None


@dataclass(frozen=True, kw_only=True)
class Orders:
    """What the robots of one world are told; what is not named stays as it was.

    Attributes:
        drive: Numbers for keys of DRIVE (robots,), by team [rad/s, m/s or rad].
        moves: Orders to joints.
        operations: Orders to effecters.
        letters: Messages to send, in worlds with mail; None: none.
    """

    drive: Mapping[int, Mapping[str, Array]] = field(default_factory=dict)
    moves: tuple[Move, ...] = ()
    operations: tuple[Operate, ...] = ()
    letters: Letters | None = None


def carry_out(scene: Scene, world: World, physics: PhysicsState, orders: Orders) -> World:
    """Return one world with the orders given and the letters sent; old mail has been read by now.

    Raises:
        UnknownNameError: A DRIVE key, joint, effecter or operation that the robots do not have.
        UsageError: Letters in a scene without mail.
    """
    for number, values in orders.drive.items():
        team, state = scene.teams[number], world.teams[number]
        shape = state.active.shape
        told = {key: jnp.broadcast_to(value, shape) for key, value in values.items()}
        world = _with_command(world, number, steer(team.robot, state.command, told))
    for move in orders.moves:
        team, state = scene.teams[move.team], world.teams[move.team]
        told = {key: jnp.broadcast_to(value, state.active.shape) for key, value in move.targets.items()}
        world = _with_command(world, move.team, move_joints(team.plan, state.command, told, move.order))
    for one in orders.operations:
        place, opcode = find_operation(scene.teams[one.team], one.name, one.opcode)
        value = opcode.usual if one.value is None else one.value
        shape = world.teams[one.team].active.shape
        told = (jnp.broadcast_to(jnp.asarray(value, jnp.float32), shape), jnp.broadcast_to(one.where, shape))
        world, _ = operate(scene, world, physics, (one.team, place), opcode, *told)
    if world.mail is not None:
        world = world.replace(mail=world.mail.replace(count=jnp.zeros_like(world.mail.count)))
    if orders.letters is not None:
        world = world.replace(mail=send(scene, world, orders.letters))
    return world


def _with_command(world: World, team: int, command: object) -> World:
    members = world.teams[team].replace(command=command)
    return world.replace(teams=(*world.teams[:team], members, *world.teams[team + 1 :]))
