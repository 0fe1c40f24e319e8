"""What worlds of batches were made of, and what their robots have been told."""

from typing import Any

import jax
import numpy as np

from usarmjx.recording.inputs import WorldSetup
from usarmjx.recording.versions import versions
from usarmjx.sim.batch import Batch
from usarmjx.sim.world import GroupState

ORDER_FIELDS = ("command", "active", "battery_start", "drowned")
"""Fields of a `GroupState` by which worlds of a batch are told what to do."""


def batch_setup(batch: Batch, number: int, steps_before: int) -> WorldSetup:
    """Return what a batch was made of, of which one world is recorded.

    Args:
        batch: The batch.
        number: Index of the world.
        steps_before: Control steps made so far.
    """
    scene = batch.scene
    seed, first, shuffle = batch.origin
    return WorldSetup(
        kind=batch.engine.name,
        arenas=(scene.arena,) if scene.arenas is None else tuple(scene.arenas.arenas),
        physics=scene.physics,
        roster=scene.roster,
        radio=scene.radio,
        mail=scene.mail,
        vary=scene.vary,
        shuffle=shuffle,
        seed=seed,
        first=first,
        number=number,
        worlds=batch.worlds,
        steps_before=steps_before,
        versions=versions(),
    )


def orders_of(state: GroupState, world: int) -> dict[str, Any]:
    """Return what a group's robots of a world of a batch have been told; leading axis over robots.

    Args:
        state: The group in all worlds (worlds, robots, ...).
        world: Index of the world.
    """
    return {name: jax.tree.map(lambda x: np.asarray(x)[world], getattr(state, name)) for name in ORDER_FIELDS}
