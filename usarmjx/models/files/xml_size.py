"""How much an MJCF or URDF file makes, counted on its XML before anything is built."""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

from usarmjx.base.errors import ArenaFileError
from usarmjx.models.files.maps import MOST_HEIGHTS
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


MOST_TEXELS = 64_000_000
"""Pixels of a model's textures."""
MOST_FILES = 100
"""Files that a model is made of, meshes and pictures left out."""
MOST_MEMORY = 1e9
"""What a model may reserve for its simulation [bytes]."""
SUFFIXES = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}
"""Of memory."""
BOUNDS: dict[tuple[str, str], float] = {
    ("size", "memory"): MOST_MEMORY,
    ("size", "nstack"): MOST_MEMORY / 8,
    ("size", "njmax"): 1e6,
    ("size", "nconmax"): 1e6,
    ("size", "nuserdata"): 1e6,
    ("size", "nkey"): 1e4,
    ("numeric", "size"): 1e6,
    ("mesh", "params"): 1e3,
}
"""Attributes by their elements, and the largest number that each may have."""
BOUNDS_ANYWHERE = {"nsample": 1e4, **{f"nuser_{kind}": 1e3 for kind in (
    "body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")}}  # fmt: skip
"""The same for attributes of whatever element."""
CUBE_SIDES = {"cube": 6, "skybox": 6, "2d": 1}


def check_model_size(path: Path) -> None:
    """Refuse a file of MJCF or URDF that makes more than a model may have.

    Elements count as often as they are repeated (`replicate`, `composite`, `flexcomp`), included and
    attached. What does not parse is left to MuJoCo, which names it.

    Raises:
        ArenaFileError: Names the element, the number found, and the bound.
    """
    _Tally(path).add_file(path, 1.0, ())


class _Tally:
    """What has been counted so far.

    Args:
        path: The file, for messages and for names of others.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[Path, ElementTree.Element | None] = {}
        self._elements = self._heights = self._texels = 0.0

    def add_file(self, path: Path, times: float, within: tuple[Path, ...]) -> None:
        """Add a file as often as it is there.

        Args:
            path: The file.
            times: How often.
            within: Files that it is included by.
        """
        path = path.resolve()
        if path in within:
            raise self._error(f"{path.name} includes itself")
        root = self._root(path)
        if root is not None:
            models = {one.get("name"): one.get("file", "") for one in root.iter("model")}
            self._add(root, times, (*within, path), len(within), models)

    def _root(self, path: Path) -> ElementTree.Element | None:
        if path not in self._known:
            if len(self._known) == MOST_FILES:
                raise self._error(f"is made of more than {MOST_FILES} files")
            try:
                text = _without_comments(read_bytes(path).decode("utf-8", "replace"))
                self._known[path] = read_xml(path, text)
            except ElementTree.ParseError:
                self._known[path] = None
        return self._known[path]

    def _add(
        self,
        element: ElementTree.Element,
        times: float,
        within: tuple[Path, ...],
        depth: int,
        models: dict[str | None, str],
    ) -> None:
        """Add an element and what is in it."""
        if depth > MOST_NESTED:
            raise self._error(f"<{element.tag}> is nested {depth} deep; at most {MOST_NESTED}")
        self._check_bounds(element)
        self._add_amounts(element, times)
        if element.tag == "include":
            self._add_other(element.get("file", ""), times, within)
        if element.tag == "attach":
            self._add_other(models.get(element.get("model"), ""), times, within)
        if element.tag == "replicate":
            times *= _product(element, "count")
        for child in element:
            self._add(child, times, within, depth + 1, models)

    def _add_amounts(self, element: ElementTree.Element, times: float) -> None:
        """Add what an element makes by itself."""
        made = times * (
            _product(element, "count") * _product(element, "cellcount")
            if element.tag in ("composite", "flexcomp")
            else 1.0
        )
        self._elements = self._within(self._elements + made, MOST_ELEMENTS, element, "elements")
        if element.tag == "hfield":
            made = _product(element, "nrow") * _product(element, "ncol")
            self._heights = self._within(self._heights + made, MOST_HEIGHTS, element, "heights")
        if element.tag == "texture" and "builtin" in element.attrib:
            made = _product(element, "width") * _product(element, "height")
            made *= CUBE_SIDES.get(element.get("type", "cube"), 1)
            self._texels = self._within(self._texels + made, MOST_TEXELS, element, "pixels")

    def _add_other(self, name: str, times: float, within: tuple[Path, ...]) -> None:
        """Add another file; names count from the model's folder, or that of the file that names it."""
        for folder in (self._path.parent, within[-1].parent):
            if name and (folder / name).is_file():
                self.add_file(folder / name, times, within)
                return

    def _within(self, found: float, most: float, element: ElementTree.Element, what: str) -> float:
        if not found <= most:
            name = element.get("name") or element.get("prefix")
            called = f"<{element.tag}>" if name is None else f"<{element.tag}> {name!r}"
            raise self._error(f"{called} brings its {what} to {found:.15g}; at most {most:.15g}")
        return found

    def _check_bounds(self, element: ElementTree.Element) -> None:
        for key, text in element.attrib.items():
            most = BOUNDS.get((element.tag, key), BOUNDS_ANYWHERE.get(key))
            if most is not None and not max(_numbers(text), default=0.0) <= most:
                raise self._error(f'<{element.tag} {key}="{text[:40]}"> is too much; at most {most:.15g}')

    def _error(self, text: str) -> ArenaFileError:
        return ArenaFileError(f"{self._path}: {text}")


def _without_comments(text: str) -> str:
    """Return XML without its comments, in which many a file has more dashes than XML allows."""
    parts: list[str] = []
    at = 0
    while (start := text.find("<!--", at)) >= 0:
        end = text.find("-->", start + 4)
        if end < 0:
            break
        parts.append(text[at:start])
        at = end + 3
    return "".join([*parts, text[at:]])


def _product(element: ElementTree.Element, key: str) -> float:
    """Return the product of an attribute's numbers, each at least 1; 1 if it has none."""
    return math.prod(max(number, 1.0) for number in _numbers(element.get(key, "")))


def _numbers(text: str) -> Sequence[float]:
    """Return a text's numbers; those of memory may end in a letter; none if it has other words."""
    found: list[float] = []
    for word in text.split()[:16]:
        scale = SUFFIXES.get(word[-1].upper(), 1)
        try:
            found.append(float(word if scale == 1 else word[:-1]) * scale)
        except ValueError:
            return ()
    return found
