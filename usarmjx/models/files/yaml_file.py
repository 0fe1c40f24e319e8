"""An arena's YAML file: the fields of `ArenaSpec` with their rules, and other files as sources of solids."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np

from usarmjx.base.errors import ArenaFileError, SpecError
from usarmjx.base.registry import is_name
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, FileValue, Setting
from usarmjx.base.settings.reader import Reader
from usarmjx.base.settings.yaml_file import read_yaml
from usarmjx.base.transforms import Vec3
from usarmjx.models.compile.geoms import arena_inertia
from usarmjx.models.compile.reachability import shapes_in_arena
from usarmjx.models.compile.victims import build_victim_table, check_victim
from usarmjx.models.files.content import (
    EMPTY_EXTENT,
    MAX_COORDINATE,
    Content,
    Rectangle,
    corners_of,
    extent_of,
    free_start_pose,
    merge_contents,
    transform_content,
)
from usarmjx.models.files.images import read_heights
from usarmjx.models.files.maps import (
    DEFAULT_CELL,
    DEFAULT_WALL_HEIGHT,
    Unknown,
    moving_ai_content,
    occupancy_grid_content,
)
from usarmjx.models.files.meshes import (
    NO_MESH,
    SeenBy,
    checked_corners,
    faces_of_file,
    load_convex_pieces,
    shapes_of,
    vertices_of_file,
)
from usarmjx.models.files.mjcf import mjcf_content
from usarmjx.models.files.resources import Resources
from usarmjx.models.files.roads_file import roads_content
from usarmjx.models.files.sdf import sdf_content
from usarmjx.models.files.stage import stage_content
from usarmjx.models.files.urdf import urdf_content
from usarmjx.models.types.arena import (
    ArenaSpec,
    Door,
    FalseAlarm,
    GpsOrigin,
    LooseObject,
    StartPose,
    Victim,
    Water,
)
from usarmjx.models.types.shapes import (
    FENDER,
    MATERIALS,
    MAX_BELT_SPEED,
    OPAQUE,
    SURFACES,
    ZERO,
    BodyInertia,
    Conveyor,
    HeightField,
    Mesh,
    Rgba,
    Shape,
    texture_problem,
)

SIZES = {
    "box": (3, "half lengths along x, y and z"),
    "sphere": (1, "the radius"),
    "capsule": (2, "radius and half length without the balls"),
    "cylinder": (2, "radius and half length"),
    "ellipsoid": (3, "radii along x, y and z"),
    "hfield": (3, "half lengths along x and y, and the ground's thickness below the lowest point"),
}
"""Number and meaning of the size numbers of a kind of solid; a mesh has none."""
MAX_SPAN, MIN_SPAN = 200.0, 0.05
"""Lengths of an arena outside which its scale is doubted [m]."""
SCALES = (0.001, 0.01, 0.0254, 0.3048)
"""Factors to metres that are proposed: of millimetres, centimetres, inches, feet."""
LEAST_SPAN, GOOD_SPAN = 0.3, 100.0
"""Lengths of an arena between which a factor is proposed [m]."""
LARGEST_SCALE = 1000.0
"""Factor that is proposed for an arena that is too small: it was scaled to metres twice."""
REMEDIES = {
    **dict.fromkeys((".obj", ".stl", ".dae"), "load it with meshes: [{{file: {name}, scale: {scale:g}}}]"),
    ".map": "load it with moving_ai: {{file: {name}, cell: {cell:.3g}}}",
    ".scen": "load it with moving_ai: {{file: {name}, cell: {cell:.3g}}}",
    ".rndf": "",
}
"""Lines to write for a file of a suffix; empty: such files are large."""
GREY: Rgba = (0.7, 0.7, 0.7, 1.0)
LOOSE_SURFACE = "loose"
T = TypeVar("T")
MAX_SOLIDS = 50_000
"""Largest number of solids and victims of an arena."""
MAX_OTHER_FILES = {
    **dict.fromkeys(("heights", "heightfield", "map", "moving_ai", "rndf"), 32),
    **dict.fromkeys(("mjcf", "urdf", "sdf", "stage"), 100),
    **dict.fromkeys(("mesh", "meshes", "decomposition"), 1000),
}
"""Largest number of files under each key that names other files."""


def _shape(shape: Shape) -> str:
    if shape.material == FENDER and shape.kind != "box":
        return f"a fender is a box, not a {shape.kind}"
    if shape.conveyor is not None and shape.kind != "box":
        return f"a conveyor is a box, not a {shape.kind}"
    for kind, key, data in (("mesh", "mesh", shape.mesh), ("hfield", "heights", shape.heights)):
        if (shape.kind == kind) != (data is not None):
            return f"kind {kind} and the key {key!r} go together; this is a {shape.kind}"
    if shape.kind in SIZES:
        count, meaning = SIZES[shape.kind]
        if len(shape.size) != count or min(shape.size) <= 0:
            return f"size {list(shape.size)} of a {shape.kind}: wants {count} above zero, {meaning} [m]"
    return texture_problem(shape.texture)


def _conveyor(belt: Conveyor) -> str:
    if not is_name(belt.name):
        return f"conveyor {belt.name!r}: a name is one word of ASCII without braces"
    fastest = max(map(abs, belt.velocity))
    # In this form: NaN is refused as well.
    if not fastest <= MAX_BELT_SPEED:
        return f"conveyor {belt.name!r} runs at {fastest:g} m/s; at most {MAX_BELT_SPEED:g}"
    return ""


def _loose(loose: LooseObject) -> str:
    if loose.inertia is not None and (loose.inertia.mass <= 0 or not _is_inertia(loose.inertia)):
        return f"loose object {loose.name!r}: inertia is that of no body: {loose.inertia}"
    # MuJoCo does not compile a body that moves and has no mass.
    if loose.inertia is None and sum(shape.mass for shape in loose.shapes) <= 0:
        return f"loose object {loose.name!r} has no mass: give one of its shapes a mass [kg]"
    if any(shape.conveyor is not None for shape in loose.shapes):
        return f"loose object {loose.name!r} is a conveyor; those are fixed solids"
    if any(shape.kind == "hfield" for shape in loose.shapes):
        return f"loose object {loose.name!r} is a terrain; those stay where they are"
    return ""


def _is_inertia(stated: BodyInertia) -> bool:
    """Return whether a body can have these moments: all above 0, none above the sum of the others."""
    tensor = arena_inertia(stated).tensor
    if not np.isfinite(tensor).all():
        return False
    values = np.linalg.eigvalsh(tensor)
    # A file's digits may exceed the sum a little: `set_inertia` mends that.
    return bool(values[0] > 0 and values[2] <= (values[0] + values[1]) * (1 + 1e-6))


def _door(door: Door) -> str:
    if door.limits[0] >= door.limits[1]:
        return f"door {door.name!r}: limits {list(door.limits)}: wants lowest and highest angle"
    return ""


def _water(water: Water) -> str:
    if all(low < high for low, high in zip(water.low, water.high, strict=True)):
        return ""
    return f"low {list(water.low)} is not below high {list(water.high)} in x, y and z"


def _victim(victim: Victim) -> str:
    return _refusal(lambda: check_victim(victim))


def _alarm(alarm: FalseAlarm) -> str:
    return _refusal(lambda: build_victim_table((), (alarm,)))


def _refusal(action: Callable[[], object]) -> str:
    try:
        action()
    except SpecError as error:
        return str(error)
    return ""


def arena_problem(arena: ArenaSpec) -> str:
    """Return the error of an arena; empty: it is valid."""
    solids = [*arena.shapes, *(shape for one in arena.loose for shape in one.shapes)]
    places = [one.at for one in (*solids, *arena.starts, *arena.loose, *arena.doors, *arena.victims)]
    lengths = [*places, *(shape.size for shape in solids), *arena.extent]
    farthest = max((abs(number) for numbers in lengths for number in numbers), default=0.0)
    # In this form: comparisons with NaN are false, so it is refused as well.
    if not farthest <= MAX_COORDINATE:
        return f"something lies or reaches {farthest:g} m from the origin; at most {MAX_COORDINATE:g}"
    for start in arena.starts:
        if not is_name(start.tag):
            return f"start {start.tag!r}: a tag is one word of ASCII without braces"
    for kind, records in (("loose object", arena.loose), ("door", arena.doors), ("victim", arena.victims)):
        twice = [name for name, count in Counter(record.name for record in records).items() if count > 1]
        if twice:
            return f"two {kind}s are called {twice[0]!r}; names are unique"
    if any(low >= high for low, high in arena.extent):
        return f"extent {[list(pair) for pair in arena.extent]}: wants [[x0, x1], [y0, y1]], lowest first"
    return ""


ARENA_RULES: dict[type, Callable[[Any], str]] = {
    ArenaSpec: arena_problem,
    Conveyor: _conveyor,
    Door: _door,
    FalseAlarm: _alarm,
    LooseObject: _loose,
    Shape: _shape,
    Victim: _victim,
    Water: _water,
}
"""Check of each dataclass, which returns its error; empty: it is valid."""


def scale_notes(arena: ArenaSpec, path: Path) -> tuple[str, ...]:
    """Return a doubt about an arena's scale, with a proposal; empty: its size is plausible.

    Args:
        arena: The arena.
        path: Its file.
    """
    shapes = [*arena.shapes, *(shape for one in arena.loose for shape in shapes_in_arena(one))]
    # A place on Earth fixes the scale: such arenas may be large.
    if not shapes or arena.gps is not None:
        return ()
    corners = np.concatenate([corners_of(shape) for shape in shapes])
    size = corners.max(0) - corners.min(0)
    span = float(size.max())
    if MIN_SPAN <= span <= MAX_SPAN:
        return ()
    remedy = REMEDIES.get(
        path.suffix.lower(), "mind the units of its file; meshes have a `scale`, as {scale:g}"
    )
    scale = (
        LARGEST_SCALE
        if span < MIN_SPAN
        else next((s for s in SCALES if LEAST_SPAN <= s * span <= GOOD_SPAN), 0.001)
    )
    said = remedy.format(name=path.name, scale=scale, cell=GOOD_SPAN / span)
    # Route networks span kilometres: no factor is proposed for them.
    if not said:
        return ()
    limit = f"over {MAX_SPAN:g} m" if span > MAX_SPAN else f"under {100 * MIN_SPAN:g} cm"
    shown = " x ".join(f"{length:.4g}" for length in size.tolist())
    return (f"{path}: its solids span {shown} m, {limit}: if its unit is not the metre, {said}",)


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
    """A map or scenario of MovingAI: see `maps`.

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
        # Fixed solids are placed themselves; those of a loose object keep the object's axes.
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


@dataclass(frozen=True, kw_only=True)
class ArenaFile(ArenaSpec):
    """A YAML file: an arena, and other files as sources of solids.

    Attributes:
        name: Level name; empty: the file's name.
        starts: Start poses; without the key, one in the largest free area.
        extent: x and y limits of the floor plan; without the key, 1 m around the solids.
        mjcf: MJCF files.
        urdf: URDF files.
        sdf: SDF files and worlds of Gazebo.
        stage: World files of Stage.
        meshes: OBJ, STL and COLLADA files.
        heightfield: Grey images as terrain.
        map: Maps of ROS' map_server.
        moving_ai: Maps and scenarios of MovingAI.
        rndf: Route networks.
    """

    name: str = ""
    starts: tuple[StartPose, ...] = ()
    extent: Rectangle = EMPTY_EXTENT
    mjcf: tuple[ModelFile, ...] = ()
    urdf: tuple[ModelFile, ...] = ()
    sdf: tuple[ModelFile, ...] = ()
    stage: tuple[ModelFile, ...] = ()
    meshes: tuple[MeshFile, ...] = ()
    heightfield: tuple[TerrainFile, ...] = ()
    map: tuple[MapFile, ...] = ()
    moving_ai: tuple[GridFile, ...] = ()
    rndf: tuple[RoadFile, ...] = ()

    @property
    def arena(self) -> ArenaSpec:
        """The arena without the content of the other files."""
        return ArenaSpec(**{one.name: getattr(self, one.name) for one in fields(ArenaSpec)})


@dataclass(frozen=True, kw_only=True)
class FileOfMesh:
    """A solid's mesh with its geometry for rays.

    Attributes:
        file: OBJ, STL or COLLADA file.
        rays: Its faces, or the hull.
    """

    file: Path
    rays: SeenBy


@dataclass(frozen=True, kw_only=True)
class FileOfHeights:
    """A solid's terrain.

    Attributes:
        file: PNG file of 8 or 16 bits.
        height: Height of white above black [m].
    """

    file: Path
    height: Annotated[float, NOT_NEGATIVE]


def arena_of_yaml(value: FileValue, resources: Resources) -> tuple[ArenaSpec, tuple[str, ...]]:
    """Return the arena that a YAML file describes, and the content of its other files that is left out.

    Args:
        value: The file.
        resources: Folders of packages and models that its other files name.

    Raises:
        ArenaFileError: An unknown, missing or invalid value; names file and line.
    """
    # Before anything is read: each of these files may take seconds.
    _check_number_of_files(value)
    given = value.mapping()
    file = ARENA_READER.from_data(ArenaFile, value, defaults={"name": value.path.stem})
    # Each source goes with its own value, so that an error in its content names its line.
    parts = [
        _content(action(source, resources), item)
        for key, action in SOLID_SOURCES.items()
        if key in given
        for source, item in zip(getattr(file, key), _one_or_several(given[key]), strict=True)
    ]
    content = merge_contents(parts)
    arena = complete_arena(file.arena, content, value, set(given))
    return arena, content.warnings + scale_notes(arena, value.path)


def _check_number_of_files(value: FileValue) -> None:
    """Refuse a file that names too many other files."""
    found: Counter[str] = Counter()
    waiting = [value]
    while waiting:
        # A loop with a list of its own: a file nested ever deeper must not end in a RecursionError.
        one = waiting.pop()
        pairs = one.data.items() if isinstance(one.data, dict) else ()
        waiting += one.data if isinstance(one.data, list) else [item for _, item in pairs]
        for key, item in pairs:
            if key in MAX_OTHER_FILES:
                named = item.data if isinstance(item.data, list) else [item]
                found[key] += sum(isinstance(name.data, str | dict) for name in named)
                if found[key] > MAX_OTHER_FILES[key]:
                    raise item.error(f"more than {MAX_OTHER_FILES[key]} files under {key!r} in one arena")


def complete_arena(arena: ArenaSpec, content: Content, value: FileValue, given: set[str]) -> ArenaSpec:
    """Return an arena with the content of other files, and with defaults for missing fields.

    Args:
        arena: The arena.
        content: Content of other files.
        value: The file's value, for errors.
        given: Fields that the file has.
    """
    shapes, loose = (*arena.shapes, *content.shapes), (*arena.loose, *content.loose)
    solids = [*shapes, *(shape for one in loose for shape in one.shapes)]
    if len(solids) + len(arena.victims) > MAX_SOLIDS:
        raise value.error(
            f"{len(solids)} solids and {len(arena.victims)} victims; at most {MAX_SOLIDS} in all"
        )
    arena = replace(
        arena,
        shapes=shapes,
        loose=loose,
        doors=(*arena.doors, *content.doors),
        lights=(*arena.lights, *content.lights),
        gps=arena.gps or content.gps,
    )
    # Statements of the file itself count; content of other files only fills gaps.
    if "has_floor" not in given and content.floor is not None:
        arena = replace(arena, has_floor=content.floor)
    if "extent" not in given:
        arena = replace(arena, extent=content.extent or extent_of(shapes, loose))
    if "starts" not in given and content.starts:
        arena = replace(arena, starts=content.starts)
    elif "starts" not in given:
        # Before the search, which needs finite lengths and a proper extent.
        if wrong := arena_problem(arena):
            raise value.error(wrong)
        try:
            start = free_start_pose(arena, content.free_position)
        except SpecError as error:
            raise value.error(f"no start pose can be found, give `starts`: {error}") from error
        if start is None:
            raise value.error("there is no free place for a robot to start from: give `starts`, or a floor")
        arena = replace(arena, starts=(start,))
    if wrong := arena_problem(arena):
        raise value.error(wrong)
    return arena


def _content(content: Content, value: FileValue) -> Content:
    """Return the content of another file, checked."""
    for shape in (*content.shapes, *(s for loose in content.loose for s in loose.shapes)):
        try:
            ARENA_READER.validate(shape)
        except ArenaFileError as error:
            # At the line of the arena's file: that of the other file is not known any more.
            raise value.error(str(error)) from None
    return content


def _one_or_several(value: FileValue) -> list[FileValue]:
    return value.data if isinstance(value.data, list) else [value]


def _sources(kind: type[T], value: FileValue) -> tuple[T, ...]:
    """Read one source of solids or a list of them, each a mapping or the name of its file alone."""
    items = _one_or_several(value)
    # `one` itself is the value of "file": errors then point at its own line.
    whole = [replace(one, data={"file": one}) if isinstance(one.data, str) else one for one in items]
    return tuple(ARENA_READER.from_data(kind, one) for one in whole)


def _file(value: FileValue) -> Path:
    path = value.path.parent / ARENA_READER.convert(str, value)
    if not path.is_file():
        raise value.error(f"there is no file {path}")
    return path


def _scale(value: FileValue) -> Scale:
    if isinstance(value.data, list):
        scale = Scale(ARENA_READER.convert(Vec3, value))
    else:
        scale = Scale([ARENA_READER.convert(float, value)] * 3)
    # A negative factor mirrors a mesh; zero flattens it, and MuJoCo needs a volume.
    if 0.0 in scale:
        raise value.error("a scale is not zero")
    return scale


def _mesh(value: FileValue) -> Mesh:
    """Read a solid's mesh: the name of a file, a list of vertices, or a file with its faces for rays."""
    if isinstance(value.data, dict):
        given = ARENA_READER.from_data(FileOfMesh, value)
        return faces_of_file(given.file) if given.rays == "faces" else Mesh(vertices_of_file(given.file))
    if isinstance(value.data, str):
        return Mesh(vertices_of_file(_file(value)))
    # Reshaped, so that an empty list has three columns and is refused with its line below.
    corners = np.array(ARENA_READER.convert(tuple[Vec3, ...], value)).reshape(-1, 3)
    return Mesh(checked_corners(corners, f"{value.place}: {value.name}"))


def _heights(value: FileValue) -> HeightField:
    """Read a terrain: a file and its height, or a list of rows."""
    if isinstance(value.data, dict):
        given = ARENA_READER.from_data(FileOfHeights, value)
        return HeightField(read_heights(given.file, given.height))
    rows = ARENA_READER.convert(tuple[tuple[Annotated[float, HEIGHT], ...], ...], value)
    if len(rows) < 2 or len(rows[0]) < 2 or len({len(row) for row in rows}) > 1:
        raise value.error("is not a table of at least 2 x 2 heights, all rows of one length")
    return HeightField(np.array(rows))


HEIGHT = Setting(ge=0, unit="m")
SOURCES = (ModelFile, MeshFile, TerrainFile, MapFile, GridFile, RoadFile)
SPECIAL: Mapping[Any, Callable[[FileValue], Any]] = {
    Path: _file,
    Scale: _scale,
    Mesh: _mesh,
    HeightField: _heights,
    **{tuple[kind, ...]: partial(_sources, kind) for kind in SOURCES},
}
"""Readers of types with a YAML form of their own."""
ARENA_READER = Reader(
    special=SPECIAL,
    rules={**ARENA_RULES, ArenaFile: arena_problem},
    refusal=ArenaFileError,
    single_precision=False,  # MuJoCo compiles arenas in double precision
)
"""Reader of arenas' files."""
