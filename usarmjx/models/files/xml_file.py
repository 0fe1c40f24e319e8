"""XML files whose elements know their file and line; the size of MJCF and URDF models before any is built."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.settings.files import read_bytes
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.files.images import MAX_HEIGHTS
from usarmjx.models.files.mjcf_solids import Pose

MAX_ELEMENTS = 50_000
"""Largest number of elements in an XML file, and in a model including its repetitions and includes."""
MAX_DEPTH = 200
"""Largest depth of elements."""
NO_POSE = Pose(np.zeros(3), np.eye(3))
"""Frame of an element without a pose."""
MAX_TEXELS = 64_000_000
"""Largest number of pixels of a model's textures."""
MAX_FILES = 100
"""Largest number of files of a model, apart from meshes and pictures."""
MAX_MEMORY = 1e9
"""Largest memory of a model's simulation [bytes]."""
SUFFIXES = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}
"""Suffixes of memory sizes."""
BOUNDS: dict[tuple[str, str], float] = {
    ("size", "memory"): MAX_MEMORY,
    ("size", "nstack"): MAX_MEMORY / 8,
    ("size", "njmax"): 1e6,
    ("size", "nconmax"): 1e6,
    ("size", "nuserdata"): 1e6,
    ("size", "nkey"): 1e4,
    ("numeric", "size"): 1e6,
    ("mesh", "params"): 1e3,
}
"""Largest number in an attribute, by element and attribute."""
BOUNDS_ANYWHERE = {"nsample": 1e4, **{f"nuser_{kind}": 1e3 for kind in (
    "body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")}}  # fmt: skip
"""Largest number in an attribute of any element."""
CUBE_SIDES = {"cube": 6, "skybox": 6, "2d": 1}
"""Number of faces of a texture type."""


class XmlSyntaxError(ArenaFileError):
    """A file that is no XML."""


class LinedElement(Element):
    """An XML element with the place where it begins.

    Attributes:
        path: Its file.
        line: Its line.
    """

    path = Path()
    line = 0

    @property
    def place(self) -> str:
        """File and line, for messages."""
        return f"{self.path}:{self.line}"

    def error(self, text: str) -> ArenaFileError:
        """Return an error about the element."""
        return ArenaFileError(f"{self.place}: {text}")

    def children(self) -> "list[LinedElement]":
        """Return all children."""
        return [child for child in self if isinstance(child, LinedElement)]

    def all(self, tag: str) -> "list[LinedElement]":
        """Return the children with a tag."""
        return [child for child in self.children() if child.tag == tag]

    def first(self, path: str) -> "LinedElement | None":
        """Return the first element at a path of tags below it, None: none."""
        found = self.find(path)
        return found if isinstance(found, LinedElement) else None

    def word(self, path: str, default: str = "") -> str:
        """Return the text of the element at a path of tags, without white space around it."""
        found = self.find(path)
        return default if found is None else (found.text or "").strip() or default

    def number(self, path: str, default: float) -> float:
        """Return the number in the element at a path of tags.

        Raises:
            ArenaFileError: It is no finite number.
        """
        found = self.first(path)
        return default if found is None else float(numbers_of(found, found.text, 1)[0])


def read_lined_xml(path: Path, text: str | bytes | None = None) -> LinedElement:
    """Return the root of an XML file; prefixes of tags need no declaration.

    Args:
        path: The file.
        text: Text to read instead of the file's content.

    Raises:
        XmlSyntaxError: It is no XML.
        ArenaFileError: A file that is missing, is too large or too deeply nested, or defines a document type.
    """
    # Not ElementTree's parser: it knows no lines, and demands that prefixes of names are declared.
    parser = expat.ParserCreate()
    builder = TreeBuilder(element_factory=LinedElement)
    depth = count = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MAX_DEPTH:
            raise ArenaFileError(f"{path}: <{tag}> is nested {depth} deep; at most {MAX_DEPTH}")
        if count > MAX_ELEMENTS:
            raise ArenaFileError(f"{path}: more than {MAX_ELEMENTS} elements, <{tag}> is the next one")
        element = builder.start(tag, attributes)
        assert isinstance(element, LinedElement)
        element.path, element.line = path, parser.CurrentLineNumber

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def doctype(name: str, *_: object) -> None:
        # Its entities can expand exponentially.
        raise ArenaFileError(f"{path}: defines a document type (<!DOCTYPE {name}>); models have none")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = builder.data, doctype
    try:
        parser.Parse(
            _declared_first(read_bytes(path, refusal=ArenaFileError) if text is None else text), True
        )
    except expat.ExpatError as error:
        raise XmlSyntaxError(f"{path}:{error.lineno}: is no XML: {expat.ErrorString(error.code)}") from error
    except (LookupError, ValueError) as error:  # an encoding that Python does not have
        raise XmlSyntaxError(f"{path}: is no XML: {error}") from error
    root = builder.close()
    assert isinstance(root, LinedElement)
    return root


def root_tag(data: bytes) -> str:
    """Return the tag of the first element in the bytes of an XML file; empty: there is none.

    Words inside the file are no sign of its kind: a world of Gazebo has `<robotNamespace>`.
    """
    at = 0
    while (at := data.find(b"<", at)) >= 0:
        skipped = next((pair for pair in NO_ELEMENTS if data.startswith(pair[0], at)), None)
        if skipped is None:
            found = TAG.match(data, at + 1)
            return found[0].decode() if found else ""
        at = data.find(skipped[1], at + len(skipped[0]))
        if at < 0:
            break
    return ""


NO_ELEMENTS = ((b"<!--", b"-->"), (b"<?", b"?>"), (b"<!", b">"))
"""Begin and end of what may come before the first element."""
TAG = re.compile(rb"[A-Za-z_][\w.:-]*")


def _declared_first(text: str | bytes) -> str | bytes:
    """Return a text whose XML declaration, if white space is before it, is white space of as many lines."""
    # XML forbids white space before its declaration; some files have it.
    if isinstance(text, str) or not text[:1].isspace() or not text.lstrip().startswith(b"<?xml"):
        return text
    head, end, rest = text.partition(b"?>")
    return b"\n" * head.count(b"\n") + rest if end else text


def numbers_of(element: LinedElement, text: str | None, count: int, key: str = "") -> np.ndarray:
    """Return the numbers of an element's text or attribute (count,).

    Args:
        element: The element.
        text: The text.
        count: Number of numbers.
        key: The attribute; empty: the text is the element's own.

    Raises:
        ArenaFileError: It has others, or another number of them.
    """
    try:
        numbers = [float(word) for word in (text or "").split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise element.error(f"<{f'{element.tag} {key}'.strip()}> has {text!r}, expected {_many(count)}")
    return np.array(numbers)


def _many(count: int) -> str:
    return "a number" if count == 1 else f"{count} numbers"


def attribute_numbers(element: LinedElement, key: str, count: int, default: str | None = None) -> np.ndarray:
    """Return the numbers of an attribute (count,).

    Raises:
        ArenaFileError: It is missing without a default, or has others.
    """
    text = element.get(key, default)
    if text is None:
        raise element.error(f"<{element.tag}> has no {key}, expected {_many(count)}")
    return numbers_of(element, text, count, key)


def pose_of(numbers: np.ndarray) -> Pose:
    """Return the frame of x, y, z, roll, pitch, yaw (6,)."""
    roll, pitch, yaw = numbers[3:].tolist()
    return Pose(numbers[:3], np.asarray(mat_from_angles(roll, pitch, yaw)))


def check_model_size(path: Path) -> None:
    """Refuse an MJCF or URDF file that exceeds the limits of a model.

    Elements count as often as they are repeated (`replicate`, `composite`, `flexcomp`), included and
    attached. Files that are no XML are left to MuJoCo, which names the error.

    Raises:
        ArenaFileError: Names the element, the number found, and the bound.
    """
    _Tally(path).add_file(path, 1.0, ())


class _Tally:
    """Running totals of a model.

    Args:
        path: The file, for messages and for relative names.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[Path, LinedElement | None] = {}
        self._elements = self._heights = self._texels = 0.0

    def add_file(self, path: Path, times: float, within: tuple[Path, ...]) -> None:
        """Add a file as often as it is included.

        Args:
            path: The file.
            times: Number of repetitions.
            within: Files that include it.
        """
        path = path.resolve()
        if path in within:
            raise self._error(f"{path.name} includes itself")
        root = self._root(path)
        if root is not None:
            # `attach` names a model asset, which names its file.
            models = {one.get("name"): one.get("file", "") for one in root.iter("model")}
            self._add(root, times, (*within, path), len(within), models)

    def _root(self, path: Path) -> LinedElement | None:
        # Files are read once, however often they are included; None: it is no XML.
        if path not in self._known:
            if len(self._known) == MAX_FILES:
                raise self._error(f"is made of more than {MAX_FILES} files")
            try:
                text = _without_comments(read_bytes(path, refusal=ArenaFileError).decode("utf-8", "replace"))
                self._known[path] = read_lined_xml(path, text)
            except XmlSyntaxError:
                self._known[path] = None
        return self._known[path]

    def _add(
        self,
        element: LinedElement,
        times: float,
        within: tuple[Path, ...],
        depth: int,
        models: dict[str | None, str],
    ) -> None:
        """Add an element and its content."""
        if depth > MAX_DEPTH:
            raise self._error(f"<{element.tag}> is nested {depth} deep; at most {MAX_DEPTH}")
        self._check_bounds(element)
        self._add_amounts(element, times)
        if element.tag == "include":
            self._add_other(element.get("file", ""), times, within)
        if element.tag == "attach":
            self._add_other(models.get(element.get("model"), ""), times, within)
        if element.tag == "replicate":
            # For what is below only: the element itself is there once.
            times *= _product(element, "count")
        for child in element.children():
            self._add(child, times, within, depth + 1, models)

    def _add_amounts(self, element: LinedElement, times: float) -> None:
        """Add the amounts of an element itself."""
        made = times * (
            _product(element, "count") * _product(element, "cellcount")
            if element.tag in ("composite", "flexcomp")
            else 1.0
        )
        self._elements = self._within(self._elements + made, MAX_ELEMENTS, element, "elements")
        if element.tag == "hfield":
            made = _product(element, "nrow") * _product(element, "ncol")
            self._heights = self._within(self._heights + made, MAX_HEIGHTS, element, "heights")
        if element.tag == "texture" and "builtin" in element.attrib:
            made = _product(element, "width") * _product(element, "height")
            # A texture of MJCF without a type is a cube.
            made *= CUBE_SIDES.get(element.get("type", "cube"), 1)
            self._texels = self._within(self._texels + made, MAX_TEXELS, element, "pixels")

    def _add_other(self, name: str, times: float, within: tuple[Path, ...]) -> None:
        """Add another file; names are relative to the model's folder, or to that of the including file."""
        for folder in (self._path.parent, within[-1].parent):
            if name and (folder / name).is_file():
                self.add_file(folder / name, times, within)
                return

    def _within(self, found: float, most: float, element: LinedElement, what: str) -> float:
        # In this form: NaN, of which sums stay NaN, is refused as well.
        if not found <= most:
            name = element.get("name") or element.get("prefix")
            called = f"<{element.tag}>" if name is None else f"<{element.tag}> {name!r}"
            raise self._error(f"{called} brings its {what} to {found:.15g}; at most {most:.15g}")
        return found

    def _check_bounds(self, element: LinedElement) -> None:
        for key, text in element.attrib.items():
            most = BOUNDS.get((element.tag, key), BOUNDS_ANYWHERE.get(key))
            if most is not None and not max(_numbers(text), default=0.0) <= most:
                raise self._error(f'<{element.tag} {key}="{text[:40]}"> is too much; at most {most:.15g}')

    def _error(self, text: str) -> ArenaFileError:
        return ArenaFileError(f"{self._path}: {text}")


def _without_comments(text: str) -> str:
    """Return XML without its comments: many files have more dashes in them than XML allows."""
    parts: list[str] = []
    at = 0
    while (start := text.find("<!--", at)) >= 0:
        end = text.find("-->", start + 4)
        if end < 0:
            break
        parts.append(text[at:start])
        at = end + 3
    return "".join([*parts, text[at:]])


def _product(element: LinedElement, key: str) -> float:
    """Return the product of an attribute's numbers, each at least 1; 1 if it has none."""
    # At least 1 each: zeros and negative numbers must not hide the others.
    return math.prod(max(number, 1.0) for number in _numbers(element.get(key, "")))


def _numbers(text: str) -> Sequence[float]:
    """Return a text's numbers; those of memory may end in a letter; none if it has other words."""
    found: list[float] = []
    # Attributes with limits have few numbers: long texts are not read through.
    for word in text.split()[:16]:
        scale = SUFFIXES.get(word[-1].upper(), 1)
        try:
            found.append(float(word if scale == 1 else word[:-1]) * scale)
        except ValueError:
            return ()
    return found


def drop_sizes(spec: Any) -> None:  # noqa: ANN401 - mujoco.MjSpec, whose stubs lack these fields
    """Drop the room that a description asks for: it is for contacts of the file's own program."""
    spec.memory = spec.njmax = spec.nconmax = -1
