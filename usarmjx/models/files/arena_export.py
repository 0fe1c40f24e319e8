"""Arenas as files of other tools: MJCF, URDF and SDF, with the solids, masses and hinges of here."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.compile.compose import DOOR_PREFIX, LOOSE_PREFIX, door_panel, new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.ray_geoms import terrain_faces
from usarmjx.models.compile.victims import segment_poses, victim_table
from usarmjx.models.files.mjcf_solids import Pose, mat_of
from usarmjx.models.files.robot_export import (
    ExportResult,
    add_child,
    add_pose,
    ellipsoid_corners,
    rpy_of,
    stl_of,
    stl_of_hull,
    text_of,
    write_file,
)
from usarmjx.models.files.robot_source import unused_name
from usarmjx.models.types.arena import ArenaSpec, Door, Light
from usarmjx.models.types.shapes import OPAQUE, SKY, SURFACES, Rgba, Shape

FLOOR_MARGIN, FLOOR_THICKNESS = 50.0, 0.5
"""Width of the floor around the arena's extent, and its thickness [m]: URDF knows no plane."""
FLOOR_RGBA = (0.5, 0.5, 0.5, 1.0)
FLOOR_SIDE = 1000.0
"""Length of the plane of the floor in pictures [m]; contacts have no end."""
LAMP_RANGE = 50.0
"""Distance up to which a lamp shines [m]."""
PARTS = {"sphere": ("radius",), "cylinder": ("radius", "length"), "capsule": ("radius", "length")}
SUFFIXES = {".xml": "mjcf", ".urdf": "urdf", ".sdf": "sdf", ".world": "sdf"}
"""Format of a file by its suffix."""


@dataclass(frozen=True, eq=False)
class Weight:
    """Mass of a link [kg], its centre (3,) and inertia about that (3, 3), in the link's axes."""

    mass: float
    centre: np.ndarray
    tensor: np.ndarray


@dataclass(frozen=True, eq=False)
class ArenaLink:
    """Solids of an arena that move together, or stay.

    Attributes:
        name: Unique within the arena.
        pose: Pose of its axes in those of the arena, whose floor has height 0.
        solids: Poses in its axes, and solids.
        weight: Its mass and inertia; None for a fixed link.
        door: The door that it is.
    """

    name: str
    pose: Pose
    solids: tuple[tuple[Pose, Shape], ...]
    weight: Weight | None = None
    door: Door | None = None


def is_touched(shape: Shape) -> bool:
    """Return whether a solid has contacts; others are seen only."""
    surface = SURFACES[shape.surface]
    return bool(surface.contype or surface.conaffinity)


def arena_links(arena: ArenaSpec) -> tuple[ArenaLink, ...]:
    """Return the links of an arena: fixed solids and victims by colour, then loose objects and doors.

    Raises:
        SpecError: The arena cannot be built.
    """
    # Compiled for weights: MuJoCo computes inertias of solids from their masses.
    model = new_spec(arena, Physics()).compile()
    # Names that the writers give themselves.
    taken = {"floor", "world"}
    links = [*_fixed(arena, taken)]
    for thing in arena.loose:
        links.append(
            ArenaLink(
                name=unused_name(thing.name, taken),
                pose=Pose(np.array(thing.at), mat_from_angles(*thing.rotation)),
                solids=tuple((_pose_of(shape), shape) for shape in thing.shapes if shape.material != SKY),
                weight=_weight(model, f"{LOOSE_PREFIX}{thing.name}"),
            )
        )
        taken.add(links[-1].name)
    for door in arena.doors:
        panel = door_panel(door)
        links.append(
            ArenaLink(
                name=unused_name(door.name, taken),
                pose=Pose(np.array(door.at), mat_from_angles(0.0, 0.0, door.yaw)),
                solids=((_pose_of(panel), panel),),
                weight=_weight(model, f"{DOOR_PREFIX}{door.name}"),
                door=door,
            )
        )
        taken.add(links[-1].name)
    return tuple(links)


def lost_content(arena: ArenaSpec) -> Iterator[str]:
    """Yield the content of an arena that no file of another tool has a place for, in words."""
    counts = {
        "start poses": len(arena.starts),
        "volumes of water": len(arena.waters),
        "RFID tags": len(arena.tags),
        "solids of the sky": sum(shape.material == SKY for shape in arena.shapes),
    }
    if names := [f"{count} {name}" for name, count in counts.items() if count]:
        yield f"{', '.join(names)}: left out"
    if arena.victims or arena.false_alarms:
        yield f"{len(arena.victims)} victims and {len(arena.false_alarms)} false alarms are solids only"
    if odd := sum(shape.material not in (OPAQUE, SKY) for shape in arena.shapes):
        yield f"{odd} solids of glass, mirrors and fenders are opaque"
    if arena.floor:
        yield f"heights count from the floor, which is {arena.floor:g} m high in usarmjx"
    yield "surfaces are left out: friction is that of the other tool"


def _pose_of(shape: Shape) -> Pose:
    return Pose(np.array(shape.at, float), mat_from_angles(*shape.rotation))


def _fixed(arena: ArenaSpec, taken: set[str]) -> Iterator[ArenaLink]:
    """Yield the fixed solids by colour: a reader may give a link one colour."""
    groups: dict[tuple[Rgba, bool], list[tuple[Pose, Shape]]] = {}
    for shape in arena.shapes:
        if shape.material != SKY:
            groups.setdefault((shape.rgba, is_touched(shape)), []).append((_pose_of(shape), shape))
    for pose, shape in _victims(arena):
        groups.setdefault((shape.rgba, True), []).append((pose, shape))
    for solids in groups.values():
        name = unused_name("solids", taken)
        taken.add(name)
        yield ArenaLink(name=name, pose=Pose(np.zeros(3), np.eye(3)), solids=tuple(solids))


def _victims(arena: ArenaSpec) -> Iterator[tuple[Pose, Shape]]:
    """Yield the boxes of victims and false alarms in their initial poses."""
    table = victim_table(arena.victims, arena.false_alarms)
    pos, quat = segment_poses(table, np.zeros(()))
    mats = np.asarray(mat_from_quat(np.asarray(quat)), float)
    for i in range(table.num_boxes):
        red, green, blue, alpha = np.asarray(table.rgba[i], float).tolist()
        size = tuple(np.asarray(table.size[i], float).tolist())
        box = Shape(kind="box", size=size, surface="ground", rgba=(red, green, blue, alpha))
        yield Pose(np.asarray(pos[i], float), mats[i]), box


def _weight(model: mujoco.MjModel, name: str) -> Weight:
    body = model.body(name).id
    # MuJoCo keeps the principal moments and the turn of their axes; URDF and SDF want six numbers in the
    # link's axes.
    axes = mat_of(model.body_iquat[body])
    tensor = axes @ np.diag(model.body_inertia[body]) @ axes.T
    return Weight(float(model.body_mass[body]), np.array(model.body_ipos[body]), tensor)


class MeshFiles:
    """STL files of solids that other tools have as meshes only, beside a file.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._names: dict[bytes, str] = {}
        self.files: list[Path] = []

    def hull(self, shape: Shape) -> str:
        """Return the name of the file of what touches of a mesh, an ellipsoid or terrain."""
        if shape.mesh is not None:
            return self._name(stl_of_hull(np.asarray(shape.mesh.vertices, float)))
        if shape.kind == "ellipsoid":
            return self._name(stl_of_hull(ellipsoid_corners(np.array(shape.size))))
        return self._name(stl_of(_terrain(shape)))

    def faces(self, shape: Shape) -> str:
        """Return the name of the file of what is seen of it."""
        if shape.mesh is None or shape.mesh.faces is None:
            return self.hull(shape)
        return self._name(stl_of(np.asarray(shape.mesh.vertices, float)[shape.mesh.faces]))

    def _name(self, data: bytes) -> str:
        # By content: equal meshes share a file, wherever they come from.
        if data not in self._names:
            path = self._path.with_name(f"{self._path.stem}-mesh-{len(self._names) + 1}.stl")
            write_file(path, data)
            self.files.append(path)
            self._names[data] = path.name
        return self._names[data]


def _terrain(shape: Shape) -> np.ndarray:
    """Return the triangles of terrain, its sides and its bottom, in its own axes (n, 3, 3)."""
    assert shape.heights is not None
    heights = np.asarray(shape.heights.heights, float)
    half_x, half_y, base = shape.size
    rows, columns = heights.shape
    x, y = np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows)
    walled = terrain_faces(x, y, heights, np.array([half_x, half_y, 0.0, base]))[:-2]
    # A bottom of two triangles leaves gaps: its sides would have no corners where the walls have them.
    ring = [(one, y[0]) for one in x] + [(x[-1], one) for one in y[1:]]
    ring += [(one, y[-1]) for one in x[-2::-1]] + [(x[0], one) for one in y[-2::-1]]
    feet = np.array([(*one, -base) for one in ring])
    middle = np.tile((0.0, 0.0, -base), (len(feet) - 1, 1))
    return np.concatenate([walled, np.stack([middle, feet[1:], feet[:-1]], 1)])


def urdf_of(arena: ArenaSpec, links: tuple[ArenaLink, ...], meshes: MeshFiles) -> ET.Element:
    """Return an arena as `<robot>`: fixed joints, hinges of doors, and floating joints of loose objects."""
    root = ET.Element("robot", name=arena.name)
    # MuJoCo would merge fixed links and drop what is only seen; other readers skip the element.
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", fusestatic="false", discardvisual="false")
    # MuJoCo takes a link of that name for the world, on which alone free bodies may stand.
    ET.SubElement(root, "link", name="world")
    if arena.has_floor:
        links = (_floor(arena), *links)
    for link in links:
        _add_urdf_link(root, link, meshes)
        kind = "fixed" if link.weight is None else "floating" if link.door is None else "revolute"
        joint = ET.SubElement(root, "joint", name=f"{link.name} joint", type=kind)
        ET.SubElement(joint, "parent", link="world")
        ET.SubElement(joint, "child", link=link.name)
        _add_origin(joint, link.pose)
        if link.door is not None:
            ET.SubElement(joint, "axis", xyz="0 0 1")
            low, high = link.door.limits
            # URDF demands effort and velocity; a door has no motor.
            limit = {"lower": text_of(low), "upper": text_of(high), "effort": "0", "velocity": "0"}
            ET.SubElement(joint, "limit", limit)
            ET.SubElement(joint, "dynamics", damping=text_of(link.door.friction))
    return root


def _floor(arena: ArenaSpec) -> ArenaLink:
    """Return a box below the arena, with its top at height 0."""
    (x0, x1), (y0, y1) = arena.extent
    size = ((x1 - x0) / 2 + FLOOR_MARGIN, (y1 - y0) / 2 + FLOOR_MARGIN, FLOOR_THICKNESS / 2)
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, -FLOOR_THICKNESS / 2])
    # URDF has no planes.
    box = Shape(kind="box", size=size, surface="ground", rgba=FLOOR_RGBA)
    at_rest = Pose(np.zeros(3), np.eye(3))
    return ArenaLink(name="floor", pose=Pose(centre, np.eye(3)), solids=((at_rest, box),))


def _add_origin(parent: ET.Element, pose: Pose) -> None:
    ET.SubElement(parent, "origin", xyz=text_of(pose.pos), rpy=text_of(rpy_of(pose.mat)))


def _add_urdf_link(root: ET.Element, link: ArenaLink, meshes: MeshFiles) -> None:
    element = ET.SubElement(root, "link", name=link.name)
    if link.weight is not None:
        inertial = ET.SubElement(element, "inertial")
        # The tensor is in the link's axes, so the inertial's need no turn.
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
            # A cylinder's axis is its z, the third column of its orientation.
            tip = Pose(where.pos + where.mat[:, 2] * end * size[1], where.mat)
            yield tip, "sphere", {"radius": text_of(size[0])}
    else:
        yield where, "mesh", {"filename": meshes.faces(shape) if seen else meshes.hull(shape)}


def sdf_of(arena: ArenaSpec, links: tuple[ArenaLink, ...], meshes: MeshFiles) -> ET.Element:
    """Return an arena as `<sdf>`: a static model, a model for each loose object and each door."""
    root = ET.Element("sdf", version="1.9")
    world = ET.SubElement(root, "world", name=arena.name)
    if arena.has_floor:
        _add_floor(world)
    if not arena.lights:
        # Worlds without any light are black in Gazebo.
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
            _add_sdf_link(model, link, link.pose, meshes)
    for link in links:
        if link.weight is not None:
            model = ET.SubElement(world, "model", name=link.name)
            add_pose(model, link.pose)
            _add_sdf_link(model, link, Pose(np.zeros(3), np.eye(3)), meshes)
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
    # A light of ours falls with the square of the distance and counts at 1 m: quadratic 1, constant and
    # linear 0.
    lamp = ET.SubElement(world, "light", name=name, type="point")
    add_child(lamp, "pose", (*light.at, 0, 0, 0))
    # Colours end at 1 there: what is beyond goes into the intensity.
    add_child(lamp, "diffuse", (*np.array(light.rgb) / max(*light.rgb, 1e-9), 1))
    add_child(lamp, "intensity", light.brightness * max(light.rgb))
    attenuation = ET.SubElement(lamp, "attenuation")
    # SDF's default is constant 1, which would halve the light at 1 m.
    for tag, value in (("range", LAMP_RANGE), ("constant", 0), ("linear", 0), ("quadratic", 1)):
        add_child(attenuation, tag, value)


def _add_sdf_link(model: ET.Element, link: ArenaLink, pose: Pose, meshes: MeshFiles) -> None:
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
                    # SDF has the transparency as an element of its own.
                    add_child(material, tag, (*shape.rgba[:3], 1))
                add_child(solid, "transparency", 1 - shape.rgba[3])


def _add_form(geometry: ET.Element, shape: Shape, meshes: MeshFiles, *, seen: bool) -> None:
    if shape.kind == "box":
        add_child(ET.SubElement(geometry, "box"), "size", 2 * np.array(shape.size))
    elif shape.kind == "ellipsoid":
        add_child(ET.SubElement(geometry, "ellipsoid"), "radii", shape.size)
    elif shape.kind in PARTS:
        form = ET.SubElement(geometry, shape.kind)
        # SDF's lengths are whole ones, ours half ones.
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


def export_arena(arena: ArenaSpec, path: Path) -> ExportResult:
    """Write an arena's solids, terrain, doors and loose objects as a file of another tool, without robots.

    Args:
        arena: The arena.
        path: The file, whose suffix is one of `SUFFIXES`; meshes of URDF and SDF become STL files beside it.

    Raises:
        UsageError: Another suffix.
        SpecError: The arena cannot be built.
        WriteError: A file cannot be written.
    """
    form = check_suffix(path)
    if form == "mjcf":
        spec = new_spec(arena, Physics())
        # MuJoCo's to_xml needs a compiled description.
        spec.compile()
        write_file(path, spec.to_xml().encode())
        return ExportResult(files=(path,), notes=())
    links, meshes = arena_links(arena), MeshFiles(path)
    root = (sdf_of if form == "sdf" else urdf_of)(arena, links, meshes)
    # Without a DTD, white space between elements has no meaning in URDF and SDF; people compare such files.
    ET.indent(root)
    write_file(path, ET.tostring(root, encoding="utf-8", xml_declaration=True))
    notes = (*lost_content(arena), *_coarser(arena, links, form))
    return ExportResult(files=(path, *meshes.files), notes=notes)


def check_suffix(path: Path) -> str:
    """Return the format of a file.

    Raises:
        UsageError: Its suffix is that of none.
    """
    form = SUFFIXES.get(path.suffix.lower())
    if form is None:
        raise UsageError(f"{path}: an arena is exported as {', '.join(SUFFIXES)}")
    return form


def _coarser(arena: ArenaSpec, links: tuple[ArenaLink, ...], form: str) -> Iterator[str]:
    """Yield what the format has otherwise, in words."""
    shapes = [shape for link in links for _, shape in link.solids]
    if count := sum(shape.kind == "hfield" for shape in shapes):
        yield f"terrain is a mesh, {count} times"
    if form == "sdf":
        return
    if count := sum(shape.kind == "ellipsoid" for shape in shapes):
        yield f"{count} ellipsoids are meshes in URDF"
    if arena.has_floor:
        yield "the floor is a box, up to 50 m beyond the arena's extent"
    if arena.lights:
        yield f"{len(arena.lights)} lamps: left out"
