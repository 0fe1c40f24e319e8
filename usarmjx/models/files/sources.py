"""Other files as sources of solids for an arena's YAML file."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.base.settings.yaml_file import read_yaml
from usarmjx.base.transforms import Vec3
from usarmjx.models.files.content import Content, transform_content
from usarmjx.models.files.images import read_heights
from usarmjx.models.files.maps import DEFAULT_WALL_HEIGHT, Unknown, occupancy_grid_content
from usarmjx.models.files.meshes import NO_MESH, SeenBy, load_convex_pieces, shapes_of
from usarmjx.models.files.mjcf import mjcf_content
from usarmjx.models.files.moving_ai import DEFAULT_CELL, moving_ai_content
from usarmjx.models.files.resources import Resources
from usarmjx.models.files.roads_file import roads_content
from usarmjx.models.files.sdf import sdf_content
from usarmjx.models.files.stage import stage_content
from usarmjx.models.files.urdf import urdf_content
from usarmjx.models.types.arena import GpsOrigin, LooseObject
from usarmjx.models.types.shapes import MATERIALS, OPAQUE, SURFACES, ZERO, HeightField, Rgba, Shape

GREY: Rgba = (0.7, 0.7, 0.7, 1.0)
LOOSE_SURFACE = "loose"


class Scale(tuple[float, float, float]):
    """Factors of x, y and z of a mesh; a file may give one number for all."""


@dataclass(frozen=True, kw_only=True)
class ModelFile:
    """A file of MJCF, URDF, SDF or Stage: see `mjcf`, `urdf`, `sdf` and `stage`.

    Attributes:
        file: The file, from the YAML file's folder.
        at: Position of its origin in the arena.
        yaw: Rotation about the vertical [rad].
        surface: Surface of its fixed solids; empty: by their form.
    """

    file: Path
    at: Vec3 = ZERO
    yaw: float = 0.0
    surface: str = ""


@dataclass(frozen=True, kw_only=True)
class MeshFile:
    """A mesh file: see `meshes`.

    Attributes:
        file: OBJ, STL or COLLADA file.
        at: Position of its origin.
        rotation: Roll, pitch, yaw [rad].
        scale: Factors that convert its numbers to metres.
        surface: Surface; empty: by the form of each piece, or "loose".
        material: Material.
        rgba: Colour.
        mass: Mass [kg]; above zero it is one loose object, else fixed.
        name: Name of the loose object; empty: the file's.
        hull: Whether contacts use the hulls of pieces that are not convex.
        rays: Geometry of those for rays: their faces, or the hull too.
        decomposition: Files with convex pieces that replace it.
    """

    file: Path
    at: Vec3 = ZERO
    rotation: Vec3 = ZERO
    scale: Scale = Scale((1.0, 1.0, 1.0))  # noqa: RUF009 - a tuple
    surface: str = ""
    material: Annotated[str, Setting(choices=MATERIALS)] = OPAQUE
    rgba: Rgba = GREY
    mass: Annotated[float, NOT_NEGATIVE] = 0.0
    name: str = ""
    hull: bool = False
    rays: SeenBy = "faces"
    decomposition: tuple[Path, ...] = ()


@dataclass(frozen=True, kw_only=True)
class TerrainFile:
    """Terrain from a grey image.

    Attributes:
        file: PNG file of 8 or 16 bits.
        size: Lengths along x and y [m].
        height: Height of white above black [m].
        at: Position of its middle, at the height of black.
        yaw: Rotation about the vertical [rad].
        base: Thickness of the ground below black [m].
        surface: Surface.
        rgba: Colour.
    """

    file: Path
    size: Annotated[tuple[float, float], POSITIVE]
    height: Annotated[float, POSITIVE]
    at: Vec3 = ZERO
    yaw: float = 0.0
    base: Annotated[float, POSITIVE] = 0.1
    surface: Annotated[str, Setting(choices=tuple(SURFACES))] = "ground"
    rgba: Rgba = (0.45, 0.5, 0.35, 1.0)


@dataclass(frozen=True, kw_only=True)
class MapFile:
    """A map of ROS' map_server: see `maps`.

    Attributes:
        file: Its YAML file.
        height: Height of the walls [m].
        unknown: Treatment of unknown cells.
        at: Position of the map's origin.
        yaw: Rotation about the vertical [rad].
    """

    file: Path
    height: Annotated[float, POSITIVE] = DEFAULT_WALL_HEIGHT
    unknown: Unknown = "free"
    at: Vec3 = ZERO
    yaw: float = 0.0


@dataclass(frozen=True, kw_only=True)
class GridFile:
    """A map or scenario of MovingAI: see `moving_ai`.

    Attributes:
        file: Its file, which ends in .map or .scen.
        cell: Side of a cell [m].
        height: Height of the walls [m].
        at: Position of the outer corner of the lowest left cell.
        yaw: Rotation about the vertical [rad].
    """

    file: Path
    cell: Annotated[float, POSITIVE] = DEFAULT_CELL
    height: Annotated[float, POSITIVE] = DEFAULT_WALL_HEIGHT
    at: Vec3 = ZERO
    yaw: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RoadFile:
    """A route network: see `roads_file`.

    Attributes:
        file: Its RNDF.
        origin: Latitude and longitude of the arena's origin [degrees]; None: the middle of the network.
    """

    file: Path
    origin: GpsOrigin | None = None


def mesh_content(mesh: MeshFile) -> Content:
    """Return a mesh file as fixed solids or a loose object."""
    files = mesh.decomposition or (mesh.file,)
    pieces = partial(load_convex_pieces, scale=mesh.scale, hull=mesh.hull, rays=mesh.rays)
    found = [piece for file in files for piece in pieces(file)]
    like = Shape(kind="mesh", mesh=NO_MESH, material=mesh.material, rgba=mesh.rgba)
    if mesh.mass <= 0:
        like = replace(like, at=mesh.at, rotation=mesh.rotation, surface=mesh.surface)
        return Content(shapes=shapes_of(found, like))
    like = replace(like, surface=mesh.surface or LOOSE_SURFACE)
    solids = shapes_of(found, like, mesh.mass)
    name = mesh.name or mesh.file.stem
    return Content(loose=(LooseObject(name=name, at=mesh.at, rotation=mesh.rotation, shapes=solids),))


def terrain_content(terrain: TerrainFile) -> Content:
    """Return a grey image as terrain."""
    x, y = terrain.size
    shape = Shape(
        kind="hfield",
        size=(x / 2, y / 2, terrain.base),
        at=terrain.at,
        rotation=(0.0, 0.0, terrain.yaw),
        surface=terrain.surface,
        rgba=terrain.rgba,
        heights=HeightField(read_heights(terrain.file, terrain.height)),
    )
    return Content(shapes=(shape,))


def map_file_content(plan: MapFile) -> Content:
    """Return a map as walls."""
    return transform_content(
        occupancy_grid_content(read_yaml(plan.file, ArenaFileError), plan.height, plan.unknown),
        plan.at,
        plan.yaw,
    )


def grid_content(grid: GridFile) -> Content:
    """Return a map or scenario of MovingAI in its pose."""
    return transform_content(moving_ai_content(grid.file, grid.cell, grid.height), grid.at, grid.yaw)


def road_file_content(roads: RoadFile) -> Content:
    """Return a route network as markings, kerbs and start poses."""
    return roads_content(roads.file, roads.origin)


def model_content(reader: Callable[[Path, str], Content], model: ModelFile) -> Content:
    """Return a model file's content in its pose."""
    return transform_content(reader(model.file, model.surface), model.at, model.yaw)


def _urdf(model: ModelFile, resources: Resources) -> Content:
    return model_content(partial(urdf_content, resources=resources), model)


def _sdf(model: ModelFile, resources: Resources) -> Content:
    return model_content(partial(sdf_content, resources=resources), model)


def _plain(reader: Callable[[Any], Content]) -> Callable[[Any, Resources], Content]:
    """Return a reader of files that name no packages."""
    return lambda source, _: reader(source)


SOLID_SOURCES: dict[str, Callable[[Any, Resources], Content]] = {
    "mjcf": _plain(partial(model_content, mjcf_content)),
    "urdf": _urdf,
    "sdf": _sdf,
    "stage": _plain(partial(model_content, stage_content)),
    "meshes": _plain(mesh_content),
    "heightfield": _plain(terrain_content),
    "map": _plain(map_file_content),
    "moving_ai": _plain(grid_content),
    "rndf": _plain(road_file_content),
}
"""Keys of other files, with the readers of their content."""
