"""A picture that a robot's camera takes: colours, depths, and what every pixel shows."""

from functools import partial

import jax
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import on_numpy, xp
from usarmjx.base.errors import UsageError
from usarmjx.cameras.casters import Caster
from usarmjx.cameras.lenses import MIRROR_DISTANCE, omni_rays, pinhole_rays, untiled
from usarmjx.cameras.mounts import Camera
from usarmjx.cameras.paint import OUTSIDE_LABEL, camera_owners
from usarmjx.cameras.shading import RenderScene, Shaded, shade
from usarmjx.models.build.body_plan import BodyPoses

MAX_SIDE = 4096
"""Most pixels along a side."""
HIDDEN_GEOMS_MULTIPLE = 256
"""Robots have a multiple of so many geoms, as far as the shape of a `Viewpoint` tells."""
CHUNK = 16_384
"""Rays that are cast together on NumPy: what they meet fits into a processor's cache."""


class Viewpoint(struct.PyTreeNode, kw_only=True):
    """From where a picture is taken, and through what: all that differs between cameras.

    Attributes:
        pos: Where the camera is [m] (3,).
        mat: Its orientation; x is the optical axis, z up in the picture (3, 3).
        eye_offsets: Where its eyes are, in its own axes [m] (eyes, 3).
        fov: Its field of view [rad] ().
        default_fov: That which it starts with [rad] ().
        slot: Its robot's slot in the roster ().
        hidden_geoms: Geoms of its robot that it does not see: `Camera.hidden_geoms`, then False (geoms,).
        lens: What it looks through; static.
    """

    pos: Array
    mat: Array
    eye_offsets: Array
    fov: Array
    default_fov: Array
    slot: Array
    hidden_geoms: Array
    lens: str = struct.field(pytree_node=False)


def camera_viewpoint(camera: Camera, bodies: BodyPoses, slot: Array, fov: Array) -> Viewpoint:
    """Return from where a robot's camera looks; numpy arrays if those given are.

    Args:
        camera: The camera.
        bodies: Poses of the robot's bodies.
        slot: Its slot in the roster ().
        fov: The camera's field of view [rad] ().
    """
    pos, mat = bodies.pos[camera.body], bodies.mat[camera.body]
    return Viewpoint(
        pos=pos + mat @ camera.pos,
        mat=mat @ camera.mat,
        eye_offsets=camera.eye_offsets,
        fov=fov,
        default_fov=np.asarray(camera.default_fov, np.float32),
        slot=slot,
        hidden_geoms=np.pad(camera.hidden_geoms, (0, -len(camera.hidden_geoms) % HIDDEN_GEOMS_MULTIPLE)),
        lens=camera.lens,
    )


class Picture(struct.PyTreeNode, kw_only=True):
    """What a camera sees; rows from the top, columns from the left.

    Attributes:
        rgb: Colours, 0 to 255, uint8 (..., height, width, 3).
        depth: How far away it is, of a pinhole perpendicular to the picture, of an omnidirectional camera
            from its mirror's focus; infinite for the sky and outside of the mirror; glass is looked
            through and mirrors are looked at, float32 [m] (..., height, width).
        segmentation: What it is, see `paint`; int32 (..., height, width).
    """

    rgb: Array
    depth: Array
    segmentation: Array


def check_size(camera: Camera, width: int, height: int) -> None:
    """Refuse sizes that a picture cannot have.

    Raises:
        UsageError: A side below 1 or above `MAX_SIDE`, or an odd width of a stereo pair.
    """
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise UsageError(f"a picture of {width} x {height} pixels; expected 1 to {MAX_SIDE} along each side")
    if width % len(camera.eye_offsets):
        raise UsageError(f"a stereo picture is {width} pixels wide; expected an even number, for two eyes")


def render_picture(
    render_scene: RenderScene,
    viewpoint: Viewpoint,
    width: int,
    height: int,
    caster: Caster | None = None,
) -> Picture:
    """Return what a robot's camera sees; pure, the size is static.

    The robot sees itself, but for what covers the lens (`Camera.hidden_geoms`). A stereo camera's picture
    has the left eye's in its left half and the right eye's in the other (MultiView's subview, manual
    3.2.6.2). The mirror of an omnidirectional camera fills the picture at the default field of view, and
    grows as it shrinks.

    Args:
        render_scene: What there is to see.
        viewpoint: From where.
        width: Pixels along a row.
        height: Rows.
        caster: What casts this camera's rays, on NumPy; None: JAX does.
    """
    offsets = xp.asarray(viewpoint.eye_offsets)
    eyes, wide = len(offsets), width // len(offsets)
    if viewpoint.lens == "omni":
        rays = omni_rays(wide, height, xp.tan(viewpoint.default_fov / 2) / xp.tan(viewpoint.fov / 2))
        offsets = offsets + xp.array([MIRROR_DISTANCE, 0.0, 0.0])
    else:
        rays = pinhole_rays(wide, height, viewpoint.fov)
    along = xp.stack(
        [sum(viewpoint.mat[i, j] * rays.direction[:, j] for j in range(3)) for i in range(3)], -1
    )
    start = xp.repeat(viewpoint.pos + offsets @ viewpoint.mat.T, len(along), 0)
    seen = _see(render_scene, viewpoint, start, xp.tile(along, (eyes, 1)), caster)
    inside, depth = xp.tile(rays.inside, eyes), seen.distance * xp.tile(rays.depth_scale, eyes)
    levels = xp.where(inside[:, None], xp.floor(255 * seen.rgb + 0.5), 0.0).astype(xp.uint8)

    def picture(values: Array) -> Array:
        views = [untiled(view, wide, height) for view in xp.split(values, eyes)]
        return xp.concatenate(views, 1)

    return Picture(
        rgb=picture(levels),
        depth=picture(xp.where(inside, depth, xp.inf).astype(xp.float32)),
        segmentation=picture(xp.where(inside, seen.label, OUTSIDE_LABEL).astype(xp.int32)),
    )


def _see(
    render_scene: RenderScene, viewpoint: Viewpoint, start: Array, along: Array, caster: Caster | None
) -> Shaded:
    """Return what a camera's rays see; on NumPy some of them after the others."""
    slot = xp.asarray(viewpoint.slot)
    if on_numpy():
        parts = [slice(first, first + CHUNK) for first in range(0, len(start), CHUNK)]
        seen = [shade(render_scene, start[part], along[part], slot, caster) for part in parts]
        return Shaded(*(xp.concatenate(columns) for columns in zip(*seen, strict=True)))
    blocks = [
        block.replace(owner=camera_owners(block.owner, viewpoint.slot, viewpoint.hidden_geoms))
        for block in render_scene.geoms.blocks
    ]
    geoms = render_scene.geoms.replace(blocks=tuple(blocks))
    return shade(render_scene.replace(geoms=geoms), start, along, slot, caster)


@partial(jax.jit, static_argnames=("width", "height"))
@jax.default_matmul_precision("highest")
def render_picture_jit(render_scene: RenderScene, viewpoint: Viewpoint, width: int, height: int) -> Picture:
    """As `render_picture`, compiled once for all cameras with as many eyes and the same lens."""
    return render_picture(render_scene, viewpoint, width, height)
