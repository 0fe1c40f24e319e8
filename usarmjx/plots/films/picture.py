"""Pictures of a film and of robots' cameras: nearest triangles by `raster`, shaded as cameras see."""

import math
from collections.abc import Collection, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.backend import Array
from usarmjx.base.errors import UsageError
from usarmjx.models.types.shapes import GLASS, MIRROR, OPAQUE
from usarmjx.plots.films.overlays import Overlay
from usarmjx.plots.films.raster import Canvas, FilmView, ShadowMap, Solids, SunView, solids_of
from usarmjx.plots.gallery import CHECKER_SIZES, MAX_CHECKERS, SUN
from usarmjx.plots.render import Lighting, lit_scene
from usarmjx.recording.reader import CameraShot, Recording
from usarmjx.recording.source import RecordingSource
from usarmjx.sensors.cameras.casters import Beams, RayHits
from usarmjx.sensors.cameras.paint import GeomAppearance
from usarmjx.sensors.cameras.shading import RenderScene, shade
from usarmjx.sensors.rays.raycast import EXCLUDE_NONE, RayQuery
from usarmjx.sensors.rays.targets import Geoms
from usarmjx.server.protocol.images import format_number, jpeg
from usarmjx.view.drawing import Drawing, DrawnMount, Frame
from usarmjx.view.viewpoint import bounds_of

SHADOW_SIDES, WIDE = (2048, 4096), 60.0
"""Texels along a side of the shadow map, of small and of wide arenas, and the size of those [m]."""
STILL_BODIES = ("arena", "victims", "false alarms", "water")
"""Bodies of a drawing that never move."""
SAMPLES = 2
"""Samples along a side of a pixel."""
SHADOW_BIAS = 2.5
"""Depth below which a surface shadows no other [texels]."""
CHUNK = 1 << 17
"""Samples that are shaded together."""
SIZE = 320, 240
"""Width and height of a picture [pixels], those of ROS topics of a served world."""
QUALITY = format_number("good")
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Axes of an optical frame in those of a camera, which has x ahead and z up, as columns."""
MIN_PERIOD = 0.02
"""Shortest interval between two pictures of a camera [s]."""


class Table(struct.PyTreeNode, kw_only=True):
    """Triangles as the shader needs them.

    Attributes:
        corner: First corners [m] (n, 3).
        dual: Vectors whose products with a point give its second and third barycentric coordinates (n, 2, 3).
        normals: Normals at the corners (n, 3, 3).
        appearance: Appearance of each.
        is_floor: Which are the floor (n,).
    """

    corner: Array
    dual: Array
    normals: Array
    appearance: GeomAppearance
    is_floor: Array


class RasterCaster:
    """Ray caster whose hits are known: a `cameras.casters.Caster`.

    Args:
        table: The triangles.
        solid: Nearest opaque triangle of each ray, and its distance [m].
        pane: Likewise for panes of glass.
        shadows: The shadow map.
        materials: Materials that occur.
    """

    def __init__(
        self,
        table: Table,
        solid: RayHits,
        pane: RayHits,
        shadows: ShadowMap,
        materials: Collection[str],
    ) -> None:
        self._table, self._solid, self._pane, self._shadows = table, solid, pane, shadows
        self.appearance, self.materials = table.appearance, materials

    @property
    def is_plane(self) -> Any:  # noqa: ANN401 - traced here, an array elsewhere
        """Mask of the floor (n,)."""
        return self._table.is_floor

    def from_camera(self, origin: Array, direction: Array, query: RayQuery) -> RayHits:
        """Return the known hits."""
        del origin, direction
        # The shader asks for solids behind glass with glass transparent, and for the panes otherwise.
        return self._solid if GLASS in query.transparent else self._pane

    def from_surfaces(self, origin: Array, direction: Array, wanted: Array) -> RayHits:
        """Return no hits: mirrors show the sky."""
        del direction, wanted
        count = len(origin)
        return RayHits(jnp.full(count, jnp.inf), jnp.full(count, -1))

    def is_dark(self, beams: Beams) -> Array:
        """Return which points are in the sun's shadow, by the shadow map."""
        held = self._shadows
        local = (jnp.asarray(beams.point).T - held.middle) @ held.axes
        side = held.side
        x, y = side / 2 + local[:, 0] * held.scale - 0.5, side / 2 - local[:, 1] * held.scale - 0.5
        column, row = jnp.floor(x).astype(int), jnp.floor(y).astype(int)
        inside = (column >= 0) & (column < side - 1) & (row >= 0) & (row < side - 1)
        first = jnp.where(inside, row * side + column, 0)
        # Without the bias a surface would shadow itself: a texel has one depth for a whole square of it.
        lowest = held.reach - local[:, 2] + SHADOW_BIAS / held.scale
        right, down = x - column, y - row
        # Between four texels the border of a shadow is a line, not a staircase.
        share = jnp.zeros(len(x))
        for step, weight in (
            (0, (1 - right) * (1 - down)),
            (1, right * (1 - down)),
            (side, (1 - right) * down),
            (side + 1, right * down),
        ):
            share += weight * (jnp.asarray(held.nearness)[first + step] > lowest)
        return inside & (share > 0.5)

    def normals(self, hits: RayHits, origin: Array, direction: Array) -> Array:
        """Return unit normals at the hits, interpolated between corners, towards the rays (rays, 3)."""
        # Rays without a hit have -1, which would read the last triangle; they are masked below.
        which = jnp.maximum(jnp.asarray(hits.geom_index), 0)
        there = hits.geom_index >= 0
        reach = jnp.where(there, hits.distance, 0.0)[:, None]
        offset = jnp.asarray(origin) + reach * direction - self._table.corner[which]
        second, third = jnp.clip(
            jnp.moveaxis((self._table.dual[which] * offset[:, None]).sum(-1), -1, 0), 0, 1
        )
        # Clipped: a sample at an edge lies a little outside of its triangle.
        share = jnp.stack([jnp.maximum(1 - second - third, 0.0), second, third], -1)
        normal = (jnp.asarray(self._table.normals)[which] * share[..., None]).sum(1)
        normal = normal / jnp.maximum(jnp.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        # Panes and fenders are seen from behind, too, where their normals point away.
        away = (normal * direction).sum(-1, keepdims=True) > 0
        return jnp.where(there[:, None], jnp.where(away, -normal, normal), 0.0)

    def frames(self, which: Array) -> tuple[Array, Array, Array]:
        """Refuse: triangles have no textures."""
        raise NotImplementedError


class Lens(struct.PyTreeNode, kw_only=True):
    """A `FilmView` as numbers for the shader."""

    eye: Array
    axes: Array
    focal: Array
    middle: Array
    width: Array


# Static, as the materials decide which parts of the shader are traced at all.
@partial(jax.jit, static_argnames="materials")
def _shade(
    scene: RenderScene,
    table: Table,
    shadows: ShadowMap,
    lens: Lens,
    pixel: jax.Array,
    hits: tuple[jax.Array, ...],
    materials: tuple[str, ...],
) -> jax.Array:
    """Return the colours of pixels, 0 to 255 (pixels, 3)."""
    x = (pixel % lens.width + 0.5 - lens.middle[0]) / lens.focal
    y = (lens.middle[1] - pixel // lens.width - 0.5) / lens.focal
    right, up, ahead = jnp.asarray(lens.axes).T
    ray = ahead + x[:, None] * right + y[:, None] * up
    length = jnp.linalg.norm(ray, axis=-1, keepdims=True)
    solid, pane = (
        # Nearness is 1 / depth, and the ray has a depth of 1.
        RayHits(jnp.where(triangle >= 0, length[:, 0] / jnp.maximum(near, 1e-9), jnp.inf), triangle)
        for triangle, near in (hits[:2], hits[2:])
    )
    caster = RasterCaster(table, solid, pane, shadows, materials)
    start = jnp.broadcast_to(lens.eye, ray.shape)
    seen = shade(scene, start, ray / length, jnp.asarray(EXCLUDE_NONE), caster)
    # As `mounts.quantize`: `round` would round halves to even.
    return jnp.floor(255 * seen.rgb + 0.5).astype(jnp.uint8)


class FilmScene:
    """A drawing, ready to be rendered frame by frame.

    What does not move is rasterized and shaded again only when the view changes.

    Args:
        drawing: The drawing.

    Attributes:
        bounds: Least and largest x, y and z of what does not move [m].
    """

    def __init__(self, drawing: Drawing) -> None:
        self._solids = of = solids_of(drawing)
        still = [body.name in STILL_BODIES for body in drawing.bodies]
        # The floor's body is -1, which indexes what is appended.
        self._still = np.append(still, True)[of.body]
        self._clear = of.transparency > 0
        self.bounds = bounds_of(drawing)
        low, high = self.bounds
        side = SHADOW_SIDES[bool(np.linalg.norm(high - low) > WIDE)]
        self._sun = SunView.over(low, high, np.array(SUN), side)
        # Drawings of similar size share a compiled program.
        self._padding = (1 << max(0, len(of) - 1).bit_length()) - len(of)
        self._appearance = jax.tree.map(self._padded, _appearance(of))
        self._is_floor = self._padded(of.is_floor)
        nothing = Geoms(blocks=(), kinds=(), materials=())
        self._scene = lit_scene(nothing, self._appearance, _lighting(drawing))
        made_of: set[str] = {OPAQUE} | ({GLASS} if self._clear.any() else set())
        self._materials = tuple(sorted(made_of | ({MIRROR} if (of.reflectance > 0).any() else set())))
        self._shadow: Canvas | None = None
        self._base: _Base | None = None

    def render(
        self, frame: Frame, view: FilmView, overlays: Sequence[Overlay] = (), *, keep: bool = False
    ) -> np.ndarray:
        """Return colours, 0 to 255 uint8 (height, width, 3).

        Each pixel is the mean of `SAMPLES` by `SAMPLES`; of a pixel within a triangle one is shaded, unless
        the view is kept.

        Args:
            frame: The frame.
            view: The view.
            overlays: Signs without light and shadow that are drawn over it, the last one over the others.
            keep: Whether the next frame has the same view.
        """
        large = view.enlarged(SAMPLES)
        corners, normals, shown = self._solids.at(frame)
        moving = shown & ~self._still
        shadow, table = self._shadow_canvas(corners, shown, moving), self._table(corners, normals)
        if keep and (self._base is None or not large.same_as(self._base.view)):
            self._base = self._new_base(large, corners, normals, shown)
        base = self._base if keep else None
        canvas = self._canvas(large, corners, shown & self._still) if base is None else base.canvas.copy()
        self._draw(canvas, large, corners, moving & ~self._clear)
        panes = self._panes(large, corners, shown) if self._clear.any() else None
        if base is None:
            rgb = self._shade_edges(large, canvas, panes, table, shadow)
        else:
            pixels = base.changed(canvas, panes, shadow)
            rgb = base.rgb.copy()
            rgb[pixels] = self._shaded(large, canvas, panes, table, shadow, pixels)
        for overlay in overlays:
            overlay.mix(rgb, canvas, large)
        return _mean(rgb.reshape(large.height, large.width, 3))

    def _new_base(
        self, view: FilmView, corners: np.ndarray, normals: np.ndarray, shown: np.ndarray
    ) -> "_Base":
        """Return what does not move, rasterized and shaded."""
        # `render` draws the shadows before it needs a base.
        assert self._shadow is not None
        canvas = self._canvas(view, corners, shown & self._still)
        panes = self._panes(view, corners, shown & self._still) if self._clear.any() else None
        pixels = np.arange(len(canvas.keys))
        rgb = self._shaded(view, canvas, panes, self._table(corners, normals), self._shadow, pixels)
        return _Base(view, canvas, panes, self._shadow, self._sun.texels(view, canvas), rgb)

    def _canvas(self, view: FilmView, corners: np.ndarray, which: np.ndarray) -> Canvas:
        canvas = Canvas(view.width, view.height)
        self._draw(canvas, view, corners, which & ~self._clear)
        return canvas

    def _panes(self, view: FilmView, corners: np.ndarray, shown: np.ndarray) -> Canvas:
        canvas = Canvas(view.width, view.height)
        self._draw(canvas, view, corners, shown & self._clear)
        return canvas

    def _draw(self, canvas: Canvas, view: FilmView, corners: np.ndarray, which: np.ndarray) -> None:
        """Draw triangles, without those of closed solids that show their back."""
        rows = np.flatnonzero(which)
        here = corners[rows]
        # Corners are counter-clockwise from outside, also after a rotation.
        outward = np.cross(here[:, 1] - here[:, 0], here[:, 2] - here[:, 0])
        front = ((view.eye - here[:, 0]) * outward).sum(-1) > 0
        rows = rows[front | self._solids.two_sided[rows]]
        view.draw(canvas, corners[rows], rows)

    def _shade_edges(
        self, view: FilmView, canvas: Canvas, panes: Canvas | None, table: Table, shadow: Canvas
    ) -> np.ndarray:
        """Shade one sample of each pixel within a triangle, and all of the others (samples, 3)."""
        keys = canvas.surface().triangle.reshape(view.height, view.width)
        first = keys[::SAMPLES, ::SAMPLES]
        same = np.ones(first.shape, bool)
        for row in range(SAMPLES):
            for column in range(SAMPLES):
                same &= keys[row::SAMPLES, column::SAMPLES] == first
        wanted = np.repeat(np.repeat(~same, SAMPLES, 0), SAMPLES, 1)
        # One sample of each pixel is shaded in any case: the others may copy it.
        wanted[::SAMPLES, ::SAMPLES] = True
        pixels = np.flatnonzero(wanted)
        rgb = np.zeros((view.height, view.width, 3), np.uint8)
        rgb.reshape(-1, 3)[pixels] = self._shaded(view, canvas, panes, table, shadow, pixels)
        once = rgb[::SAMPLES, ::SAMPLES].copy()
        for row in range(SAMPLES):
            for column in range(SAMPLES):
                np.copyto(rgb[row::SAMPLES, column::SAMPLES], once, where=same[..., None])
        return rgb.reshape(-1, 3)

    def _shaded(
        self,
        view: FilmView,
        canvas: Canvas,
        panes: Canvas | None,
        table: Table,
        shadow: Canvas,
        pixels: np.ndarray,
    ) -> np.ndarray:
        """Return the colours of some samples (samples, 3)."""
        surface = canvas.surface()
        none = np.full(len(pixels), -1, np.int32), np.zeros(len(pixels), np.float32)
        columns = [
            pixels.astype(np.int32),
            *(column[pixels] for column in surface),
            *(none if panes is None else (column[pixels] for column in panes.surface())),
        ]
        held, lens, parts = self._sun.numbers(shadow), _lens(view), [np.zeros((0, 3), np.uint8)]
        for first in range(0, len(pixels), CHUNK):
            part = [column[first : first + CHUNK] for column in columns]
            # Filled up to one size, so that one program shades all parts.
            missing = CHUNK - len(part[0])
            pixel, *hits = (jnp.asarray(np.pad(column, (0, missing), mode="edge")) for column in part)
            rgb = _shade(self._scene, table, held, lens, pixel, tuple(hits), self._materials)
            parts.append(np.asarray(rgb)[: CHUNK - missing])
        return np.concatenate(parts)

    def _shadow_canvas(self, corners: np.ndarray, shown: np.ndarray, moving: np.ndarray) -> Canvas:
        cast = ~self._clear & ~self._solids.is_floor
        # Shadows of what stands still are drawn once; each frame adds what moves to a copy.
        if self._shadow is None:
            self._shadow = Canvas(self._sun.side, self._sun.side)
            rows = np.flatnonzero(shown & self._still & cast)
            self._sun.draw(self._shadow, corners[rows], rows)
        canvas, rows = self._shadow.copy(), np.flatnonzero(moving & cast)
        self._sun.draw(canvas, corners[rows], rows)
        return canvas

    def _table(self, corners: np.ndarray, normals: np.ndarray) -> Table:
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        across = np.cross(first, second)
        # Triangles without an area would divide by 0.
        square = np.maximum((across * across).sum(-1, keepdims=True), 1e-18)
        dual = np.stack([np.cross(second, across), np.cross(across, first)], 1) / square[:, None]
        return Table(
            corner=self._padded(corners[:, 0].astype(np.float32)),
            dual=self._padded(dual.astype(np.float32)),
            normals=self._padded(normals.astype(np.float32)),
            appearance=self._appearance,
            is_floor=self._is_floor,
        )

    def _padded(self, column: np.ndarray) -> np.ndarray:
        return np.pad(column, [(0, self._padding), *[(0, 0)] * (column.ndim - 1)])


class _Base(NamedTuple):
    """Part of a picture that does not move, in a view that stays.

    Attributes:
        view: The view.
        canvas: Its solids.
        panes: Its panes of glass.
        shadow: Their shadows.
        texels: Index of each sample's texel in the shadow map; one past the end: none (samples,).
        rgb: Colours, 0 to 255 (samples, 3).
    """

    view: FilmView
    canvas: Canvas
    panes: Canvas | None
    shadow: Canvas
    texels: np.ndarray
    rgb: np.ndarray

    def changed(self, canvas: Canvas, panes: Canvas | None, shadow: Canvas) -> np.ndarray:
        """Return the indices of samples that look different now."""
        differ = canvas.keys != self.canvas.keys
        if panes is not None and self.panes is not None:
            differ |= panes.keys != self.panes.keys
        moved = (shadow.keys != self.shadow.keys).reshape(shadow.height, shadow.width)
        # The neighbours, too: shading mixes four texels.
        moved[:, :-1] |= moved[:, 1:]
        moved[:-1] |= moved[1:]
        moved[:, 1:] |= moved[:, :-1]
        moved[1:] |= moved[:-1]
        # The appended texel is that of samples without one.
        differ |= np.append(moved.reshape(-1), False)[self.texels]
        return np.flatnonzero(differ)


def _lens(view: FilmView) -> Lens:
    return Lens(
        eye=view.eye.astype(np.float32),
        axes=view.axes.astype(np.float32),
        focal=np.array(view.focal, np.float32),
        middle=np.array([view.width / 2, view.height / 2], np.float32),
        width=np.array(view.width, np.int32),
    )


def _mean(rgb: np.ndarray) -> np.ndarray:
    """Return the means of samples as pixels, uint8 (height, width, 3)."""
    # Sums of four bytes exceed a byte; half of the divisor below rounds to the nearest.
    total = np.zeros((rgb.shape[0] // SAMPLES, rgb.shape[1] // SAMPLES, 3), np.uint16)
    for row in range(SAMPLES):
        for column in range(SAMPLES):
            total += rgb[row::SAMPLES, column::SAMPLES]
    return ((total + SAMPLES * SAMPLES // 2) // (SAMPLES * SAMPLES)).astype(np.uint8)


def _appearance(of: Solids) -> GeomAppearance:
    return GeomAppearance(
        rgb=of.rgb, transparency=of.transparency, reflectance=of.reflectance, label=of.label
    )


def _lighting(drawing: Drawing) -> Lighting:
    """Return the sun's light, whatever lamps there are, and a floor with checkers below the arena."""
    (x0, x1), (y0, y1) = drawing.extent.tolist()
    longest = max(x1 - x0, y1 - y0)
    tile = next((size for size in CHECKER_SIZES if size * MAX_CHECKERS > longest), CHECKER_SIZES[-1])
    return Lighting(sun=SUN, checker_size=tile, checker_extent=((x0, x1), (y0, y1)))


def camera_shots(recording: Recording, period: float, world: int | None = None) -> Iterator[CameraShot]:
    """Yield a picture of each robot's pinhole cameras at every period, with their initial fields of view.

    Args:
        recording: The recording.
        period: Interval between two pictures of a camera [s].
        world: Number of its world; None: all.

    Raises:
        UsageError: A period below 0.02 s, no such world, or no frames.
    """
    if not period >= MIN_PERIOD:
        raise UsageError(f"pictures every {period:g} s; expected {MIN_PERIOD:g} or more")
    source = RecordingSource(recording)
    if world is not None and world not in source.worlds:
        raise UsageError(f"{recording.path}: has no world {world}")
    for index, number in enumerate(source.worlds):
        if world in (None, number):
            yield from _shots(source, index, number, period)


def _shots(source: RecordingSource, index: int, number: int, period: float) -> Iterator[CameraShot]:
    drawn: Drawing | None = None
    scene: FilmScene | None = None
    # A picture at the start, too.
    for step in range(math.floor((source.end - source.start) / period) + 1):
        source.seek(source.start + step * period)
        drawing, frame = source.drawing(index), source.frame(index)
        if scene is None or drawing is not drawn:
            drawn, scene = drawing, FilmScene(drawing)
        for slot in sorted(frame.robots):
            robot = drawing.robots.get(slot)
            for camera in robot.cameras if robot is not None else ():
                if camera.settings[0].get("lens") == "pinhole":
                    assert robot is not None
                    view = camera_view(camera, frame, SIZE)
                    quat = np.zeros(4)
                    # A view has right, up and ahead, which are left-handed; an optical frame has
                    # right, down and ahead.
                    mujoco.mju_mat2Quat(quat, (view.axes * [1.0, -1.0, 1.0]).ravel())
                    yield CameraShot(
                        time=source.time,
                        world=number,
                        robot=robot.name,
                        camera=camera.names[0],
                        pos=view.eye,
                        # Both signs are the same rotation: one of them makes equal poses equal numbers.
                        quat=quat if quat[0] >= 0 else -quat,
                        fov=float(camera.settings[0]["fov"]),
                        size=SIZE,
                        jpeg=jpeg(QUALITY, scene.render(frame, view)),
                    )


def camera_view(camera: DrawnMount, frame: Frame, size: tuple[int, int]) -> FilmView:
    """Return the view through a camera of a frame, with pictures of that width and height [pixels]."""
    body, turn = int(camera.body[0]), np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.asarray(frame.quat[body], float))
    mat = turn.reshape(3, 3)
    ahead = mat @ np.asarray(camera.mat[0], float) @ OPTICAL  # right, down, ahead
    # Fields of view of cameras are horizontal, that of the live page is vertical.
    focal = size[0] / 2 / math.tan(float(camera.settings[0]["fov"]) / 2)  # type: ignore[arg-type]
    eye = np.asarray(frame.pos[body], float) + mat @ np.asarray(camera.pos[0], float)
    return FilmView(eye, ahead * [1.0, -1.0, 1.0], focal, *size)
