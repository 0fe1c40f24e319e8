"""Independent figures of robots' files for `survey_robots`: ElementTree, trimesh and MuJoCo's own loader.

It shares no code with usarmjx's readers. Positions are in the axes of the root link, joints at 0.
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

SIDES = 64
"""Corners around a tessellated cylinder or sphere."""
ROUND = 0.9
"""Smallest over largest distance of a round outline from its axis; an octagon has 0.92."""


@dataclass
class Oracle:
    """Figures of a file.

    Attributes:
        mass: Sum of the masses [kg].
        solids: Vertices of each solid that collides [m], each (n, 3).
        wheels: Radius of the solids about each joint that turns without end [m], by its name.
    """

    mass: float = 0.0
    solids: list[np.ndarray] = field(default_factory=list)
    wheels: dict[str, float] = field(default_factory=dict)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and highest corner of all solids (3,), (3,)."""
        points = np.concatenate(self.solids)
        return points.min(0), points.max(0)

    def hulls(self) -> list[np.ndarray]:
        """Return the half spaces of each solid's hull (faces, 4): inside, a x + b y + c z + d <= 0."""
        found = []
        for points in self.solids:
            try:
                found.append(ConvexHull(points).equations)
            except (QhullError, ValueError):
                continue  # flat
        return found


def distances(hulls: list[np.ndarray], starts: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Return how far each ray gets until it enters a hull (rays,); infinite: it meets none."""
    best = np.full(len(starts), np.inf)
    for planes in hulls:
        normal, offset = planes[:, :3], planes[:, 3]
        speed = ways @ normal.T
        gap = starts @ normal.T + offset
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -gap / speed
        enter = np.where(speed < -1e-12, at, -np.inf).max(1)
        leave = np.where(speed > 1e-12, at, np.inf).min(1)
        beside = ((np.abs(speed) <= 1e-12) & (gap > 0)).any(1)
        hit = (enter <= leave) & (enter >= 0) & ~beside
        best = np.where(hit, np.minimum(best, enter), best)
    return best


def oracle_of(path: Path, expanded: bytes | None = None) -> Oracle:
    """Return the figures of a URDF (or expanded xacro) or an MJCF file."""
    text = expanded or path.read_bytes()
    if b"<robot" in text:
        return _Urdf(path, ET.fromstring(text.strip())).figures()
    return _mjcf(path)


class _Urdf:
    """Reader of one URDF file."""

    def __init__(self, path: Path, root: ET.Element) -> None:
        self.path, self.root = path, root
        self.links = {link.get("name"): link for link in root.findall("link")}
        self.joints = root.findall("joint")
        collides = any(link.find("collision/geometry") is not None for link in self.links.values())
        self.tag = "collision" if collides else "visual"

    def figures(self) -> Oracle:
        """Return the figures."""
        children: dict[str | None, list[ET.Element]] = {}
        below = set()
        for joint in self.joints:
            children.setdefault(_end(joint, "parent"), []).append(joint)
            below.add(_end(joint, "child"))
        tops = [name for name in self.links if name not in below]
        oracles = [self._tree(top, children) for top in tops]
        return max(oracles, key=lambda pair: pair[1])[0]

    def _tree(self, top: str | None, children: dict[str | None, list[ET.Element]]) -> tuple[Oracle, int]:
        found, count = Oracle(), 0
        waiting: list[tuple[str | None, np.ndarray]] = [(top, np.eye(4))]
        while waiting:
            name, frame = waiting.pop()
            count += 1
            link = self.links[name]
            mass = link.find("inertial/mass")
            found.mass += 0.0 if mass is None else float(mass.get("value", "0"))
            solids = [frame @ one for one in map(self._solid, link.findall(self.tag)) if one is not None]
            found.solids += [points[:3].T for points in solids]
            for joint in children.get(name, ()):
                inner = frame @ _origin(joint)
                waiting.append((_end(joint, "child"), inner))
                if joint.get("type") == "continuous":
                    found.wheels[joint.get("name", "")] = self._radius(joint, children)
        return found, count

    def _radius(self, joint: ET.Element, children: dict[str | None, list[ET.Element]]) -> float:
        """Return the radius of what is round about a joint's axis: collides, or else is drawn."""
        first = 0.0
        for tag in (self.tag, "visual"):
            outline = self._outline(joint, children, tag)
            if not len(outline):
                continue
            far = float(np.linalg.norm(outline, axis=1).max())
            if -ConvexHull(outline).equations[:, 2].max() >= ROUND * far:
                return far
            first = first or far
        return first

    def _outline(
        self, joint: ET.Element, children: dict[str | None, list[ET.Element]], tag: str
    ) -> np.ndarray:
        """Return the vertices of the solids behind a joint, in the plane across its axis (n, 2)."""
        axis = joint.find("axis")
        way = np.array([*_numbers("1 0 0" if axis is None else axis.get("xyz", "1 0 0"), 3)])
        plane = np.linalg.svd(way[None])[2][1:]
        found, waiting = [np.zeros((0, 2))], [(_end(joint, "child"), np.eye(4))]
        while waiting:
            name, frame = waiting.pop()
            for one in map(self._solid, self.links[name].findall(tag)):
                if one is not None:
                    found.append((frame @ one)[:3].T @ plane.T)
            waiting += [
                (_end(child, "child"), frame @ _origin(child))
                for child in children.get(name, ())
                if child.get("type") == "fixed"
            ]
        return np.concatenate(found)

    def _solid(self, element: ET.Element) -> np.ndarray | None:
        """Return the vertices of a solid in its link's frame (4, n)."""
        form = element.find("geometry/*")
        if form is None:
            return None
        numbers = lambda key, usual="": np.array(_numbers(form.get(key, usual), 3))  # noqa: E731
        if form.tag == "box":
            points = box(numbers("size") / 2)
        elif form.tag == "sphere":
            points = ball(numbers("radius")[0] * np.ones(3))
        elif form.tag == "cylinder":
            points = rod(numbers("radius")[0], numbers("length")[0] / 2)
        elif form.tag == "capsule":
            ends = ball(numbers("radius")[0] * np.ones(3))
            half = np.array([0, 0, numbers("length")[0] / 2])
            points = np.concatenate([ends + half, ends - half])
        else:
            points = mesh(str(self._file(form.get("filename", "")))) * numbers("scale", "1 1 1")
        return _origin(element) @ np.vstack([points.T, np.ones(len(points))])

    def _file(self, name: str) -> Path:
        """Return the file of a mesh: beside, above, or below a folder of the package's name."""
        plain = name.split("://")[-1]
        for base in self.path.resolve().parents:
            for tail in (plain, plain.partition("/")[2]):
                if tail and (base / tail).is_file():
                    return base / tail
        raise FileNotFoundError(name)


def _numbers(text: str, count: int) -> list[float]:
    """Return the first numbers of a text; some files have commas between them, or more than axes."""
    if text.lstrip().startswith("$("):  # an argument of xacro in a URDF file: its usual value
        text = text.strip().lstrip("$(").rstrip(")").split(None, 2)[2]
    return [float(word) for word in text.replace(",", " ").split()[:count]]


def _end(joint: ET.Element, which: str) -> str | None:
    found = joint.find(which)
    return None if found is None else found.get("link")


def _origin(element: ET.Element) -> np.ndarray:
    found = element.find("origin")
    frame = np.eye(4)
    if found is not None:
        roll, pitch, yaw = _numbers(found.get("rpy", "0 0 0"), 3)
        (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (roll, pitch, yaw))
        frame[:3, :3] = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
        frame[:3, 3] = _numbers(found.get("xyz", "0 0 0"), 3)
    return frame


@lru_cache(maxsize=64)
def mesh(path: str) -> np.ndarray:
    """Return the vertices of a mesh file in metres (n, 3)."""
    import trimesh

    collada: dict[str, Any] = {"resolver": None} if path.lower().endswith("dae") else {}
    scene: Any = trimesh.load_scene(path, **collada)
    parts = []
    for node in sorted(scene.graph.nodes_geometry):
        frame, name = scene.graph[node]
        solid = scene.geometry[name]
        unit = str(solid.metadata.get("units") or "").partition(" * ")
        scale = float(unit[0]) if unit[1] and path.lower().endswith("dae") else 1.0
        vertices = np.asarray(solid.vertices)
        parts.append((vertices @ frame[:3, :3].T + frame[:3, 3]) * scale)
    return np.concatenate(parts)


def box(half: np.ndarray) -> np.ndarray:
    """Return the corners of a box (8, 3)."""
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half


def rod(radius: float, half: float) -> np.ndarray:
    """Return corners of a cylinder along z (n, 3)."""
    turn = np.arange(SIDES) * 2 * np.pi / SIDES
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1) * radius
    top = np.array([0, 0, half])
    return np.concatenate([ring + top, ring - top])


def ball(radii: np.ndarray) -> np.ndarray:
    """Return points of an ellipsoid (n, 3), its ends among them."""
    turn = np.arange(SIDES) * 2 * np.pi / SIDES
    rings = [
        np.stack([np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up) + 0 * turn], 1)
        for up in np.linspace(-np.pi / 2, np.pi / 2, SIDES // 2 + 1)
    ]
    return np.concatenate(rings) * radii


def _mjcf(path: Path) -> Oracle:
    """Return the figures of the first body under the world and all below it."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = next(body for body in range(1, model.nbody) if model.body_parentid[body] == 0)
    own = {body for body in range(model.nbody) if body >= root and model.body_rootid[body] == root}
    mat, pos = data.xmat[root].reshape(3, 3), data.xpos[root]
    found = Oracle(mass=float(model.body_subtreemass[root]))
    touching = [bool(model.geom_contype[g] or model.geom_conaffinity[g]) for g in range(model.ngeom)]
    any_touches = any(touching[g] for g in range(model.ngeom) if model.geom_bodyid[g] in own)
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] in own and (touching[geom] or not any_touches):
            points = _geom_points(model, geom) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            found.solids.append((points - pos) @ mat)
    return found


def _geom_points(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Return vertices of a geom in its own frame (n, 3)."""
    kind, size, types = model.geom_type[geom], model.geom_size[geom], mujoco.mjtGeom
    if kind == types.mjGEOM_MESH:
        number = model.geom_dataid[geom]
        first = model.mesh_vertadr[number]
        return model.mesh_vert[first : first + model.mesh_vertnum[number]].astype(float)
    if kind == types.mjGEOM_BOX:
        return box(size)
    if kind == types.mjGEOM_CYLINDER:
        return rod(size[0], size[1])
    if kind == types.mjGEOM_CAPSULE:
        ends = ball(np.full(3, size[0]))
        top = np.array([0, 0, size[1]])
        return np.concatenate([ends + top, ends - top])
    return ball(size if kind == types.mjGEOM_ELLIPSOID else np.full(3, size[0]))
