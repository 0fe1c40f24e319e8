"""A robot class as URDF, for viewers: links are the frames of its parts, joints those of joint_states."""

from collections.abc import Sequence
from functools import cache
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from usarmjx.base.transforms import Vec3, flip_angles, flip_vector
from usarmjx.models.compile.parts import chassis_shapes, parts_of
from usarmjx.models.types.robot import CHASSIS, Part, RobotSpec
from usarmjx.models.types.shapes import Shape
from usarmjx.server.rosbridge.motion import frame_name

BASE = "base_link"
UNMEASURED = 1000.0
"""Effort of a joint without a motor, which URDF wants a number for [N or N m]."""


@cache
def urdf(robot: RobotSpec, name: str | None = None) -> str:
    """Return the URDF of a robot class: its looks and solids, without masses.

    Args:
        robot: The class.
        name: Name of a robot; its links are named as its frames then, `R1/base_link`. None: of any robot.
    """
    root = Element("robot", name=frame_name(robot.name) if name is None else name)
    above = "" if name is None else f"{name}/"
    _add_link(root, above + BASE, robot.looks or chassis_shapes(robot), chassis_shapes(robot))
    for part in parts_of(robot):
        _add_link(root, above + frame_name(part.name), part.looks or part.shapes, part.shapes)
        _add_joint(root, part, above)
    indent(root)
    return '<?xml version="1.0"?>\n' + tostring(root, encoding="unicode")


def _add_link(root: Element, name: str, looks: Sequence[Shape], solids: Sequence[Shape]) -> None:
    link = SubElement(root, "link", name=name)
    for tag, shapes in (("visual", looks), ("collision", solids)):
        for number, shape in enumerate(shapes):
            size = _geometry(shape)
            # Terrain has no form in URDF; robots have none.
            if size is None:
                continue
            item = SubElement(link, tag)
            _add_origin(item, shape.at, shape.rotation)
            kind, sizes = size
            SubElement(SubElement(item, "geometry"), kind, sizes)
            if tag == "visual":
                material = SubElement(item, "material", name=f"{name}_{number}")
                SubElement(material, "color", rgba=_numbers(shape.rgba))


def _geometry(shape: Shape) -> tuple[str, dict[str, str]] | None:
    """Return the solid of URDF that is most like a shape: a capsule is a cylinder, a mesh its box."""
    if shape.mesh is not None:
        points = np.asarray(shape.mesh.vertices, float)
        # Viewers would need the mesh as a file of its own; a description over a topic has none.
        # Symmetric about the mesh's origin, as URDF centres a box there: never smaller than the mesh.
        return "box", {"size": _numbers((2 * np.abs(points).max(0)).tolist())}
    if shape.kind == "box":
        return "box", {"size": _numbers([2 * half for half in shape.size])}
    if shape.kind in ("cylinder", "capsule"):
        radius, half = shape.size[:2]
        # A capsule's half length is that between the centres of its balls.
        length = 2 * half + (2 * radius if shape.kind == "capsule" else 0.0)
        return "cylinder", {"radius": f"{radius:.6g}", "length": f"{length:.6g}"}
    if shape.kind in ("sphere", "ellipsoid"):
        # URDF has no ellipsoid: the ball around one stands for it.
        return "sphere", {"radius": f"{max(shape.size):.6g}"}
    return None


def _add_joint(root: Element, part: Part, above: str) -> None:
    slides, limited = part.joint == "slide", part.limits is not None
    kind = "prismatic" if slides else "revolute" if limited else "continuous"
    joint = SubElement(root, "joint", name=part.name, type=kind)
    SubElement(joint, "parent", link=above + (BASE if part.parent == CHASSIS else frame_name(part.parent)))
    SubElement(joint, "child", link=above + frame_name(part.name))
    _add_origin(joint, part.at, part.rotation)
    SubElement(joint, "axis", xyz=_numbers(flip_vector(part.axis)))
    if slides or limited:
        # URDF requires a limit of every prismatic joint, also of one without limits.
        low, high = part.limits or (-1.0, 1.0)
        motor = part.motor
        SubElement(
            joint,
            "limit",
            lower=f"{low:.6g}",
            upper=f"{high:.6g}",
            effort=f"{motor.torque if motor else UNMEASURED:.6g}",
            velocity=f"{motor.max_speed if motor else UNMEASURED:.6g}",
        )


def _add_origin(parent: Element, at: Vec3, rotation: Vec3) -> None:
    SubElement(parent, "origin", xyz=_numbers(flip_vector(at)), rpy=_numbers(flip_angles(rotation)))


def _numbers(values: Sequence[float]) -> str:
    # Adding zero turns -0 into 0.
    return " ".join(f"{value + 0.0:.6g}" for value in values)
