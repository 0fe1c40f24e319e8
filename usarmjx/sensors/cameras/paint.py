"""What geoms look like: colours and labels, beside what rays meet."""

from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.models.compile.compose import ARENA_PREFIX as ARENA_NAMES
from usarmjx.models.compile.compose import DOOR_PREFIX, LOOSE_PREFIX, VICTIM_PREFIX
from usarmjx.models.compile.victims import victim_table
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import GLASS, MIRROR

OUTSIDE_LABEL = -1
"""Label of a pixel outside of an omnidirectional camera's mirror."""
SKY_LABEL = 0
"""Label of the sky."""
ARENA_LABEL = 1
"""Label of the floor and of fixed solids."""
LOOSE_LABEL = 2
"""Label of loose objects."""
DOOR_LABEL = 3
"""Label of doors."""
VICTIM_LABEL = 4
"""Label of victims."""
FALSE_ALARM_LABEL = 5
"""Label of body parts that are no victim's."""
WATER_LABEL = 6
"""Label of water, which no pixel has, since it lets light through."""
ROBOT_LABEL = 16
"""Label of the robot in roster slot 0; the robot in slot k has `ROBOT_LABEL` + k."""
PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
INSTANCES = 1 << 16
"""An instance is its class's label times this, plus which one it is of its class; see `instances`."""
MAX_ROBOT_GEOMS = 1 << 16
"""More than any robot has geoms."""
GLASS_TRANSPARENCY = 0.65
"""How much of what is behind it glass shows."""
MIRROR_REFLECTANCE = 0.75
"""How much of what a mirror shows is what it reflects."""
WATER_RGB, WATER_TRANSPARENCY = (0.25, 0.5, 0.65), 0.55


class GeomAppearance(struct.PyTreeNode, kw_only=True):
    """How geoms look, in the order of the blocks of their `Geoms`, one block after the other.

    Attributes:
        rgb: Colours, in [0, 1] (n, 3).
        transparency: Share of what is behind that is seen through them (n,).
        reflectance: Share of what they reflect in how they look (n,).
        label: What they are in a segmentation (n,).
        instance: Which one of its class each belongs to, see `instances` (n,); None: not told apart.
        texture: Codes of what is on them, see `models.spec.textures` (n,); None: nothing is.
        textures: Names of all textures that there are; static.
    """

    rgb: Array
    transparency: Array
    reflectance: Array
    label: Array
    instance: Array | None = None
    texture: Array | None = None
    textures: frozenset[str] = struct.field(pytree_node=False, default=frozenset())


def instances(label: Any, index: Any) -> Any:  # noqa: ANN401 - whole numbers or arrays of them
    """Return the instances of the things of a class (n,) that are the first, the second ... of theirs (n,).

    Robots have the class `ROBOT_LABEL`, and are told apart by their slots. `instance // INSTANCES` gives the
    class back, and `instance % INSTANCES` which one it is.
    """
    return label * INSTANCES + index


def robot_geom_owner(slot: Array, geom: Array) -> Array:
    """Return the owner that tells a robot's geom, by its index in the `KinematicTree`, from all others."""
    return slot * MAX_ROBOT_GEOMS + geom


def camera_owners(owner: Array, slot: Array, hidden_geoms: Array) -> Array:
    """Return the owners (n,) as those see it that look through a camera of the robot in a slot ().

    What its class's camera does not see (`Camera.hidden_geoms`) belongs to the slot; nothing else is owned.
    """
    piece = jnp.append(jnp.asarray(hidden_geoms), False)[
        jnp.clip(owner - slot * MAX_ROBOT_GEOMS, 0, len(hidden_geoms))
    ]
    return jnp.where((owner // MAX_ROBOT_GEOMS == slot) & piece, slot, -1)


def transparencies(material: np.ndarray) -> np.ndarray:
    """Return how much of what is behind things of some materials (n,) show (n,)."""
    return np.array([GLASS_TRANSPARENCY * (name == GLASS) for name in material], np.float32)


def reflectances(material: np.ndarray) -> np.ndarray:
    """Return how much of what things of some materials (n,) look like they reflect (n,)."""
    return np.array([MIRROR_REFLECTANCE * (name == MIRROR) for name in material], np.float32)


def bone_labels(owner: Array, xp: object = np) -> Array:
    """Return the labels of victims' boxes (n,) from their owners in a `VictimTable` (n,)."""
    return xp.where(owner >= 0, VICTIM_LABEL, FALSE_ALARM_LABEL)  # type: ignore[attr-defined]


def labels_of(model: mujoco.MjModel, arena: ArenaSpec) -> np.ndarray:
    """Return the labels of a model's geoms (ngeom,); robots have `ROBOT_LABEL`, whichever they are."""
    bones = bone_labels(victim_table(arena.victims, arena.false_alarms).owner)
    names = [model.geom(i).name for i in range(model.ngeom)]
    known = {f"{VICTIM_PREFIX}{i}": int(label) for i, label in enumerate(bones)} | {"floor": ARENA_LABEL}
    starts = {
        ARENA_NAMES: ARENA_LABEL,
        LOOSE_PREFIX: LOOSE_LABEL,
        DOOR_PREFIX: DOOR_LABEL,
        VICTIM_PREFIX: VICTIM_LABEL,
    }

    def label(name: str) -> int:
        return known.get(name) or next(
            (v for start, v in starts.items() if name.startswith(start)), ROBOT_LABEL
        )

    return np.array([label(name) for name in names], np.int32)
