"""URDF files: links, joints and frames; and a building as fixed solids, its joints at zero."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import flip_angles, flip_vector
from usarmjx.models.files.content import Content, surface_of
from usarmjx.models.files.meshes import NO_MESH, load_convex_pieces, shapes_of
from usarmjx.models.files.mjcf_solids import Pose, usarsim_angles, usarsim_vector
from usarmjx.models.files.resources import Resources
from usarmjx.models.files.robot_source import listed
from usarmjx.models.files.xml_lines import NO_POSE, LinedElement, attribute_numbers, pose_of, read_lined_xml
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
    frames = {name: NO_POSE for name in names if name not in above}
    waiting = list(frames)
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
