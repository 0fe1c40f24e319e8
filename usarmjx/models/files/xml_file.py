"""XML files as trees, without what makes much of little: no document types, and so no entities."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from usarmjx.base.errors import ArenaFileError
from usarmjx.models.files.values import read_bytes

MOST_ELEMENTS = 50_000
"""In an XML file, and in a model with all that it repeats and includes."""
MOST_NESTED = 200
"""Elements within each other."""


def read_xml(path: Path, text: str | None = None) -> ElementTree.Element:
    """Return the root of an XML file.

    Args:
        path: The file.
        text: What to read in place of what it holds.

    Raises:
        ArenaFileError: A file that is not there, is too large, or is nested too deeply, or defines a document
            type; names what was found and what is allowed.
        ElementTree.ParseError: It is no XML.
    """
    parser = ElementTree.XMLParser(target=_BoundedTree(path))
    parser.feed(read_bytes(path) if text is None else text)
    return parser.close()


class _BoundedTree(ElementTree.TreeBuilder):
    """Builds a tree while that is small enough.

    Args:
        path: The file, for messages.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path, self._depth, self._count = path, 0, 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuse a document type, as what comes with it can make much of little."""
        raise ArenaFileError(f"{self._path}: defines a document type (<!DOCTYPE {name}>); models have none")

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        """Begin an element."""
        self._depth, self._count = self._depth + 1, self._count + 1
        if self._depth > MOST_NESTED:
            raise ArenaFileError(f"{self._path}: <{tag}> is nested {self._depth} deep; at most {MOST_NESTED}")
        if self._count > MOST_ELEMENTS:
            raise ArenaFileError(f"{self._path}: more than {MOST_ELEMENTS} elements, <{tag}> is the next one")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        """End an element."""
        self._depth -= 1
        return super().end(tag)
