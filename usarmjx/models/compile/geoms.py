"""Solids of a description as geoms of an MjSpec body, with mass and inertia."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import flip_vector, mat_from_angles, quat_from_angles
from usarmjx.models.types.robot import BodyInertia
from usarmjx.models.types.shapes import FENDER, MATERIALS, SKY, SURFACES, Mesh, Shape, texture_problem

BALANCE = 1.0 - 1e-9
"""Ratio of the largest moment to the sum of the others up to which MuJoCo surely accepts them."""


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
    # Nothing touches the sky, whatever surface it has.
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
    if shape.conveyor is not None:
        geom.surfacevel[:3] = shape.conveyor.velocity  # type: ignore - not in the stubs
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
    if shape.conveyor is not None and shape.kind != "box":
        raise SpecError(f"{name}: a conveyor is a box, not a {shape.kind}")
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


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass [kg], its centre [m] (3,), and inertia about that centre [kg m2] (3, 3), MuJoCo's axes."""

    mass: float
    centre: np.ndarray
    tensor: np.ndarray


def combine_inertias(parts: Sequence[Inertia]) -> Inertia:
    """Return the inertia of several rigidly joined bodies."""
    mass = sum(part.mass for part in parts)
    if mass <= 0:
        return Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
    centre = sum((part.mass * part.centre for part in parts), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for part in parts:
        arm = part.centre - centre
        # Parallel axis theorem (Steiner).
        tensor += part.tensor + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertia(mass, centre, tensor)


def stated_inertia(stated: BodyInertia) -> Inertia:
    """Return a description's inertia in MuJoCo's axes."""
    xx, yy, zz, xy, xz, yz = stated.moments
    # The axes differ by half a turn about x: products of x with y or z change their sign.
    tensor = np.array([[xx, -xy, -xz], [-xy, yy, yz], [-xz, yz, zz]])
    return Inertia(stated.mass, np.array(flip_vector(stated.at)), tensor)


def described_inertia(found: Inertia) -> BodyInertia:
    """Return an inertia in MuJoCo's axes as a description's."""
    # Plus 0.0: -0.0 becomes 0.0, or files would show its sign.
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (np.asarray(found.tensor) + 0.0).tolist()
    x, y, z = flip_vector(tuple((np.asarray(found.centre) + 0.0).tolist()))
    return BodyInertia(mass=float(found.mass), at=(x, y, z), moments=(xx, yy, zz, -xy, -xz, yz))


def arena_inertia(stated: BodyInertia) -> Inertia:
    """Return the inertia of a loose object, whose description has MuJoCo's axes."""
    xx, yy, zz, xy, xz, yz = stated.moments
    return Inertia(stated.mass, np.array(stated.at), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def described_in_arena(found: Inertia) -> BodyInertia:
    """Return an inertia as that of a loose object's description."""
    # Plus 0.0, as above.
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (np.asarray(found.tensor) + 0.0).tolist()
    x, y, z = (np.asarray(found.centre) + 0.0).tolist()
    return BodyInertia(mass=float(found.mass), at=(x, y, z), moments=(xx, yy, zz, xy, xz, yz))


def set_inertia(body: mujoco.MjsBody, stated: Inertia, shapes: Sequence[Shape]) -> None:
    """Give a body its stated inertia, and that of the solids that have a mass of their own.

    Args:
        body: The body.
        stated: Its inertia.
        shapes: Its solids, MuJoCo's axes.

    Raises:
        SpecError: It is not finite, as that of masses too far apart.
    """
    heavy = [shape for shape in shapes if shape.mass > 0]
    whole = combine_inertias([stated, *([_inertia_of_solids(heavy)] if heavy else [])])
    if not np.isfinite(whole.tensor).all():
        raise SpecError(f"the inertia of {body.name} is not finite: masses and distances are too large")
    moments, axes = np.linalg.eigh(whole.tensor)
    # eigh may return a left-handed frame, which is no rotation.
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    # MuJoCo refuses a moment above the sum of the others, where rounding of a file may put the largest one.
    moments[2] = min(moments[2], (moments[0] + moments[1]) * BALANCE)
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat, body.inertia = whole.mass, whole.centre, quat, moments


def _inertia_of_solids(shapes: Sequence[Shape]) -> Inertia:
    """Return the inertia of solids that have masses, by MuJoCo."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    body.add_freejoint()
    for i, shape in enumerate(shapes):
        add_geom(spec, body, str(i), replace(shape, material="opaque"))
    model = spec.compile()
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[1])
    axes = turn.reshape(3, 3)
    return Inertia(
        float(model.body_mass[1]), model.body_ipos[1].copy(), axes @ np.diag(model.body_inertia[1]) @ axes.T
    )
