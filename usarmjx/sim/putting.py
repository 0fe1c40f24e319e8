"""Robots of a batch that are put somewhere while it runs."""

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.sim.batch import Batch
from usarmjx.sim.batch_state import BatchState


def put_robot(batch: Batch, state: BatchState, world: int, slot: int, pos: Array, quat: Array) -> BatchState:
    """Return a batch with a robot put somewhere, at rest; its joints stay as they are.

    Args:
        batch: The batch.
        state: Its state.
        world: Index of the world.
        slot: Slot of the robot.
        pos: Where its chassis' origin shall be [m] (3,).
        quat: How it shall be turned (4,).
    """
    scene = batch.scene
    group, member = scene.group_of(slot)
    index = scene.groups[group].indices[member]
    shape = batch.worlds, scene.model.nq
    pinned, qpos = np.zeros(shape, bool), np.zeros(shape, np.float32)
    pinned_dof = np.zeros((batch.worlds, scene.model.nv), bool)
    root = slice(index.root_qposadr, index.root_qposadr + 7)
    pinned[world, root], qpos[world, root] = True, (*pos, *quat)
    pinned_dof[world, index.root_dofadr : index.root_dofadr + 6] = True
    return state.replace(physics=batch.engine.set_qpos(state.physics, pinned, pinned_dof, qpos))
