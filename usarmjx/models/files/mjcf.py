"""MJCF files to arenas: what is fixed, what lies loose, and doors."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import Vec3, flip_angles
from usarmjx.models.files.content import Content, surface_of
from usarmjx.models.files.doors import Hinge, door_of
from usarmjx.models.files.geoms import FIXTURE, MeshPieces, geom_mass, geom_shapes
from usarmjx.models.files.masses import with_masses
from usarmjx.models.files.mjcf_size import check_model_size
from usarmjx.models.files.mjcf_solids import Inertia, Pose, combine_inertias, usarsim_angles
from usarmjx.models.files.reader_process import try_model
from usarmjx.models.spec.arena import Door, LooseObject
from usarmjx.models.spec.shapes import Shape

GeomType, JointType = mujoco.mjtGeom, mujoco.mjtJoint
FLOOR_TOLERANCE = 1e-6
"""How far a floor may be from height zero [m], and its normal from the vertical."""
MOST_MOVING = 1000
"""Loose objects and doors of a file."""
LOOSE_SURFACE = "loose"
"""Surface of what lies loose."""


def mjcf_content(path: Path, surface: str = "") -> Content:
    """Return what an MJCF file has for an arena, at its reference configuration.

    Geoms of the world and of bodies without joints are fixed solids; a plane at height zero is the floor. A
    body with a free joint is a loose object, with all that is fixed to it. A body with one hinge about the
    vertical is a door, if it is one upright box that hangs on one of its narrow sides. Any other joint is
    refused, as are tendons, equality constraints and flexes. Actuators, sensors, lights, cameras, sites and
    options are left out, with a warning. Friction is ours: see `surface_of`.

    Args:
        path: The file.
        surface: Surface of its fixed solids; empty: as their form suggests.

    Raises:
        ArenaFileError: A file that does not read, or something that an arena cannot have; names it.
    """
    check_model_size(path)
    if wrong := try_model(path):
        raise ArenaFileError(f"{path}: does not read as MJCF: {wrong}")
    spec = mujoco.MjSpec.from_file(str(path))
    model = spec.compile()
    for kind, count in (("tendon", model.ntendon), ("equality constraint", model.neq), ("flex", model.nflex)):
        if count:
            raise ArenaFileError(f"{path}: has {count} of kind {kind}; arenas have none")
    try:
        return _MjcfReader(path, spec, model, surface).content()
    except UnicodeDecodeError as error:
        raise ArenaFileError(f"{path}: has a name that is no UTF-8: {error}") from error


class _MjcfReader:
    """A compiled file, its bodies sorted by what they are part of.

    Args:
        path: The file, for messages.
        spec: Its description, for densities.
        model: The compiled model.
        surface: Surface of fixed solids; empty: as their form suggests.
    """

    def __init__(self, path: Path, spec: mujoco.MjSpec, model: mujoco.MjModel, surface: str) -> None:
        self._path, self._model, self._surface = path, model, surface
        self._described = {geom.id: geom for geom in spec.geoms}
        self._data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self._data)
        self._warnings = _ignored(path, spec)
        self._meshes = MeshPieces(model)
        self._owner = [0] * model.nbody  # the body with the joint that moves each one; 0: it is fixed
        for body in range(1, model.nbody):
            jointed = model.body_jntnum[body] > 0
            self._owner[body] = body if jointed else self._owner[model.body_parentid[body]]
        self._owned: dict[int, list[int]] = {}
        for geom in range(model.ngeom):
            self._owned.setdefault(self._owner[model.geom_bodyid[geom]], []).append(geom)
        self._members: dict[int, list[int]] = {}
        for body in range(model.nbody):
            self._members.setdefault(self._owner[body], []).append(body)

    def content(self) -> Content:
        """Return what the file has."""
        model, loose, doors = self._model, [], []
        moving = sum(owner == body for body, owner in enumerate(self._owner)) - 1
        if moving > MOST_MOVING:
            raise self._error(f"has {moving} bodies that move; at most {MOST_MOVING}")
        for body in range(1, model.nbody):
            if self._owner[body] != body:
                continue
            if self._free(body):
                loose.append(self._loose(body))
            else:
                doors.append(self._door(body))
        shapes = [shape for geom in self._geoms(0) for shape in self._fixed(geom)]
        planes = [geom for geom in self._geoms(0) if self._kind(geom) == GeomType.mjGEOM_PLANE]
        return Content(
            shapes=tuple(shapes),
            loose=tuple(loose),
            doors=tuple(doors),
            floor=bool(planes),
            warnings=tuple(self._warnings),
        )

    def _error(self, text: str) -> ArenaFileError:
        return ArenaFileError(f"{self._path}: {text}")

    def _kind(self, geom: int) -> mujoco.mjtGeom:
        return GeomType(self._model.geom_type[geom])

    def _name(self, kind: str, number: int) -> str:
        return getattr(self._model, kind)(number).name or f"number {number}"

    def _geoms(self, owner: int) -> list[int]:
        """Return the geoms of a body and of all that is fixed to it."""
        return self._owned.get(owner, [])

    def _free(self, body: int) -> bool:
        """Return whether a body with joints lies loose, and refuse what is neither that nor a door."""
        model, first = self._model, int(self._model.body_jntadr[body])
        kinds = [
            JointType(kind) for kind in model.jnt_type[first : first + int(model.body_jntnum[body])].tolist()
        ]
        if kinds == [JointType.mjJNT_FREE]:
            return True
        name, parent = self._name("body", body), self._owner[model.body_parentid[body]]
        if parent:
            raise self._error(
                f"body {name!r} hangs on {self._name('body', parent)!r} by a joint; loose objects and doors "
                "are rigid: fix it, or make it a robot"
            )
        if kinds != [JointType.mjJNT_HINGE]:
            said = ", ".join(kind.name[6:].lower() for kind in kinds)
            raise self._error(f"body {name!r} has the joints {said}; arenas have one free joint or one hinge")
        return False

    def _fixed(self, geom: int) -> list[Shape]:
        """Return a geom of the world as shapes in the world's axes."""
        mat = self._data.geom_xmat[geom].reshape(3, 3)
        if self._kind(geom) == GeomType.mjGEOM_PLANE:
            if abs(self._data.geom_xpos[geom][2]) > FLOOR_TOLERANCE or mat[2, 2] < 1 - FLOOR_TOLERANCE:
                raise self._error(
                    f"plane {self._name('geom', geom)!r} is unbounded and not the floor at height 0: "
                    "make it a box"
                )
            return []
        shapes = self._shapes(geom, Pose(self._data.geom_xpos[geom], mat), "wall")
        return [
            shape if shape.surface == FIXTURE else replace(shape, surface=self._surface or surface_of(shape))
            for shape in shapes
        ]

    def _shapes(self, geom: int, pose: Pose, surface: str) -> list[Shape]:
        """Return a geom as shapes where `pose` says; those that touch nothing get surface "fixture"."""
        touches = bool(self._model.geom_contype[geom] or self._model.geom_conaffinity[geom])
        name = f"{self._path}: geom {self._name('geom', geom)!r}"
        try:
            return geom_shapes(self._model, geom, pose, surface if touches else FIXTURE, name, self._meshes)
        except ArenaFileError as error:
            if touches or self._kind(geom) != GeomType.mjGEOM_MESH:
                raise
            self._warnings.append(f"{error}; nothing touches it: it is left out")
            return []

    def _loose(self, body: int) -> LooseObject:
        """Return a body with a free joint, with masses on its solids if those account for its inertia."""
        data, name = self._data, self._name("body", body)
        frame = Pose(data.xpos[body], data.xmat[body].reshape(3, 3))
        shapes: list[Shape] = []
        for geom in self._geoms(body):
            if self._kind(geom) in (GeomType.mjGEOM_PLANE, GeomType.mjGEOM_HFIELD):
                raise self._error(
                    f"body {name!r} is free and has a plane or terrain; those stay where they are"
                )
            found = self._shapes(geom, self._relative_pose(frame, geom), LOOSE_SURFACE)
            share = geom_mass(self._model, geom, self._described[geom], self._meshes) / max(len(found), 1)
            shapes += [replace(shape, mass=share) for shape in found]
        return LooseObject(
            name=name,
            at=_vec(data.xpos[body]),
            rotation=flip_angles(usarsim_angles(frame.mat)),
            shapes=with_masses(shapes, self._inertia(body, frame)),
        )

    def _relative_pose(self, frame: Pose, geom: int) -> Pose:
        pos, mat = self._data.geom_xpos[geom], self._data.geom_xmat[geom].reshape(3, 3)
        return Pose(frame.mat.T @ (pos - frame.pos), frame.mat.T @ mat)

    def _inertia(self, body: int, frame: Pose) -> Inertia:
        """Return mass, centre and inertia of a body with what is fixed to it, in the body's axes."""
        parts = []
        for member in self._members[body]:
            mat = frame.mat.T @ self._data.ximat[member].reshape(3, 3)
            tensor = mat @ np.diag(self._model.body_inertia[member]) @ mat.T
            centre = frame.mat.T @ (self._data.xipos[member] - frame.pos)
            parts.append(Inertia(float(self._model.body_mass[member]), centre, tensor))
        return combine_inertias(parts)

    def _door(self, body: int) -> Door:
        """Return a body with a hinge as a door."""
        model, joint, name = self._model, int(self._model.body_jntadr[body]), self._name("body", body)
        geoms = [g for g in self._geoms(body) if model.geom_contype[g] or model.geom_conaffinity[g]]
        if len(geoms) != 1 or self._kind(geoms[0]) != GeomType.mjGEOM_BOX:
            raise self._error(f"body {name!r} has a hinge and is not one box; a door is")
        (geom,) = geoms
        low, high = (model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]).tolist()
        place = Pose(self._data.geom_xpos[geom], self._data.geom_xmat[geom].reshape(3, 3))
        hinge = Hinge(
            anchor=self._data.xanchor[joint],
            axis=self._data.xaxis[joint],
            limits=(low, high) if model.jnt_limited[joint] else None,
            friction=float(np.ravel(model.dof_damping[model.jnt_dofadr[joint]])[0]),
        )
        try:
            return door_of(
                name,
                place,
                model.geom_size[geom],
                hinge,
                mass=float(model.body_mass[body]),
                rgba=tuple(model.geom_rgba[geom].tolist()),
            )
        except ArenaFileError as error:
            raise self._error(str(error)) from error


def _vec(vector: np.ndarray) -> Vec3:
    x, y, z = vector.tolist()
    return (x, y, z)


def _ignored(path: Path, spec: mujoco.MjSpec) -> list[str]:
    """Return what of a file is left out, in words."""
    kinds = {
        "actuators": spec.actuators,
        "sensors": spec.sensors,
        "cameras": spec.cameras,
        "lights": spec.lights,
        "sites": spec.sites,
        "keyframes": spec.keys,
        "contact pairs": spec.pairs,
        "contact exclusions": spec.excludes,
    }
    said = []
    for kind, found in kinds.items():
        if found:
            names = ", ".join(one.name or "without name" for one in found[:5])
            said.append(f"{path}: {len(found)} {kind} left out: {names}{', ...' if len(found) > 5 else ''}")
    return said
