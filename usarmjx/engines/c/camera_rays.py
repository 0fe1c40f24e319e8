"""Camera rays in one world of C MuJoCo, without compilation.

Rays from one point are cast together, also shadow rays, against the direction of the light: from the light's
position, or for the sun from a distant point. Mirror reflections are cast one by one. Camera rays meet the
visual meshes of robots and victims, each in a model of its own, instead of the collision solids that sensors'
rays meet: the world's model contains no visuals.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np

from usarmjx.base.backend import Array, numpy_backend
from usarmjx.engines.c.rays import HIDDEN_GROUP, MIN_COSINE, SPHERE_MARGIN, CRayCaster, nearest_in_block
from usarmjx.models.compile.visuals import VisualModel
from usarmjx.models.types.shapes import GLASS, OPAQUE
from usarmjx.sensors.cameras.casters import SOLID_QUERY, Beams, RayHits
from usarmjx.sensors.cameras.paint import PLANE, ROBOT_LABEL, GeomAppearance
from usarmjx.sensors.cameras.picture import NO_ROBOT, Picture, Viewpoint, render_picture
from usarmjx.sensors.cameras.shading import RenderScene
from usarmjx.sensors.rays.raycast import RayQuery
from usarmjx.sensors.rays.targets import GeomBlock

BUNDLE_SIZE = 512
"""Rays per cone test."""
SUN_DISTANCE = 1e5
"""Distance of the point that stands for the sun [m]: rays within 100 m are parallel up to 1e-3."""
BOX_GEOM = int(mujoco.mjtGeom.mjGEOM_BOX)
NO_GEOMS = np.zeros(0, int)
"""Empty array of geom ids."""


@dataclass(frozen=True, eq=False)
class AttachedVisual:
    """Visual meshes attached to frames of the model.

    Attributes:
        figure: The visual meshes.
        frames: Ids of the model's bodies (or geoms) that carry its frames (frames,).
        of_geoms: Whether the frames are geoms: victims' boxes.
        label: Segmentation label, see `cameras.paint`.
        slot: The robot's slot; `NO_ROBOT`: not a robot.
    """

    figure: VisualModel
    frames: np.ndarray
    of_geoms: bool
    label: int
    slot: int = NO_ROBOT

    def posed(self, data: mujoco.MjData, first: int) -> "CameraTarget":
        """Return the target at a world's state; its geom ids start at `first`."""
        places, turns = (data.geom_xpos, data.geom_xmat) if self.of_geoms else (data.xpos, data.xmat)
        model = self.figure.model.__copy__()  # casting changes the geom groups
        here = mujoco.MjData(model)
        # Frames are mocap bodies: a new pose needs no joints and no new model.
        here.mocap_pos[:] = places[self.frames]
        for quat, mat in zip(here.mocap_quat, turns[self.frames], strict=True):
            mujoco.mju_mat2Quat(quat, mat)
        mujoco.mj_kinematics(model, here)
        caster = CRayCaster(model, here, [OPAQUE] * model.ngeom, {})
        return CameraTarget(
            caster, here.geom_xpos.copy(), model.geom_rbound + SPHERE_MARGIN, first, self.slot
        )


class ConeBundles(NamedTuple):
    """Rays from one point in consecutive bundles, each within a cone.

    Attributes:
        start: The point [m] (3,).
        bounds: First ray of each bundle, then the number of rays (bundles_and_end,).
        axis: Unit vectors along the cones (bundles, 3).
        cosine: Cosine of the cones' half angles (bundles, 1).
        sine: Sine of the cones' half angles (bundles, 1).
    """

    start: np.ndarray
    bounds: np.ndarray
    axis: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray

    @classmethod
    def of(cls, start: np.ndarray, along: np.ndarray) -> "ConeBundles":
        """Return the bundles of unit vectors (rays, 3) from a point (3,)."""
        # Consecutive rays are neighbours in the picture: their cones are narrow.
        bounds = np.append(np.arange(0, len(along), BUNDLE_SIZE), len(along))
        axis = np.add.reduceat(along, bounds[:-1])
        axis /= np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-9)
        ahead = (along * axis.repeat(np.diff(bounds), 0)).sum(-1)
        cosine = np.minimum.reduceat(ahead, bounds[:-1])[:, None]
        return cls(start, bounds, axis, cosine, np.sqrt(np.maximum(1 - cosine * cosine, 0.0)))

    def near(self, centre: np.ndarray, radius: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Return which cones meet which balls within their reach [m] (bundles,): (bundles, balls)."""
        way = centre - self.start
        square = (way * way).sum(-1)
        ahead = self.axis @ way.T
        aside = np.sqrt(np.maximum(square - ahead * ahead, 0.0))
        # The distance of the ball's middle from the cone's side; wide cones are not tested, and meet all.
        outside = (aside * self.cosine - ahead * self.sine > radius) & (self.cosine > MIN_COSINE)
        return ~outside & (np.sqrt(square) - radius <= reach[:, None])


class CameraTarget:
    """Model that camera rays are cast at, culled by bounding balls.

    Args:
        caster: Ray caster of the model.
        centre: Centres of the geoms' bounding balls [m] (geoms, 3).
        radius: Their radii; infinite for unbounded geoms [m] (geoms,).
        first: Id of its first geom among all visible geoms.
        slot: The robot's slot, or `NO_ROBOT`.
    """

    def __init__(
        self, caster: CRayCaster, centre: np.ndarray, radius: np.ndarray, first: int, slot: int = NO_ROBOT
    ) -> None:
        self._caster, self._centre, self._radius, self._first, self.slot = caster, centre, radius, first, slot
        self._middle = (centre.min(0) + centre.max(0))[None] / 2
        # Infinite with a plane, which has no bound: such a target is in every bundle's way.
        self._ball = (np.linalg.norm(centre - self._middle, axis=-1) + radius).max(keepdims=True)

    def keep_closer(
        self,
        bundles: ConeBundles,
        along: np.ndarray,
        query: RayQuery,
        hidden: np.ndarray,
        hits: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        """Replace hits of rays by hits of this target where they are closer.

        Args:
            bundles: The rays.
            along: Unit vectors (rays, 3).
            query: Materials that the rays pass.
            hidden: Geoms of this target that they pass (n,).
            hits: Distances [m] (rays,), normals (rays, 3) and geoms (rays,); changed in place.
        """
        # The farthest hit so far of each bundle: what is behind it changes nothing.
        reach = np.maximum.reduceat(hits[0], bundles.bounds[:-1])
        # The ball around the whole first: most robots are in few bundles' way.
        if not bundles.near(self._middle, self._ball, reach).any():
            return
        shown = bundles.near(self._centre, self._radius, reach)
        shown[:, hidden] = False
        for number in np.flatnonzero(shown.any(1)).tolist():
            rays = slice(bundles.bounds[number], bundles.bounds[number + 1])
            start = np.broadcast_to(bundles.start, along[rays].shape)
            # Geoms outside the cone are hidden, too: MuJoCo then tests few geoms for each ray.
            found = self._caster.hit_geoms(start, along[rays], query, np.flatnonzero(~shown[number]))
            self._keep(rays, found, hits)

    def keep_closer_each(
        self,
        start: np.ndarray,
        along: np.ndarray,
        query: RayQuery,
        hits: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        """As `keep_closer`, for rays with individual starts (rays, 3)."""
        way = self._middle - start
        ahead, square = (along * way).sum(-1), (way * way).sum(-1)
        aside = np.sqrt(np.maximum(square - ahead * ahead, 0.0))
        rays = np.flatnonzero((aside <= self._ball) & (ahead + self._ball >= 0))
        if len(rays):
            found = self._caster.hit_geoms(start[rays], along[rays], query, np.zeros(0, int))
            self._keep(rays, found, hits)

    def _keep(
        self,
        rays: slice | np.ndarray,
        found: tuple[np.ndarray, np.ndarray, np.ndarray],
        hits: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        """Write hits that are closer than the previous ones."""
        better = found[0] < hits[0][rays]
        # `rays` is a slice or an array: either way these are places in the arrays of all rays.
        places = np.arange(len(hits[0]))[rays][better]
        for column, own in zip(hits, found, strict=True):
            column[places] = own[better]
        # Geoms of each model begin at 0; pictures number those of all models through.
        hits[2][places] += self._first


@dataclass(frozen=True, eq=False)
class GeomColors:
    """Appearance of a model's geoms, of water and of visual meshes, which are not geoms of it.

    Attributes:
        appearance: Appearance of the model's geoms in their order, then of the water, then of the visuals.
        materials: Materials of the model's geoms (ngeom,); see `models.compile.compose`.
        water: Bodies of water, boxes with the material glass.
        figures: Visual meshes of robots and victims.
        replaced: Geoms of the model that these visuals replace (n,).
    """

    appearance: GeomAppearance
    materials: Sequence[str]
    water: GeomBlock
    figures: Sequence[AttachedVisual]
    replaced: np.ndarray


class CCameraRays:
    """Snapshot of a world for cameras; may be used in another thread, one at a time.

    Args:
        model: The model; it is copied.
        data: Its state; positions are copied.
        looks: Its appearance.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, looks: GeomColors) -> None:
        # A copy: the world goes on, and casting changes the groups of geoms.
        self.model, self.looks = model.__copy__(), looks
        # All that `mj_kinematics` reads.
        self._places = {name: getattr(data, name).copy() for name in ("qpos", "mocap_pos", "mocap_quat")}

    @cached_property
    def _data(self) -> mujoco.MjData:
        data = mujoco.MjData(self.model)
        for name, values in self._places.items():
            getattr(data, name)[:] = values
        mujoco.mj_kinematics(self.model, data)
        return data

    @cached_property
    def targets(self) -> list[CameraTarget]:
        """Ray targets, built at the first use in the thread of that use."""
        data, model = self._data, self.model
        caster = CRayCaster(model, data, self.looks.materials, {})
        model.geom_group[self.looks.replaced] = HIDDEN_GROUP
        radius = np.where(
            model.geom_rbound > 0, model.geom_rbound + SPHERE_MARGIN, np.inf
        )  # planes have no bound
        found, first = [CameraTarget(caster, data.geom_xpos.copy(), radius, 0)], model.ngeom
        # Water is no target here, but has its numbers between the model's geoms and the visuals'.
        first += len(self.looks.water.owner)
        for visual in self.looks.figures:
            found.append(visual.posed(data, first))
            first += visual.figure.model.ngeom
        return found

    @cached_property
    def frames(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions [m] (n, 3), orientations (n, 3, 3) and sizes (n, 3) of the model's geoms."""
        data, size = self._data, self.model.geom_size
        mat = data.geom_xmat.reshape(-1, 3, 3)
        return data.geom_xpos.astype(np.float32), mat.astype(np.float32), size.astype(np.float32)

    def render(self, render_scene: RenderScene, viewpoint: Viewpoint, width: int, height: int) -> Picture:
        """Render a camera's picture; light and floor are those of `render_scene`."""
        with numpy_backend():
            caster = self.camera(viewpoint.slot, viewpoint.hidden_geoms)
            return render_picture(render_scene, viewpoint, width, height, caster)

    def camera(self, slot: Array, hidden_geoms: Array) -> "CameraCaster":
        """Return the ray caster of one camera's pictures.

        Args:
            slot: Slot of the camera's robot, or any other number ().
            hidden_geoms: Geoms of that robot hidden from the camera; see `picture.Viewpoint` (geoms,).
        """
        # A camera of no robot hides nothing, though victims' figures have that slot, too.
        figures = [one.figure for one in self.looks.figures if one.slot == slot != NO_ROBOT]
        geom_of = figures[0].geom_of if figures else NO_GEOMS
        # Masks are padded to a whole multiple, see `Viewpoint`.
        hidden = np.unique(geom_of[np.asarray(hidden_geoms)[: len(geom_of)]])
        return CameraCaster(self, int(slot), hidden)


class CameraCaster:
    """Ray caster of one camera's pictures: a `cameras.casters.Caster`.

    Args:
        camera_rays: The world.
        slot: Slot of the camera's robot.
        hidden: Geoms of that robot's visuals hidden from the camera (n,).
    """

    def __init__(self, camera_rays: CCameraRays, slot: int, hidden: np.ndarray) -> None:
        (self._world, *self._figures), self._looks = camera_rays.targets, camera_rays.looks
        self._slot, self._hidden, self._camera_rays = slot, hidden, camera_rays
        rest = np.zeros(len(camera_rays.looks.appearance.label) - camera_rays.model.ngeom, bool)
        self.is_plane = np.concatenate([camera_rays.model.geom_type == PLANE, rest])

    @property
    def appearance(self) -> GeomAppearance:
        """Appearance of geoms, water and visuals."""
        return self._looks.appearance

    @property
    def materials(self) -> Collection[str]:
        """Materials that occur."""
        water, figures = [GLASS] * len(self._looks.water.owner), [OPAQUE] * len(self._figures)
        return {*self._looks.materials, *water, *figures}

    def from_camera(self, origin: Array, direction: Array, query: RayQuery) -> RayHits:
        """Cast the camera's own rays (rays, 3), which pass the geoms that cover the lens."""
        start, along = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        distance, geom, normal = self._meet(start, along, query)
        # Water is glass, which rays in search of solids pass.
        water = self._looks.water
        if GLASS in query.transparent or not len(water.owner):
            return RayHits(distance, geom, normal)
        reach, which, its_normal = nearest_in_block(BOX_GEOM, water, start, along)
        closer = reach < distance
        return RayHits(
            distance=np.where(closer, reach, distance).astype(np.float32),
            geom_index=np.where(closer, len(self._looks.materials) + which, geom),
            normal=np.where(closer[:, None], _towards(its_normal, along), normal),
        )

    def from_surfaces(self, origin: Array, direction: Array, wanted: Array) -> RayHits:
        """Cast mirror reflections (rays, 3) at solids; only the wanted ones (rays,)."""
        count, rays = len(origin), np.flatnonzero(wanted)
        start, along = (np.asarray(x, np.float64)[rays] for x in (origin, direction))
        # Incidence only for the normals, which MuJoCo computes on request.
        hits, query = _no_hits(len(rays)), SOLID_QUERY.replace(incidence=True)
        for target in (self._world, *self._figures):
            target.keep_closer_each(start, along, query, hits)
        distance, geom = np.full(count, np.inf, np.float32), np.full(count, -1)
        normal = np.zeros((count, 3), np.float32)
        distance[rays], geom[rays], normal[rays] = hits[0], hits[2], _towards(hits[1], along)
        return RayHits(distance, geom, normal)

    def is_dark(self, beams: Beams) -> Array:
        """Return which wanted rays to a light source are blocked (rays,)."""
        dark = np.zeros(len(beams.wanted), bool)
        for source in np.unique(beams.source[beams.wanted]).tolist():
            rays = np.flatnonzero(beams.wanted & (beams.source == source))
            point, own = np.asarray(beams.point, np.float64)[:, rays].T, NO_ROBOT
            if source < 0:
                # From the middle of the points: there the rays of a near picture differ
                # least from parallel ones.
                light = point.mean(0) + SUN_DISTANCE * np.asarray(beams.sun, np.float64)
            else:
                light = np.asarray(beams.pos[source], np.float64)
                if beams.carrier is not None:
                    own = int(beams.carrier[source]) - ROBOT_LABEL
            # Cast from the light: all shadow rays of one light share an origin, and so form bundles.
            way = point - light
            distance = np.sqrt((way * way).sum(-1))
            along, query = way / distance[:, None], SOLID_QUERY.replace(incidence=False)
            bundles, hits = ConeBundles.of(light, along), _no_hits(len(rays))
            # Only what is nearer to the light than the surface shades it.
            hits[0][:] = distance
            # A headlight sits in or on its robot, which would keep all of its light.
            for target in (self._world, *self._figures):
                if own == NO_ROBOT or target.slot != own:
                    target.keep_closer(bundles, along, query, NO_GEOMS, hits)
            dark[rays] = hits[2] >= 0
        return dark

    def normals(self, hits: RayHits, origin: Array, direction: Array) -> Array:
        """Return the unit normals at the hits, towards the ray origins (rays, 3)."""
        del origin, direction  # the hits contain the normals
        assert hits.normal is not None
        return hits.normal

    def frames(self, which: Array) -> tuple[Array, Array, Array]:
        """Return poses and sizes of the model's geoms; arbitrary ones for water and visuals (no signs)."""
        pos, mat, size = self._camera_rays.frames
        place = np.minimum(which, len(pos) - 1)
        return pos[place], mat[place], size[place]

    def _meet(
        self, start: np.ndarray, along: np.ndarray, query: RayQuery
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distances (rays,), geoms (rays,) and normals towards the ray origins (rays, 3)."""
        query, hits = query.replace(incidence=True), _no_hits(len(start))
        # Nothing in the model stops rays that pass all of its materials.
        targets = [self._world] if set(self._looks.materials) - query.transparent else []
        targets += self._figures if OPAQUE not in query.transparent else []
        turns = (
            np.flatnonzero((start[1:] != start[:-1]).any(-1)) + 1
        )  # ray origins change, between the two lenses of a stereo camera
        for first, end in pairwise([0, *turns.tolist(), len(start)]):
            bundles = ConeBundles.of(start[first], along[first:end])
            rays = hits[0][first:end], hits[1][first:end], hits[2][first:end]
            for target in targets:
                hidden = self._hidden if target.slot == self._slot != NO_ROBOT else NO_GEOMS
                target.keep_closer(bundles, along[first:end], query, hidden, rays)
        distance, normal, geom = hits
        return distance.astype(np.float32), geom, _towards(normal, along)


def _no_hits(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the result of `count` rays without hits: distances, normals and geoms."""
    return np.full(count, np.inf), np.zeros((count, 3)), np.full(count, -1, np.int32)


def _towards(normal: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Flip normals (rays, 3) towards the ray origins."""
    away = (normal * along).sum(-1, keepdims=True) > 0
    return np.where(away, -normal, normal).astype(np.float32)
