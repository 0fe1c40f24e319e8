"""Robots as files of other tools: MJCF, URDF, SDF, with the mass, solids and joints of the composed model.

Exports of arenas use its pieces: numbers, poses, meshes.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.models.compile.compose import add_robot
from usarmjx.models.files.mjcf_solids import Pose, mat_of
from usarmjx.models.types.robot import RobotSpec

ELLIPSOID_SIDES = 16
"""Corners around an ellipsoid, which URDF has as a mesh only."""
LOCKED = 1e-6
"""Cosine of a pitch below which roll and yaw are rounding errors of single precision."""


@dataclass(frozen=True, kw_only=True)
class ExportResult:
    """An exported robot or arena.

    Attributes:
        files: The files, the main one first.
        notes: Content that the format has no place for, in words.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...]


def write_file(path: Path, data: bytes) -> None:
    """Write a file whole or not at all."""
    with atomic_write(path) as fresh:
        fresh.write_bytes(data)


def text_of(values: object) -> str:
    """Return numbers with as many digits as they need to be read back equal."""
    return " ".join(repr(float(value)) for value in np.atleast_1d(np.asarray(values, float)))


def rpy_of(mat: np.ndarray) -> np.ndarray:
    """Return roll, pitch, yaw (3,) of a rotation (3, 3): turns about fixed x, y, z, as in URDF and SDF."""
    # Not the arcsine: it loses digits near 90 degrees, and rounding may carry its argument beyond 1.
    pitch = np.arctan2(-mat[2, 0], np.hypot(mat[0, 0], mat[1, 0]))
    if np.hypot(mat[0, 0], mat[1, 0]) < LOCKED:  # gimbal lock: roll and yaw are one rotation
        return np.array([np.arctan2(-mat[1, 2], mat[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(mat[2, 1], mat[2, 2]), pitch, np.arctan2(mat[1, 0], mat[0, 0])])


def add_child(parent: ET.Element, tag: str, values: object) -> None:
    """Add an element that holds numbers."""
    ET.SubElement(parent, tag).text = text_of(values)


def add_pose(parent: ET.Element, pose: Pose) -> None:
    """Add a `<pose>` of SDF."""
    add_child(parent, "pose", [*pose.pos, *rpy_of(pose.mat)])


def ellipsoid_corners(radii: np.ndarray) -> np.ndarray:
    """Return corners on an ellipsoid (n, 3), its six ends among them."""
    turn = np.arange(ELLIPSOID_SIDES) * 2 * np.pi / ELLIPSOID_SIDES
    # An odd number of rings: one of them is the equator, with four of the six ends.
    up = np.linspace(-np.pi / 2, np.pi / 2, ELLIPSOID_SIDES // 2 + 1)[:, None]
    x, y, z = np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up) + 0 * turn
    # Each pole comes once for every corner around it: rounding makes the copies equal.
    return np.unique(np.stack([x, y, z], -1).reshape(-1, 3).round(12), axis=0) * radii


def stl_of_hull(corners: np.ndarray) -> bytes:
    """Return the convex hull of corners (n, 3) as a binary STL file, its faces outwards."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(corners)
    faces = corners[hull.simplices]
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    inwards = (normal * hull.equations[:, :3]).sum(1) < 0
    # Qhull's simplices have corners in any order; readers take faces from the order.
    faces[inwards] = faces[inwards][:, ::-1]
    return stl_of(faces)


def stl_of(triangles: np.ndarray) -> bytes:
    """Return triangles (n, 3, 3), counter-clockwise from outside, as a binary STL file."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facets = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
    # Flat triangles have no normal: zeros, from which readers compute their own.
    facets["normal"], facets["corners"] = normal / np.maximum(length, 1e-300), triangles
    # The header must not begin with the word solid, by which readers know text files.
    return b"usarmjx".ljust(80, b"\0") + len(facets).to_bytes(4, "little") + facets.tobytes()


FORMATS = ("mjcf", "urdf", "sdf")
"""Formats of files."""
SUFFIXES = {"mjcf": ".xml", "urdf": ".urdf", "sdf": ".sdf"}
"""Suffix of a file of each format."""
NO_LIMIT = 1e16
"""Limit of a joint without one, as SDF has it."""


def export_robot(robot: RobotSpec, path: Path, form: str) -> ExportResult:
    """Write a robot as a file of another tool; meshes of URDF and SDF become STL files beside it.

    Args:
        robot: The robot.
        path: The file.
        form: One of `FORMATS`.

    Raises:
        UsageError: Another format.
        SpecError: The robot cannot be built.
        WriteError: A file cannot be written.
    """
    if form not in FORMATS:
        raise UsageError(f"format {form!r}; known: {', '.join(FORMATS)}")
    spec = mujoco.MjSpec()
    # `add_robot` gives angles in radians, which MuJoCo would take for degrees.
    spec.compiler.degree = False
    spec.modelname = robot.name
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    notes = ["sensors, cameras and effecters are left out"] if robot.sensors or robot.cameras else []
    if form == "mjcf":
        write_file(path, spec.to_xml().encode())
        return ExportResult(files=(path,), notes=tuple(notes))
    writer = _ModelWriter(model, robot, path)
    root = writer.urdf() if form == "urdf" else writer.sdf()
    ET.indent(root)
    write_file(path, ET.tostring(root, encoding="utf-8", xml_declaration=True))
    notes += writer.notes
    return ExportResult(files=(path, *writer.files), notes=tuple(notes))


class _ModelWriter:
    """Writer of one compiled robot.

    Args:
        model: The robot alone.
        robot: Its class, for the motors.
        path: The file.
    """

    def __init__(self, model: mujoco.MjModel, robot: RobotSpec, path: Path) -> None:
        self._model, self._robot, self._path = model, robot, path
        self._motors = {part.name: part.motor for part in robot.parts if part.motor is not None}
        self._gears = {part.name: part for part in robot.parts if part.geared is not None}
        self.files: list[Path] = []
        self.notes: list[str] = []
        self._meshes: dict[int, str] = {}
        self._data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self._data)

    def urdf(self) -> ET.Element:
        """Return the robot as `<robot>`."""
        root = ET.Element("robot", name=self._robot.name)
        # MuJoCo would weld the root to the world and drop its mass; other readers skip the element.
        ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", fusestatic="false", discardvisual="false")
        for body in range(1, self._model.nbody):
            link = ET.SubElement(root, "link", name=self._name(body))
            self._urdf_inertial(link, body)
            for geom in self._geoms(body):
                self._urdf_geom(link, geom)
        # Body 1 is the chassis, which hangs on no joint.
        for body in range(2, self._model.nbody):
            self._urdf_joint(root, body)
        return root

    def sdf(self) -> ET.Element:
        """Return the robot as `<sdf>`."""
        root = ET.Element("sdf", version="1.9")
        model = ET.SubElement(root, "model", name=self._robot.name)
        for body in range(1, self._model.nbody):
            link = ET.SubElement(model, "link", name=self._sdf_link(body))
            add_pose(link, self._pose(body))
            self._sdf_inertial(link, body)
            for geom in self._geoms(body):
                self._sdf_geom(link, geom)
        for body in range(2, self._model.nbody):
            self._sdf_joint(model, body)
        return root

    def _sdf_link(self, body: int) -> str:
        """Return the name of a link in SDF, where no link and joint of a model may share one."""
        return f"{self._name(body)}_link" if self._model.body_jntnum[body] and body > 1 else self._name(body)

    def _name(self, body: int) -> str:
        return self._model.body(body).name

    def _geoms(self, body: int) -> range:
        first = int(self._model.body_geomadr[body])
        return range(first, first + int(self._model.body_geomnum[body]))

    def _pose(self, body: int) -> Pose:
        """Return the pose of a body in the root's frame, joints at 0."""
        mat, pos = self._data.xmat[1].reshape(3, 3), self._data.xpos[1]
        return Pose(mat.T @ (self._data.xpos[body] - pos), mat.T @ self._data.xmat[body].reshape(3, 3))

    def _tensor(self, body: int) -> np.ndarray:
        """Return the moments of inertia xx, yy, zz, xy, xz, yz in the axes of the body (6,)."""
        # MuJoCo has principal moments; URDF and SDF take six numbers in the link's axes.
        axes = mat_of(self._model.body_iquat[body])
        tensor = axes @ np.diag(self._model.body_inertia[body]) @ axes.T
        return np.array([tensor[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))])

    def _urdf_inertial(self, link: ET.Element, body: int) -> None:
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz=text_of(self._model.body_ipos[body]), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=text_of(self._model.body_mass[body]))
        keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        moments = {key: text_of(value) for key, value in zip(keys, self._tensor(body), strict=True)}
        ET.SubElement(inertial, "inertia", moments)

    def _urdf_geom(self, link: ET.Element, geom: int) -> None:
        """Add a geom as a visual, and as a collision if it has contacts."""
        for pose, tag, attributes in self._urdf_forms(geom):
            for role in self._roles(geom):
                solid = ET.SubElement(link, role)
                ET.SubElement(solid, "origin", xyz=text_of(pose.pos), rpy=text_of(rpy_of(pose.mat)))
                ET.SubElement(ET.SubElement(solid, "geometry"), tag, attributes)
                if role == "visual":
                    material = ET.SubElement(solid, "material", name=f"colour {geom}")
                    ET.SubElement(material, "color", rgba=text_of(self._model.geom_rgba[geom].round(4)))

    def _roles(self, geom: int) -> tuple[str, ...]:
        touches = self._model.geom_contype[geom] or self._model.geom_conaffinity[geom]
        return ("visual", "collision") if touches else ("visual",)

    def _urdf_forms(self, geom: int) -> Iterator[tuple[Pose, str, dict[str, str]]]:
        """Yield poses and forms of a geom: a capsule is a cylinder and two spheres, an ellipsoid a mesh."""
        model, kinds = self._model, mujoco.mjtGeom
        pose = Pose(model.geom_pos[geom], mat_of(model.geom_quat[geom]))
        kind, size = kinds(int(model.geom_type[geom])), model.geom_size[geom]
        if kind == kinds.mjGEOM_BOX:
            yield pose, "box", {"size": text_of(2 * size)}
        elif kind == kinds.mjGEOM_SPHERE:
            yield pose, "sphere", {"radius": text_of(size[0])}
        elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
            yield pose, "cylinder", {"radius": text_of(size[0]), "length": text_of(2 * size[1])}
            if kind == kinds.mjGEOM_CAPSULE:
                for end in (1, -1):
                    tip = Pose(pose.pos + pose.mat[:, 2] * end * size[1], pose.mat)
                    yield tip, "sphere", {"radius": text_of(size[0])}
        else:
            yield pose, "mesh", {"filename": self._mesh(geom)}

    def _mesh(self, geom: int) -> str:
        """Return the name of the STL file of a mesh or an ellipsoid, in the geom's frame."""
        model = self._model
        is_mesh = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH
        # Negative for ellipsoids: they have no number of a mesh, and must not meet one.
        key = int(model.geom_dataid[geom]) if is_mesh else -1 - geom
        if key not in self._meshes:
            if is_mesh:
                first, count = int(model.mesh_vertadr[key]), int(model.mesh_vertnum[key])
                corners = model.mesh_vert[first : first + count].astype(float)
            else:
                corners = ellipsoid_corners(model.geom_size[geom])
                self.notes.append(f"{model.geom(geom).name}: an ellipsoid is a mesh in URDF")
            path = self._path.with_name(f"{self._path.stem}-mesh-{len(self._meshes) + 1}.stl")
            write_file(path, stl_of_hull(corners))
            self.files.append(path)
            self._meshes[key] = path.name
        return self._meshes[key]

    def _urdf_joint(self, root: ET.Element, body: int) -> None:
        model, parent = self._model, int(self._model.body_parentid[body])
        number = int(model.body_jntadr[body])
        moves = model.body_jntnum[body] > 0
        name = model.joint(number).name if moves else f"{self._name(body)}_fixed"
        kind = "fixed"
        if moves:
            slides = model.jnt_type[number] == mujoco.mjtJoint.mjJNT_SLIDE
            # URDF has another type for hinges without limits, SDF gives those huge limits.
            kind = "prismatic" if slides else "revolute" if model.jnt_limited[number] else "continuous"
        joint = ET.SubElement(root, "joint", name=name, type=kind)
        ET.SubElement(joint, "parent", link=self._name(parent))
        ET.SubElement(joint, "child", link=self._name(body))
        turn = rpy_of(mat_of(model.body_quat[body]))
        ET.SubElement(joint, "origin", xyz=text_of(model.body_pos[body]), rpy=text_of(turn))
        if not moves:
            return
        ET.SubElement(joint, "axis", xyz=text_of(model.jnt_axis[number]))
        effort, speed = self._limits(name)
        limit = {"effort": text_of(effort), "velocity": text_of(speed)}
        # URDF's sliding joints need limits, continuous ones have none.
        if kind != "continuous":
            low, high = model.jnt_range[number] if model.jnt_limited[number] else (-NO_LIMIT, NO_LIMIT)
            limit = {"lower": text_of(low), "upper": text_of(high), **limit}
        ET.SubElement(joint, "limit", limit)
        damping = float(model.dof_damping[model.jnt_dofadr[number]])
        ET.SubElement(joint, "dynamics", damping=text_of(damping))
        if (gear := self._gears.get(name)) is not None and gear.geared is not None:
            ratio, offset = text_of(gear.gear_ratio), text_of(gear.gear_offset)
            ET.SubElement(joint, "mimic", joint=gear.geared, multiplier=ratio, offset=offset)

    def _limits(self, name: str) -> tuple[float, float]:
        """Return effort and speed of a joint's motor; 0: it has none."""
        motor = self._motors.get(name)
        return (0.0, 0.0) if motor is None else (motor.torque, motor.max_speed)

    def _sdf_inertial(self, link: ET.Element, body: int) -> None:
        inertial = ET.SubElement(link, "inertial")
        add_pose(inertial, Pose(self._model.body_ipos[body], np.eye(3)))
        add_child(inertial, "mass", self._model.body_mass[body])
        inertia = ET.SubElement(inertial, "inertia")
        for key, value in zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), self._tensor(body), strict=True):
            add_child(inertia, key, value)

    def _sdf_geom(self, link: ET.Element, geom: int) -> None:
        model, kinds = self._model, mujoco.mjtGeom
        kind, size = kinds(int(model.geom_type[geom])), model.geom_size[geom]
        for role in self._roles(geom):
            solid = ET.SubElement(link, role, name=f"{role} {geom}")
            add_pose(solid, Pose(model.geom_pos[geom], mat_of(model.geom_quat[geom])))
            geometry = ET.SubElement(solid, "geometry")
            if kind == kinds.mjGEOM_BOX:
                add_child(ET.SubElement(geometry, "box"), "size", 2 * size)
            elif kind == kinds.mjGEOM_SPHERE:
                add_child(ET.SubElement(geometry, "sphere"), "radius", size[0])
            elif kind == kinds.mjGEOM_ELLIPSOID:
                add_child(ET.SubElement(geometry, "ellipsoid"), "radii", size)
            elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
                tag = "cylinder" if kind == kinds.mjGEOM_CYLINDER else "capsule"
                form = ET.SubElement(geometry, tag)
                add_child(form, "radius", size[0])
                add_child(form, "length", 2 * size[1])
            else:
                ET.SubElement(ET.SubElement(geometry, "mesh"), "uri").text = self._mesh(geom)
            if role == "visual":
                material = ET.SubElement(solid, "material")
                for tag in ("ambient", "diffuse"):
                    # MuJoCo stores colours in single precision: 0.6 would be written with 16 digits.
                    add_child(material, tag, model.geom_rgba[geom].round(4))

    def _sdf_joint(self, root: ET.Element, body: int) -> None:
        model, number = self._model, int(self._model.body_jntadr[body])
        moves = model.body_jntnum[body] > 0
        name = model.joint(number).name if moves else f"{self._name(body)}_fixed"
        slides = moves and model.jnt_type[number] == mujoco.mjtJoint.mjJNT_SLIDE
        joint = ET.SubElement(
            root, "joint", name=name, type="prismatic" if slides else "revolute" if moves else "fixed"
        )
        ET.SubElement(joint, "parent").text = self._sdf_link(int(model.body_parentid[body]))
        ET.SubElement(joint, "child").text = self._sdf_link(body)
        if not moves:
            return
        axis = ET.SubElement(joint, "axis")
        add_child(axis, "xyz", model.jnt_axis[number])
        if (gear := self._gears.get(name)) is not None and gear.geared is not None:
            # libsdformat looks for it in the axis, and nowhere deeper.
            mimic = ET.SubElement(axis, "mimic", joint=gear.geared)
            for tag, value in (
                ("multiplier", gear.gear_ratio),
                ("offset", gear.gear_offset),
                ("reference", 0),
            ):
                add_child(mimic, tag, value)
        limit = ET.SubElement(axis, "limit")
        low, high = model.jnt_range[number] if model.jnt_limited[number] else (-NO_LIMIT, NO_LIMIT)
        effort, speed = self._limits(name)
        for tag, value in (("lower", low), ("upper", high), ("effort", effort), ("velocity", speed)):
            add_child(limit, tag, value)
        add_child(ET.SubElement(axis, "dynamics"), "damping", model.dof_damping[model.jnt_dofadr[number]])
