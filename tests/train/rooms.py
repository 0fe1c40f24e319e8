"""A room drawn by hand, and what robots in it would report: for tests of team tasks without rays."""

import math
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from tests.train.views import beginning
from usarmjx.comms.links import no_links
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose, Victim
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.base import Reading
from usarmjx.sim.actions import apply_actions
from usarmjx.train.envs.env import command
from usarmjx.train.envs.task import TaskView
from usarmjx.train.tasks.team import scanner_poses

WIDTH, DEPTH = 6.0, 3.0


def linked(steps, *pairs):
    """Links of the base and two robots in all steps (steps, 3, 3)."""
    table = np.zeros((steps, 3, 3), bool)
    for i, j in pairs:
        table[:, i, j] = table[:, j, i] = True
    return table


def room(starts, victims=(), width=WIDTH, depth=DEPTH):
    """A room of that size with robots' start poses x, y and victims' x, y; walls 5 cm thick around it."""
    sides = [
        ((width / 2, 0.0), (width / 2, 0.025)),
        ((width / 2, depth), (width / 2, 0.025)),
        ((0.0, depth / 2), (0.025, depth / 2)),
        ((width, depth / 2), (0.025, depth / 2)),
    ]
    return ArenaSpec(
        name="DM-Room",
        about="A room.",
        shapes=tuple(
            Shape(kind="box", at=(*at, 0.6), size=(*size, 0.6), surface="wall") for at, size in sides
        ),
        starts=tuple(
            StartPose(tag=f"Start{i}", at=(*at, START_ELEVATION), yaw=0.0) for i, at in enumerate(starts)
        ),
        extent=((0.0, width), (0.0, depth)),
        victims=tuple(
            Victim(name=f"Victim{i}", at=(*at, 0.12), posture="sitting") for i, at in enumerate(victims)
        ),
    )


def scan(pose, settings, width=WIDTH, depth=DEPTH):
    """Ranges in an empty rectangle (beams,), by the slab method, at most the scanner's range."""
    x, y, yaw = pose
    angle = yaw - settings.scan_fov / 2 + np.arange(settings.beams) * settings.resolution
    cos, sin = np.cos(angle), np.sin(angle)
    with np.errstate(divide="ignore"):
        along = np.where(cos > 0, (width - x) / cos, np.where(cos < 0, -x / cos, np.inf))
        across = np.where(sin > 0, (depth - y) / sin, np.where(sin < 0, -y / sin, np.inf))
    return np.minimum(np.minimum(along, across), settings.max_range).astype(np.float32)


def begin(task):
    """The scene, and its world and physics at the start."""
    scene = task.scene()
    return scene, *beginning(scene)


def view_of(scene, world, physics, poses, *, linked=None, met=None, step=0):
    """What a task is shown: robots truly at poses x, y, yaw by slot, which their sensors report as well.

    Args:
        scene: The scene.
        world: Its world.
        physics: Its physics; only places and headings are changed.
        poses: By slot (robots, 3).
        linked: Which links hold; None: none.
        met: What victim sensors report, by slot: rows of met, part, x, y, z; None: nothing.
        step: Control step.
    """
    poses, qpos, readings = np.asarray(poses, np.float32), np.array(physics.qpos), []
    for group in scene.groups:
        here = poses[group.slots]
        for address, (x, y, yaw) in zip(group.root_qposadr, here, strict=True):
            qpos[address[:2]] = x, y
            qpos[address[3:]] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)
        values = []
        for sensor in group.suite.sensors:
            if sensor.kind == "RangeScanner":
                places = np.asarray(scanner_poses(group, jnp.asarray(here)))
                value = np.stack([scan(place, sensor.settings[0]) for place in places])
            elif sensor.kind == "VictSensor":
                none = np.zeros((len(here), len(scene.victims.part), 5), np.float32)
                value = none if met is None else np.stack([met[slot] for slot in group.slots])
            else:
                flat = np.zeros((len(here), 2), np.float32)
                up = np.full((len(here), 1), 0.26, np.float32)
                value = np.concatenate([here[:, :2], up, flat, here[:, 2:]], -1)
            fresh = jnp.ones(len(here), bool)
            values.append(Reading(value=jnp.asarray(value, jnp.float32), fresh=fresh))
        readings.append(tuple(values))
    robots = scene.num_robots
    linked = np.zeros((robots, robots), bool) if linked is None else linked
    links = no_links(robots).replace(
        in_range=jnp.asarray(linked),
        paired=jnp.asarray(~np.eye(robots, dtype=bool)),
        delivery_probability=jnp.asarray(linked, jnp.float32),
        evaluated=jnp.ones((), bool),
    )
    world = world.replace(links=links, step=jnp.int32(step))
    physics = physics.replace(qpos=jnp.asarray(qpos, jnp.float32))
    return TaskView(world=world, physics=physics, readings=tuple(readings), scene=scene)


def play(task, paths, linked=None, met=None, choose=None):
    """Yield memory and result of each step of robots on paths (steps, robots, 3), the start's result None.

    Args:
        task: The task; its robots are led, whatever they are told.
        paths: Where they are at the start and after each step.
        linked: Which links hold at each of these times (steps, robots, robots); None: none ever.
        met: What victim sensors report at each of them (steps, robots, boxes, 5); None: nothing.
        choose: Function of view and memory that returns actions, per group (robots, n), by which the task
            decides; None: it decides nothing, and actions are 0.
    """
    (scene, world, physics), start, evaluate, act, decide = _machine(task)
    memory = None
    for step, poses in enumerate(paths):
        now = {"linked": None if linked is None else linked[step], "met": None if met is None else met[step]}
        view = view_of(scene, world, physics, poses, step=step * task.repeat, **now)
        if memory is None:
            memory, result = start(view, jax.random.key(0)), None
        else:
            result = evaluate(view, memory)
            memory = result.memory
        yield view, memory, result
        if choose is None:
            world = act(view, memory)
        else:
            world, memory = decide(view, memory, choose(view, memory))


@cache
def _machine(task):
    """Scene and compiled functions of a task, once for all tests."""
    steps = jax.jit(task.start), jax.jit(task.evaluate), jax.jit(partial(_act, task))
    return begin(task), *steps, jax.jit(partial(_decide, task))


def _decide(task, view, memory, actions):
    """The world and the memory after a task decided by actions."""
    orders, memory = command(task, view, memory, actions)
    return apply_actions(view.scene, view.world, view.physics, orders), memory


def _act(task, view, memory):
    """The world after the messages of a step."""
    sizes, scene = task.action_sizes(view.scene), view.scene
    groups = zip(task.agent_groups(scene), sizes, strict=True)
    still = tuple(jnp.zeros((len(scene.groups[group].slots), size)) for group, size in groups)
    return apply_actions(scene, view.world, view.physics, task.act(view, memory, still))
