"""Arenas as URDF: a tree of links below the link `world`."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np

from usarmjx.models.files.arena_parts import ArenaLink, MeshFiles, is_touched
from usarmjx.models.files.export_pieces import rpy_of, text_of
from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import Shape

FLOOR_MARGIN, FLOOR_THICKNESS = 50.0, 0.5
"""Width of the floor around the arena's extent, and its thickness [m]: URDF knows no plane."""
FLOOR_RGBA = (0.5, 0.5, 0.5, 1.0)


def urdf_of(arena: ArenaSpec, links: tuple[ArenaLink, ...], meshes: MeshFiles) -> ET.Element:
    """Return an arena as `<robot>`: fixed joints, hinges of doors, and floating joints of loose objects."""
    root = ET.Element("robot", name=arena.name)
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", fusestatic="false", discardvisual="false")
    # MuJoCo takes a link of that name for the world, on which alone free bodies may stand.
    ET.SubElement(root, "link", name="world")
    if arena.has_floor:
        links = (_floor(arena), *links)
    for link in links:
        _add_link(root, link, meshes)
        kind = "fixed" if link.weight is None else "floating" if link.door is None else "revolute"
        joint = ET.SubElement(root, "joint", name=f"{link.name} joint", type=kind)
        ET.SubElement(joint, "parent", link="world")
        ET.SubElement(joint, "child", link=link.name)
        _add_origin(joint, link.pose)
        if link.door is not None:
            ET.SubElement(joint, "axis", xyz="0 0 1")
            low, high = link.door.limits
            limit = {"lower": text_of(low), "upper": text_of(high), "effort": "0", "velocity": "0"}
            ET.SubElement(joint, "limit", limit)
            ET.SubElement(joint, "dynamics", damping=text_of(link.door.friction))
    return root


def _floor(arena: ArenaSpec) -> ArenaLink:
    """Return a box below the arena, with its top at height 0."""
    (x0, x1), (y0, y1) = arena.extent
    size = ((x1 - x0) / 2 + FLOOR_MARGIN, (y1 - y0) / 2 + FLOOR_MARGIN, FLOOR_THICKNESS / 2)
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, -FLOOR_THICKNESS / 2])
    box = Shape(kind="box", size=size, surface="ground", rgba=FLOOR_RGBA)
    at_rest = Pose(np.zeros(3), np.eye(3))
    return ArenaLink(name="floor", pose=Pose(centre, np.eye(3)), solids=((at_rest, box),))


def _add_origin(parent: ET.Element, pose: Pose) -> None:
    ET.SubElement(parent, "origin", xyz=text_of(pose.pos), rpy=text_of(rpy_of(pose.mat)))


def _add_link(root: ET.Element, link: ArenaLink, meshes: MeshFiles) -> None:
    element = ET.SubElement(root, "link", name=link.name)
    if link.weight is not None:
        inertial = ET.SubElement(element, "inertial")
        _add_origin(inertial, Pose(link.weight.centre, np.eye(3)))
        ET.SubElement(inertial, "mass", value=text_of(link.weight.mass))
        pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        moments = {f"i{'xyz'[i]}{'xyz'[j]}": text_of(link.weight.tensor[i, j]) for i, j in pairs}
        ET.SubElement(inertial, "inertia", moments)
    for number, (where, shape) in enumerate(link.solids):
        for role in ("visual", "collision") if is_touched(shape) else ("visual",):
            for pose, tag, attributes in _forms(where, shape, meshes, seen=role == "visual"):
                solid = ET.SubElement(element, role)
                _add_origin(solid, pose)
                ET.SubElement(ET.SubElement(solid, "geometry"), tag, attributes)
                if role == "visual":
                    material = ET.SubElement(solid, "material", name=f"{link.name} {number}")
                    ET.SubElement(material, "color", rgba=text_of(shape.rgba))


def _forms(
    where: Pose, shape: Shape, meshes: MeshFiles, *, seen: bool
) -> Iterator[tuple[Pose, str, dict[str, str]]]:
    """Yield poses and forms of a solid: a capsule is a cylinder and two spheres, an ellipsoid a mesh."""
    size = shape.size
    if shape.kind == "box":
        yield where, "box", {"size": text_of(2 * np.array(size))}
    elif shape.kind == "sphere":
        yield where, "sphere", {"radius": text_of(size[0])}
    elif shape.kind in ("cylinder", "capsule"):
        yield where, "cylinder", {"radius": text_of(size[0]), "length": text_of(2 * size[1])}
        for end in (1, -1) if shape.kind == "capsule" else ():
            tip = Pose(where.pos + where.mat[:, 2] * end * size[1], where.mat)
            yield tip, "sphere", {"radius": text_of(size[0])}
    else:
        yield where, "mesh", {"filename": meshes.faces(shape) if seen else meshes.hull(shape)}
