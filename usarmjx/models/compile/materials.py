"""Materials (manual 14.1.2) and textures of the geoms of a compiled model."""

import mujoco
import numpy as np

from usarmjx.models.compile.compose import ARENA_PREFIX, LOOSE_PREFIX
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import OPAQUE
from usarmjx.models.types.textures import texture_code


def materials_of(model: mujoco.MjModel, arena: ArenaSpec) -> list[str]:
    """Return the material of every geom of a model of that arena, one of `shapes.MATERIALS`.

    The arena's fixed solids and loose objects have their own; its floor, doors and victims, and all robots
    are opaque.
    """
    known = {f"{ARENA_PREFIX}{i}": shape.material for i, shape in enumerate(arena.shapes)}
    for loose in arena.loose:
        known |= {f"{LOOSE_PREFIX}{loose.name}/{i}": shape.material for i, shape in enumerate(loose.shapes)}
    return [known.get(model.geom(i).name, OPAQUE) for i in range(model.ngeom)]


def textures_of(model: mujoco.MjModel, arena: ArenaSpec) -> np.ndarray:
    """Return the texture codes of a model's geoms (ngeom,): those of the arena's fixed solids."""
    known = {
        f"{ARENA_PREFIX}{i}": texture_code(shape.texture)
        for i, shape in enumerate(arena.shapes)
        if shape.texture
    }
    if not known:
        return np.zeros(model.ngeom, np.int32)
    return np.array([known.get(model.geom(i).name, 0) for i in range(model.ngeom)], np.int32)
