"""Stages of a few solids for tests of the shading."""

import mujoco
import numpy as np

from usarmjx.models.types.shapes import OPAQUE
from usarmjx.sensors.cameras.paint import (
    ARENA_LABEL,
    ROBOT_LABEL,
    GeomAppearance,
    reflectances,
    transparencies,
)
from usarmjx.sensors.cameras.shading import Headlights, PointLights, RenderScene, no_headlights, point_lights
from usarmjx.sensors.rays.targets import indices_by_key, make_geoms

BOX, PLANE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_PLANE)
NO_LAMPS = point_lights((), 0.0)


def solid(at, size, rgb, kind=BOX, material=OPAQUE, label=ROBOT_LABEL + 9, owner=-1) -> dict:
    """A solid without bricks, since it is no arena's; see `wall`."""
    return {**locals()}


def wall(at, size, rgb, **more) -> dict:
    return solid(at, size, rgb, label=ARENA_LABEL, **more)


def stage_of(
    *solids: dict, sun=(0.0, 0.0, 1.0), lamps: PointLights = NO_LAMPS, headlights: Headlights | None = None
) -> RenderScene:
    """Upright solids in some light."""

    def column(name, kind=np.float32):
        return np.array([one[name] for one in solids], kind)

    kind, material = column("kind", int), np.array([one["material"] for one in solids], object)
    order = np.concatenate(list(indices_by_key(kind, material.tolist()).values()))
    mat = np.tile(np.eye(3, dtype=np.float32), (len(solids), 1, 1))
    owner = column("owner", np.int32)
    return RenderScene(
        geoms=make_geoms(kind, column("at"), mat, column("size"), owner, material.tolist()),
        appearance=GeomAppearance(
            rgb=column("rgb")[order],
            transparency=transparencies(material[order]),
            reflectance=reflectances(material[order]),
            label=column("label", np.int32)[order],
        ),
        sun_direction=np.array(sun, np.float32) / np.float32(np.linalg.norm(sun)),
        lights=lamps,
        headlights=headlights or no_headlights(),
        checker_size=np.float32(0.5),
        checker_bounds=np.array([(-np.inf, np.inf)] * 2, np.float32),
    )
