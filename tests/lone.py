"""One world on C MuJoCo and NumPy: what a world of a batch is compared with, where nothing is compiled."""

import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import numpy_backend
from usarmjx.engines.c.world import CWorld
from usarmjx.sim.control import CommandUpdate, update_command
from usarmjx.sim.radio import update_links
from usarmjx.sim.ray_geometry import moved_geom_poses
from usarmjx.sim.reset import init_world
from usarmjx.sim.world import clock_of, compute_inputs, finish_step, observe


class LoneWorld:
    """World `number` of a scene, with the random numbers that it has in a batch of that seed.

    Attributes:
        scene: Its scene.
        world: Everything but the physics; NumPy's arrays.
    """

    def __init__(self, scene, number=0, seed=0):
        self.scene = scene
        self._indices = {int(s): i for g in scene.groups for s, i in zip(g.slots, g.indices, strict=True)}
        with numpy_backend():
            key = random.fold_in(random.key(seed), number)
            self.world, qpos = init_world(scene, key, np.int32(number))
        self._engine = CWorld(scene.spec, scene.arena, scene.physics.substeps, scene.moved_geoms)
        self._engine.data.qpos[:] = qpos

    @property
    def physics(self):
        """Positions, velocities and activations in single precision."""
        return self._engine.state()

    def drive(self, group, values):
        """Set keys of DRIVE for a group's robots."""
        members = self.world.groups[group]
        with numpy_backend():
            told = update_command(self.scene.groups[group].plan, members.command, CommandUpdate(drive=values))
        self.world = self.world.with_group(group, members.replace(command=told))

    def step(self):
        """Advance by one control step; nothing must go bad."""
        with numpy_backend():
            self.world, inputs = compute_inputs(self.scene, self.world, self.physics)
            self._engine.apply(inputs)
            sound = dict.fromkeys(self._indices, np.inf)
            lost, put_back = self._engine.advance(self._indices, sound, {})
            assert not lost
            assert not put_back
            self.world, _ = finish_step(self.scene, self.world, self.physics, np.int32(lost))

    def observe(self):
        """Read the sensors that are due, by group and sensor."""
        with numpy_backend():
            moved = moved_geom_poses(self.scene, None, clock_of(self.scene, self.world))
            caster = self._engine.caster(self._indices, moved)
            self.world, readings = observe(self.scene, self.world, self.physics, caster)
        return readings

    def links(self):
        """The radio links."""
        with numpy_backend():
            self.world = self.world.replace(links=update_links(self.scene, self.world, self.physics))
        return self.world.links
