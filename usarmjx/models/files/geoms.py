"""Geoms of a compiled model to shapes."""

from dataclasses import replace

import mujoco
import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import flip_angles, flip_vector
from usarmjx.models.files.meshes import ConvexPiece, convex_pieces
from usarmjx.models.files.mjcf_solids import KINDS, SIZES, Pose, usarsim_angles, usarsim_vector, volume
from usarmjx.models.spec.shapes import HeightField, Shape

GeomType = mujoco.mjtGeom
FIXTURE = "fixture"
"""Surface of what is seen but never touched."""


class MeshPieces:
    """The convex pieces of a model's meshes, each found once however many geoms have it.

    Args:
        model: The compiled model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._known: dict[tuple[int, bool], list[ConvexPiece] | str] = {}

    def of(self, geom: int, name: str, *, hull: bool = False) -> list[ConvexPiece]:
        """Return the pieces of a geom's mesh, in the geom's axes.

        Args:
            geom: The geom's id.
            name: What errors call it.
            hull: Whether to take the hulls of pieces that are not convex.

        Raises:
            ArenaFileError: See `convex_pieces`.
        """
        key = int(self._model.geom_dataid[geom]), hull
        if key not in self._known:
            try:
                self._known[key] = convex_pieces(*_mesh(self._model, key[0]), "", hull=hull)
            except ArenaFileError as error:
                self._known[key] = str(error)
        found = self._known[key]
        if isinstance(found, str):
            raise ArenaFileError(f"{name}{found}")
        return found


def geom_shapes(
    model: mujoco.MjModel, geom: int, pose: Pose, surface: str, name: str, meshes: MeshPieces
) -> list[Shape]:
    """Return a geom as shapes without mass; a mesh gives one for each of its pieces.

    Args:
        model: The compiled model.
        geom: The geom's id.
        pose: Where it is, in the axes that the shapes shall be in.
        surface: Their surface.
        name: What errors call it.
        meshes: The pieces of the model's meshes.

    Raises:
        ArenaFileError: A geom of a kind that arenas do not have, or a mesh that is not convex.
    """
    kind, material = GeomType(model.geom_type[geom]), int(model.geom_matid[geom])
    colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    red, green, blue, alpha = colour.tolist()
    like = Shape(
        kind="box",
        at=flip_vector(usarsim_vector(pose.pos)),
        rotation=flip_angles(usarsim_angles(pose.mat)),
        surface=surface,
        rgba=(red, green, blue, alpha),
    )
    if kind in KINDS:
        form = KINDS[kind]
        size = tuple(model.geom_size[geom][: SIZES[form]].tolist())
        return [replace(like, kind=form, size=size)]
    if kind == GeomType.mjGEOM_HFIELD:
        return [_terrain(model, int(model.geom_dataid[geom]), like)]
    if kind != GeomType.mjGEOM_MESH:
        raise ArenaFileError(f"{name} is a {kind.name[7:].lower()}; arenas have none")
    # What nothing touches is only looked at, by its faces.
    pieces = meshes.of(geom, name, hull=surface == FIXTURE)
    return [replace(like, kind="mesh", mesh=piece.mesh) for piece in pieces]


def geom_mass(model: mujoco.MjModel, geom: int, described: mujoco.MjsGeom, meshes: MeshPieces) -> float:
    """Return the mass that a geom would give its body [kg]."""
    if np.isfinite(described.mass):
        return float(described.mass)
    if GeomType(model.geom_type[geom]) in KINDS:
        return described.density * volume(model, geom)
    found = meshes.of(geom, described.name, hull=True)
    return described.density * sum(piece.volume for piece in found)


def _terrain(model: mujoco.MjModel, number: int, like: Shape) -> Shape:
    rows, columns, start = (
        int(values[number]) for values in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr)
    )
    x, y, top, base = model.hfield_size[number].tolist()
    shares = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    heights = HeightField(shares.astype(float) * top)
    return replace(like, kind="hfield", size=(x, y, base), heights=heights)


def _mesh(model: mujoco.MjModel, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of a mesh."""
    first, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
    start, faces = int(model.mesh_faceadr[number]), int(model.mesh_facenum[number])
    return model.mesh_vert[first : first + count].astype(float), model.mesh_face[start : start + faces]
