"""URDF files as robots: links and joints as bodies of MuJoCo's description.

MuJoCo's own reader is not used here: it takes no COLLADA meshes, weighs what has no mass, refuses inertias
that are out of balance, and drops limits of effort and speed. Tests compare both where it reads a file.
"""

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.errors import ArenaFileError, SpecError
from usarmjx.models.files.mesh_solids import hull_corners, round_about
from usarmjx.models.files.meshes import mesh_vertices
from usarmjx.models.files.reader_process import read_pieces
from usarmjx.models.files.resources import Resources
from usarmjx.models.files.robot_source import JointLimit, MimicJoint, RobotSource, listed
from usarmjx.models.files.urdf import form_of, frame_of, joints_by_parent, lengths_of, link_at
from usarmjx.models.files.xml_lines import MAX_DEPTH, NO_POSE, LinedElement, attribute_numbers

LIGHT = 1e-3
"""Mass of a root where the file has no mass at all [kg]."""
LIGHT_SHARE = 1e-7
"""Mass of all moving links for which the file has none, over that of the robot: MuJoCo needs some."""
LIGHT_NOTE = f"it gets its part of {LIGHT_SHARE:g} of the robot's mass"
"""Note about such a link."""
LIGHT_INERTIA = 1e-6
"""Moments of inertia of such a link [kg m2]."""
HINGES, SLIDES = ("revolute", "continuous"), ("prismatic",)
"""Types of joints that turn, and of those that slide."""
MOVING = (*HINGES, *SLIDES)
"""Types of joints that move."""
HELD = ("floating", "planar")
"""Types of joints that robots do not have; they are held."""
BALANCE_TOLERANCE = 1e-6
"""Excess of a moment over the sum of the others that is taken for rounding, relative to it."""
MIN_MASS = 1e-9
"""Mass up to which a link counts as one without mass [kg]: MuJoCo does."""
MIN_MOMENT = 1e-12
"""Smallest moment of inertia [kg m2]: MuJoCo's is smaller."""


def read_urdf_robot(root: LinedElement, path: Path, resources: Resources, pieces: int = 1) -> RobotSource:
    """Return a URDF file's robot.

    Args:
        root: Its `<robot>` element.
        path: The file, for messages and relative names.
        resources: Finder of the files that it names.
        pieces: Largest number of convex pieces of a mesh.

    Raises:
        SpecError: An element that does not read, or content that a robot cannot have; names file and line.
    """
    return _UrdfReader(root, path, resources, pieces).read()


class _UrdfReader:
    """Reader of one file.

    Args:
        root: The `<robot>` element.
        path: The file.
        resources: Finder of the files that it names.
    """

    def __init__(self, root: LinedElement, path: Path, resources: Resources, pieces: int) -> None:
        self._pieces = pieces
        self._root, self._path, self._resources = root, path, resources
        self._links = {link.get("name", ""): link for link in root.all("link")}
        self._spec = mujoco.MjSpec()
        self._spec.compiler.degree = False
        self._visual_only = all(link.first("collision/geometry") is None for link in self._links.values())
        self._meshes: dict[tuple[str, tuple[float, ...], int], list[str]] = {}
        self._bodies: dict[str, mujoco.MjsBody] = {}
        self._massless: list[mujoco.MjsBody] = []
        self._joints: Mapping[str, list[LinedElement]] = {}

    def read(self) -> RobotSource:
        """Return the file's robot."""
        self._joints = joints = joints_by_parent(self._root, self._links)
        top = self._top(joints)
        self._source = RobotSource(
            path=self._path, name=self._root.get("name", ""), spec=self._spec, root=body_name(top)
        )
        if self._visual_only:
            self._source.notes.append(f"{self._path}: no link collides: visual solids collide in their place")
        waiting: list[tuple[str, LinedElement | None, mujoco.MjsBody]] = [(top, None, self._spec.worldbody)]
        for name, joint, parent in waiting:
            body = self._add_link(name, joint, parent)
            waiting += [(link_at(child, "child"), child, body) for child in joints.get(name, ())]
        self._weigh_chassis(top, joints)
        self._weigh_massless()
        self._note_left_out(joints)
        return self._source

    def _weigh_chassis(self, top: str, joints: Mapping[str, list[LinedElement]]) -> None:
        """Give the root a mass where it and all links that are fixed to it have none."""
        rigid = [top]
        for name in rigid:
            if self._bodies[name].mass > MIN_MASS:
                return
            rigid += [
                child
                for joint in joints.get(name, ())
                if not self._bodies[child := link_at(joint, "child")].joints
            ]
        self._massless.append(self._bodies[top])
        self._source.notes.append(
            f"{self._links[top].place}: no link that is fixed to the root {top!r} has a mass: {LIGHT_NOTE}"
        )

    def _weigh_massless(self) -> None:
        """Give the bodies that need a mass and have none a share of the robot's that does not count."""
        whole = sum(body.mass for body in self._bodies.values())
        for body in self._massless:
            body.mass = max(LIGHT_SHARE * whole / len(self._massless), MIN_MASS) if whole else LIGHT
            body.inertia = [LIGHT_INERTIA] * 3

    def _top(self, joints: Mapping[str, list[LinedElement]]) -> str:
        """Return the root link with the most links below it."""
        children = {link_at(joint, "child") for some in joints.values() for joint in some}
        tops = [name for name in self._links if name not in children]
        if not tops:
            raise SpecError(f"{self._path}: no link is the root: links hang on each other, or there are none")

        return max(tops, key=lambda name: len(self._links_below(name, joints)))

    def _links_below(self, top: str, joints: Mapping[str, list[LinedElement]]) -> list[str]:
        """Return a link and all links below it, parents first."""
        found, depth = [top], {top: 0}
        for name in found:
            for joint in joints.get(name, ()):
                child = link_at(joint, "child")
                depth[child] = depth[name] + 1
                if depth[child] > MAX_DEPTH:
                    raise joint.error(
                        f"link {child!r} hangs on a chain of {depth[child]} joints; at most {MAX_DEPTH}"
                    )
                found.append(child)
        return found

    def _note_left_out(self, joints: Mapping[str, list[LinedElement]]) -> None:
        lost = [name for name in self._links if name not in self._bodies]
        if lost:
            self._source.notes.append(
                f"{self._links[lost[0]].place}: links {listed(lost)} are not joined to "
                f"{self._source.root!r}: left out"
            )
        every = [joint for some in joints.values() for joint in some]
        for tag in ("safety_controller", "calibration", "dynamics"):
            found = [(joint, element) for joint in every if (element := joint.first(tag)) is not None]
            if tag == "dynamics":
                found = [pair for pair in found if attribute_numbers(pair[1], "friction", 1, "0")[0] > 0]
            if found:
                what = "friction" if tag == "dynamics" else f"<{tag}>"
                names = listed([joint.get("name", "") for joint, _ in found])
                self._source.notes.append(f"{found[0][1].place}: {what} of joints is left out: {names}")

    def _add_link(self, name: str, joint: LinedElement | None, parent: mujoco.MjsBody) -> mujoco.MjsBody:
        """Add a link's body, its joint, inertia and solids; return it."""
        link = self._links[name]
        frame = NO_POSE if joint is None else frame_of(joint)
        body = parent.add_body(name=body_name(name), pos=frame.pos, quat=_quat(frame.mat))
        self._bodies[name] = body
        moves = joint is not None and self._add_joint(joint, body)
        self._add_inertia(link, body, moves=moves)
        rolls = joint is not None and joint.get("type") == "continuous"
        may_be_wheel = rolls and not any(one.get("type") in MOVING for one in self._joints.get(name, ()))
        for number, solid in enumerate(self._solids_of(link, joint if may_be_wheel else None)):
            self._add_solid(solid, body, f"{name}/{number}", rolls=rolls)
        return body

    def _solids_of(self, link: LinedElement, hinge: LinedElement | None) -> list[LinedElement]:
        """Return a link's solids: on a wheel's hinge, a round mesh instead of square ones."""
        solids = [*link.all("visual" if self._visual_only else "collision")]
        if hinge is None or self._visual_only or not solids:
            return solids
        given = hinge.first("axis")
        axis = np.array([1.0, 0, 0]) if given is None else attribute_numbers(given, "xyz", 3, "1 0 0")
        axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
        if any(self._is_round(one, axis, otherwise=True) for one in solids):
            return solids
        looks = [one for one in link.all("visual") if self._is_round(one, axis, otherwise=False)]
        if looks:
            self._source.notes.append(
                f"{solids[0].place}: the collision mesh of {link.get('name')!r}, which turns without end, is "
                "not round: its round <visual> collides instead"
            )
        return looks[:1] or solids

    def _is_round(self, element: LinedElement, axis: np.ndarray, *, otherwise: bool) -> bool:
        """Return whether a mesh is round about an axis through its link's origin; `otherwise`: no mesh."""
        form = form_of(element)
        if form is None or form.tag != "mesh":
            return otherwise
        found = self._resources.file(form.get("filename", ""), form.path)
        if found is None:
            return False
        try:
            vertices = mesh_vertices(found)
        except ArenaFileError:  # a mesh that collides is read again, and refused with its line
            return False
        frame = frame_of(element)
        scaled = vertices * attribute_numbers(form, "scale", 3, "1 1 1")
        return round_about(scaled @ frame.mat.T + frame.pos, axis, np.zeros(3)) is not None

    def _add_joint(self, joint: LinedElement, body: mujoco.MjsBody) -> bool:
        """Add a link's joint; return whether it moves."""
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind == "fixed":
            return False
        if kind in HELD:
            self._source.notes.append(f"{joint.place}: joint {name!r} is {kind}: it is held")
            return False
        if kind not in (*HINGES, *SLIDES):
            known = ", ".join((*HINGES, *SLIDES, "fixed", *HELD))
            raise joint.error(f"joint {name!r} has the type {kind!r}; known: {known}")
        axis = np.array([1.0, 0.0, 0.0])  # the format's default
        given = joint.first("axis")
        if given is not None:
            axis = attribute_numbers(given, "xyz", 3, "1 0 0")
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise joint.error(f"joint {name!r} has an axis of length 0")
        made = body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_HINGE if kind in HINGES else mujoco.mjtJoint.mjJNT_SLIDE,
            axis=axis / length,
        )
        self._limit(joint, made, kind)
        dynamics = joint.first("dynamics")
        if dynamics is not None:
            damping = float(attribute_numbers(dynamics, "damping", 1, "0")[0])
            made.damping = [max(damping, 0.0), 0.0, 0.0]
        mimic = joint.first("mimic")
        if mimic is not None:
            ratio, offset = (
                float(attribute_numbers(mimic, key, 1, usual)[0])
                for key, usual in (("multiplier", "1"), ("offset", "0"))
            )
            self._source.mimics[name] = MimicJoint(leader=mimic.get("joint", ""), ratio=ratio, offset=offset)
        return True

    def _limit(self, joint: LinedElement, made: mujoco.MjsJoint, kind: str) -> None:
        limit = joint.first("limit")
        if limit is None:
            if kind == "prismatic":
                self._source.notes.append(f"{joint.place}: joint {joint.get('name')!r} has no limit")
            return
        low, high, effort, speed = (
            float(attribute_numbers(limit, key, 1, "0")[0])
            for key in ("lower", "upper", "effort", "velocity")
        )
        if kind != "continuous" and high > low:
            made.limited, made.range = True, (low, high)
        self._source.limits[made.name] = JointLimit(
            effort=effort if effort > 0 else np.inf, speed=speed if speed > 0 else np.inf
        )

    def _add_inertia(self, link: LinedElement, body: mujoco.MjsBody, *, moves: bool) -> None:
        """Give a body the link's mass and inertia, balanced."""
        inertial = link.first("inertial")
        mass, name = 0.0, link.get("name")
        moments = None if inertial is None else inertial.first("inertia")
        if inertial is not None:
            weight = inertial.first("mass")
            mass = 0.0 if weight is None else float(attribute_numbers(weight, "value", 1)[0])
            if mass < 0:
                raise inertial.error(f"link {name!r} has a mass of {mass:g} kg")
        body.explicitinertial = True
        if inertial is None or mass <= MIN_MASS:
            body.mass, body.inertia = 0.0, [0.0] * 3
            if moves:
                self._massless.append(body)
                self._source.notes.append(
                    f"{link.place}: link {name!r} has a joint and no mass: {LIGHT_NOTE}"
                )
            return
        frame = frame_of(inertial)
        keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        numbers = [
            0.0 if moments is None else float(attribute_numbers(moments, key, 1, "0")[0]) for key in keys
        ]
        xx, yy, zz, xy, xz, yz = numbers
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        values, axes = np.linalg.eigh(frame.mat @ tensor @ frame.mat.T)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        body.mass, body.ipos, body.iquat = mass, frame.pos, _quat(axes)
        body.inertia = self._balanced(values, mass, inertial, str(name))

    def _balanced(self, values: np.ndarray, mass: float, where: LinedElement, name: str) -> np.ndarray:
        """Return moments of inertia (3,) ascending that a body can have."""
        if values[0] < MIN_MOMENT:
            least = max(MIN_MOMENT, 1e-9 * mass, 1e-3 * float(np.abs(values).max()))
            if np.abs(values).max() > 0:
                shown = ", ".join(f"{value:.3g}" for value in values)
                self._source.notes.append(
                    f"{where.place}: link {name!r}: moments of inertia {shown} are mended: they are above 0"
                )
            else:
                least = max(MIN_MOMENT, mass * 1e-4)  # a ball of 1.6 cm radius
                self._source.notes.append(f"{where.place}: link {name!r} has a mass and no inertia: mended")
            values = np.maximum(values, least)
        if values[2] > (values[0] + values[1]) * (1 + BALANCE_TOLERANCE):
            shown = ", ".join(f"{value:.4g}" for value in values)
            self._source.notes.append(
                f"{where.place}: link {name!r}: no body has the moments of inertia {shown}; the largest one "
                "becomes the sum of the others"
            )
        values[2] = min(values[2], (values[0] + values[1]) * (1 - 1e-9))
        return values

    def _add_solid(self, element: LinedElement, body: mujoco.MjsBody, name: str, *, rolls: bool) -> None:
        """Add a collision element's solid, without mass; a mesh that rolls is in one piece."""
        form = form_of(element)
        if form is None:
            raise element.error(f"link {body.name!r} has a <{element.tag}> without geometry")
        frame = frame_of(element)
        like = {"name": name, "pos": frame.pos, "quat": _quat(frame.mat), "mass": 0.0}
        kinds = mujoco.mjtGeom
        if form.tag == "box":
            body.add_geom(type=kinds.mjGEOM_BOX, size=lengths_of(form, "size", 3) / 2, **like)
        elif form.tag == "sphere":
            body.add_geom(type=kinds.mjGEOM_SPHERE, size=[*lengths_of(form, "radius", 1), 0, 0], **like)
        elif form.tag in ("cylinder", "capsule"):
            radius, length = lengths_of(form, "radius", 1)[0], lengths_of(form, "length", 1)[0]
            kind = kinds.mjGEOM_CYLINDER if form.tag == "cylinder" else kinds.mjGEOM_CAPSULE
            body.add_geom(type=kind, size=[radius, length / 2, 0], **like)
        elif form.tag == "mesh":
            for number, mesh in enumerate(self._mesh(form, 1 if rolls else self._pieces)):
                like["name"] = f"{name}/piece {number}" if number else name
                body.add_geom(type=kinds.mjGEOM_MESH, meshname=mesh, **like)
        else:
            raise form.error(f"a solid is a <{form.tag}>; allowed: box, sphere, cylinder, capsule, mesh")

    def _mesh(self, form: LinedElement, pieces: int) -> list[str]:
        """Return the names of a mesh's hull, or of those of its pieces, in the description."""
        file = form.get("filename", "")
        scale = attribute_numbers(form, "scale", 3, "1 1 1")
        key = (file, tuple(scale.tolist()), pieces)
        if key not in self._meshes:
            found = self._resources.file(file, form.path) if file else None
            if found is None:
                raise form.error(f"mesh {file!r} is not there; --packages DIR names folders to search")
            whole = mesh_vertices(found) * scale  # also where it is cut: this checks the file
            cut = [whole] if pieces == 1 else read_pieces(found, pieces, scale)
            self._meshes[key] = [f"mesh {len(self._meshes)}/{number}" for number in range(len(cut))]
            for name, vertices in zip(self._meshes[key], cut, strict=True):
                mesh = self._spec.add_mesh(name=name, uservert=hull_corners(vertices).ravel())
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        return self._meshes[key]


def body_name(link: str) -> str:
    """Return the name of a link's body: MuJoCo keeps `world` for its own."""
    return "world of the file" if link == "world" else link


def _quat(mat: np.ndarray) -> np.ndarray:
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(mat).ravel())
    return quat
