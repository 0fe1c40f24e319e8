"""Views of one world made by hand: robots where a test puts them, sensors that tell what it says."""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import numpy_backend
from usarmjx.base.transforms import quat_from_angles
from usarmjx.engines import PhysicsState
from usarmjx.sensors.base import Reading
from usarmjx.sim.reset import init_world
from usarmjx.train.envs.task import TaskView


def beginning(scene):
    """World and physics of a scene as they start, made on NumPy: JAX would compile every operation."""
    sites = None if scene.arenas is None else scene.arenas.states
    with numpy_backend():
        world, qpos = jax.device_put(init_world(scene, random.key(0), np.int32(0), sites))
    world = world.replace(key=jax.random.wrap_key_data(world.key))
    model = scene.model
    return world, PhysicsState(qpos=qpos, qvel=jnp.zeros(model.nv), act=jnp.zeros(model.na))


def view_of(task, scene=None):
    """A world of a task as it starts."""
    scene = scene or task.scene()
    world, physics = beginning(scene)
    return TaskView(world=world, physics=physics, readings=(), scene=scene)


def placed(view, *poses, group=0):
    """The same view with a group's robots at x, y, z, roll, pitch, yaw."""
    qpos = view.physics.qpos
    for address, (x, y, z, *turn) in zip(view.scene.groups[group].root_qposadr, poses, strict=True):
        qpos = qpos.at[address].set(jnp.array([x, y, z, *np.asarray(quat_from_angles(*turn))], jnp.float32))
    return view.replace(physics=view.physics.replace(qpos=qpos))


def told(view, group=0, **values):
    """The same view with what a group's sensors told, by type; others told nothing that is right."""
    suite = view.scene.groups[group].suite
    known = {suite.index(kind): jnp.asarray(value, jnp.float32) for kind, value in values.items()}
    fresh = jnp.ones(len(view.scene.groups[group].slots), bool)
    readings = tuple(Reading(value=known.get(i), fresh=fresh) for i in range(len(suite.sensors)))
    return view.replace(readings=(readings,))
