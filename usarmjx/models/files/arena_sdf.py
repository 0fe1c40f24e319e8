"""Arenas as SDF worlds, for Gazebo and what else reads them."""

import xml.etree.ElementTree as ET

import numpy as np

from usarmjx.models.files.arena_parts import ArenaLink, MeshFiles, is_touched
from usarmjx.models.files.export_pieces import add_child, add_pose
from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.types.arena import ArenaSpec, Light
from usarmjx.models.types.shapes import Shape

FLOOR_SIDE = 1000.0
"""Length of the plane of the floor in pictures [m]; contacts have no end."""
LAMP_RANGE = 50.0
"""Distance up to which a lamp shines [m]."""
PARTS = {"sphere": ("radius",), "cylinder": ("radius", "length"), "capsule": ("radius", "length")}


def sdf_of(arena: ArenaSpec, links: tuple[ArenaLink, ...], meshes: MeshFiles) -> ET.Element:
    """Return an arena as `<sdf>`: a static model, a model for each loose object and each door."""
    root = ET.Element("sdf", version="1.9")
    world = ET.SubElement(root, "world", name=arena.name)
    if arena.has_floor:
        _add_floor(world)
    if not arena.lights:
        sun = ET.SubElement(world, "light", name="sun", type="directional")
        add_child(sun, "pose", (0, 0, 10, 0, 0, 0))
        add_child(sun, "direction", (-0.4, 0.2, -1))
    for number, light in enumerate(arena.lights, 1):
        _add_lamp(world, f"lamp {number}", light)
    fixed = [link for link in links if link.weight is None]
    if fixed:
        model = ET.SubElement(world, "model", name="arena")
        ET.SubElement(model, "static").text = "true"
        for link in fixed:
            _add_link(model, link, link.pose, meshes)
    for link in links:
        if link.weight is not None:
            model = ET.SubElement(world, "model", name=link.name)
            add_pose(model, link.pose)
            _add_link(model, link, Pose(np.zeros(3), np.eye(3)), meshes)
            if link.door is not None:
                _add_hinge(model, link)
    return root


def _add_floor(world: ET.Element) -> None:
    model = ET.SubElement(world, "model", name="floor")
    ET.SubElement(model, "static").text = "true"
    link = ET.SubElement(model, "link", name="floor")
    for role in ("collision", "visual"):
        plane = ET.SubElement(ET.SubElement(ET.SubElement(link, role, name=role), "geometry"), "plane")
        add_child(plane, "normal", (0, 0, 1))
        add_child(plane, "size", (FLOOR_SIDE, FLOOR_SIDE))


def _add_lamp(world: ET.Element, name: str, light: Light) -> None:
    """Add a point light, of which the brightness is that at 1 m."""
    lamp = ET.SubElement(world, "light", name=name, type="point")
    add_child(lamp, "pose", (*light.at, 0, 0, 0))
    add_child(lamp, "diffuse", (*np.array(light.rgb) / max(*light.rgb, 1e-9), 1))
    add_child(lamp, "intensity", light.brightness * max(light.rgb))
    attenuation = ET.SubElement(lamp, "attenuation")
    for tag, value in (("range", LAMP_RANGE), ("constant", 0), ("linear", 0), ("quadratic", 1)):
        add_child(attenuation, tag, value)


def _add_link(model: ET.Element, link: ArenaLink, pose: Pose, meshes: MeshFiles) -> None:
    element = ET.SubElement(model, "link", name=link.name)
    add_pose(element, pose)
    if link.weight is not None:
        inertial = ET.SubElement(element, "inertial")
        add_pose(inertial, Pose(link.weight.centre, np.eye(3)))
        add_child(inertial, "mass", link.weight.mass)
        inertia = ET.SubElement(inertial, "inertia")
        for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
            add_child(inertia, f"i{'xyz'[i]}{'xyz'[j]}", link.weight.tensor[i, j])
    for number, (where, shape) in enumerate(link.solids):
        for role in ("collision", "visual") if is_touched(shape) else ("visual",):
            solid = ET.SubElement(element, role, name=f"{role} {number}")
            add_pose(solid, where)
            _add_form(ET.SubElement(solid, "geometry"), shape, meshes, seen=role == "visual")
            if role == "visual":
                material = ET.SubElement(solid, "material")
                for tag in ("ambient", "diffuse"):
                    add_child(material, tag, (*shape.rgba[:3], 1))
                add_child(solid, "transparency", 1 - shape.rgba[3])


def _add_form(geometry: ET.Element, shape: Shape, meshes: MeshFiles, *, seen: bool) -> None:
    if shape.kind == "box":
        add_child(ET.SubElement(geometry, "box"), "size", 2 * np.array(shape.size))
    elif shape.kind == "ellipsoid":
        add_child(ET.SubElement(geometry, "ellipsoid"), "radii", shape.size)
    elif shape.kind in PARTS:
        form = ET.SubElement(geometry, shape.kind)
        for tag, size in zip(PARTS[shape.kind], shape.size, strict=False):
            add_child(form, tag, size * (2 if tag == "length" else 1))
    else:
        name = meshes.faces(shape) if seen else meshes.hull(shape)
        ET.SubElement(ET.SubElement(geometry, "mesh"), "uri").text = name


def _add_hinge(model: ET.Element, link: ArenaLink) -> None:
    """Add the upright hinge of a door, at its link's origin."""
    assert link.door is not None
    joint = ET.SubElement(model, "joint", name=f"{link.name} hinge", type="revolute")
    ET.SubElement(joint, "parent").text = "world"
    ET.SubElement(joint, "child").text = link.name
    axis = ET.SubElement(joint, "axis")
    add_child(axis, "xyz", (0, 0, 1))
    limit = ET.SubElement(axis, "limit")
    for tag, value in zip(("lower", "upper"), link.door.limits, strict=True):
        add_child(limit, tag, value)
    add_child(ET.SubElement(axis, "dynamics"), "damping", link.door.friction)
