"""XML files whose elements know their file and line, for what readers say about them."""

import math
import re
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.settings.files import read_bytes
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.files.mjcf_solids import Pose

MAX_ELEMENTS = 50_000
"""Largest number of elements in an XML file, and in a model including its repetitions and includes."""
MAX_DEPTH = 200
"""Largest depth of elements."""
NO_POSE = Pose(np.zeros(3), np.eye(3))
"""Frame of an element without a pose."""


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
