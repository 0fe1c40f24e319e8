"""Stages of a few solids for tests of the shading."""

import mujoco
import numpy as np

from usarmjx.cameras.light import Headlights, Lamps, lamps_of, no_headlights
from usarmjx.cameras.paint import ARENA, ROBOT, Paint, clears, glosses
from usarmjx.cameras.shading import Stage
from usarmjx.models.spec.robot import OPAQUE
from usarmjx.sensors.rays.targets import gather, sort_places

BOX, PLANE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_PLANE)
NO_LAMPS = lamps_of((), 0.0)


def solid(at, size, rgb, kind=BOX, material=OPAQUE, label=ROBOT + 9, owner=-1) -> dict:
    """A solid without bricks, since it is no arena's; see `wall`."""
    return {**locals()}


def wall(at, size, rgb, **more) -> dict:
    return solid(at, size, rgb, label=ARENA, **more)


def stage_of(
    *solids: dict, sun=(0.0, 0.0, 1.0), lamps: Lamps = NO_LAMPS, headlights: Headlights | None = None
) -> Stage:
    """Upright solids in some light."""

    def column(name, kind=np.float32):
        return np.array([one[name] for one in solids], kind)

    kind, material = column("kind", int), np.array([one["material"] for one in solids], object)
    order = np.concatenate(list(sort_places(kind, material.tolist()).values()))
    mat = np.tile(np.eye(3, dtype=np.float32), (len(solids), 1, 1))
    owner = column("owner", np.int32)
    return Stage(
        geoms=gather(kind, column("at"), mat, column("size"), owner, material.tolist()),
        paint=Paint(
            rgb=column("rgb")[order],
            clear=clears(material[order]),
            gloss=glosses(material[order]),
            label=column("label", np.int32)[order],
        ),
        sun=np.array(sun, np.float32) / np.float32(np.linalg.norm(sun)),
        lamps=lamps,
        headlights=headlights or no_headlights(),
        tile=np.float32(0.5),
        tiled=np.array([(-np.inf, np.inf)] * 2, np.float32),
    )
