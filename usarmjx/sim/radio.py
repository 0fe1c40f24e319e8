"""The radio of a world: its links, and messages over them. Pure functions."""

from functools import partial

import jax
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, ArrayLike, Part, named_scope, on_numpy, set_rows, vmap, xp
from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.comms.attenuation import AnyRadioSettings, RadioSettings, WorldRadioSettings
from usarmjx.comms.links import Links, antenna_positions, drop_old_events, evaluate_links, is_due
from usarmjx.comms.mail import BYTES_PER_NUMBER, Inboxes, MessageSettings, OutgoingMessages, deliver
from usarmjx.comms.walls import add_boxes, arena_solids, bare_floor
from usarmjx.engines.base import PhysicsState
from usarmjx.models.compile.compose import door_boxes
from usarmjx.models.types.shapes import SKY
from usarmjx.sensors.rays.targets import Geoms
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import Stream, World, clock_of, episode_key, robot_states


def radio_of(scene: Scene) -> RadioSettings:
    """Return the radio of a scene.

    Raises:
        UsageError: It has none.
    """
    if scene.radio is None:
        raise UsageError("this scene has no radio: give build_scene a radio=RadioSettings(...)")
    return scene.radio


def world_radio(scene: Scene, world: World) -> AnyRadioSettings:
    """Return the constants of a world's radios.

    Raises:
        UsageError: The scene has no radio.
    """
    usual, varied = radio_of(scene), world.varied
    if varied is None:
        return usual
    drawn = {name: getattr(varied, f"radio_{name}") for name in ("pdo", "n", "cutoff", "atten_fac")}
    # Constants that do not vary stay plain numbers, which XLA folds into the program.
    if all(value is None for value in drawn.values()):
        return usual
    own = {name: getattr(usual, name) if value is None else value for name, value in drawn.items()}
    same = {name: getattr(usual, name) for name in ("do", "max_obs", "shadowing", "loss_band")}
    return WorldRadioSettings(**own, **same)


def mail_of(scene: Scene) -> MessageSettings:
    """Return the mail of a scene.

    Raises:
        UsageError: It has none.
    """
    if scene.mail is None:
        raise UsageError("this scene has no mail: give build_scene a mail=MessageSettings(...)")
    return scene.mail


def robot_antennas(scene: Scene, world: World, physics: PhysicsState) -> tuple[Array, Array]:
    """Return positions of the robots' antennas [m] (robots, 3) and the robots in use (robots,), by slot.

    A robot whose battery is empty still has its radio, as with the in-engine server; a parked one has not.
    """
    places, in_use = list[Part](), list[Part]()
    for group, state in zip(scene.groups, world.groups, strict=True):
        robots = robot_states(group, physics)
        here = antenna_positions(group.robot, robots.pos, robots.quat, scene.arena.floor)
        places.append((group.slots, here))
        in_use.append((group.slots, state.active))
    n = scene.num_robots
    return set_rows(xp.zeros((n, 3)), *places), set_rows(xp.zeros(n, bool), *in_use)


def link_interval(scene: Scene) -> int:
    """Return the number of control steps between two evaluations of the links."""
    # A period shorter than a control step means every step.
    return max(1, round(radio_of(scene).period / scene.physics.period))


def links_due(scene: Scene, world: World) -> Array:
    """Return whether the links are to be evaluated again ()."""
    return is_due(_links(world), world.step, link_interval(scene))


def last_links(world: World) -> Links:
    """Return the links as they were last."""
    return drop_old_events(_links(world), world.step)


def radio_obstacles(scene: Scene, world: World, physics: PhysicsState) -> Geoms:
    """Return the present obstacles of links: the arena's solids, and doors in their positions."""
    if world.arena_state is None:
        doors = door_boxes(scene.arena, physics.qpos[scene.door_qpos], xp)
        return add_boxes(arena_solids(scene.arena), *doors)
    # Solids of an arena set stand on its floor: z is lifted to that of the scene.
    arena, lift = world.arena_state, xp.array([0.0, 0.0, scene.arena.floor])
    # The template's last boxes are for victims, which do not attenuate.
    shapes = scene.arena.shapes[: len(arena.pos)]
    walls = np.array([i for i, shape in enumerate(shapes) if shape.material != SKY], int)
    pos, mat = arena.pos[walls] + lift, mat_from_quat(arena.quat[walls])
    return add_boxes(arena_solids(bare_floor(scene.arena)), pos, mat, arena.size[walls])


@named_scope("update_links")
def update_links(scene: Scene, world: World, physics: PhysicsState) -> Links:
    """Return the links as they are now if they are due, else as they were last."""
    due = links_due(scene, world)
    if on_numpy() and not due:
        return last_links(world)
    places, in_use = robot_antennas(scene, world, physics)
    key, walls = episode_key(world, Stream.RADIO), radio_obstacles(scene, world, physics)
    now = evaluate_links(world_radio(scene, world), walls, (places, in_use), _links(world), key, world.step)
    if on_numpy():
        return now
    # Under `vmap` worlds may be due at different times, since each counts from its own reset.
    return jax.tree.map(lambda new, old: xp.where(due, new, old), now, last_links(world))


def update_links_of_worlds(scene: Scene, worlds: World, physics: PhysicsState) -> Links:
    """Return the links of all worlds (worlds, ...); where none are due, nothing is evaluated."""
    update, keep = vmap(partial(update_links, scene)), vmap(last_links)
    if link_interval(scene) == 1:
        return update(worlds, physics)
    # One condition for all worlds: within `vmap` a condition becomes a select, which evaluates both branches.
    due = vmap(partial(links_due, scene))(worlds).any()
    return jax.lax.cond(due, update, lambda worlds, _: keep(worlds), worlds, physics)


def mailboxes(scene: Scene, world: World) -> Inboxes:
    """Return the robots' boxes.

    Raises:
        UsageError: The scene has no mail.
    """
    mail_of(scene)
    assert world.mail is not None  # as the scene has mail
    return world.mail


def outgoing_messages(
    scene: Scene, worlds: tuple[int, ...], to: ArrayLike, payload: ArrayLike, length: ArrayLike | None = None
) -> OutgoingMessages:
    """Return messages from all robots.

    Args:
        scene: The scene.
        worlds: Leading axes.
        to: Receivers, sender by row, broadcast to (*worlds, robots, robots).
        payload: Numbers to send, broadcast to (*worlds, robots, numbers).
        length: Size of each message [bytes], broadcast to (*worlds, robots); None: 4 a number.

    Raises:
        UsageError: The scene has no mail.
    """
    mail, shape = mail_of(scene), (*worlds, scene.num_robots)
    size = BYTES_PER_NUMBER * mail.numbers if length is None else length
    return OutgoingMessages(
        receivers=xp.broadcast_to(to, (*shape, scene.num_robots)),
        payload=xp.broadcast_to(xp.asarray(payload, xp.float32), (*shape, mail.numbers)),
        size_bytes=xp.broadcast_to(size, shape),
    )


@named_scope("send_messages")
def send(scene: Scene, world: World, messages: OutgoingMessages) -> Inboxes:
    """Return the boxes after everyone's message went to its receivers, as far as links hold."""
    mail = mailboxes(scene, world)
    # The count tells apart messages that are sent within one step.
    key = random.fold_in(episode_key(world, Stream.MAIL), mail.sent.sum())
    return deliver(mail_of(scene), mail, messages, _links(world), clock_of(scene, world), key)


def _links(world: World) -> Links:
    assert world.links is not None  # the scene has a radio
    return world.links
