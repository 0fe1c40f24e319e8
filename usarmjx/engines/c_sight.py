"""What cameras see of a world on C MuJoCo at one moment: nothing is compiled for it.

Rays that start at one point are cast together. So are those from lights to surfaces, against the light, and
those from the sun, from a point that is far away. What mirrors throw back is cast one by one.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import numpy_backend
from usarmjx.cameras.casters import SOLID_QUERY, Beams, Met
from usarmjx.cameras.paint import PLANE, ROBOT_LABEL, GeomAppearance
from usarmjx.cameras.picture import Picture, Viewpoint, render_picture
from usarmjx.cameras.shading import RenderScene
from usarmjx.engines.c_rays import CRayCaster, nearest_of_block
from usarmjx.models.build.layout import RobotIndex
from usarmjx.models.build.pieces import MESH, ray_primitives_of
from usarmjx.models.spec.shapes import GLASS
from usarmjx.sensors.rays.raycast import RayQuery
from usarmjx.sensors.rays.targets import GeomBlock

SUN_DISTANCE = 1e5
"""From so far the sun's rays are cast: within 100 m of each other they are parallel but for 1e-3 [m]."""
BOX = int(mujoco.mjtGeom.mjGEOM_BOX)


@dataclass(frozen=True, eq=False)
class Looks:
    """How the geoms of a model look, and water, which is no geom of it.

    Attributes:
        appearance: Of the model's geoms in their order, then of the water.
        materials: What the model's geoms are made of (ngeom,); see `models.build.materials`.
        water: Bodies of water, boxes as of glass.
    """

    appearance: GeomAppearance
    materials: Sequence[str]
    water: GeomBlock


class CSight:
    """A world as it is at the moment of the call; may be looked at in another thread, one at a time.

    Args:
        model: The model; it is copied.
        data: Its state; positions are copied.
        looks: How it looks.
        robots: Where each robot is in the model, by slot.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, looks: Looks, robots: Mapping[int, RobotIndex]
    ) -> None:
        self.model, self.looks, self._robots = model.__copy__(), looks, robots
        self._places = {name: getattr(data, name).copy() for name in ("qpos", "mocap_pos", "mocap_quat")}

    @cached_property
    def caster(self) -> CRayCaster:
        """What casts rays at it; made when it is looked at first, in the thread that does so."""
        data = mujoco.MjData(self.model)
        for name, values in self._places.items():
            getattr(data, name)[:] = values
        mujoco.mj_kinematics(self.model, data)
        return CRayCaster(self.model, data, self.looks.materials, self._robots)

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
        own = self.caster.geoms_of(int(slot))
        piece_of = np.arange(len(own))
        if (self.model.geom_type[own] == MESH).any():  # seen in pieces elsewhere
            piece_of = ray_primitives_of(self.model, own).geom
        return CameraCaster(self, own[np.unique(piece_of[np.asarray(hidden_geoms)[: len(piece_of)]])])


class CameraCaster:
    """Casts the rays of one camera's pictures: a `cameras.casters.Caster`.

    Args:
        sight: The world.
        hidden: Geoms that the camera does not see (n,).
    """

    def __init__(self, sight: CSight, hidden: np.ndarray) -> None:
        self._caster, self._looks, self._hidden = sight.caster, sight.looks, hidden
        water = np.zeros(len(sight.looks.water.owner), bool)
        self.is_plane = np.concatenate([sight.model.geom_type == PLANE, water])

    @property
    def appearance(self) -> GeomAppearance:
        """How geoms and water look."""
        return self._looks.appearance

    @property
    def materials(self) -> Collection[str]:
        """What they are made of."""
        return {*self._looks.materials, *[GLASS] * len(self._looks.water.owner)}

    def from_camera(self, origin: Array, direction: Array, query: RayQuery) -> Met:
        """Return what the camera's own rays meet (rays, 3); what covers its lens is left out."""
        start, along = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        distance, geom, normal = self._meet(start, along, query, self._hidden)
        water = self._looks.water
        if GLASS in query.transparent or not len(water.owner):
            return Met(distance, geom, normal)
        reach, which, its_normal = nearest_of_block(BOX, water, start, along)
        closer = reach < distance
        return Met(
            distance=np.where(closer, reach, distance).astype(np.float32),
            geom_index=np.where(closer, len(self._looks.materials) + which, geom),
            normal=np.where(closer[:, None], _towards(its_normal, along), normal),
        )

    def from_surfaces(self, origin: Array, direction: Array, wanted: Array) -> Met:
        """Return what solids rays meet (rays, 3) that a mirror throws back; those that are wanted (rays,)."""
        count, rays = len(origin), np.flatnonzero(wanted)
        start, along = (np.asarray(x, np.float64)[rays] for x in (origin, direction))
        distance, geom = np.full(count, np.inf, np.float32), np.full(count, -1)
        normal = np.zeros((count, 3), np.float32)
        distance[rays], geom[rays], normal[rays] = self._meet(start, along, SOLID_QUERY, self._hidden[:0])
        return Met(distance, geom, normal)

    def is_dark(self, beams: Beams) -> Array:
        """Return where something stands in the way of the light, of what is wanted (rays,)."""
        dark = np.zeros(len(beams.wanted), bool)
        for source in np.unique(beams.source[beams.wanted]).tolist():
            rays = np.flatnonzero(beams.wanted & (beams.source == source))
            point, own = np.asarray(beams.point, np.float64)[:, rays].T, self._hidden[:0]
            if source < 0:
                light = point.mean(0) + SUN_DISTANCE * np.asarray(beams.sun, np.float64)
            else:
                light = np.asarray(beams.pos[source], np.float64)
                if beams.carrier is not None:
                    own = self._caster.geoms_of(int(beams.carrier[source]) - ROBOT_LABEL)
            way = point - light
            distance = np.sqrt((way * way).sum(-1))
            start = np.broadcast_to(light, way.shape)
            query = SOLID_QUERY.replace(incidence=False)
            met, _, _ = self._caster.meet(start, way / distance[:, None], query, own)
            dark[rays] = met < distance
        return dark

    def normals(self, met: Met, origin: Array, direction: Array) -> Array:
        """Return the unit normals of the surfaces that rays meet, towards the rays (rays, 3)."""
        del origin, direction  # it was found with what they met
        assert met.normal is not None
        return met.normal

    def _meet(
        self, start: np.ndarray, along: np.ndarray, query: RayQuery, hidden: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distances (rays,), geoms (rays,) and normals towards the rays (rays, 3)."""
        if not set(self._looks.materials) - query.transparent:
            nothing = np.full(len(start), np.inf, np.float32)
            return nothing, np.full(len(start), -1), np.zeros(start.shape, np.float32)
        distance, normal, geom = self._caster.meet(start, along, query.replace(incidence=True), hidden)
        return distance.astype(np.float32), geom, _towards(normal, along)


def _towards(normal: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return normals (rays, 3), turned to where rays come from."""
    away = (normal * along).sum(-1, keepdims=True) > 0
    return np.where(away, -normal, normal).astype(np.float32)
