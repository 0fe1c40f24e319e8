"""Still pictures of solids, shaded as what robots' cameras see: see `cameras.shading`.

Rays are cast in chunks, so that the memory that a picture takes does not grow with its size.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.errors import UnsupportedGeomError
from usarmjx.base.transforms import Vec3
from usarmjx.models.compile.ray_geoms import ray_primitives_of
from usarmjx.models.compile.victims import VictimTable, orientations, segment_poses
from usarmjx.models.compile.visuals import VISUAL_SLOTS, drawn_bones, used_slots
from usarmjx.models.types.shapes import GLASS, MIRROR, OPAQUE, SKY
from usarmjx.sensors.cameras.lenses import TILE, from_tiles, to_tiles
from usarmjx.sensors.cameras.paint import (
    ROBOT_LABEL,
    WATER_LABEL,
    GeomAppearance,
    bone_labels,
    reflectances,
    transparencies,
)
from usarmjx.sensors.cameras.shading import (
    SUN_DIRECTION,
    RenderScene,
    no_headlights,
    point_lights,
    shade,
)
from usarmjx.sensors.rays.kernels import RAY_KERNELS
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE
from usarmjx.sensors.rays.targets import Geoms, indices_by_key, make_geoms

PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
BOX = int(mujoco.mjtGeom.mjGEOM_BOX)


@dataclass(frozen=True, eq=False)
class RenderGeoms:
    """Visible geoms.

    Attributes:
        kind: MuJoCo types, or those of `models.compile.ray_geoms` (n,).
        pos: Places [m] (n, 3).
        mat: Orientations (n, 3, 3).
        size: Size numbers [m] (n, 3).
        rgb: Colours (n, 3).
        transparency: Share of what is behind that is seen through them (n,).
        reflectance: Share of what they reflect in how they look (n,).
        label: Labels, see `cameras.paint`; an arena's solids show bricks (n,).
    """

    kind: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    size: np.ndarray
    rgb: np.ndarray
    transparency: np.ndarray
    reflectance: np.ndarray
    label: np.ndarray

    def __len__(self) -> int:
        """Return the number of geoms."""
        return len(self.kind)

    def select(self, which: np.ndarray) -> "RenderGeoms":
        """Return some of them, by index or mask."""
        return RenderGeoms(**{field.name: getattr(self, field.name)[which] for field in fields(self)})

    def concatenate(self, other: "RenderGeoms") -> "RenderGeoms":
        """Return these and others."""
        both = {f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)}
        return RenderGeoms(**both)


def render_geoms_of(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    materials: Sequence[str] | None = None,
    labels: np.ndarray | None = None,
) -> RenderGeoms:
    """Return a model's geoms for rays in their present poses; kinematics must be current.

    Args:
        model: The model.
        data: Its state.
        materials: Material of each geom, see `materials_of`; None: all opaque. Sky is left out.
        labels: Class of each geom in a segmentation (ngeom,); None: all are robots.
    """
    named = np.array([OPAQUE] * model.ngeom if materials is None else materials, object)
    ids = np.flatnonzero(named != SKY)
    pieces = ray_primitives_of(model, ids, named.tolist())
    pos, mat = pieces.world_poses(
        data.geom_xpos[ids].astype(np.float32), data.geom_xmat[ids].reshape(-1, 3, 3).astype(np.float32)
    )
    return RenderGeoms(
        kind=pieces.kind,
        pos=np.asarray(pos),
        mat=np.asarray(mat),
        size=pieces.size,
        rgb=model.geom_rgba[ids, :3].astype(np.float32)[pieces.geom],
        transparency=transparencies(pieces.material),
        reflectance=reflectances(pieces.material),
        label=(np.full(model.ngeom, ROBOT_LABEL) if labels is None else labels)[ids][pieces.geom],
    )


def victim_geoms(table: VictimTable, floor: float) -> RenderGeoms:
    """Return the visuals of victims and false alarms at the start, with the floor at a height [m]."""
    drawn, used = drawn_bones(table), used_slots(table.part)
    place, quat = segment_poses(table, 0.0)
    turn = np.asarray(orientations(quat))[:, None]
    pos = (
        np.asarray(place)[:, None] + (turn @ np.asarray(drawn.offset)[..., None])[..., 0] + (0.0, 0.0, floor)
    )
    count = int(used.sum())
    return RenderGeoms(
        kind=np.tile(VISUAL_SLOTS, (table.num_boxes, 1))[used],
        pos=pos[used].astype(np.float32),
        mat=np.broadcast_to(turn, (*used.shape, 3, 3))[used].astype(np.float32),
        size=np.asarray(drawn.size, np.float32)[used],
        rgb=np.asarray(drawn.rgb, np.float32)[used],
        transparency=np.zeros(count, np.float32),
        reflectance=np.zeros(count, np.float32),
        label=np.broadcast_to(bone_labels(np.asarray(table.owner))[:, None], used.shape)[used],
    )


def box_geoms(low: np.ndarray, high: np.ndarray, rgb: np.ndarray, clear: float = 0.0) -> RenderGeoms:
    """Return upright boxes between corners (n, 3) and (n, 3), all of one colour (3,)."""
    count = len(low)
    return RenderGeoms(
        kind=np.full(count, BOX),
        pos=((low + high) / 2).astype(np.float32),
        mat=np.tile(np.eye(3, dtype=np.float32), (count, 1, 1)),
        size=((high - low) / 2).astype(np.float32),
        rgb=np.tile(np.asarray(rgb, np.float32), (count, 1)),
        transparency=np.full(count, clear, np.float32),
        reflectance=np.zeros(count, np.float32),
        label=np.full(count, WATER_LABEL),
    )


FOV_Y = math.radians(32.0)
"""Field of view across a picture's height."""
FRAMING_MARGIN = 1.03
"""Factor on the distance at which the arena fills the picture."""


def camera_rays(eye: np.ndarray, target: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the directions of a picture's rays, row by row from the top (height * width, 3)."""
    right, up, forward = camera_axes(eye - target)
    scale = 2 * math.tan(FOV_Y / 2) / height
    # Through the middles of pixels.
    x = (np.arange(width) - (width - 1) / 2) * scale
    y = ((height - 1) / 2 - np.arange(height)) * scale
    rays = forward + x[None, :, None] * right + y[:, None, None] * up
    return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3).astype(np.float32)


def camera_axes(back: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a picture's axes right, up, forward (3,) from the direction of the eye, seen from its middle."""
    forward = -back / np.linalg.norm(back)
    # Not for a view straight down, whose cross product with the vertical is 0.
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return right, np.cross(right, forward), forward


def fit_camera(corners: np.ndarray, back: np.ndarray, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """Return from where corners fill a picture, and the picture's middle (3,) and (3,) [m].

    Args:
        corners: Points that shall be in the picture [m] (n, 3).
        back: Unit vector from the picture's middle to the eye (3,).
        aspect: Width of the picture over its height.
    """
    right, up, forward = camera_axes(back)
    slope = np.array([aspect, 1.0]) * math.tan(FOV_Y / 2)
    target, away = corners.mean(0), 0.0
    for _ in range(4):  # near corners take more of the picture than far ones: move the middle a little
        seen, deep = (corners - target) @ np.stack([right, up], -1), (corners - target) @ forward
        away = float((np.abs(seen) / slope - deep[:, None]).max())
        on_screen = seen / (away + deep)[:, None]
        target = target + away * (on_screen.max(0) + on_screen.min(0)) / 2 @ np.stack([right, up])
    return target + FRAMING_MARGIN * away * back, target


def downsample(picture: np.ndarray) -> np.ndarray:
    """Return a picture half as wide and high (rows, columns, 3), each pixel the mean of four."""
    rows, columns, _ = picture.shape
    return picture.reshape(rows // 2, 2, columns // 2, 2, 3).mean((1, 3))


CHUNK = 65_536
"""Rays that are cast together."""


@dataclass(frozen=True, kw_only=True)
class Lighting:
    """Lighting of a picture, and the floor in it.

    Attributes:
        sun: Direction to the sun; need not be a unit vector.
        checker_size: Side of the floor's checkers [m].
        checker_extent: Part of the floor with them, as `ArenaSpec.extent` [m].
    """

    sun: Vec3 = SUN_DIRECTION
    checker_size: float = 0.5
    checker_extent: tuple[tuple[float, float], tuple[float, float]] = (
        (-math.inf, math.inf),
        (-math.inf, math.inf),
    )


DEFAULT_LIGHTING = Lighting()


def _render_scene(solids: RenderGeoms, setting: Lighting) -> RenderScene:
    """Return the scene of a picture.

    Raises:
        UnsupportedGeomError: A kind that no kernel can hit.
    """
    if unknown := sorted({int(kind) for kind in solids.kind} - set(RAY_KERNELS)):
        raise UnsupportedGeomError(f"no ray kernel for geoms of type {unknown}")
    material = np.where(
        solids.transparency > 0, GLASS, np.where(solids.reflectance > 0, MIRROR, OPAQUE)
    ).tolist()
    # `make_geoms` sorts by kind and material: colours must follow in the same order.
    order = np.concatenate([np.zeros(0, int), *indices_by_key(solids.kind, material).values()])
    owner = np.full(len(solids), -1)
    geoms = make_geoms(solids.kind, solids.pos, solids.mat, solids.size, owner, material)
    appearance = GeomAppearance(
        rgb=solids.rgb[order],
        transparency=solids.transparency[order],
        reflectance=solids.reflectance[order],
        label=solids.label[order],
    )
    return lit_scene(geoms, appearance, setting)


def lit_scene(geoms: Geoms, appearance: GeomAppearance, setting: Lighting) -> RenderScene:
    """Return a scene in some light, without lamps."""
    return RenderScene(
        geoms=geoms,
        appearance=appearance,
        sun_direction=np.array(setting.sun, np.float32) / np.float32(np.linalg.norm(setting.sun)),
        lights=point_lights((), 0.0),
        headlights=no_headlights(),
        checker_size=np.array(setting.checker_size, np.float32),
        checker_bounds=np.array(setting.checker_extent, np.float32),
    )


@jax.jit
def _shade(render_scene: RenderScene, start: jax.Array, direction: jax.Array) -> jax.Array:
    # A picture has no camera on a robot, whose own body rays would leave out.
    return jnp.asarray(shade(render_scene, start, direction, jnp.asarray(EXCLUDE_NONE)).rgb)


def render_picture(
    solids: RenderGeoms,
    eye: np.ndarray,
    target: np.ndarray,
    width: int,
    height: int,
    lighting: Lighting = DEFAULT_LIGHTING,
) -> np.ndarray:
    """Return a picture (height, width, 3) with values in [0, 1].

    Args:
        solids: The geoms.
        eye: Position of the viewer (3,) [m].
        target: Centre of the picture (3,) [m].
        width: Pixels along a row.
        height: Rows.
        lighting: Light and floor.

    Raises:
        UnsupportedGeomError: A geom type that rays cannot hit.
    """
    render_scene = _render_scene(solids, lighting)
    rows = camera_rays(eye, target, width, height).reshape(height, width, 3)
    # Whole tiles: rays are traced tile by tile, as neighbours hit the same few solids.
    room = ((0, -height % TILE), (0, -width % TILE), (0, 0))
    rays = to_tiles(np.pad(rows, room, mode="edge"))
    chunk = min(CHUNK, len(rays))
    # Filled up: a last chunk of another size would be compiled by itself.
    padded = np.concatenate([rays, np.repeat(rays[-1:], -len(rays) % chunk, 0)])
    start = jnp.asarray(np.broadcast_to(np.asarray(eye, np.float32), (chunk, 3)))
    parts = map(jnp.asarray, padded.reshape(-1, chunk, 3))
    seen = [np.asarray(_shade(render_scene, start, part)) for part in parts]
    return np.asarray(from_tiles(jnp.asarray(np.concatenate(seen)[: len(rays)]), width, height))
