"""Geometry and colours of SDF as solids."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import Vec3, flip_angles
from usarmjx.models.files.content import MIN_WALL_HEIGHT, surface_of
from usarmjx.models.files.images import read_height_shares
from usarmjx.models.files.mesh_solids import Use, WorldPiece, convex_parts, prism, signed_area, world_pieces
from usarmjx.models.files.mjcf_solids import Pose, usarsim_angles
from usarmjx.models.files.sdf_tree import SdfFiles
from usarmjx.models.files.xml_file import LinedElement, numbers_of
from usarmjx.models.types.shapes import HeightField, Rgba, Shape

GREY: Rgba = (0.7, 0.7, 0.7, 1.0)
FIXTURE = "fixture"
PLANE_THICKNESS = 0.1
"""Thickness of a plane that is not the floor [m]."""
FLOOR_TOLERANCE = 1e-6
"""Largest distance of a floor from height zero [m], and of its normal from the vertical."""
HEIGHTMAP_BASE = 0.1
"""Thickness of the ground below the lowest point of a height map [m]."""
STEEP = 0.5
"""Vertical part of a plate's normal up to which the plate is a wall."""
NAMED_COLOURS: dict[str, Rgba] = {
    "grey": GREY,
    "gray": GREY,
    "darkgrey": (0.175, 0.175, 0.175, 1.0),
    "lightgrey": (0.88, 0.88, 0.88, 1.0),
    "white": (1.0, 1.0, 1.0, 1.0),
    "flatblack": (0.1, 0.1, 0.1, 1.0),
    "black": (0.0, 0.0, 0.0, 1.0),
    "red": (1.0, 0.0, 0.0, 1.0),
    "green": (0.0, 1.0, 0.0, 1.0),
    "blue": (0.0, 0.0, 1.0, 1.0),
    "yellow": (1.0, 1.0, 0.0, 1.0),
    "orange": (1.0, 0.51, 0.0, 1.0),
    "purple": (1.0, 0.0, 1.0, 1.0),
    "turquoise": (0.0, 1.0, 1.0, 1.0),
    "skyblue": (0.13, 0.44, 0.7, 1.0),
    "indigo": (0.33, 0.0, 0.5, 1.0),
    "gold": (0.9, 0.75, 0.2, 1.0),
    "wood": (0.6, 0.45, 0.3, 1.0),
    "bricks": (0.6, 0.3, 0.25, 1.0),
    "residential": (0.6, 0.55, 0.5, 1.0),
    "road": (0.3, 0.3, 0.3, 1.0),
    "asphalt": (0.3, 0.3, 0.3, 1.0),
}
"""Colours of Gazebo's materials by their names without `Gazebo/` (chosen for those with textures)."""
SILENT = ("empty",)
"""Kinds of geometry that are nothing."""


@dataclass(eq=False)
class SdfSolids:
    """Maker of solids from the `<geometry>` of an SDF file.

    Attributes:
        files: Reader of the files that it names.
        surface: Surface of fixed solids; empty: by their form.
        floors: Planes that are the floor.
        notes: Content that is left out or coarser than in the file, in words.
    """

    files: SdfFiles
    surface: str = ""
    floors: int = 0
    notes: list[str] = field(default_factory=list[str])

    def of(self, solid: LinedElement, pose: Pose, like: Shape, use: Use) -> list[Shape]:
        """Return a `<collision>` or `<visual>` as shapes; one that cannot be read is left out with a note.

        Args:
            solid: The element.
            pose: Pose in the axes that hold the shapes.
            like: Their colour, and their surface; empty: by their form.
            use: Bodies and rays that meet them.
        """
        geometry = solid.first("geometry")
        form = None if geometry is None else next(iter(geometry.children()), None)
        called = f"<{solid.tag}> {solid.get('name', '')!r}"
        if form is None:
            self.notes.append(f"{solid.place}: {called} has no geometry: left out")
            return []
        maker = MAKERS.get(form.tag)
        if maker is None:
            if form.tag not in SILENT:
                known = ", ".join(MAKERS)
                self.notes.append(f"{form.place}: {called} is a <{form.tag}>: left out; known: {known}")
            return []
        others = len(geometry.all("polyline")) - 1 if geometry is not None else 0
        if others > 0:
            self.notes.append(f"{form.place}: {called} has {others} more polylines, holes perhaps: left out")
        like = replace(like, at=at_of(pose), rotation=angles_of(pose))
        try:
            return [*maker(self, form, pose, like, use)]
        except ArenaFileError as error:
            text = str(error)
            # Errors of meshes name the mesh's file only.
            said = text if text.startswith(f"{form.path}:") else f"{form.place}: {text}"
            self.notes.append(f"{said}; {called} is left out")
            return []


def _lengths(form: LinedElement, tag: str, count: int) -> np.ndarray:
    """Return the lengths in a child of a form [m] (count,)."""
    found = form.first(tag)
    if found is None:
        raise form.error(f"<{form.tag}> has no <{tag}>")
    lengths = numbers_of(found, found.text, count)
    if lengths.min() <= 0:
        raise found.error(f"<{tag}> has {lengths.tolist()}, expected lengths above zero [m]")
    return lengths


def _plain(kind: str, tags: tuple[tuple[str, int, float], ...]) -> "SolidMaker":
    """Return a maker of a kind of shape, from children with a number of lengths and a factor each."""

    def make(own: SdfSolids, form: LinedElement, pose: Pose, like: Shape, use: Use) -> Iterator[Shape]:
        del pose, use
        sizes = np.concatenate([_lengths(form, tag, count) * factor for tag, count, factor in tags])
        shape = replace(like, kind=kind, size=tuple(sizes.tolist()))
        yield replace(shape, surface=like.surface or own.surface or surface_of(shape))

    return make


def _plane(own: SdfSolids, form: LinedElement, pose: Pose, like: Shape, use: Use) -> Iterator[Shape]:
    """Yield a plane that is not the floor as a thin box."""
    found = form.first("normal")
    normal = np.array([0.0, 0.0, 1.0]) if found is None else numbers_of(found, found.text, 3)
    length = float(np.linalg.norm(normal))
    if length < 1e-9:
        raise form.error("<normal> has a length of 0")
    normal = normal / length
    # The normal is in the plane's own axes, the test for a floor in the world's.
    world = pose.mat @ normal
    if use == "loose":
        raise form.error("a plane does not move")
    if abs(pose.pos[2]) <= FLOOR_TOLERANCE and world[2] >= 1 - FLOOR_TOLERANCE:
        # Looks of a plane come with a collision: only that counts.
        own.floors += use == "fixed"
        return
    sizes = form.first("size")
    x, y = (1.0, 1.0) if sizes is None else _lengths(form, "size", 2).tolist()
    # The axis that is least parallel: the cross product cannot vanish.
    side = np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])
    # For a level plane the sizes are along its own x and y.
    side = np.array([1.0, 0.0, 0.0]) if abs(normal[2]) > 1 - 1e-9 else side / np.linalg.norm(side)
    axes = np.stack([side, np.cross(normal, side), normal], 1)
    if use == "fixed":
        own.notes.append(
            f"{form.place}: a plane that is not the floor at height 0 becomes a box of {x:g} x {y:g} m"
        )
    frame = pose.then(Pose(np.zeros(3), axes))
    # Below the plane: its upper face is where the plane is.
    centre = frame.pos - PLANE_THICKNESS / 2 * world
    yield replace(
        like,
        kind="box",
        size=(x / 2, y / 2, PLANE_THICKNESS / 2),
        at=vector_of(centre),
        rotation=angles_of(frame),
        surface=like.surface or own.surface or "ground",
    )


def _mesh(own: SdfSolids, form: LinedElement, pose: Pose, like: Shape, use: Use) -> Iterator[Shape]:
    uri = form.word("uri")
    if not uri:
        raise form.error("<mesh> has no <uri>")
    file = own.files.file(uri, form.path)
    if file is None or not file.is_file():
        raise form.error(
            f"mesh {uri} is not there; --packages or GZ_SIM_RESOURCE_PATH name folders to search"
        )
    found = form.first("scale")
    scale = (1.0, 1.0, 1.0) if found is None else numbers_of(found, found.text, 3).tolist()
    if 0.0 in scale:
        raise form.error("a scale is not zero")
    centred = form.word("submesh/center").lower() in ("1", "true")
    pieces, notes = world_pieces(
        file, (scale[0], scale[1], scale[2]), form.word("submesh/name"), centred, use
    )
    own.notes += [f"{form.place}: {note}" for note in notes]
    yield from placed_pieces(pieces, pose, replace(like, surface=like.surface or own.surface), use)


def placed_pieces(pieces: Iterable[WorldPiece], pose: Pose, like: Shape, use: Use) -> Iterator[Shape]:
    """Yield the solids of a mesh in a pose as shapes like another one; without a surface each gets one."""
    for piece in pieces:
        shape = replace(like, kind="mesh", mesh=piece.mesh)
        surface = like.surface or _surface(shape, pose, piece.normal)
        if piece.box is not None:
            half, frame = piece.box
            there = pose.then(frame)
            x, y, z = half.tolist()
            yield replace(
                like, kind="box", size=(x, y, z), at=at_of(there), rotation=angles_of(there), surface=surface
            )
        else:
            yield replace(shape, mass=piece.volume if use == "loose" else 0.0, surface=surface)


def _surface(shape: Shape, pose: Pose, normal: np.ndarray | None) -> str:
    """Return the surface of a piece: a plate is a wall if it is steep and high."""
    if normal is None or shape.mesh is None:
        return surface_of(shape)
    # The third row of the pose: z of each corner in the world, apart from a constant.
    heights = shape.mesh.vertices @ pose.mat[2]
    steep = abs(float(pose.mat[2] @ normal)) < STEEP
    return "wall" if steep and float(np.ptp(heights)) >= MIN_WALL_HEIGHT else "ground"


def _heightmap(own: SdfSolids, form: LinedElement, pose: Pose, like: Shape, use: Use) -> Iterator[Shape]:
    uri = form.word("uri")
    file = own.files.file(uri, form.path) if uri else None
    if file is None or not file.is_file():
        raise form.error(f"height map {uri!r} is not there")
    if use == "loose":
        raise form.error("terrain stays where it is")
    size = (1.0, 1.0, 1.0) if form.first("size") is None else _lengths(form, "size", 3).tolist()
    found = form.first("pos")
    offset = np.zeros(3) if found is None else numbers_of(found, found.text, 3)
    shares = read_height_shares(file)
    # MuJoCo's terrain stands upright; the file's offset counts in the world's axes in Gazebo too.
    centre = pose.pos + offset
    yield replace(
        like,
        kind="hfield",
        size=(size[0] / 2, size[1] / 2, HEIGHTMAP_BASE),
        at=vector_of(centre),
        heights=HeightField(shares * size[2]),
        surface=like.surface or own.surface or "ground",
    )


def _polyline(own: SdfSolids, form: LinedElement, pose: Pose, like: Shape, use: Use) -> Iterator[Shape]:
    """Yield a polygon with a height as prisms."""
    points = form.all("point")
    if len(points) < 3:
        raise form.error(f"<polyline> has {len(points)} points, expected 3 or more")
    corners = np.array([numbers_of(point, point.text, 2) for point in points])
    height = form.number("height", 1.0)
    if height <= 0:
        raise form.error(f"<height> is {height:g}, expected a length above zero [m]")
    try:
        parts = convex_parts(corners)
    except ValueError as error:
        raise form.error(f"<polyline> is {error}") from error
    for part in parts:
        local = prism(part, 0.0, height, like)
        placed = pose.then(Pose(np.array(local.at), np.eye(3)))
        shape = replace(
            local,
            at=at_of(placed),
            rotation=angles_of(placed),
        )
        volume = height * signed_area(part)
        surface = like.surface or own.surface or surface_of(shape)
        yield replace(shape, mass=volume if use == "loose" else 0.0, surface=surface)


SolidMaker = Callable[[SdfSolids, LinedElement, Pose, Shape, Use], Iterator[Shape]]
MAKERS: dict[str, SolidMaker] = {
    "box": _plain("box", (("size", 3, 0.5),)),
    "sphere": _plain("sphere", (("radius", 1, 1.0),)),
    # SDF states whole lengths, a Shape half lengths: factor 0.5.
    "cylinder": _plain("cylinder", (("radius", 1, 1.0), ("length", 1, 0.5))),
    "capsule": _plain("capsule", (("radius", 1, 1.0), ("length", 1, 0.5))),
    "ellipsoid": _plain("ellipsoid", (("radii", 3, 1.0),)),
    "plane": _plane,
    "mesh": _mesh,
    "heightmap": _heightmap,
    "polyline": _polyline,
}
"""Makers of shapes by SDF's kinds of geometry."""


def colour_of(visual: LinedElement) -> Rgba | None:
    """Return the colour of a `<visual>`; None: it has none that is known."""
    material = visual.first("material")
    if material is None:
        return None
    alpha = 1.0 - min(max(visual.number("transparency", 0.0), 0.0), 1.0)
    for tag in ("diffuse", "ambient"):
        found = material.first(tag)
        if found is not None:
            words = (found.text or "").split()
            # Files leave the fourth number out, or have it: transparency is an element of its own.
            numbers = numbers_of(found, " ".join(words[:3]), 3)
            red, green, blue = np.clip(numbers, 0.0, 1.0).tolist()
            return (red, green, blue, alpha)
    name = material.word("script/name").rpartition("/")[2].lower()
    red, green, blue, _ = NAMED_COLOURS.get(name, GREY)
    return (red, green, blue, alpha) if name in NAMED_COLOURS else None


def volume_of(shape: Shape) -> float:
    """Return the volume of a shape that can be loose, for its share of a mass [m3]."""
    if shape.kind == "mesh":
        # Makers of meshes leave the volume in the mass until the link's is shared out.
        return max(shape.mass, 1e-9)
    x, y, z = (*shape.size, 1.0, 1.0)[:3]
    volumes: dict[str, float] = {
        "box": 8 * x * y * z,
        "sphere": 4 / 3 * np.pi * x * x * x,  # a power of a large number raises
        "capsule": np.pi * x * x * (2 * y + 4 / 3 * x),
        "cylinder": 2 * np.pi * x * x * y,
        "ellipsoid": 4 / 3 * np.pi * x * y * z,
    }
    return volumes[shape.kind]


def vector_of(vector: np.ndarray) -> Vec3:
    """Return a vector (3,) as numbers, none of them a negative zero."""
    x, y, z = (np.asarray(vector, float) + 0.0).tolist()
    return (x, y, z)


def at_of(pose: Pose) -> Vec3:
    """Return the position of a pose in an arena's axes."""
    return vector_of(pose.pos)


def angles_of(pose: Pose) -> Vec3:
    """Return roll, pitch and yaw of a pose in an arena's axes."""
    return vector_of(np.array(flip_angles(usarsim_angles(pose.mat))))
