"""MJCF files as arenas: fixed solids, loose objects, and doors; robots of a scene are left out."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import Vec3, flip_angles, flip_vector
from usarmjx.models.compile.compose import DOOR_GAP
from usarmjx.models.compile.geoms import Inertia, add_geom, combine_inertias, described_in_arena
from usarmjx.models.files.content import Content, surface_of, transform_content
from usarmjx.models.files.mesh_solids import hull_corners
from usarmjx.models.files.meshes import ConvexPiece, convex_pieces
from usarmjx.models.files.mjcf_solids import (
    KINDS,
    SIZES,
    Pose,
    geom_colour,
    mat_of,
    usarsim_angles,
    usarsim_vector,
    volume,
)
from usarmjx.models.files.reader_process import try_model
from usarmjx.models.files.robot_source import left_out
from usarmjx.models.files.xml_file import check_model_size, drop_sizes
from usarmjx.models.types.arena import Door, LooseObject
from usarmjx.models.types.shapes import BodyInertia, HeightField, Rgba, Shape

TRANSMISSIONS: Any = mujoco.mjtTrn  # its stubs lack some
AXIS_TOLERANCE = 1e-3
"""Largest lean of a hinge or an edge [rad]."""
HINGE_OFFSET_TOLERANCE = 0.02
"""Largest distance of a hinge from the door's end, to which the door is moved [m]."""
FULL_TURN = (-math.pi, math.pi)
"""Limits of a hinge without limits [rad]."""
GeomType, JointType = mujoco.mjtGeom, mujoco.mjtJoint
FIXTURE = "fixture"
"""Surface of solids that are visible, without contacts."""
INERTIA_TOLERANCE = 1e-3
"""Relative difference of inertias that is neglected."""
FLOOR_TOLERANCE = 1e-6
"""Largest distance of a floor from height zero [m], and of its normal from the vertical."""
MAX_MOVING_BODIES = 1000
"""Largest number of loose objects and doors of a file."""
LOOSE_SURFACE = "loose"
"""Surface of loose objects."""


def leave_out_robots(path: Path, spec: Any) -> list[str]:  # noqa: ANN401
    """Delete the robots of a scene from its description; return notes that name them.

    A robot is a body of the world with motors on joints, sites or bodies of it, and with several joints or a
    free one: a door that a motor turns stays a door. Tendons, constraints, sensors and pairs of its parts go
    with it.

    Args:
        path: The file, for the notes.
        spec: The scene, which is changed.
    """
    # Targets are names of one kind: a site may have the name of a joint.
    driven = {(int(one.trntype), one.target) for one in spec.actuators}
    driven |= _driven_by_tendons(spec)
    robots: list[Any] = []
    for body in spec.worldbody.bodies:
        parts = _subtree(body)
        joints = [joint for part in parts for joint in part.joints]
        named = {(int(kind), joint.name) for joint in joints for kind in JOINT_TRANSMISSIONS}
        sites = [site for part in parts for site in part.sites]
        named |= {(int(kind), site.name) for site in sites for kind in SITE_TRANSMISSIONS}
        named |= {(int(TRANSMISSIONS.mjTRN_BODY), part.name) for part in parts}
        free = any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in joints)
        # A single driven hinge on a fixed base is a door with an opener.
        if driven & named and (free or len(joints) > 1):
            robots.append(body)
    if not robots:
        return []
    note = left_out(path, "robots", robots)
    for body in robots:
        _delete_with_references(spec, body)
    for key in [*spec.keys]:
        spec.delete(key)  # its numbers are those of the joints that are gone
    return [note]


JOINT_TRANSMISSIONS: tuple[Any, ...] = (TRANSMISSIONS.mjTRN_JOINT, TRANSMISSIONS.mjTRN_JOINTINPARENT)
"""Transmissions of actuators to joints."""
SITE_TRANSMISSIONS: tuple[Any, ...] = (TRANSMISSIONS.mjTRN_SITE, TRANSMISSIONS.mjTRN_SLIDERCRANK)
"""Transmissions of actuators to sites."""


def _driven_by_tendons(spec: Any) -> set[tuple[int, str]]:  # noqa: ANN401
    """Return the joints and sites on tendons that an actuator pulls, as targets of actuators."""
    pulled = {one.target for one in spec.actuators if one.trntype == TRANSMISSIONS.mjTRN_TENDON}
    found: set[tuple[int, str]] = set()
    for tendon in spec.tendons:
        if tendon.name in pulled:
            for wrap in tendon.path:
                name = getattr(wrap.target, "name", "")
                found |= {(int(kind), name) for kind in (*JOINT_TRANSMISSIONS, *SITE_TRANSMISSIONS)}
    return found


def _subtree(body: Any) -> list[Any]:  # noqa: ANN401
    """Return a body and all below it."""
    found = [body]
    # The list grows while it is walked: bodies below those that were added come too.
    for one in found:
        found += list(one.bodies)
    return found


def _delete_with_references(spec: Any, body: Any) -> None:  # noqa: ANN401
    """Delete a body and all elements that refer to it or to what is on it."""
    parts = _subtree(body)
    gone = {part.name for part in parts}
    for part in parts:
        gone |= {one.name for kind in (part.joints, part.sites, part.geoms, part.cameras) for one in kind}
    # Elements without names all have the empty one; references that are not used have it too.
    gone.discard("")
    # Tendons before actuators before sensors: each kind may refer to those before it.
    tendons = [one for one in spec.tendons if _wrapped(one) & gone]
    gone |= {one.name for one in tendons if one.name}
    actuators = [one for one in spec.actuators if one.target in gone]
    gone |= {one.name for one in actuators if one.name}
    doomed: list[Any] = [one for one in spec.sensors if {one.objname, one.refname} & gone]
    doomed += [one for one in spec.equalities if {one.name1, one.name2} & gone]
    doomed += [one for one in spec.pairs if {one.geomname1, one.geomname2} & gone]
    doomed += [one for one in spec.excludes if {one.bodyname1, one.bodyname2} & gone]
    for one in (*doomed, *actuators, *tendons, body):
        spec.delete(one)


def _wrapped(tendon: Any) -> set[str]:  # noqa: ANN401 - mujoco.MjsTendon
    return {getattr(wrap.target, "name", "") for wrap in tendon.path}


@dataclass(frozen=True, kw_only=True, eq=False)
class Hinge:
    """The hinge of a door, in the arena's axes.

    Attributes:
        anchor: A point on it (3,).
        axis: Its direction (3,).
        limits: Lowest and highest angle about that direction; None: no limits.
        friction: Damping [N m s/rad].
    """

    anchor: np.ndarray
    axis: np.ndarray
    limits: tuple[float, float] | None
    friction: float


def door_of(name: str, pose: Pose, half: np.ndarray, hinge: Hinge, mass: float, rgba: Rgba) -> Door:
    """Return a box that turns about a hinge as a door.

    Args:
        name: Its name.
        pose: Pose of the box while the door is closed, in the arena's axes.
        half: Its half lengths [m] (3,).
        hinge: The hinge.
        mass: Mass of the door [kg].
        rgba: Colour.

    Raises:
        ArenaFileError: The hinge or the box does not stand upright, or the hinge is not at the box's end.
    """
    if abs(hinge.axis[2]) < 1 - AXIS_TOLERANCE:
        raise ArenaFileError(f"body {name!r}: its hinge is not upright; a door's is (axis 0 0 1)")
    # Any of the box's axes may be the upright one: files turn boxes as they like.
    up = int(np.abs(pose.mat[2]).argmax())
    if abs(pose.mat[2, up]) < 1 - AXIS_TOLERANCE:
        raise ArenaFileError(f"body {name!r}: its box does not stand upright; a door does")
    flat = [i for i in range(3) if i != up]
    long = max(flat, key=lambda i: float(half[i]))
    thin = next(i for i in flat if i != long)
    # In the plane only: the height of the anchor on its axis has no meaning.
    offset = pose.pos[:2] - hinge.anchor[:2]
    along = pose.mat[:2, long]
    reach, aside = float(along @ offset), float(pose.mat[:2, thin] @ offset)
    # A door's pose has its leaf ahead of the hinge along x; the box's axis may point the other way.
    if reach < 0:
        along, reach = -along, -reach
    if abs(reach - half[long]) > HINGE_OFFSET_TOLERANCE or abs(aside) > HINGE_OFFSET_TOLERANCE + half[thin]:
        raise ArenaFileError(f"body {name!r}: its hinge is not at a narrow side of its box; a door's is")
    low, high = hinge.limits or FULL_TURN
    # About the opposite axis angles change their sign, and the lowest becomes the highest.
    if hinge.axis[2] < 0:
        low, high = -high, -low
    x, y = hinge.anchor[:2].tolist()
    # `Door` leaves a gap below its leaf: with the size below, the leaf is where the file has it.
    foot = float(pose.pos[2] - half[up]) - DOOR_GAP
    return Door(
        name=name,
        at=(x, y, foot),
        yaw=math.atan2(along[1], along[0]),
        size=(2 * float(half[long]), 2 * float(half[thin]), 2 * float(half[up]) + DOOR_GAP),
        limits=(low, high),
        mass=mass,
        friction=hinge.friction,
        rgba=rgba,
    )


class MeshPieces:
    """Convex pieces of a model's meshes, cached as several geoms may share one.

    Args:
        model: The compiled model.

    Attributes:
        notes: Meshes that are coarser than in the file, in words.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.notes: dict[str, None] = {}
        self._model = model
        self._known: dict[tuple[int, bool], list[ConvexPiece] | str] = {}

    def of(self, geom: int, name: str, *, hull: bool = False) -> list[ConvexPiece]:
        """Return the pieces of a geom's mesh, in the geom's axes.

        Args:
            geom: The geom's id.
            name: Name in errors.
            hull: Whether to replace pieces that are not convex by their hulls.

        Raises:
            ArenaFileError: See `convex_pieces`.
        """
        key = int(self._model.geom_dataid[geom]), hull
        if key not in self._known:
            try:
                self._known[key] = convex_pieces(*_mesh(self._model, key[0]), "", hull=hull)
            except ArenaFileError as error:
                # A mesh that fails costs as much as one that does not: keep that too.
                self._known[key] = str(error)
        found = self._known[key]
        if isinstance(found, str):
            raise ArenaFileError(f"{name}{found}")
        return found

    def touched(self, geom: int, name: str) -> list[ConvexPiece]:
        """Return the pieces of a geom's mesh that things touch: as in MuJoCo, hulls if it is not convex."""
        from scipy.spatial import ConvexHull

        try:
            return self.of(geom, name)
        except ArenaFileError:
            try:
                found = self.of(geom, name, hull=True)
                met = "robots meet its hull, rays its faces"
            except ArenaFileError:
                vertices = hull_corners(_mesh(self._model, int(self._model.geom_dataid[geom]))[0])
                found = [ConvexPiece(name, vertices, float(ConvexHull(vertices).volume))]
                met = f"robots and rays meet a hull of {len(vertices)} corners"
        self.notes.setdefault(f"{name} is not convex, not closed or too fine: {met}")
        return found


def geom_shapes(
    model: mujoco.MjModel, geom: int, pose: Pose, surface: str, name: str, meshes: MeshPieces
) -> list[Shape]:
    """Return a geom as shapes without mass; a mesh gives one for each of its pieces.

    Args:
        model: The compiled model.
        geom: The geom's id.
        pose: Pose in the axes of the shapes.
        surface: Their surface.
        name: Name in errors.
        meshes: Pieces of the model's meshes.

    Raises:
        ArenaFileError: A geom of a kind that arenas do not have, or a flat mesh.
    """
    kind = GeomType(model.geom_type[geom])
    like = Shape(
        kind="box",
        at=flip_vector(usarsim_vector(pose.pos)),
        rotation=flip_angles(usarsim_angles(pose.mat)),
        surface=surface,
        rgba=geom_colour(model, geom),
    )
    if kind in KINDS:
        form = KINDS[kind]
        size = tuple(model.geom_size[geom][: SIZES[form]].tolist())
        return [replace(like, kind=form, size=size)]
    if kind == GeomType.mjGEOM_HFIELD:
        return [_terrain(model, int(model.geom_dataid[geom]), like)]
    if kind != GeomType.mjGEOM_MESH:
        # mjGEOM_PLANE without its prefix.
        raise ArenaFileError(f"{name} is a {kind.name[7:].lower()}; arenas have none")
    # Solids without contacts are only seen, by their faces.
    pieces = meshes.of(geom, name, hull=True) if surface == FIXTURE else meshes.touched(geom, name)
    return [replace(like, kind="mesh", mesh=piece.mesh) for piece in pieces]


def geom_mass(model: mujoco.MjModel, geom: int, described: mujoco.MjsGeom, meshes: MeshPieces) -> float:
    """Return the mass that a geom would contribute to its body [kg]."""
    if np.isfinite(described.mass):
        return float(described.mass)
    if GeomType(model.geom_type[geom]) in KINDS:
        return described.density * volume(model, geom)
    found = meshes.touched(geom, described.name)
    return described.density * sum(piece.volume for piece in found)


def _terrain(model: mujoco.MjModel, number: int, like: Shape) -> Shape:
    rows, columns, start = (
        int(values[number]) for values in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr)
    )
    x, y, top, base = model.hfield_size[number].tolist()
    # MuJoCo scales heights to 0..1; the largest height is in the size.
    shares = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    heights = HeightField(shares.astype(float) * top)
    return replace(like, kind="hfield", size=(x, y, base), heights=heights)


def _mesh(model: mujoco.MjModel, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of a mesh."""
    first, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
    start, faces = int(model.mesh_faceadr[number]), int(model.mesh_facenum[number])
    # MuJoCo keeps vertices in single precision, centred and turned to the mesh's principal axes, as the geom
    # is.
    return model.mesh_vert[first : first + count].astype(float), model.mesh_face[start : start + faces]


def with_masses(shapes: list[Shape], whole: Inertia) -> tuple[tuple[Shape, ...], BodyInertia | None]:
    """Return solids, with masses if these account for the given inertia; else the inertia too."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    body.add_freejoint()
    for i, shape in enumerate(shapes):
        add_geom(spec, body, str(i), shape)
    # MuJoCo refuses to compile a moving body without mass.
    if sum(shape.mass for shape in shapes) > 0:
        model = spec.compile()
        turn = mat_of(model.body_iquat[1])
        tensor = turn @ np.diag(model.body_inertia[1]) @ turn.T
        # A length of the body's own: a tolerance in metres would be too wide for small bodies.
        reach = np.sqrt(np.trace(whole.tensor) / whole.mass)
        if (
            abs(model.body_mass[1] - whole.mass) <= INERTIA_TOLERANCE * whole.mass
            and np.abs(model.body_ipos[1] - whole.centre).max() <= INERTIA_TOLERANCE * reach
            and np.abs(tensor - whole.tensor).max() <= INERTIA_TOLERANCE * np.trace(whole.tensor)
        ):
            return tuple(shapes), None
    return tuple(replace(shape, mass=0.0) for shape in shapes), described_in_arena(whole)


def mjcf_content(path: Path, surface: str = "") -> Content:
    """Return the content of an MJCF file for an arena, at its reference configuration.

    Geoms of the world and of bodies without joints are fixed solids; planes of one height are the floor, to
    whose height everything moves. Meshes that are not convex are touched as their hulls, as in MuJoCo. A
    body with a free joint is a loose object, including all bodies fixed to it. A body with one hinge about
    the vertical is a door, if it is one upright box with the hinge at one of its narrow sides. Any other
    joint is refused, as are tendons, equality constraints and flexes. Robots, which are bodies with motors
    and several joints or a free one, are left out with all that belongs to them. Actuators, sensors, lights,
    cameras, sites and options are left out, with a warning. Friction is ours: see `surface_of`.

    Args:
        path: The file.
        surface: Surface of its fixed solids; empty: by their form.

    Raises:
        ArenaFileError: An unreadable file, or content that an arena cannot have; names it.
    """
    check_model_size(path)
    # In a process of its own first: some files crash MuJoCo's parser, which would end this one.
    if wrong := try_model(path):
        raise ArenaFileError(f"{path}: does not read as MJCF: {wrong}")
    spec = mujoco.MjSpec.from_file(str(path))
    drop_sizes(spec)
    try:
        notes = leave_out_robots(path, spec)
        model = spec.compile()
        refused = (("tendon", model.ntendon), ("equality constraint", model.neq), ("flex", model.nflex))
        for kind, count in refused:
            if count:
                raise ArenaFileError(f"{path}: has {count} of kind {kind}; arenas have none")
        content = _MjcfReader(path, spec, model, surface).content()
        return replace(content, warnings=(*notes, *content.warnings))
    except UnicodeDecodeError as error:
        raise ArenaFileError(f"{path}: has a name that is no UTF-8: {error}") from error


class _MjcfReader:
    """A compiled file, its bodies sorted by the moving body that they belong to.

    Args:
        path: The file, for messages.
        spec: Its description, for densities.
        model: The compiled model.
        surface: Surface of fixed solids; empty: by their form.
    """

    def __init__(self, path: Path, spec: mujoco.MjSpec, model: mujoco.MjModel, surface: str) -> None:
        self._path, self._model, self._surface = path, model, surface
        # The compiled model has no densities: masses of single geoms come from the description.
        self._described = {geom.id: geom for geom in spec.geoms}
        self._data = mujoco.MjData(model)
        # Not `mj_forward`: poses need neither contacts nor forces, which are slow in large scenes.
        mujoco.mj_kinematics(model, self._data)
        self._warnings = _ignored(path, spec)
        self._meshes = MeshPieces(model)
        self._owner = [0] * model.nbody  # the body with the joint that moves each one; 0: it is fixed
        # Parents have lower numbers than their children.
        for body in range(1, model.nbody):
            jointed = model.body_jntnum[body] > 0
            self._owner[body] = body if jointed else self._owner[int(model.body_parentid[body])]
        self._owned: dict[int, list[int]] = {}
        for geom in range(model.ngeom):
            self._owned.setdefault(self._owner[int(model.geom_bodyid[geom])], []).append(geom)
        self._members: dict[int, list[int]] = {}
        for body in range(model.nbody):
            self._members.setdefault(self._owner[body], []).append(body)
        self._planes = [geom for geom in self._geoms(0) if self._kind(geom) == GeomType.mjGEOM_PLANE]
        self._floor = self._floor_height()

    def content(self) -> Content:
        """Return the file's content."""
        loose: list[LooseObject] = []
        doors: list[Door] = []
        model = self._model
        # The world is its own owner, too.
        moving = sum(owner == body for body, owner in enumerate(self._owner)) - 1
        if moving > MAX_MOVING_BODIES:
            raise self._error(f"has {moving} bodies that move; at most {MAX_MOVING_BODIES}")
        for body in range(1, model.nbody):
            if self._owner[body] != body:
                continue
            if self._free(body):
                loose.append(self._loose(body))
            else:
                doors.append(self._door(body))
        shapes = [shape for geom in self._geoms(0) for shape in self._fixed(geom)]
        content = Content(
            shapes=tuple(shapes),
            loose=tuple(loose),
            doors=tuple(doors),
            floor=bool(self._planes),
            warnings=(*self._warnings, *self._meshes.notes),
        )
        # Arenas have their floor at height 0.
        return transform_content(content, (0.0, 0.0, -self._floor), 0.0)

    def _floor_height(self) -> float:
        """Return the height of the planes [m]: if all lie at one, that is the floor's."""
        heights = [float(self._data.geom_xpos[plane][2]) for plane in self._planes]
        height = heights[0] if heights and np.ptp(heights) <= FLOOR_TOLERANCE else 0.0
        if abs(height) <= FLOOR_TOLERANCE:
            return 0.0
        name = self._name("geom", self._planes[0])
        self._warnings.append(
            f"{self._path}: the floor, plane {name!r}, is at height {height:g}: everything moves by "
            f"{-height:g} m, so that it is at 0"
        )
        return height

    def _error(self, text: str) -> ArenaFileError:
        return ArenaFileError(f"{self._path}: {text}")

    def _kind(self, geom: int) -> mujoco.mjtGeom:
        return GeomType(self._model.geom_type[geom])

    def _name(self, kind: str, number: int) -> str:
        return getattr(self._model, kind)(number).name or f"number {number}"

    def _geoms(self, owner: int) -> list[int]:
        """Return the geoms of a body and of all bodies fixed to it."""
        return self._owned.get(owner, [])

    def _free(self, body: int) -> bool:
        """Return whether a body with joints is a loose object; refuse anything but that and doors."""
        model, first = self._model, int(self._model.body_jntadr[body])
        kinds = [
            JointType(kind) for kind in model.jnt_type[first : first + int(model.body_jntnum[body])].tolist()
        ]
        if kinds == [JointType.mjJNT_FREE]:
            return True
        name, parent = self._name("body", body), self._owner[int(model.body_parentid[body])]
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
            above = abs(self._data.geom_xpos[geom][2] - self._floor)
            if above > FLOOR_TOLERANCE or mat[2, 2] < 1 - FLOOR_TOLERANCE:
                raise self._error(
                    f"plane {self._name('geom', geom)!r} is unbounded and not the floor: make it a box"
                )
            return []
        shapes = self._shapes(geom, Pose(self._data.geom_xpos[geom], mat), "wall")
        return [
            shape if shape.surface == FIXTURE else replace(shape, surface=self._surface or surface_of(shape))
            for shape in shapes
        ]

    def _shapes(self, geom: int, pose: Pose, surface: str) -> list[Shape]:
        """Return a geom as shapes with a pose; those without contacts get surface "fixture"."""
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
        solids, inertia = with_masses(shapes, self._inertia(body, frame))
        return LooseObject(
            name=name,
            at=_vec(data.xpos[body]),
            rotation=flip_angles(usarsim_angles(frame.mat)),
            shapes=solids,
            inertia=inertia,
        )

    def _relative_pose(self, frame: Pose, geom: int) -> Pose:
        pos, mat = self._data.geom_xpos[geom], self._data.geom_xmat[geom].reshape(3, 3)
        return Pose(frame.mat.T @ (pos - frame.pos), frame.mat.T @ mat)

    def _inertia(self, body: int, frame: Pose) -> Inertia:
        """Return mass, centre and inertia of a body including bodies fixed to it, in the body's axes."""
        parts: list[Inertia] = []
        for member in self._members[body]:
            mat = frame.mat.T @ self._data.ximat[member].reshape(3, 3)
            # The file's principal axes (`ximat`) in those of the moving body: parts add up in one frame only.
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
        # Limits count from where the model has the door, which is closed here.
        low, high = (model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]).tolist()
        pose = Pose(self._data.geom_xpos[geom], self._data.geom_xmat[geom].reshape(3, 3))
        hinge = Hinge(
            anchor=self._data.xanchor[joint],
            axis=self._data.xaxis[joint],
            limits=(low, high) if model.jnt_limited[joint] else None,
            friction=float(np.ravel(model.dof_damping[model.jnt_dofadr[joint]])[0]),
        )
        try:
            return door_of(
                name,
                pose,
                model.geom_size[geom],
                hinge,
                mass=float(model.body_mass[body]),
                rgba=geom_colour(model, geom),
            )
        except ArenaFileError as error:
            raise self._error(str(error)) from error


def _vec(vector: np.ndarray) -> Vec3:
    x, y, z = vector.tolist()
    return (x, y, z)


def _ignored(path: Path, spec: mujoco.MjSpec) -> list[str]:
    """Return the content of a file that is left out, in words."""
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
    return [left_out(path, kind, found) for kind, found in kinds.items() if found]
