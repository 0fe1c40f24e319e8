"""Conversion of one solid of a description to one geom of an MjSpec body."""

from dataclasses import dataclass

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import mat_from_angles, quat_from_angles
from usarmjx.models.types.shapes import FENDER, MATERIALS, SKY, SURFACES, Mesh, Shape
from usarmjx.models.types.textures import texture_problem


@dataclass(frozen=True, eq=False)
class MovedGeoms:
    """Geoms of a model whose poses are data. All are children of the mocap body `arena`.

    Attributes:
        names: Their names in the model.
        max_half_length: The largest half length of each in any world [m] (geoms,).
        resized: Whether their sizes differ between worlds too; they are then boxes.
    """

    names: tuple[str, ...]
    max_half_length: np.ndarray
    resized: bool


GEOM_TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
    "hfield": mujoco.mjtGeom.mjGEOM_HFIELD,
}
"""MuJoCo's geom types by kind of shape."""


MIN_TERRAIN_RISE = 1e-3
"""Smallest rise of a terrain that MuJoCo accepts [m]."""


def add_geom(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    shape: Shape,
    kind: mujoco.mjtGeom | None = None,
) -> mujoco.MjsGeom:
    """Add a solid to a body, in the body's axes; `kind` overrides the shape's own (a plane).

    Raises:
        SpecError: An unknown material; a fender that is no box; a mesh or terrain without its data.
    """
    _check(name, shape)
    surface = SURFACES["fixture" if shape.material == SKY else shape.surface]
    if shape.tyre is not None:
        surface = shape.tyre.on(surface)
    geom = body.add_geom(
        name=name,
        type=GEOM_TYPES[shape.kind] if kind is None else kind,
        pos=shape.at,
        quat=quat_from_angles(*shape.rotation),
        mass=shape.mass,
        rgba=shape.rgba,
        # Torsional and rolling friction, and the last two of solimp, are MuJoCo's defaults.
        friction=[surface.friction, 0.005, 0.0001],
        priority=surface.priority,
        solref=surface.solref,
        solimp=(*surface.solimp, 0.5, 2.0),
        contype=surface.contype,
        conaffinity=surface.conaffinity,
        condim=3,
    )
    if shape.mesh is not None:
        _add_mesh(spec, name, shape.mesh)
        geom.meshname = name
    elif shape.heights is not None:
        _add_terrain(spec, geom, shape)
    else:
        geom.size = [*shape.size, 0.0, 0.0][:3]
    return geom


def _check(name: str, shape: Shape) -> None:
    """Refuse a shape whose fields contradict each other."""
    if shape.material not in MATERIALS:
        raise SpecError(f"{name}: no material {shape.material!r}; known: {', '.join(MATERIALS)}")
    if problem := texture_problem(shape.texture):
        raise SpecError(f"{name}: {problem}")
    if shape.material == FENDER and shape.kind != "box":
        raise SpecError(f"{name}: a fender is a box, not a {shape.kind}")
    for kind, data in (("mesh", shape.mesh), ("hfield", shape.heights)):
        if (shape.kind == kind) != (data is not None):
            raise SpecError(f"{name}: kind {shape.kind!r} and its data do not go together")


def _add_mesh(spec: mujoco.MjSpec, name: str, mesh: Mesh) -> None:
    """Add a mesh; MuJoCo makes faces for vertices without any, and uses the hull for contacts."""
    described = spec.add_mesh(name=name, uservert=np.asarray(mesh.vertices, float).ravel())
    if mesh.faces is not None:
        described.userface = np.asarray(mesh.faces, np.int32).ravel()  # type: ignore - not in the stubs
        # Mass is that of the hull, which is what others touch; faces need not be closed.
        described.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX


def _add_terrain(spec: mujoco.MjSpec, geom: mujoco.MjsGeom, shape: Shape) -> None:
    """Give a geom its terrain.

    MuJoCo scales heights to [0, 1], so the lowest height becomes the geom's zero.
    """
    assert shape.heights is not None
    heights, name = np.asarray(shape.heights.heights, float), geom.name
    if heights.ndim != 2 or min(heights.shape) < 2 or not np.isfinite(heights).all() or heights.min() < 0:
        raise SpecError(f"{name}: heights are a table of at least 2 x 2 numbers, none below zero")
    low, rise = float(heights.min()), float(np.ptp(heights))
    half_x, half_y, base = shape.size
    spec.add_hfield(
        name=name,
        nrow=heights.shape[0],
        ncol=heights.shape[1],
        size=[half_x, half_y, max(rise, MIN_TERRAIN_RISE), base + low],
        userdata=((heights - low) / max(rise, MIN_TERRAIN_RISE)).ravel(),
    )
    geom.hfieldname = name
    geom.pos = np.array(shape.at) + mat_from_angles(*shape.rotation) @ (0.0, 0.0, low)
