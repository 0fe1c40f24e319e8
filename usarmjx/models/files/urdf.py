"""URDF files: links, joints and frames; as robots, and as fixed solids with joints at zero.

MuJoCo's own reader is not used here: it takes no COLLADA meshes, weighs what has no mass, refuses inertias
that are out of balance, and drops limits of effort and speed. Tests compare both where it reads a file.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.errors import ArenaFileError, SpecError
from usarmjx.base.transforms import flip_angles, flip_vector
from usarmjx.models.files.content import Content, surface_of
from usarmjx.models.files.mesh_solids import hull_corners, round_about
from usarmjx.models.files.meshes import NO_MESH, load_convex_pieces, mesh_vertices, shapes_of
from usarmjx.models.files.mjcf_solids import Pose, usarsim_angles, usarsim_vector
from usarmjx.models.files.reader_process import read_pieces
from usarmjx.models.files.resources import Resources
from usarmjx.models.files.robot_source import JointLimit, MimicJoint, RobotSource, listed
from usarmjx.models.files.xml_file import (
    MAX_DEPTH,
    NO_POSE,
    LinedElement,
    attribute_numbers,
    pose_of,
    read_lined_xml,
)
from usarmjx.models.types.shapes import Rgba, Shape

MAX_LISTED_LINKS = 20
"""Largest number of links in a message."""
GREY = (0.7, 0.7, 0.7, 1.0)
PACKAGE = "package://"
"""Prefix of files in ROS packages."""
MAX_MESH_FILES = 1000
"""Largest number of meshes in a file, repetitions included."""
GEOMETRY_KINDS = ("box", "sphere", "cylinder", "mesh")
"""Supported geometry elements."""
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


def read_urdf(path: Path, text: bytes | None = None) -> LinedElement:
    """Return the `<robot>` element of a URDF file.

    Args:
        path: The file.
        text: Text to read instead of the file's content.

    Raises:
        ArenaFileError: See `read_lined_xml`; or another root.
    """
    root = read_lined_xml(path, text)
    if root.tag != "robot":
        raise ArenaFileError(f"{path}: its root is <{root.tag}>; a URDF file's is <robot>")
    return root


VECTORS = {"xyz": 3, "rpy": 3, "scale": 3, "size": 3}
"""Attributes of URDF with several numbers, and how many."""
MAX_STEERING = 3.0
"""Largest limit of a continuous joint that counts [rad]: wheels are limited to half a turn by mistake."""
VALUES = ("mu1", "mu2", "mu")
"""Elements of `<gazebo>` whose number some files have in an attribute."""


def mend_urdf(root: LinedElement) -> list[str]:
    """Change what other readers of URDF accept to the format; return notes, with file and line.

    Commas between numbers, more numbers than there are axes, numbers of `<gazebo>` in an attribute, and
    limits of continuous joints within which no wheel turns.
    """
    notes: list[str] = []
    for element in root.iter():
        assert isinstance(element, LinedElement)
        for key, count in VECTORS.items():
            text = element.get(key)
            if text is None:
                continue
            words = text.replace(",", " ").split()
            # Fewer numbers are left to the reader, which refuses them.
            if "," not in text and len(words) <= count:
                continue
            said = "commas" if "," in text else f"{len(words)} numbers"
            notes.append(
                f"{element.place}: <{element.tag} {key}> has {said}: {' '.join(words[:count])} counts"
            )
            element.set(key, " ".join(words[:count]))
        if element.tag in VALUES and not (element.text or "").strip() and (value := element.get("value")):
            element.text = value
        if element.tag == "joint" and element.get("type") == "continuous" and _is_limited(element):
            notes.append(
                f"{element.place}: joint {element.get('name')!r} is continuous and has limits: they hold"
            )
            # The range of a continuous joint is not read, see `_limit`: as a revolute one it keeps it.
            element.set("type", "revolute")
    return notes


def _is_limited(joint: LinedElement) -> bool:
    """Return whether a continuous joint has limits of less than half a turn to each side."""
    limit = joint.first("limit")
    if limit is None:
        return False
    try:
        low, high = float(limit.get("lower", "0")), float(limit.get("upper", "0"))
    except ValueError:
        return False  # its reader says so
    return -MAX_STEERING < low < high < MAX_STEERING


def joints_by_parent(root: LinedElement, links: Collection[str]) -> dict[str, list[LinedElement]]:
    """Return the joints of a file by the link that they hang on, in the file's order.

    Args:
        root: Its `<robot>` element.
        links: Names of its links.

    Raises:
        ArenaFileError: A joint without a name or between links that do not exist, or a link on two joints.
    """
    found: dict[str, list[LinedElement]] = {}
    owners: dict[str, LinedElement] = {}
    for joint in root.all("joint"):
        name = joint.get("name")
        if name is None:
            raise joint.error("a joint has no name")
        for end in ("parent", "child"):
            if link_at(joint, end) not in links:
                raise joint.error(
                    f"joint {name!r}: its {end} {link_at(joint, end)!r} is no link; "
                    f"known: {listed([*links], MAX_LISTED_LINKS)}"
                )
        child = link_at(joint, "child")
        # URDF describes trees: a link has one joint above it.
        if child in owners:
            raise joint.error(f"joint {name!r}: link {child!r} hangs on {owners[child].get('name')!r} too")
        owners[child] = joint
        found.setdefault(link_at(joint, "parent"), []).append(joint)
    return found


def link_at(joint: LinedElement, end: str) -> str:
    """Return the link at an end of a joint, `parent` or `child`; empty: the joint names none."""
    found = joint.first(end)
    return "" if found is None else found.get("link", "")


def frame_of(element: LinedElement) -> Pose:
    """Return the frame of an element's `<origin>`."""
    origin = element.first("origin")
    if origin is None:
        return NO_POSE
    xyz, rpy = (attribute_numbers(origin, key, 3, "0 0 0") for key in ("xyz", "rpy"))
    return pose_of(np.concatenate([xyz, rpy]))


def lengths_of(form: LinedElement, key: str, count: int) -> np.ndarray:
    """Return the lengths in an attribute [m] (count,).

    Raises:
        ArenaFileError: It is missing, or has others.
    """
    lengths = attribute_numbers(form, key, count)
    if lengths.min() <= 0:
        raise form.error(f"<{form.tag} {key}> has {lengths.tolist()}, expected lengths above zero [m]")
    return lengths


def form_of(solid: LinedElement) -> LinedElement | None:
    """Return the box, sphere or other form of a `<collision>` or `<visual>`; None: it has no geometry."""
    geometry = solid.first("geometry")
    return None if geometry is None else next(iter(geometry.children()), None)


def urdf_content(path: Path, surface: str = "", *, resources: Resources | None = None) -> Content:
    """Return the links of a URDF file as fixed solids, with the root link at the origin.

    Collision geometry has contacts; a link without it gets its visual geometry, without contacts. Masses,
    limits, transmissions and plugins are left out.

    Args:
        path: The file; see `Resources` for the names of its meshes.
        surface: Surface of the solids; empty: by their form.
        resources: Folders of the packages that it names; None: those above it and of the environment.

    Raises:
        ArenaFileError: An unreadable file, or content that an arena cannot have; names it.
    """
    resources = resources or Resources()
    root = read_urdf(path)
    # Counted before any is read: cutting one into convex pieces may take seconds.
    meshes = sum(1 for _ in root.iter("mesh"))
    if meshes > MAX_MESH_FILES:
        raise ArenaFileError(f"{path}: names {meshes} meshes; at most {MAX_MESH_FILES}")
    frames = _frames(root)
    colours = _colours(root)
    shapes: list[Shape] = []
    for link in root.all("link"):
        solids = link.all("collision")
        visuals = link.all("visual")
        rgba = next((c for visual in visuals if (c := _colour(visual, colours))), GREY)
        name = link.get("name", "")
        # A link of visuals only is seen, not touched.
        where = _Where(name, frames[name], surface if solids else "fixture", rgba)
        for solid in solids or visuals:
            shapes += _solid(solid, where, resources)
    moving = [joint for joint in root.all("joint") if joint.get("type") != "fixed"]
    names = listed([joint.get("name", "") for joint in moving])
    warnings = (f"{moving[0].place}: {len(moving)} joints are held at zero: {names}",) if moving else ()
    return Content(shapes=tuple(shapes), warnings=warnings)


@dataclass(frozen=True, eq=False)
class _Where:
    """Common properties of the solids of a link: name of the link, pose, surface and colour."""

    name: str
    frame: Pose
    surface: str
    rgba: Rgba


def _frames(root: LinedElement) -> dict[str, Pose]:
    """Return the pose of each link, all joints at zero."""
    names = dict.fromkeys(link.get("name", "") for link in root.all("link"))
    joints = joints_by_parent(root, names)
    above = {link_at(joint, "child"): joint for some in joints.values() for joint in some}
    # A file may have several roots: each stands at the origin.
    frames = {name: NO_POSE for name in names if name not in above}
    waiting = list(frames)
    # The list grows while it is walked; links of a circle are never reached.
    for name in waiting:
        for joint in joints.get(name, ()):
            child = link_at(joint, "child")
            frames[child] = frames[name].then(frame_of(joint))
            waiting.append(child)
    lost = next((name for name in names if name not in frames), None)
    if lost is not None:
        raise above[lost].error(f"link {lost!r} hangs on itself")
    return frames


def _solid(element: LinedElement, where: _Where, resources: Resources) -> Iterator[Shape]:
    """Yield the solids of a collision or visual element."""
    form = form_of(element)
    if form is None or form.tag not in GEOMETRY_KINDS:
        found = "no geometry" if form is None else f"the geometry <{form.tag}>"
        raise element.error(f"link {where.name!r}: has {found}; allowed: {', '.join(GEOMETRY_KINDS)}")
    pose = where.frame.then(frame_of(element))
    like = Shape(
        kind="box",
        at=flip_vector(usarsim_vector(pose.pos)),
        rotation=flip_angles(usarsim_angles(pose.mat)),
        surface=where.surface,
        rgba=where.rgba,
    )
    if form.tag == "mesh":
        scale = attribute_numbers(form, "scale", 3, "1 1 1")
        found = load_convex_pieces(_mesh_file(form, resources), scale.tolist())
        yield from shapes_of(found, replace(like, kind="mesh", mesh=NO_MESH))
        return
    if form.tag == "box":
        # URDF states whole lengths, a Shape has half lengths.
        sizes = lengths_of(form, "size", 3) / 2
    elif form.tag == "sphere":
        sizes = lengths_of(form, "radius", 1)
    else:
        sizes = np.concatenate([lengths_of(form, "radius", 1), lengths_of(form, "length", 1) / 2])
    shape = replace(like, kind=form.tag, size=tuple(sizes.tolist()))
    yield replace(shape, surface=shape.surface or surface_of(shape))


def _mesh_file(form: LinedElement, resources: Resources) -> Path:
    """Return the file that a `<mesh>` names."""
    name = form.get("filename")
    if not name:
        raise form.error("a mesh has no filename")
    found = resources.file(name, form.path)
    if found is None:
        package = name.removeprefix(PACKAGE).partition("/")[0] if name.startswith(PACKAGE) else ""
        why = f": no folder {package!r} with it is above {form.path.name} or in ROS_PACKAGE_PATH"
        raise form.error(f"{name} is not there{why if package else ''}")
    return found


def _colours(root: LinedElement) -> dict[str, Rgba]:
    """Return the named colours of a file."""
    found: dict[str, Rgba] = {}
    for material in root.all("material"):
        color = material.first("color")
        if color is not None:
            found[material.get("name", "")] = _rgba(color)
    return found


def _colour(visual: LinedElement, colours: dict[str, Rgba]) -> Rgba | None:
    material = visual.first("material")
    if material is None:
        return None
    color = material.first("color")
    return colours.get(material.get("name", "")) if color is None else _rgba(color)


def _rgba(color: LinedElement) -> Rgba:
    red, green, blue, alpha = np.clip(attribute_numbers(color, "rgba", 4), 0.0, 1.0).tolist()
    return (red, green, blue, alpha)


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
        # URDF states radians; MuJoCo's default is degrees.
        self._spec.compiler.degree = False
        # Some exporters write no collision geometry at all: such a robot would fall through the floor.
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
        # The list grows while it is walked: links are added parents first, without recursion.
        for name, joint, parent in waiting:
            body = self._add_link(name, joint, parent)
            waiting += [(link_at(child, "child"), child, body) for child in joints.get(name, ())]
        # Before the share is dealt out: this may add the root to those without mass.
        self._weigh_chassis(top, joints)
        self._weigh_massless()
        self._note_left_out(joints)
        return self._source

    def _weigh_chassis(self, top: str, joints: Mapping[str, list[LinedElement]]) -> None:
        """Give the root a mass where it and all links that are fixed to it have none."""
        # Links on fixed joints have no joint in MuJoCo: they weigh like a part of the root.
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

        # Of several roots the others are loose links beside the robot.
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
        # A link that carries moving ones turns without end too, and is an arm's or a turret's.
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
        # An axis of zeros stays one: the joint's reader refuses it with its line.
        axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
        if any(self._is_round(one, axis, otherwise=True) for one in solids):
            return solids
        looks = [one for one in link.all("visual") if self._is_round(one, axis, otherwise=False)]
        if looks:
            self._source.notes.append(
                f"{solids[0].place}: the collision mesh of {link.get('name')!r}, which turns without end, is "
                "not round: its round <visual> collides instead"
            )
        # One alone: several round meshes of a wheel, such as tyre and rim, would collide twice.
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
        # MuJoCo welds a body without a joint to its parent.
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
            # MuJoCo's damping is a polynomial of the speed, of which URDF has the linear term.
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
        # Without limits the format has 0 for both.
        if kind != "continuous" and high > low:
            made.limited, made.range = True, (low, high)
        # 0 is the format's default and states nothing.
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
        # MuJoCo would otherwise derive mass and inertia from the geoms.
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
        # MuJoCo takes principal moments and a quaternion; URDF gives a tensor in the inertial's own axes.
        values, axes = np.linalg.eigh(frame.mat @ tensor @ frame.mat.T)
        # eigh may return a left-handed frame, which is no rotation.
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
        # A little less than the sum: rounding must not carry it beyond, where MuJoCo refuses it.
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
            # MuJoCo has half lengths, URDF whole ones.
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
        # Wheels of a robot share a file: it is read and cut once.
        if key not in self._meshes:
            found = self._resources.file(file, form.path) if file else None
            if found is None:
                raise form.error(f"mesh {file!r} is not there; --packages DIR names folders to search")
            whole = mesh_vertices(found) * scale  # also where it is cut: this checks the file
            cut = [whole] if pieces == 1 else read_pieces(found, pieces, scale)
            self._meshes[key] = [f"mesh {len(self._meshes)}/{number}" for number in range(len(cut))]
            for name, vertices in zip(self._meshes[key], cut, strict=True):
                # Corners alone: MuJoCo builds the hull itself.
                mesh = self._spec.add_mesh(name=name, uservert=hull_corners(vertices).ravel())
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        return self._meshes[key]


def body_name(link: str) -> str:
    """Return the name of a link's body: MuJoCo keeps `world` for its own."""
    return "world of the file" if link == "world" else link


def _quat(mat: np.ndarray) -> np.ndarray:
    quat = np.zeros(4)
    # The C function reads nine numbers in a row, which a transposed matrix is not.
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(mat).ravel())
    return quat
