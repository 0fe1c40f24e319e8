"""Pictures of a robot's camera: colours, depths, segmentation, and annotation of each pixel."""

from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from flax import struct

from usarmjx.base.backend import Array, on_numpy, xp
from usarmjx.base.errors import UsageError
from usarmjx.base.nodes import Node
from usarmjx.base.warp_functions import warp_in_use
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.sensors.cameras.casters import SOLID_QUERY, Caster, GeomCaster, RayHits
from usarmjx.sensors.cameras.lenses import MIRROR_DISTANCE, from_tiles, omni_rays, pinhole_rays
from usarmjx.sensors.cameras.mounts import Camera, box_filter, quantize
from usarmjx.sensors.cameras.paint import INSTANCES, OUTSIDE_LABEL, SKY_LABEL, camera_owners
from usarmjx.sensors.cameras.shading import RenderScene, Shaded, shade, shadow_gain
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE
from usarmjx.sensors.rays.targets import GeomBlock, concatenated

MAX_SIDE = 4096
"""Largest side of a picture [pixels]."""
HIDDEN_GEOMS_MULTIPLE = 256
"""Multiple to which `Viewpoint.hidden_geoms` is padded, so that robots share compiled programs."""
NO_ROBOT = int(EXCLUDE_NONE)
"""Slot of a viewpoint that belongs to no robot; -1 is the owner of the arena, which it would hide."""
CHUNK = 16_384
"""Rays cast together on NumPy: their hits fit into a CPU cache."""


class Viewpoint(Node, kw_only=True):
    """Pose and lens of a camera: everything that differs between cameras.

    Attributes:
        pos: Position [m] (3,).
        mat: Orientation; x is the optical axis, z up in the picture (3, 3).
        eye_offsets: Positions of its lenses in its own axes [m] (eyes, 3).
        fov: Field of view [rad] ().
        default_fov: Initial field of view [rad] ().
        slot: Slot of its robot ().
        hidden_geoms: Geoms of its robot hidden from it: `Camera.hidden_geoms`, padded with False (geoms,).
        exposure: Factor on the brightness of its pictures ().
        distortion: k1 and k2 of its lens, see `lenses.undistort` (2,); None: no distortion.
        noise: Standard deviation of each colour of a pixel, of 255 (); None: no noise.
        lens: Type of lens; static.
        supersampling: Rays along each side of a pixel; static.
    """

    pos: Array
    mat: Array
    eye_offsets: Array
    fov: Array
    default_fov: Array
    slot: Array
    hidden_geoms: Array
    lens: str = struct.field(pytree_node=False)
    exposure: Array | float = 1.0
    distortion: Array | None = None
    noise: Array | None = None
    supersampling: int = struct.field(pytree_node=False, default=1)


def pinhole_viewpoint(pos: np.ndarray, mat: np.ndarray, fov: float, supersampling: int = 1) -> Viewpoint:
    """Return the viewpoint of a pinhole that belongs to no robot.

    Args:
        pos: See `Viewpoint`.
        mat: See `Viewpoint`.
        fov: Field of view [rad].
        supersampling: See `Viewpoint`.
    """
    angle = np.array(fov, np.float32)
    return Viewpoint(
        pos=pos,
        mat=mat,
        eye_offsets=np.zeros((1, 3), np.float32),
        fov=angle,
        default_fov=angle,
        slot=np.array(NO_ROBOT, np.int32),
        hidden_geoms=np.zeros(0, bool),
        exposure=np.array(1.0, np.float32),
        lens="pinhole",
        supersampling=supersampling,
    )


def camera_viewpoint(camera: Camera, bodies: BodyPoses, slot: Array, fov: Array) -> Viewpoint:
    """Return the viewpoint of a robot's camera; NumPy arrays if the arguments are.

    Args:
        camera: The camera.
        bodies: Poses of the robot's bodies.
        slot: The robot's slot ().
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
        exposure=np.array(camera.imaging.exposure, np.float32),
        distortion=camera.imaging.distortion,
        noise=None if camera.imaging.noise is None else np.array(camera.imaging.noise, np.float32),
        supersampling=camera.imaging.supersampling,
    )


class Picture(Node, kw_only=True):
    """Picture of a camera; rows from the top, columns from the left.

    Attributes:
        rgb: Colours, 0 to 255, uint8 (..., height, width, 3).
        depth: Depth, perpendicular to the picture for a pinhole, distance from the mirror's focus for an
            omnidirectional camera; infinite for the sky and outside of the mirror; glass is transparent and
            mirrors are surfaces, float32 [m] (..., height, width).
        segmentation: Labels, see `paint`; int32 (..., height, width).
    """

    rgb: Array
    depth: Array
    segmentation: Array


def check_size(camera: Camera, width: int, height: int) -> None:
    """Refuse invalid sizes of a picture.

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
    """Render a robot's camera; pure, with static size.

    The robot sees itself except for geoms that cover the lens (`Camera.hidden_geoms`). A stereo picture has
    the left lens's view in its left half and the right one's in the other (MultiView's subview, manual
    3.2.6.2). The mirror of an omnidirectional camera fills the picture at the default field of view, and
    grows as the field of view shrinks.

    Args:
        render_scene: The scene.
        viewpoint: The camera.
        width: Pixels along a row.
        height: Rows.
        caster: Ray caster on NumPy; None: JAX.
    """
    view = camera_view(viewpoint, width, height)
    # Exposure belongs to the camera, so that cameras of one scene can differ.
    exposed = render_scene.replace(exposure=viewpoint.exposure, gain=shadow_gain(render_scene.lights))
    seen = _shade_rays(exposed, viewpoint, view.start, view.along, caster)
    times, inside = viewpoint.supersampling, view.inside
    rgb = view.picture(xp.where(inside[:, None], seen.rgb, 0.0))
    depth = view.picture(xp.where(inside, seen.distance * view.depth_scale, xp.inf).astype(xp.float32))
    label = view.picture(xp.where(inside, seen.label, OUTSIDE_LABEL).astype(xp.int32))
    if times > 1:
        # Depth and labels are sampled, not averaged: a mean of labels has no meaning.
        middle = slice(times // 2, None, times)
        rgb, depth, label = box_filter(rgb, times), depth[middle, middle], label[middle, middle]
    return Picture(
        rgb=quantize(rgb, viewpoint.noise, render_scene.seed, viewpoint.slot), depth=depth, segmentation=label
    )


class CameraView(NamedTuple):
    """Rays of all lenses of a camera, and their arrangement in pictures.

    Attributes:
        start: Origins [m] (rays, 3).
        along: Unit vectors (rays, 3).
        depth_scale: Factor from a ray's length to depth (rays,).
        inside: Whether its pixel is inside the lens's field of view (rays,).
        eyes: Number of lenses.
        size: Width and height of each lens's picture, in rays.
    """

    start: Array
    along: Array
    depth_scale: Array
    inside: Array
    eyes: int
    size: tuple[int, int]

    def picture(self, values: Array) -> Array:
        """Return values of rays (rays, ...) as a picture (rows, columns, ...), the left lens on the left."""
        return xp.concatenate([from_tiles(one, *self.size) for one in xp.split(values, self.eyes)], 1)


def camera_view(viewpoint: Viewpoint, width: int, height: int) -> CameraView:
    """Return the rays of a camera's picture of `width` x `height` pixels, lens by lens."""
    offsets = xp.asarray(viewpoint.eye_offsets)
    eyes, times = len(offsets), viewpoint.supersampling
    size = width // eyes * times, height * times
    if viewpoint.lens == "omni":
        # By tangents: at half of the default one the mirror is twice as large.
        rays = omni_rays(*size, xp.tan(viewpoint.default_fov / 2) / xp.tan(viewpoint.fov / 2))
        # Rays start at the mirror's focus, as its reflections seem to.
        offsets = offsets + xp.array([MIRROR_DISTANCE, 0.0, 0.0])
    else:
        rays = pinhole_rays(*size, viewpoint.fov, viewpoint.distortion)
    # Sums of products and no `@`, which a GPU computes with TensorFloat-32 by default.
    along = xp.stack(
        [sum(viewpoint.mat[i, j] * rays.direction[:, j] for j in range(3)) for i in range(3)], -1
    )
    start = xp.repeat(viewpoint.pos + offsets @ viewpoint.mat.T, len(along), 0)
    columns = (xp.tile(along, (eyes, 1)), xp.tile(rays.depth_scale, eyes), xp.tile(rays.inside, eyes))
    return CameraView(start, *columns, eyes, size)


def _shade_rays(
    render_scene: RenderScene, viewpoint: Viewpoint, start: Array, along: Array, caster: Caster | None
) -> Shaded:
    """Shade a camera's rays; in chunks on NumPy."""
    slot = xp.asarray(viewpoint.slot)
    # On NumPy a chunk's arrays stay in the cache, and one scene's memory stays bounded.
    if on_numpy():
        parts = [slice(first, first + CHUNK) for first in range(0, len(start), CHUNK)]
        seen = [shade(render_scene, start[part], along[part], slot, caster) for part in parts]
        return Shaded(*(xp.concatenate(columns) for columns in zip(*seen, strict=True)))
    blocks = [
        block.replace(owner=camera_owners(block.owner, viewpoint.slot, viewpoint.hidden_geoms))
        for block in render_scene.geoms.blocks
    ]
    visible = render_scene.replace(geoms=render_scene.geoms.replace(blocks=tuple(blocks)))
    if caster is None and warp_in_use():
        # Here, as Warp belongs to an extra.
        from usarmjx.sensors.cameras.shading_warp import shade_on_warp

        return shade_on_warp(visible, start, along, slot)
    return shade(visible, start, along, slot, caster)


@partial(jax.jit, static_argnames=("width", "height"))
# In TensorFloat-32, a GPU's default, products have 10 bits: positions would be off by centimetres.
@jax.default_matmul_precision("highest")
def render_picture_jit(render_scene: RenderScene, viewpoint: Viewpoint, width: int, height: int) -> Picture:
    """As `render_picture`, compiled once for all cameras with equal numbers of lenses and types of lens."""
    return render_picture(render_scene, viewpoint, width, height)


class Annotation(Node, kw_only=True):
    """Annotation of a camera's pixels; rows from the top, columns from the left.

    Attributes:
        instances: Instances, see `paint.instances`; 0 for the sky and -1 outside of a mirror, int32 (...,
            height, width).
        normals: Unit normals of the surfaces, in the camera's axes (x along its optical axis, y to the left,
            z up), towards it; zero without a surface (..., height, width, 3).
        flow: Optical flow to the right and down until another moment, of a pinhole; NaN without a surface or
            for a point behind the later camera [pixels] (..., height, width, 2).
    """

    instances: Array
    normals: Array
    flow: Array


class _Seen(NamedTuple):
    """Hits of one ray per pixel.

    Attributes:
        view: The rays.
        hits: Their hits.
        normal: Unit normals there, towards the rays (rays, 3).
        point: Hit points [m] (rays, 3).
    """

    view: CameraView
    hits: RayHits
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
    """Annotate a camera's pixels, with the optical flow until another moment; pure, with static size.

    Args:
        render_scene: The scene.
        viewpoint: The camera.
        later_scene: The same scene at the other moment.
        later_viewpoint: The camera at the other moment.
        width: Pixels along a row.
        height: Rows.
    """
    # One ray per pixel: instances and normals cannot be averaged.
    plain = viewpoint.replace(supersampling=1)
    seen = _first_hits(render_scene, plain, width, height)
    there, which = seen.hits.geom_index >= 0, xp.maximum(xp.asarray(seen.hits.geom_index), 0)
    instance = xp.asarray(render_scene.appearance.instance)[which]
    instance = xp.where(there, instance, SKY_LABEL * INSTANCES)
    instance = xp.where(seen.view.inside, instance, OUTSIDE_LABEL)
    shown = (there & seen.view.inside)[:, None]
    normal = xp.where(shown, seen.normal @ xp.asarray(viewpoint.mat), 0.0)
    # By index: geoms are in the same order at both moments.
    now, then = (
        jax.tree.map(lambda column: xp.asarray(column)[which], concatenated(scene.geoms))
        for scene in (render_scene, later_scene)
    )
    moved = _move_points(seen.point, now, then)
    there_then = _project(later_viewpoint, moved, seen.view)
    flow = xp.where(shown, there_then - _project(viewpoint, seen.point, seen.view), xp.nan)
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
    hits = caster.from_camera(view.start, view.along, SOLID_QUERY)
    # Misses are infinite, and infinity times a direction's zero would be NaN.
    reach = xp.where(hits.geom_index >= 0, hits.distance, 0.0)[:, None]
    normal = caster.normals(hits, view.start, view.along)
    return _Seen(view, hits, normal, view.start + reach * view.along)


def _move_points(point: Array, now: GeomBlock, then: GeomBlock) -> Array:
    """Return the later positions of points (rays, 3) that move with their geoms."""
    local = ((point - now.pos)[:, None, :] * xp.swapaxes(now.mat, -1, -2)).sum(-1)
    return then.pos + (then.mat * local[:, None, :]).sum(-1)


def _project(viewpoint: Viewpoint, point: Array, view: CameraView) -> Array:
    """Return the pinhole projections of points (rays, 3), to the right and down [pixels] (rays, 2)."""
    # Rays are in order of the lenses, as many of each.
    count = len(point) // view.eyes
    eye = viewpoint.pos + xp.asarray(viewpoint.eye_offsets) @ viewpoint.mat.T
    local = (point - xp.repeat(eye, count, 0)) @ xp.asarray(viewpoint.mat)
    ahead = local[:, :1]
    # A point behind the camera would be projected upside down.
    flat = -local[:, 1:] / xp.where(ahead > 0, ahead, xp.nan)
    if viewpoint.distortion is not None:
        square = (flat * flat).sum(-1, keepdims=True)
        # Forward, from the undistorted point; `pinhole_rays` inverts it.
        flat = flat * (1 + square * (viewpoint.distortion[0] + viewpoint.distortion[1] * square))
    focal = view.size[0] / 2 / xp.tan(viewpoint.fov / 2)
    return flat * focal if viewpoint.lens == "pinhole" else xp.full(flat.shape, np.nan)
