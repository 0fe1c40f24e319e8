"""Arenas taken apart for files of other tools: links, each with its solids, and the meshes' files."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.compile.compose import DOOR_PREFIX, LOOSE_PREFIX, new_spec
from usarmjx.models.compile.doors import door_panel
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.ray_geoms import terrain_faces
from usarmjx.models.compile.victims import segment_poses, victim_table
from usarmjx.models.files.export_pieces import ellipsoid_corners, stl_of, stl_of_hull, write_file
from usarmjx.models.files.mjcf_solids import Pose, mat_of
from usarmjx.models.files.robot_source import unused_name
from usarmjx.models.types.arena import ArenaSpec, Door
from usarmjx.models.types.shapes import OPAQUE, SKY, SURFACES, Rgba, Shape


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
    model = new_spec(arena, Physics()).compile()
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
