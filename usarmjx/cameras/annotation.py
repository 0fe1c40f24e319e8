"""What a picture shows, for those who train on it: whose each pixel is, how it faces, and where it goes.

All of it is of what the rays of pixels meet first; glass is looked through, mirrors are looked at.
"""

from typing import NamedTuple

import jax
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.cameras.casters import SOLID_QUERY, GeomCaster, Met
from usarmjx.cameras.paint import INSTANCES, OUTSIDE_LABEL, SKY_LABEL, camera_owners
from usarmjx.cameras.picture import CameraView, Viewpoint, camera_view
from usarmjx.cameras.shading import RenderScene
from usarmjx.sensors.rays.surfaces import concatenated
from usarmjx.sensors.rays.targets import GeomBlock


class Annotation(struct.PyTreeNode, kw_only=True):
    """What a camera's pixels show; rows from the top, columns from the left.

    Attributes:
        instances: What they belong to, see `paint.instances`; the sky has 0 and what is outside of a mirror
            -1, int32 (..., height, width).
        normals: Unit normals of the surfaces, in the camera's axes (x along its optical axis, y to the left,
            z up), towards it; zero where nothing is (..., height, width, 3).
        flow: How far what is there moves in the picture, to the right and down, until another moment; of a
            pinhole, NaN where nothing is or where it is behind the camera then [pixels] (..., height,
            width, 2).
    """

    instances: Array
    normals: Array
    flow: Array


class _Seen(NamedTuple):
    """What one ray for each pixel meets.

    Attributes:
        view: The rays.
        met: What they meet.
        normal: Unit normals there, towards the rays (rays, 3).
        point: Where that is [m] (rays, 3).
    """

    view: CameraView
    met: Met
    normal: Array
    point: Array


def annotate(
    render_scene: RenderScene,
    viewpoint: Viewpoint,
    later_scene: RenderScene,
    later_viewpoint: Viewpoint,
    width: int,
    height: int,
) -> Annotation:
    """Return what a camera's pixels show, and where it goes until another moment; pure, the size is static.

    Args:
        render_scene: What there is to see.
        viewpoint: From where.
        later_scene: The same things, where they are at the other moment.
        later_viewpoint: Where the camera is then.
        width: Pixels along a row.
        height: Rows.
    """
    plain = viewpoint.replace(supersampling=1)
    seen = _first_hits(render_scene, plain, width, height)
    there, which = seen.met.geom_index >= 0, xp.maximum(xp.asarray(seen.met.geom_index), 0)
    instance = xp.asarray(render_scene.appearance.instance)[which]
    instance = xp.where(there, instance, SKY_LABEL * INSTANCES)
    instance = xp.where(seen.view.inside, instance, OUTSIDE_LABEL)
    shown = (there & seen.view.inside)[:, None]
    normal = xp.where(shown, seen.normal @ xp.asarray(viewpoint.mat), 0.0)
    now, then = (
        jax.tree.map(lambda column: xp.asarray(column)[which], concatenated(scene.geoms))
        for scene in (render_scene, later_scene)
    )
    moved = _carried(seen.point, now, then)
    there_then = _image(later_viewpoint, moved, seen.view)
    flow = xp.where(shown, there_then - _image(viewpoint, seen.point, seen.view), xp.nan)
    return Annotation(
        instances=seen.view.picture(instance.astype(xp.int32)),
        normals=seen.view.picture(normal),
        flow=seen.view.picture(flow),
    )


def _first_hits(render_scene: RenderScene, viewpoint: Viewpoint, width: int, height: int) -> _Seen:
    blocks = [
        block.replace(owner=camera_owners(block.owner, viewpoint.slot, viewpoint.hidden_geoms))
        for block in render_scene.geoms.blocks
    ]
    geoms = render_scene.geoms.replace(blocks=tuple(blocks))
    caster = GeomCaster(geoms, render_scene.appearance, xp.asarray(viewpoint.slot))
    view = camera_view(viewpoint, width, height)
    met = caster.from_camera(view.start, view.along, SOLID_QUERY)
    reach = xp.where(met.geom_index >= 0, met.distance, 0.0)[:, None]
    normal = caster.normals(met, view.start, view.along)
    return _Seen(view, met, normal, view.start + reach * view.along)


def _carried(point: Array, now: GeomBlock, then: GeomBlock) -> Array:
    """Return where points (rays, 3) on geoms are when these are elsewhere."""
    local = ((point - now.pos)[:, None, :] * xp.swapaxes(now.mat, -1, -2)).sum(-1)
    return then.pos + (then.mat * local[:, None, :]).sum(-1)


def _image(viewpoint: Viewpoint, point: Array, view: CameraView) -> Array:
    """Return where a pinhole's eyes see points (rays, 3): to the right and down [pixels] (rays, 2)."""
    count = len(point) // view.eyes
    eye = viewpoint.pos + xp.asarray(viewpoint.eye_offsets) @ viewpoint.mat.T
    local = (point - xp.repeat(eye, count, 0)) @ xp.asarray(viewpoint.mat)
    ahead = local[:, :1]
    flat = -local[:, 1:] / xp.where(ahead > 0, ahead, xp.nan)
    if viewpoint.distortion is not None:
        square = (flat * flat).sum(-1, keepdims=True)
        flat = flat * (1 + square * (viewpoint.distortion[0] + viewpoint.distortion[1] * square))
    focal = view.size[0] / 2 / xp.tan(viewpoint.fov / 2)
    return flat * focal if viewpoint.lens == "pinhole" else xp.full(flat.shape, np.nan)
