"""What cameras see of a world on C MuJoCo at one moment: nothing is compiled for it.

Rays that start at one point are cast together. So are those from lights to surfaces, against the light, and
those from the sun, from a point that is far away. What mirrors throw back is cast one by one. In place of the
solids of robots and victims, which are the sensors', rays meet their figures, each in a model of its own: the
world's is compiled for nobody's looks.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import numpy_backend
from usarmjx.engines.c.rays import HIDDEN_GROUP, MARGIN, MIN_COSINE, CRayCaster, nearest_of_block
from usarmjx.models.compile.visuals import Figure
from usarmjx.models.types.shapes import GLASS, OPAQUE
from usarmjx.sensors.cameras.casters import SOLID_QUERY, Beams, RayHits
from usarmjx.sensors.cameras.paint import PLANE, ROBOT_LABEL, GeomAppearance
from usarmjx.sensors.cameras.picture import Picture, Viewpoint, render_picture
from usarmjx.sensors.cameras.shading import RenderScene
from usarmjx.sensors.rays.raycast import RayQuery
from usarmjx.sensors.rays.targets import GeomBlock

BUNDLE_SIZE = 512
"""Rays that are cast together at what comes near their cone."""
NOBODY = -1
"""Slot of what is no robot."""


@dataclass(frozen=True, eq=False)
class AttachedVisual:
    """A figure, and what it follows.

    Attributes:
        figure: What is drawn.
        frames: Ids of the model's bodies (or geoms) that its frames are (frames,).
        of_geoms: Whether they are geoms: victims' boxes.
        label: What it is in a segmentation, see `cameras.paint`.
        slot: The robot's slot; `NOBODY`: it is no robot.
    """

    figure: Figure
    frames: np.ndarray
    of_geoms: bool
    label: int
    slot: int = NOBODY

    def posed(self, data: mujoco.MjData, first: int) -> "CameraTarget":
        """Return it where a world's state has it; its geoms count from `first` among what can be seen."""
        places, turns = (data.geom_xpos, data.geom_xmat) if self.of_geoms else (data.xpos, data.xmat)
        model = self.figure.model.__copy__()  # groups of geoms change while rays are cast
        here = mujoco.MjData(model)
        here.mocap_pos[:] = places[self.frames]
        for quat, mat in zip(here.mocap_quat, turns[self.frames], strict=True):
            mujoco.mju_mat2Quat(quat, mat)
        mujoco.mj_kinematics(model, here)
        caster = CRayCaster(model, here, [OPAQUE] * model.ngeom, {})
        return CameraTarget(caster, here.geom_xpos.copy(), model.geom_rbound + MARGIN, first, self.slot)


class Bundles(NamedTuple):
    """Rays from one point, in bundles of some after the other, each in a cone.

    Attributes:
        start: The point [m] (3,).
        bounds: The first ray of each bundle, and how many rays there are (ends,).
        axis: Unit vectors along the cones (bundles, 3).
        cosine: Of the angle between a cone's axis and its side (bundles, 1).
        sine: Of that angle (bundles, 1).
    """

    start: np.ndarray
    bounds: np.ndarray
    axis: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray

    @classmethod
    def of(cls, start: np.ndarray, along: np.ndarray) -> "Bundles":
        """Return the bundles of unit vectors (rays, 3) from a point (3,)."""
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
        outside = (aside * self.cosine - ahead * self.sine > radius) & (self.cosine > MIN_COSINE)
        return ~outside & (np.sqrt(square) - radius <= reach[:, None])


class CameraTarget:
    """Something that rays of cameras are cast at, as far as they come near it.

    Args:
        caster: Casts rays at it.
        centre: Middles of balls about its geoms [m] (geoms, 3).
        radius: Their radii; infinite for what has no end [m] (geoms,).
        first: Place of its first geom among all that can be seen.
        slot: Slot of the robot that it is, or `NOBODY`.
    """

    def __init__(
        self, caster: CRayCaster, centre: np.ndarray, radius: np.ndarray, first: int, slot: int = NOBODY
    ) -> None:
        self._caster, self._centre, self._radius, self._first, self.slot = caster, centre, radius, first, slot
        self._middle = (centre.min(0) + centre.max(0))[None] / 2
        self._ball = (np.linalg.norm(centre - self._middle, axis=-1) + radius).max(keepdims=True)

    def closer(
        self,
        bundles: Bundles,
        along: np.ndarray,
        query: RayQuery,
        hidden: np.ndarray,
        met: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        """Replace what rays met by this where it is closer.

        Args:
            bundles: The rays.
            along: Unit vectors (rays, 3).
            query: What they pass.
            hidden: Geoms of it that they pass too (n,).
            met: Distances [m] (rays,), normals (rays, 3) and geoms (rays,); changed in place.
        """
        reach = np.maximum.reduceat(met[0], bundles.bounds[:-1])
        if not bundles.near(self._middle, self._ball, reach).any():
            return
        shown = bundles.near(self._centre, self._radius, reach)
        shown[:, hidden] = False
        for number in np.flatnonzero(shown.any(1)).tolist():
            rays = slice(bundles.bounds[number], bundles.bounds[number + 1])
            start = np.broadcast_to(bundles.start, along[rays].shape)
            found = self._caster.meet(start, along[rays], query, np.flatnonzero(~shown[number]))
            self._keep(rays, found, met)

    def closer_one_by_one(
        self,
        start: np.ndarray,
        along: np.ndarray,
        query: RayQuery,
        met: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        """As `closer`, for rays that start anywhere (rays, 3)."""
        way = self._middle - start
        ahead, square = (along * way).sum(-1), (way * way).sum(-1)
        aside = np.sqrt(np.maximum(square - ahead * ahead, 0.0))
        rays = np.flatnonzero((aside <= self._ball) & (ahead + self._ball >= 0))
        if len(rays):
            found = self._caster.meet(start[rays], along[rays], query, np.zeros(0, int))
            self._keep(rays, found, met)

    def _keep(
        self,
        rays: slice | np.ndarray,
        found: tuple[np.ndarray, np.ndarray, np.ndarray],
        met: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        """Put what some rays found in its place, where it is closer than what they met before."""
        better = found[0] < met[0][rays]
        places = np.arange(len(met[0]))[rays][better]
        for column, own in zip(met, found, strict=True):
            column[places] = own[better]
        met[2][places] += self._first


SUN_DISTANCE = 1e5
"""From so far the sun's rays are cast: within 100 m of each other they are parallel but for 1e-3 [m]."""
BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
NO_GEOMS = np.zeros(0, int)


@dataclass(frozen=True, eq=False)
class GeomColors:
    """How the geoms of a model look, and water and figures, which are no geoms of it.

    Attributes:
        appearance: Of the model's geoms in their order, then of the water, then of the figures.
        materials: What the model's geoms are made of (ngeom,); see `models.build.materials`.
        water: Bodies of water, boxes as of glass.
        figures: What is drawn of robots and victims.
        replaced: The model's geoms in whose place that is (n,).
    """

    appearance: GeomAppearance
    materials: Sequence[str]
    water: GeomBlock
    figures: Sequence[AttachedVisual]
    replaced: np.ndarray


class CCameraRays:
    """A world as it is at the moment of the call; may be looked at in another thread, one at a time.

    Args:
        model: The model; it is copied.
        data: Its state; positions are copied.
        looks: How it looks.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, looks: GeomColors) -> None:
        self.model, self.looks = model.__copy__(), looks
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
        """What rays are cast at; made when it is looked at first, in the thread that does so."""
        data, model = self._data, self.model
        caster = CRayCaster(model, data, self.looks.materials, {})
        model.geom_group[self.looks.replaced] = HIDDEN_GROUP
        radius = np.where(model.geom_rbound > 0, model.geom_rbound + MARGIN, np.inf)  # planes have no bound
        found, first = [CameraTarget(caster, data.geom_xpos.copy(), radius, 0)], model.ngeom
        first += len(self.looks.water.owner)
        for worn in self.looks.figures:
            found.append(worn.posed(data, first))
            first += worn.figure.model.ngeom
        return found

    @cached_property
    def frames(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the model's geoms are [m] (n, 3), how they are turned (n, 3, 3), and how large (n, 3)."""
        data, size = self._data, self.model.geom_size
        mat = data.geom_xmat.reshape(-1, 3, 3)
        return data.geom_xpos.astype(np.float32), mat.astype(np.float32), size.astype(np.float32)

    def render(self, render_scene: RenderScene, viewpoint: Viewpoint, width: int, height: int) -> Picture:
        """Return what a camera sees; its light and its floor are those of `render_scene`."""
        with numpy_backend():
            caster = self.camera(viewpoint.slot, viewpoint.hidden_geoms)
            return render_picture(render_scene, viewpoint, width, height, caster)

    def camera(self, slot: Array, hidden_geoms: Array) -> "CameraCaster":
        """Return what casts the rays of a camera's pictures.

        Args:
            slot: Slot of its robot; of no robot's camera anything else ().
            hidden_geoms: Which geoms of that it does not see; see `picture.Viewpoint` (geoms,).
        """
        figures = [one.figure for one in self.looks.figures if one.slot == slot != NOBODY]
        geom_of = figures[0].geom_of if figures else NO_GEOMS
        hidden = np.unique(geom_of[np.asarray(hidden_geoms)[: len(geom_of)]])
        return CameraCaster(self, int(slot), hidden)


class CameraCaster:
    """Casts the rays of one camera's pictures: a `cameras.casters.Caster`.

    Args:
        sight: The world.
        slot: Slot of the camera's robot.
        hidden: Geoms of that robot's figure that the camera does not see (n,).
    """

    def __init__(self, sight: CCameraRays, slot: int, hidden: np.ndarray) -> None:
        (self._world, *self._figures), self._looks = sight.targets, sight.looks
        self._slot, self._hidden, self._sight = slot, hidden, sight
        rest = np.zeros(len(sight.looks.appearance.label) - sight.model.ngeom, bool)
        self.is_plane = np.concatenate([sight.model.geom_type == PLANE, rest])

    @property
    def appearance(self) -> GeomAppearance:
        """How geoms and water look."""
        return self._looks.appearance

    @property
    def materials(self) -> Collection[str]:
        """What they are made of."""
        water, figures = [GLASS] * len(self._looks.water.owner), [OPAQUE] * len(self._figures)
        return {*self._looks.materials, *water, *figures}

    def from_camera(self, origin: Array, direction: Array, query: RayQuery) -> RayHits:
        """Return what the camera's own rays meet (rays, 3); what covers its lens is left out."""
        start, along = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        distance, geom, normal = self._meet(start, along, query)
        water = self._looks.water
        if GLASS in query.transparent or not len(water.owner):
            return RayHits(distance, geom, normal)
        reach, which, its_normal = nearest_of_block(BOX, water, start, along)
        closer = reach < distance
        return RayHits(
            distance=np.where(closer, reach, distance).astype(np.float32),
            geom_index=np.where(closer, len(self._looks.materials) + which, geom),
            normal=np.where(closer[:, None], _towards(its_normal, along), normal),
        )

    def from_surfaces(self, origin: Array, direction: Array, wanted: Array) -> RayHits:
        """Return what solids rays meet (rays, 3) that a mirror throws back; those that are wanted (rays,)."""
        count, rays = len(origin), np.flatnonzero(wanted)
        start, along = (np.asarray(x, np.float64)[rays] for x in (origin, direction))
        met, query = _nothing(len(rays)), SOLID_QUERY.replace(incidence=True)
        for target in (self._world, *self._figures):
            target.closer_one_by_one(start, along, query, met)
        distance, geom = np.full(count, np.inf, np.float32), np.full(count, -1)
        normal = np.zeros((count, 3), np.float32)
        distance[rays], geom[rays], normal[rays] = met[0], met[2], _towards(met[1], along)
        return RayHits(distance, geom, normal)

    def is_dark(self, beams: Beams) -> Array:
        """Return where something stands in the way of the light, of what is wanted (rays,)."""
        dark = np.zeros(len(beams.wanted), bool)
        for source in np.unique(beams.source[beams.wanted]).tolist():
            rays = np.flatnonzero(beams.wanted & (beams.source == source))
            point, own = np.asarray(beams.point, np.float64)[:, rays].T, NOBODY
            if source < 0:
                light = point.mean(0) + SUN_DISTANCE * np.asarray(beams.sun, np.float64)
            else:
                light = np.asarray(beams.pos[source], np.float64)
                if beams.carrier is not None:
                    own = int(beams.carrier[source]) - ROBOT_LABEL
            way = point - light
            distance = np.sqrt((way * way).sum(-1))
            along, query = way / distance[:, None], SOLID_QUERY.replace(incidence=False)
            bundles, met = Bundles.of(light, along), _nothing(len(rays))
            met[0][:] = distance
            for target in (self._world, *self._figures):
                if own == NOBODY or target.slot != own:
                    target.closer(bundles, along, query, NO_GEOMS, met)
            dark[rays] = met[2] >= 0
        return dark

    def normals(self, met: RayHits, origin: Array, direction: Array) -> Array:
        """Return the unit normals of the surfaces that rays meet, towards the rays (rays, 3)."""
        del origin, direction  # it was found with what they met
        assert met.normal is not None
        return met.normal

    def frames(self, which: Array) -> tuple[Array, Array, Array]:
        """Return poses and sizes of the model's geoms; of water and figures, which have no signs, any."""
        pos, mat, size = self._sight.frames
        place = np.minimum(which, len(pos) - 1)
        return pos[place], mat[place], size[place]

    def _meet(
        self, start: np.ndarray, along: np.ndarray, query: RayQuery
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distances (rays,), geoms (rays,) and normals towards the rays (rays, 3)."""
        query, met = query.replace(incidence=True), _nothing(len(start))
        targets = [self._world] if set(self._looks.materials) - query.transparent else []
        targets += self._figures if OPAQUE not in query.transparent else []
        turns = np.flatnonzero((start[1:] != start[:-1]).any(-1)) + 1  # from one eye to the other
        for first, end in pairwise([0, *turns.tolist(), len(start)]):
            bundles = Bundles.of(start[first], along[first:end])
            rays = met[0][first:end], met[1][first:end], met[2][first:end]
            for target in targets:
                hidden = self._hidden if target.slot == self._slot != NOBODY else NO_GEOMS
                target.closer(bundles, along[first:end], query, hidden, rays)
        distance, normal, geom = met
        return distance.astype(np.float32), geom, _towards(normal, along)


def _nothing(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what so many rays meet where nothing is: distances, normals and geoms."""
    return np.full(count, np.inf), np.zeros((count, 3)), np.full(count, -1, np.int32)


def _towards(normal: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return normals (rays, 3), turned to where rays come from."""
    away = (normal * along).sum(-1, keepdims=True) > 0
    return np.where(away, -normal, normal).astype(np.float32)
