"""Appearance of geoms: colours, transparency, and segmentation labels."""

from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.base.nodes import Node
from usarmjx.models.compile.compose import ARENA_PREFIX as ARENA_NAMES
from usarmjx.models.compile.compose import DOOR_PREFIX, LOOSE_PREFIX, VICTIM_PREFIX
from usarmjx.models.compile.victims import victim_table
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import GLASS, MIRROR

OUTSIDE_LABEL = -1
"""Segmentation labels: outside of an omnidirectional camera's mirror; sky; floor and fixed solids; loose
object; door; victim; body part of no victim; water (on no pixel, as it is transparent)."""
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
"""Label of the robot in slot 0; that in slot k has `ROBOT_LABEL` + k."""
PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
"""MuJoCo's plane type."""
INSTANCES = 1 << 16
"""Instance numbers per class: an instance is its class's label times this, plus its number; see `instances`.
"""
MAX_ROBOT_GEOMS = 1 << 16
"""Upper bound of a robot's number of geoms."""
GLASS_TRANSPARENCY = 0.65
"""Share of the background seen through glass."""
MIRROR_REFLECTANCE = 0.75
"""Share of the reflection in a mirror's colour."""
WATER_RGB, WATER_TRANSPARENCY = (0.25, 0.5, 0.65), 0.55
"""Colour of water, and share of the background seen through it."""


class GeomAppearance(Node, kw_only=True):
    """Appearance of geoms, in the order of the blocks of their `Geoms`.

    Attributes:
        rgb: Colours, in [0, 1] (n, 3).
        transparency: Share of the background seen through them (n,).
        reflectance: Share of the reflection in their colour (n,).
        label: Segmentation labels (n,).
        instance: Instances, see `instances` (n,); None: not distinguished.
        texture: Texture codes, see `models.types.shapes` (n,); None: no textures.
        textures: Names of all textures that occur; static.
    """

    rgb: Array
    transparency: Array
    reflectance: Array
    label: Array
    instance: Array | None = None
    texture: Array | None = None
    textures: frozenset[str] = struct.field(pytree_node=False, default=frozenset())


def instances(label: Any, index: Any) -> Any:  # noqa: ANN401 - whole numbers or arrays of them
    """Return the instances of objects by their class labels (n,) and their numbers within the class (n,).

    Robots have the class `ROBOT_LABEL`, numbered by slot. `instance // INSTANCES` is the class, and `instance
    % INSTANCES` the number.
    """
    return label * INSTANCES + index


def robot_geom_owner(slot: Array, geom: Array) -> Array:
    """Return the unique owner of a robot's geom, given its index in the `KinematicTree`."""
    # One number for both, as a ray compares a single owner; int32 has room for 32,767 slots.
    return slot * MAX_ROBOT_GEOMS + geom


def camera_owners(owner: Array, slot: Array, hidden_geoms: Array) -> Array:
    """Return the owners (n,) as seen through a camera of the robot in a slot ().

    Geoms hidden from the camera (`Camera.hidden_geoms`) belong to the slot; all others have no owner.
    """
    piece = jnp.append(jnp.asarray(hidden_geoms), False)[
        # Owners of others are clipped to the appended False.
        jnp.clip(owner - slot * MAX_ROBOT_GEOMS, 0, len(hidden_geoms))
    ]
    return jnp.where((owner // MAX_ROBOT_GEOMS == slot) & piece, slot, -1)


def transparencies(material: np.ndarray) -> np.ndarray:
    """Return the transparencies of materials (n,)."""
    return np.array([GLASS_TRANSPARENCY * (name == GLASS) for name in material], np.float32)


def reflectances(material: np.ndarray) -> np.ndarray:
    """Return the reflectances of materials (n,)."""
    return np.array([MIRROR_REFLECTANCE * (name == MIRROR) for name in material], np.float32)


def bone_labels(owner: Array, xp: object = np) -> Array:
    """Return the labels of victims' boxes (n,), given their owners in a `VictimTable` (n,)."""
    return xp.where(owner >= 0, VICTIM_LABEL, FALSE_ALARM_LABEL)  # type: ignore[attr-defined]


def labels_of(model: mujoco.MjModel, arena: ArenaSpec) -> np.ndarray:
    """Return the labels of a model's geoms (ngeom,); all robots have `ROBOT_LABEL`."""
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
        # 0 is the sky's label, which no geom has: `or` may take it for missing.
        return known.get(name) or next(
            (v for start, v in starts.items() if name.startswith(start)), ROBOT_LABEL
        )

    return np.array([label(name) for name in names], np.int32)
