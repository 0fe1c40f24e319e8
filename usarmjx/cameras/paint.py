"""What geoms look like: colours and labels, beside what rays meet."""

import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.transforms import Array
from usarmjx.models.build.compose_arena import ARENA as ARENA_NAMES
from usarmjx.models.build.compose_arena import BONE, DOOR, LOOSE
from usarmjx.models.build.victims import victim_table
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import GLASS, MIRROR

OUTSIDE, SKY_LABEL, ARENA, LOOSE_OBJECT, DOOR_LABEL, VICTIM, FALSE_ALARM, WATER = range(-1, 7)
"""What a pixel of a segmentation shows: nothing, since it is outside of an omnidirectional camera's mirror;
the sky; floor and fixed solids; a loose object; a door; a victim; a body part that is no victim's; water,
which no pixel has, since it lets light through."""
ROBOT = 16
"""The robot in roster slot k has the label `ROBOT` + k."""
PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
PIECES = 1 << 16
"""More than any robot has geoms."""
NOBODY = -2
"""A viewer to whom every geom is visible."""
CLEAR = 0.65
"""How much of what is behind it glass shows."""
GLOSS = 0.75
"""How much of what a mirror shows is what it reflects."""
WATER_RGB, WATER_CLEAR = (0.25, 0.5, 0.65), 0.55


class Paint(struct.PyTreeNode, kw_only=True):
    """How geoms look, in the order of the blocks of their `Geoms`, one block after the other.

    Attributes:
        rgb: Colours, in [0, 1] (n, 3).
        clear: Share of what is behind that is seen through them (n,).
        gloss: Share of what they reflect in how they look (n,).
        label: What they are in a segmentation (n,).
    """

    rgb: Array
    clear: Array
    gloss: Array
    label: Array


def piece_of(slot: Array, piece: Array) -> Array:
    """Return the owner that tells a robot's geom, by its place in the class's `BodyPlan`, from all others."""
    return slot * PIECES + piece


def hidden(owner: Array, slot: Array, hides: Array) -> Array:
    """Return the owners (n,) as those see it that look through a camera of the robot in a slot ().

    What its class's camera does not see (`Camera.hides`) belongs to the slot; nothing else belongs to anyone.
    """
    piece = jnp.append(jnp.asarray(hides), False)[jnp.clip(owner - slot * PIECES, 0, len(hides))]
    return jnp.where((owner // PIECES == slot) & piece, slot, -1)


def clears(material: np.ndarray) -> np.ndarray:
    """Return how much of what is behind things of some materials (n,) show (n,)."""
    return np.array([CLEAR * (name == GLASS) for name in material], np.float32)


def glosses(material: np.ndarray) -> np.ndarray:
    """Return how much of what things of some materials (n,) look like they reflect (n,)."""
    return np.array([GLOSS * (name == MIRROR) for name in material], np.float32)


def bone_labels(owner: Array, xp: object = np) -> Array:
    """Return the labels of victims' boxes (n,) from their owners in a `VictimTable` (n,)."""
    return xp.where(owner >= 0, VICTIM, FALSE_ALARM)  # type: ignore[attr-defined]


def labels_of(model: mujoco.MjModel, arena: ArenaSpec) -> np.ndarray:
    """Return the labels of a model's geoms (ngeom,); robots have `ROBOT`, whichever they are."""
    bones = bone_labels(victim_table(arena.victims, arena.false_alarms).owner)
    names = [model.geom(i).name for i in range(model.ngeom)]
    known = {f"{BONE}{i}": int(label) for i, label in enumerate(bones)} | {"floor": ARENA}
    starts = {ARENA_NAMES: ARENA, LOOSE: LOOSE_OBJECT, DOOR: DOOR_LABEL, BONE: VICTIM}

    def label(name: str) -> int:
        return known.get(name) or next((v for start, v in starts.items() if name.startswith(start)), ROBOT)

    return np.array([label(name) for name in names], np.int32)
