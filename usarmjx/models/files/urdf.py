"""URDF files as fixed solids: a building as a tree of links, its joints at zero."""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import flip_angles, flip_vector, mat_from_angles
from usarmjx.models.files.content import Content, surface_of
from usarmjx.models.files.meshes import NO_MESH, load_convex_pieces, shapes_of
from usarmjx.models.files.mjcf_solids import Pose, usarsim_angles, usarsim_vector
from usarmjx.models.files.xml_size import read_xml
from usarmjx.models.types.shapes import Rgba, Shape

GREY = (0.7, 0.7, 0.7, 1.0)
PACKAGE = "package://"
"""Prefix of files in ROS packages."""
MAX_MESH_FILES = 1000
"""Largest number of meshes in a file, repetitions included."""
GEOMETRY_KINDS = ("box", "sphere", "cylinder", "mesh")
"""Supported geometry elements."""


def urdf_content(path: Path, surface: str = "") -> Content:
    """Return the links of a URDF file as fixed solids, with the root link at the origin.

    Collision geometry has contacts; a link without it gets its visual geometry, without contacts. Masses,
    limits, transmissions and plugins are left out.

    Args:
        path: The file; names of meshes are relative to its folder, those of packages to the nearest folder
            above that has a folder of that name.
        surface: Surface of the solids; empty: by their form.

    Raises:
        ArenaFileError: An unreadable file, or content that an arena cannot have; names it.
    """
    root = _parse(path)
    meshes = sum(1 for _ in root.iter("mesh"))
    if meshes > MAX_MESH_FILES:
        raise ArenaFileError(f"{path}: names {meshes} meshes; at most {MAX_MESH_FILES}")
    frames = _frames(path, root)
    colours = _colours(path, root)
    shapes: list[Shape] = []
    for link in root.findall("link"):
        name = f"{path}: link {link.get('name')!r}"
        solids = link.findall("collision")
        rgba = next((c for visual in link.findall("visual") if (c := _colour(visual, colours, name))), GREY)
        for solid in solids or link.findall("visual"):
            given = surface if solids else "fixture"
            shapes += _solid(path, solid, _Where(name, frames[link.get("name", "")], given, rgba))
    moving = [j.get("name") for j in root.findall("joint") if j.get("type") != "fixed"]
    said = f"{path}: {len(moving)} joints are held at zero: {', '.join(map(str, moving[:5]))}"
    return Content(shapes=tuple(shapes), warnings=(said,) if moving else ())


@dataclass(frozen=True, eq=False)
class _Where:
    """Common properties of the solids of a link: its name for errors, pose, surface and colour."""

    name: str
    frame: Pose
    surface: str
    rgba: Rgba


def _parse(path: Path) -> ElementTree.Element:
    try:
        root = read_xml(path)
    except ElementTree.ParseError as error:
        raise ArenaFileError(f"{path}:{error.position[0]}: is no XML: {error}") from error
    if root.tag != "robot":
        raise ArenaFileError(f"{path}: its root is <{root.tag}>; a URDF file's is <robot>")
    return root


def _frames(path: Path, root: ElementTree.Element) -> dict[str, Pose]:
    """Return the pose of each link, all joints at zero."""
    above: dict[str, tuple[str, Pose]] = {}
    names = dict.fromkeys(link.get("name", "") for link in root.findall("link"))
    for joint in root.findall("joint"):
        where = f"{path}: joint {joint.get('name')!r}"
        ends = [getattr(joint.find(end), "attrib", {}).get("link") for end in ("parent", "child")]
        for end, link in zip(("parent", "child"), ends, strict=True):
            if link not in names:
                there = ", ".join([*names][:20]) + (", ..." if len(names) > 20 else "")
                raise ArenaFileError(f"{where}: its {end} {link!r} is no link; there is: {there}")
        parent, child = (str(end) for end in ends)
        if child in above:
            raise ArenaFileError(f"{where}: link {child!r} hangs on two joints")
        above[child] = (parent, _origin(joint, where))
    frames: dict[str, Pose] = {}
    for name in names:
        waiting: dict[str, None] = {}  # links up to one with a known pose, or to a root
        while name in above and name not in frames:
            if name in waiting:
                raise ArenaFileError(f"{path}: link {name!r} hangs on itself")
            waiting[name] = None
            name = above[name][0]
        frames.setdefault(name, Pose(np.zeros(3), np.eye(3)))
        for link in reversed(waiting):
            parent, offset = above[link]
            frames[link] = _then(frames[parent], offset)
    return frames


def _then(frame: Pose, offset: Pose) -> Pose:
    return Pose(frame.pos + frame.mat @ offset.pos, frame.mat @ offset.mat)


def _origin(element: ElementTree.Element, where: str) -> Pose:
    origin = element.find("origin")
    if origin is None:
        return Pose(np.zeros(3), np.eye(3))
    xyz, rpy = (_numbers(origin, key, 3, where, "0 0 0") for key in ("xyz", "rpy"))
    roll, pitch, yaw = rpy.tolist()
    return Pose(xyz, mat_from_angles(roll, pitch, yaw))


def _numbers(
    element: ElementTree.Element, key: str, count: int, where: str, default: str | None = None
) -> np.ndarray:
    """Return an attribute's numbers (count,)."""
    text = element.get(key, default)
    try:
        numbers = [float(word) for word in (text or "").split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ArenaFileError(f"{where}: <{element.tag} {key}={text!r}> is not {count} numbers")
    return np.array(numbers)


def _solid(path: Path, element: ElementTree.Element, where: _Where) -> Iterator[Shape]:
    """Yield the solids of a collision or visual element."""
    geometry = element.find("geometry")
    form = next(iter(geometry), None) if geometry is not None else None
    if form is None or form.tag not in GEOMETRY_KINDS:
        found = "no geometry" if form is None else f"the geometry <{form.tag}>"
        raise ArenaFileError(f"{where.name}: has {found}; allowed: {', '.join(GEOMETRY_KINDS)}")
    pose = _then(where.frame, _origin(element, where.name))
    like = Shape(
        kind="box",
        at=flip_vector(usarsim_vector(pose.pos)),
        rotation=flip_angles(usarsim_angles(pose.mat)),
        surface=where.surface,
        rgba=where.rgba,
    )
    if form.tag == "mesh":
        file = _mesh_file(path, form.get("filename", ""), where.name)
        scale = _numbers(form, "scale", 3, where.name, "1 1 1")
        found = load_convex_pieces(file, scale.tolist())
        yield from shapes_of(found, replace(like, kind="mesh", mesh=NO_MESH))
        return
    if form.tag == "box":
        sizes = (_numbers(form, "size", 3, where.name) / 2).tolist()
    elif form.tag == "sphere":
        sizes = _numbers(form, "radius", 1, where.name).tolist()
    else:
        radius, length = (_numbers(form, key, 1, where.name)[0] for key in ("radius", "length"))
        sizes = [float(radius), float(length) / 2]
    if min(sizes) <= 0:
        raise ArenaFileError(f"{where.name}: a <{form.tag}> wants lengths above zero [m]")
    shape = replace(like, kind=form.tag, size=tuple(sizes))
    yield replace(shape, surface=shape.surface or surface_of(shape))


def _mesh_file(path: Path, name: str, where: str) -> Path:
    """Return the file of a mesh's name."""
    if not name:
        raise ArenaFileError(f"{where}: a mesh has no filename")
    if not name.startswith(PACKAGE):
        return path.parent / name.removeprefix("file://")
    package, _, inside = name.removeprefix(PACKAGE).partition("/")
    for folder in path.resolve().parents:
        for home in (folder / package, folder if folder.name == package else None):
            if home is not None and (home / inside).is_file():
                return home / inside
    raise ArenaFileError(f"{where}: {name} is not there: no folder {package!r} with it is above {path.name}")


def _colours(path: Path, root: ElementTree.Element) -> dict[str, Rgba]:
    """Return the named colours of a file."""
    found: dict[str, Rgba] = {}
    for material in root.findall("material"):
        color = material.find("color")
        if color is not None:
            found[material.get("name", "")] = _rgba(color, f"{path}: material {material.get('name')!r}")
    return found


def _colour(visual: ElementTree.Element, colours: dict[str, Rgba], where: str) -> Rgba | None:
    material = visual.find("material")
    if material is None:
        return None
    color = material.find("color")
    return colours.get(material.get("name", "")) if color is None else _rgba(color, where)


def _rgba(color: ElementTree.Element, where: str) -> Rgba:
    red, green, blue, alpha = np.clip(_numbers(color, "rgba", 4, where), 0.0, 1.0).tolist()
    return (red, green, blue, alpha)
