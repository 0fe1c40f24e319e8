"""World files of the Stage simulator as arenas: floor plans, boxes and blocks; robots become start poses."""

import math
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.settings.files import read_bytes
from usarmjx.models.files.content import Content
from usarmjx.models.files.images import read_grey
from usarmjx.models.files.maps import MAX_MAP_BOXES, GridFrame, cover
from usarmjx.models.files.mesh_solids import convex_parts, prism
from usarmjx.models.files.robot_source import listed, plain_name, unused_name
from usarmjx.models.types.arena import START_ELEVATION, StartPose
from usarmjx.models.types.shapes import Rgba, Shape

MAX_STAGE_TOKENS = 500_000
"""Largest number of words of a file, its includes with it."""
MAX_STAGE_MODELS = 20_000
"""Largest number of models, those of definitions as often as they are used."""
MAX_STAGE_DEPTH = 50
"""Largest depth of models in models, of includes, and of definitions by others."""
TOKEN = re.compile(
    r"""(?P<space>[ \t\r\f\v,;]+|\#[^\n]*)|(?P<line>\n)|"(?P<string>[^"\n]*)"
    |(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![A-Za-z_])
    |(?P<word>[A-Za-z_][\w.\-]*(?:\[\d+\][\w.\-]*)*)|(?P<sign>[()\[\]])""",
    re.VERBOSE,
)
Scalar = str | float
"""Word or number."""
DEFAULT_SIZE = (0.4, 0.4, 1.0)
"""Size of a model without one [m]: Stage's."""
BITMAP_THRESHOLD = 127
"""Grey value up to which a pixel is a solid: Stage's."""
BOUNDARY_THICKNESS = 0.05
"""Thickness of the walls of `boundary`, within the size [m] (chosen: Stage's have almost none)."""
ROBOT_KINDS = ("position",)
"""Types that are robots."""
SOLID_KINDS = ("model", "floorplan")
"""Types that are solids; `floorplan` is mostly defined by the file itself."""
QUIET_KINDS = ("window",)
"""Types that have nothing to do with an arena."""
RED: Rgba = (1.0, 0.0, 0.0, 1.0)
"""Colour of a model without one: Stage's."""
FLAT_BLOCK = re.compile(r"(?:block|polygon)\[(\d+)\]\.(points|point\[\d+\]|z|color)")
"""Name of a property that is one of a block."""
READ_OF_WORLD = ("unit_length", "unit_angle")
"""Properties of a world that are read."""
READ_OF_MODELS = (
    *("name", "pose", "origin", "size", "color", "color_rgba", "bitmap", "boundary", "stack_children"),
    *("obstacle_return", "ranger_return", "laser_return", "gripper_return", "blocks", "polygons"),
)
"""Properties of a solid that are read, besides those of blocks."""
LENGTH_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
ANGLE_UNITS = {"degrees": math.pi / 180, "radians": 1.0}
MAX_STAGE_FILES = 1000
"""Largest number of files, those of includes as often as they are included."""
MAX_STAGE_STARTS = 256
"""Largest number of robots."""


@dataclass(frozen=True, kw_only=True)
class StageToken:
    """A word, number, text or bracket of a file.

    Attributes:
        kind: One of string, number, word, sign.
        text: Its text, without quotes.
        place: File and line.
    """

    kind: str
    text: str
    place: str

    def error(self, text: str) -> ArenaFileError:
        """Return an error about it."""
        return ArenaFileError(f"{self.place}: {text}")


@dataclass(frozen=True, kw_only=True)
class StageProperty:
    """Values of a property.

    Attributes:
        name: Its name.
        values: Its values: one, or those of a tuple.
        place: File and line.
        folder: Folder of its file: other files are named from there.
    """

    name: str
    values: tuple[Scalar, ...]
    place: str
    folder: Path


@dataclass(kw_only=True)
class StageModel:
    """A model with what it inherits.

    Attributes:
        kind: Stage's own type that it is.
        word: Word that makes it in the file.
        properties: Its properties by name, the last one of a name.
        children: Models on it, and blocks.
        place: File and line.
    """

    kind: str
    word: str
    place: str
    properties: dict[str, StageProperty] = field(default_factory=dict[str, StageProperty])
    children: "list[StageModel]" = field(default_factory=list["StageModel"])

    def error(self, text: str) -> ArenaFileError:
        """Return an error about it."""
        return ArenaFileError(f"{self.place}: {text}")

    def text(self, name: str, default: str = "") -> str:
        """Return the text of a property."""
        found = self.properties.get(name)
        return default if found is None else str(found.values[0])

    def numbers(self, name: str, counts: tuple[int, ...]) -> tuple[float, ...] | None:
        """Return the numbers of a property; None: it has none.

        Args:
            name: The property.
            counts: Allowed numbers of them.

        Raises:
            ArenaFileError: It has others, or another number of them.
        """
        found = self.properties.get(name)
        if found is None:
            return None
        numbers = [value for value in found.values if isinstance(value, float) and math.isfinite(value)]
        if len(numbers) != len(found.values) or len(numbers) not in counts:
            shown = " ".join(map(str, found.values[:8]))
            wanted = " or ".join(map(str, counts))
            raise ArenaFileError(f"{found.place}: {name} is {shown!r}, expected {wanted} numbers")
        return tuple(numbers)

    def number(self, name: str, default: float) -> float:
        """Return the number of a property."""
        found = self.numbers(name, (1,))
        return default if found is None else found[0]


@dataclass(frozen=True, kw_only=True)
class _Definition:
    """A `define`: its word, the type or word that it extends, and its body."""

    parent: str
    body: "_Body"


@dataclass(kw_only=True)
class _Body:
    """The content of brackets as written: properties, and models by their words."""

    properties: list[StageProperty] = field(default_factory=list[StageProperty])
    models: "list[tuple[StageToken, _Body]]" = field(default_factory=list["tuple[StageToken, _Body]"])


def read_stage(path: Path) -> StageModel:
    """Return the models of a world file; the root has the world's own properties.

    Raises:
        ArenaFileError: An unreadable file; names it and the line.
    """
    parser = _Parser(path)
    body = parser.body(0)
    root = StageModel(kind="world", word="world", place=str(path))
    root.properties = {one.name: one for one in body.properties}
    root.children = [parser.model(token, own, 1) for token, own in body.models]
    return root


class _Parser:
    """Reader of a world file and its includes.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        self._files = 0
        # One more than is allowed is enough to tell.
        self._tokens = [*islice(self._read(path, ()), MAX_STAGE_TOKENS + 1)]
        if len(self._tokens) > MAX_STAGE_TOKENS:
            raise self._tokens[-1].error(f"more than {MAX_STAGE_TOKENS} words")
        self._next = 0
        self._definitions: dict[str, _Definition] = {}
        self._models = 0

    def _read(self, path: Path, above: tuple[Path, ...]) -> Iterator[StageToken]:
        """Yield the tokens of a file, with those of a file in the place of its `include`."""
        # Resolved: a link or another spelling of the path leads to the same file.
        if path.resolve() in above or len(above) > MAX_STAGE_DEPTH:
            raise ArenaFileError(f"{path} includes itself")
        # A few files, each of which includes the next one twice, stand for millions.
        self._files += 1
        if self._files > MAX_STAGE_FILES:
            raise ArenaFileError(f"{path}: more than {MAX_STAGE_FILES} files with all that is included")
        # Never fails: old files have names in any code page, and only quoted texts and comments have such
        # letters.
        text = read_bytes(path, refusal=ArenaFileError).decode("latin-1")
        include: StageToken | None = None
        for token in _tokens(path, text):
            if include is not None:
                if token.kind != "string":
                    raise include.error(f"include {token.text!r}: expected a file name in quotes")
                file = path.parent / token.text
                if not file.is_file():
                    raise include.error(f"includes {token.text!r}, which is not there")
                yield from self._read(file, (*above, path.resolve()))
                include = None
            elif token.kind == "word" and token.text == "include":
                include = token
            else:
                yield token
        if include is not None:
            raise include.error("include: expected a file name in quotes")

    def _take(self) -> StageToken | None:
        token = self._tokens[self._next] if self._next < len(self._tokens) else None
        self._next += 1
        return token

    def _word(self, after: StageToken, what: str) -> StageToken:
        token = self._take()
        if token is None or token.kind != "word":
            raise after.error(f"{after.text}: expected {what}")
        return token

    def body(self, depth: int) -> _Body:
        """Read properties and models up to the closing bracket, or up to the end at depth 0."""
        found = _Body()
        while (token := self._take()) is not None:
            # The kind too: a text in quotes may be a bracket.
            if token.text == ")" and token.kind == "sign" and depth:
                return found
            if token.kind != "word":
                raise token.error(f"{token.text!r} is neither a property nor a model")
            if token.text == "define" and not depth:
                name, parent = self._word(token, "a name"), self._word(token, "a type after the name")
                self._open(parent)
                self._definitions[name.text] = _Definition(parent=parent.text, body=self._inner(token, 1))
            elif self._peek() == "(":
                self._take()
                found.models.append((token, self._inner(token, depth + 1)))
            else:
                found.properties.append(self._property(token))
        if depth:
            raise self._tokens[-1].error("the file ends within brackets: `)` is missing")
        return found

    def _inner(self, owner: StageToken, depth: int) -> _Body:
        if depth > MAX_STAGE_DEPTH:
            raise owner.error(f"{owner.text} is nested {depth} deep; at most {MAX_STAGE_DEPTH}")
        return self.body(depth)

    def _peek(self) -> str:
        token = self._tokens[self._next] if self._next < len(self._tokens) else None
        return token.text if token is not None and token.kind == "sign" else ""

    def _open(self, after: StageToken) -> None:
        token = self._take()
        if token is None or token.text != "(" or token.kind != "sign":
            raise after.error(f"{after.text}: expected `(`")

    def _property(self, name: StageToken) -> StageProperty:
        first = self._take()
        if first is None or (first.text in ("(", ")", "]") and first.kind == "sign"):
            raise name.error(f"{name.text} has no value")
        values: list[Scalar] = []
        if first.kind == "sign":
            while (token := self._take()) is not None and token.text != "]":
                if token.kind == "sign":
                    raise token.error(f"{name.text}: {token.text!r} in brackets, expected words and numbers")
                values.append(_value(token))
            if token is None:
                raise name.error(f"{name.text}: `]` is missing")
        else:
            values.append(_value(first))
        if not values:
            raise name.error(f"{name.text} has no value")
        # Of the file that has the line, which may be an included one.
        folder = Path(name.place.rpartition(":")[0]).parent
        return StageProperty(name=name.text, values=tuple(values), place=name.place, folder=folder)

    def model(self, token: StageToken, body: _Body, depth: int) -> StageModel:
        """Return a model with what its definitions state, the outermost first."""
        self._models += 1
        if self._models > MAX_STAGE_MODELS:
            raise token.error(f"more than {MAX_STAGE_MODELS} models")
        bodies, word, seen = [body], token.text, set[str]()
        # `seen`: a definition may extend its own name, such as Stage's own type with other defaults.
        while word in self._definitions and word not in seen:
            seen.add(word)
            bodies.insert(0, self._definitions[word].body)
            word = self._definitions[word].parent
        if depth > MAX_STAGE_DEPTH:
            raise token.error(f"{token.text} is nested {depth} deep; at most {MAX_STAGE_DEPTH}")
        made = StageModel(kind=word, word=token.text, place=token.place)
        for one in bodies:
            # Outermost first: what is nearer to the model overrides.
            made.properties |= {known.name: known for known in one.properties}
        made.children = [self.model(child, own, depth + 1) for one in bodies for child, own in one.models]
        return made


def _tokens(path: Path, text: str) -> Iterator[StageToken]:
    line, at = 1, 0
    while at < len(text):
        found = TOKEN.match(text, at)
        if found is None:
            # Cut short: a binary file may be one line of megabytes.
            rest = text[at : at + 20].splitlines()[0]
            raise ArenaFileError(f"{path}:{line}: {rest!r} is no part of a world file")
        at = found.end()
        kind = found.lastgroup or ""
        # Ends of lines have a group apart from blanks: errors name the line.
        if kind == "line":
            line += 1
        elif kind != "space":
            yield StageToken(kind=kind, text=found[kind], place=f"{path}:{line}")


def _value(token: StageToken) -> Scalar:
    return float(token.text) if token.kind == "number" else token.text


@dataclass(frozen=True, kw_only=True)
class StagePose:
    """Pose of a model: x, y, height of its foot [m], and heading [rad]."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    heading: float = 0.0

    def then(self, offset: "StagePose") -> "StagePose":
        """Return a pose that is given relative to this one."""
        # Models turn about the vertical only, so heights and headings add.
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        return StagePose(
            x=self.x + cos * offset.x - sin * offset.y,
            y=self.y + sin * offset.x + cos * offset.y,
            z=self.z + offset.z,
            heading=self.heading + offset.heading,
        )


def stage_content(path: Path, surface: str = "") -> Content:
    """Return a world file of Stage as solids on the floor.

    Models are their bitmap, their blocks, or a box of their size; each is scaled to its size as in Stage: the
    dark pixels of a bitmap span it. Robots (`position`) become start poses. Other types, controllers and
    looks are left out.

    Args:
        path: The file; others that it names count from the file that names them.
        surface: Surface of the solids; empty: they are walls.

    Raises:
        ArenaFileError: An unreadable file, or content that an arena cannot have; names it and the line.
    """
    return _StageReader(path, read_stage(path), surface or "wall").content()


class _StageReader:
    """Models of a world file, sorted into solids and start poses.

    Args:
        path: The file.
        root: Its models.
        surface: Surface of the solids.
    """

    def __init__(self, path: Path, root: StageModel, surface: str) -> None:
        self._path, self._root, self._surface = path, root, surface
        self._length = _unit(root, "unit_length", LENGTH_UNITS, 1.0)
        # Stage's angles are in degrees unless a file says otherwise.
        self._angle = _unit(root, "unit_angle", ANGLE_UNITS, math.pi / 180)
        self._shapes: list[Shape] = []
        self._starts: list[StartPose] = []
        self._notes: list[str] = []
        self._left_out: dict[str, StageModel] = {}
        self._unread: dict[str, str] = {}

    def content(self) -> Content:
        """Return the file's content."""
        self._note_unread(self._root, READ_OF_WORLD)
        for model in self._root.children:
            self._add(model, StagePose())
        if not self._shapes and not self._starts:
            words = listed([child.word for child in self._root.children]) or "no models"
            raise ArenaFileError(f"{self._path}: places no solids and no robots; it has: {words}")
        if self._left_out:
            first = next(iter(self._left_out.values()))
            kinds = listed([*self._left_out], 12)
            self._notes.append(f"{first.place}: models of other types are left out: {kinds}")
        if self._unread:
            names = listed([*self._unread], 12)
            self._notes.append(f"{next(iter(self._unread.values()))}: properties are left out: {names}")
        return Content(
            shapes=tuple(self._shapes), starts=tuple(self._starts), floor=True, warnings=tuple(self._notes)
        )

    def _add(self, model: StageModel, parent: StagePose) -> None:
        """Add a model, and the models on it."""
        if model.kind in QUIET_KINDS:
            return
        pose = parent.then(self._pose(model, "pose"))
        if model.kind in ROBOT_KINDS:
            self._add_start(model, pose)
            return
        if model.kind not in SOLID_KINDS:
            # One note for a type, at its first model: a world may have hundreds of them.
            self._left_out.setdefault(model.kind, model)
            return
        self._note_unread(model, READ_OF_MODELS)
        size = self._size(model)
        like = self._looks(model)
        if like is not None:
            # The origin moves the geometry alone: models on it count from the pose without it.
            centre = pose.then(self._pose(model, "origin"))
            before = len(self._shapes)
            self._shapes += [_placed(shape, centre) for shape in self._solids(model, size, like)]
            if model.number("gripper_return", 0) > 0 and len(self._shapes) > before:
                self._notes.append(f"{model.place}: {model.word} can be gripped in Stage; it is fixed here")
        # Stage puts models on top of those that hold them by default.
        top = size[2] if model.number("stack_children", 1) else 0.0
        for child in model.children:
            # Blocks are solids of this model: `_solids` has them.
            if child.word != "block":
                self._add(child, pose.then(StagePose(z=top)))

    def _note_unread(self, model: StageModel, read: Collection[str]) -> None:
        """Keep the place of each property that nobody reads, for one note."""
        for name, found in model.properties.items():
            if name not in read and not FLAT_BLOCK.fullmatch(name):
                self._unread.setdefault(name, found.place)

    def _add_start(self, model: StageModel, pose: StagePose) -> None:
        if len(self._starts) >= MAX_STAGE_STARTS:
            raise model.error(f"more than {MAX_STAGE_STARTS} robots")
        taken = {start.tag for start in self._starts}
        name = plain_name(model.text("name")) or f"robot{len(taken)}"
        tag = unused_name(name, taken)
        # Stage's robots stand on their foot; a start pose is that of a chassis above the ground (manual
        # 5.3.5).
        at = (pose.x, pose.y, pose.z + START_ELEVATION)
        self._starts.append(StartPose(tag=tag, at=at, yaw=_turned(pose.heading)))
        self._notes.append(f"{model.place}: robot {model.word} {name!r} becomes the start pose {tag}")

    def _pose(self, model: StageModel, name: str) -> StagePose:
        """Return a pose: x, y, z, heading, or Stage 2's x, y, heading."""
        found = model.numbers(name, (3, 4))
        if found is None:
            return StagePose()
        # Three numbers are x, y, heading: the star then takes nothing.
        x, y, *z, heading = found
        length = self._length
        return StagePose(
            x=x * length, y=y * length, z=(z[0] if z else 0.0) * length, heading=heading * self._angle
        )

    def _size(self, model: StageModel) -> tuple[float, float, float]:
        found = model.numbers("size", (2, 3))
        if found is None:
            return DEFAULT_SIZE
        x, y, *z = (number * self._length for number in found)
        size = (x, y, z[0] if z else DEFAULT_SIZE[2])
        if min(size) <= 0:
            raise ArenaFileError(
                f"{model.properties['size'].place}: size {list(found)}: wants lengths above 0"
            )
        return size

    def _looks(self, model: StageModel) -> Shape | None:
        """Return surface and colour of a model; None: nothing meets it."""
        touched = model.number("obstacle_return", 1) > 0
        seen = any(model.number(f"{kind}_return", 1) > 0 for kind in ("ranger", "laser"))
        if not touched and not seen:
            self._notes.append(f"{model.place}: {model.word} is no obstacle and no ranger sees it: left out")
            return None
        if not seen:
            self._notes.append(f"{model.place}: no ranger sees {model.word} in Stage; rays meet it here")
        surface = self._surface if touched else "fixture"
        return Shape(kind="box", surface=surface, rgba=self._colour(model))

    def _colour(self, model: StageModel) -> Rgba:
        numbers = model.numbers("color_rgba", (4,))
        if numbers is not None:
            red, green, blue, alpha = np.clip(numbers, 0.0, 1.0).tolist()
            return (red, green, blue, alpha)
        name = model.properties.get("color")
        if name is None:
            return RED
        from PIL import ImageColor

        try:
            # Pillow returns four numbers for a name with an alpha value.
            red, green, blue = ImageColor.getrgb(_plain_colour(str(name.values[0])))[:3]
        except ValueError:
            self._notes.append(f"{name.place}: the colour {str(name.values[0])[:40]!r} is not known: red")
            return RED
        return (red / 255, green / 255, blue / 255, 1.0)

    def _solids(self, model: StageModel, size: tuple[float, float, float], like: Shape) -> Iterator[Shape]:
        """Yield the solids of a model in its own axes, its foot at height 0."""
        bitmap = model.properties.get("bitmap")
        blocks = [child for child in model.children if child.word == "block"] or _flat_blocks(model)
        # An empty name takes an inherited bitmap away.
        if bitmap is not None and bitmap.values[0]:
            yield from self._bitmap(bitmap, size, like)
        elif blocks:
            yield from self._blocks(blocks, size, like)
        elif not model.number("boundary", 0):
            yield _box(like, -size[0] / 2, size[0] / 2, -size[1] / 2, size[1] / 2, size[2])
        if model.number("boundary", 0):
            # A quarter of the size at most: opposite walls must not meet.
            x, y, thick = size[0] / 2, size[1] / 2, min(BOUNDARY_THICKNESS, *(s / 4 for s in size[:2]))
            yield _box(like, -x, -x + thick, -y, y, size[2])
            yield _box(like, x - thick, x, -y, y, size[2])
            yield _box(like, -x, x, -y, -y + thick, size[2])
            yield _box(like, -x, x, y - thick, y, size[2])

    def _bitmap(
        self, bitmap: StageProperty, size: tuple[float, float, float], like: Shape
    ) -> Iterator[Shape]:
        """Yield the dark pixels of a picture as boxes that span the size."""
        file = bitmap.folder / str(bitmap.values[0])
        if not file.is_file():
            raise ArenaFileError(f"{bitmap.place}: the bitmap {str(bitmap.values[0])!r} is not there")
        grey, _ = read_grey(file)
        dark = grey <= BITMAP_THRESHOLD
        if not dark.any():
            self._notes.append(f"{bitmap.place}: {file.name} has no dark pixels: nothing stands there")
            return
        # White margins do not count: Stage stretches the dark pixels alone to the size of the model.
        rows, columns = np.flatnonzero(dark.any(1)), np.flatnonzero(dark.any(0))
        r0, r1, c0, c1 = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
        high, wide = dark.shape
        if (r1 - r0, c1 - c0) != dark.shape:
            self._notes.append(
                f"{bitmap.place}: the dark pixels of {file.name}, {c1 - c0} x {r1 - r0} of {wide} x {high}, "
                "span the size of the model, as in Stage"
            )
        cells = cover(dark[r0:r1, c0:c1], MAX_MAP_BOXES)
        if len(cells) > MAX_MAP_BOXES:
            raise ArenaFileError(
                f"{bitmap.place}: {file.name} makes more than the {MAX_MAP_BOXES} boxes that are allowed"
            )
        frame = GridFrame(
            origin=(-size[0] / 2, -size[1] / 2, 0.0), cell=(size[0] / (c1 - c0), size[1] / (r1 - r0))
        )
        for one in cells:
            made = frame.box(one, 0.0, size[2], like.rgba)
            yield Shape(kind="box", size=made.size, at=made.at, surface=like.surface, rgba=like.rgba)

    def _blocks(
        self, blocks: list[StageModel], size: tuple[float, float, float], like: Shape
    ) -> Iterator[Shape]:
        """Yield blocks as prisms, which together span the size."""
        if not blocks:
            return
        rings = [self._corners(block) for block in blocks]
        heights = [block.numbers("z", (2,)) or (0.0, 1.0) for block in blocks]
        points = np.concatenate(rings)
        # Stage stretches the blocks' common box to the model's size, whatever their unit is.
        low, high = points.min(0), points.max(0)
        # Heights count from 0 whatever the lowest one is: blocks above it stay in the air.
        top = max(z[1] for z in heights)
        if top <= 0 or (high - low).min() <= 0:
            raise blocks[0].error("the blocks of a model have no area or no height")
        scale = np.array(size[:2]) / (high - low)
        for block, ring, (foot, head) in zip(blocks, rings, heights, strict=True):
            if foot >= head:
                raise block.error(f"z is [{foot:g} {head:g}], expected the lower height first")
            try:
                # MuJoCo's contacts need convex solids, and the outline of a block may be concave.
                parts = convex_parts((ring - (low + high) / 2) * scale)
            except ValueError as error:
                raise block.error(f"the block is {error}") from error
            colour = self._colour(block) if block.properties.keys() & {"color", "color_rgba"} else like.rgba
            own = Shape(kind="box", surface=like.surface, rgba=colour)
            for part in parts:
                yield prism(part, foot * size[2] / top, head * size[2] / top, own)

    def _corners(self, block: StageModel) -> np.ndarray:
        """Return the corners of a block (n, 2)."""
        count = block.number("points", 0)
        # Bounded before the loop: the count is whatever the file says, and need not match its points.
        if count != int(count) or not 3 <= count <= 10_000:
            raise block.error(f"points is {count:g}, expected a whole number from 3 on")
        found = [block.numbers(f"point[{i}]", (2,)) for i in range(int(count))]
        if any(point is None for point in found):
            raise block.error(f"has no point[{found.index(None)}]; points is {count:g}")
        return np.array(found, float)


def _flat_blocks(model: StageModel) -> list[StageModel]:
    """Return blocks in Stage 2's and 3.0's form: properties of the model as block[0].points."""
    blocks: dict[str, StageModel] = {}
    for name, found in model.properties.items():
        split = FLAT_BLOCK.fullmatch(name)
        if split is not None:
            block = blocks.setdefault(split[1], StageModel(kind="block", word="block", place=found.place))
            block.properties[split[2]] = found
    return list(blocks.values())


def _plain_colour(name: str) -> str:
    """Return a colour of X11 as Pillow spells it: gray30 is a share of white there."""
    plain = name.lower().replace(" ", "").replace("_", "")
    share = plain.removeprefix("gray").removeprefix("grey")
    return f"rgb({share}%,{share}%,{share}%)" if share.isdecimal() and len(share) <= 3 else plain


def _unit(root: StageModel, name: str, units: dict[str, float], default: float) -> float:
    found = root.properties.get(name)
    if found is None:
        return default
    if found.values[0] not in units:
        raise ArenaFileError(f"{found.place}: {name} is {found.values[0]!r}, expected {', '.join(units)}")
    return units[str(found.values[0])]


def _box(like: Shape, x0: float, x1: float, y0: float, y1: float, height: float) -> Shape:
    return Shape(
        kind="box",
        size=((x1 - x0) / 2, (y1 - y0) / 2, height / 2),
        at=((x0 + x1) / 2, (y0 + y1) / 2, height / 2),
        surface=like.surface,
        rgba=like.rgba,
    )


def _placed(shape: Shape, pose: StagePose) -> Shape:
    x, y, z = shape.at
    # Rounded to a nanometre below: turns leave digits behind that mean nothing.
    there = pose.then(StagePose(x=x, y=y, z=z))
    return Shape(
        kind=shape.kind,
        size=shape.size,
        at=(round(there.x, 9), round(there.y, 9), round(there.z, 9)),
        rotation=(0.0, 0.0, _turned(pose.heading)),
        surface=shape.surface,
        rgba=shape.rgba,
        mesh=shape.mesh,
    )


def _turned(heading: float) -> float:
    """Return an angle between -pi and pi [rad]."""
    # The rest nearest to zero: no other remainder of Python's is between -pi and pi.
    return math.remainder(heading, 2 * math.pi)
