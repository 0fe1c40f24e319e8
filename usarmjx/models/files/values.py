"""YAML text as values with their positions, so that errors can name file and line."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import yaml

from usarmjx.base.errors import ArenaFileError

MAX_YAML_BYTES = 16_000_000
"""Largest size of a YAML file [bytes]."""
MAX_VALUES = 500_000
"""Largest number of values in a YAML file, repetitions by aliases included."""
MAX_DIGITS = 100
"""Largest length of a number [characters]; YAML's base 60 takes quadratic time."""
MAX_KEY_LENGTH = 100
"""Largest length of a key [characters]."""
MERGE = "tag:yaml.org,2002:merge"
"""YAML's tag of a merge key (<<)."""
MAX_COORDINATE = 1e7
"""Largest distance from an arena's origin, and largest length [m]."""
MAX_QUOTED = 100
"""Largest length of a quoted value, and of its name, in errors [characters]."""

Plain = dict[str, "YamlValue"] | list["YamlValue"] | str | int | float | bool | None
"""Content of a value."""


@dataclass(frozen=True, eq=False)
class YamlValue:
    """A value of a YAML file.

    Attributes:
        data: The value; items and entries are values in turn.
        path: The file.
        line: Line of its beginning, from 1.
        name: Path within the file, as shapes[3].size; empty: the whole file.
    """

    data: Plain
    path: Path
    line: int
    name: str = ""

    def error(self, text: str) -> ArenaFileError:
        """Return an error at this position."""
        name = f"{self.name}: " if self.name else ""
        return ArenaFileError(f"{self.path}:{self.line}: {name}{text}")

    def mapping(self) -> dict[str, "YamlValue"]:
        """Return the keys and their values.

        Raises:
            ArenaFileError: It is no mapping.
        """
        if isinstance(self.data, dict):
            return self.data
        raise self.error(f"{self.shown} is not a mapping of keys to values")

    def items(self) -> list["YamlValue"]:
        """Return the items of a list.

        Raises:
            ArenaFileError: It is no list.
        """
        if isinstance(self.data, list):
            return self.data
        raise self.error(f"{self.shown} is not a list")

    @property
    def shown(self) -> str:
        """The value as quoted in errors."""
        if isinstance(self.data, dict):
            return "a mapping"
        if isinstance(self.data, list):
            return f"a list of {len(self.data)}"
        if isinstance(self.data, str) and len(self.data) > MAX_QUOTED:
            return repr(self.data[:MAX_QUOTED] + "...")
        return repr(self.data) if self.data is not None else "nothing"


def read_bytes(path: Path, most: int = MAX_YAML_BYTES) -> bytes:
    """Return the content of a file.

    Raises:
        ArenaFileError: It is missing, cannot be read, or has more bytes than `most`.
    """
    try:
        size = path.stat().st_size
        if size > most:
            raise ArenaFileError(f"{path}: {size} bytes are too many; at most {most}")
        if not path.is_file():
            raise ArenaFileError(f"{path}: cannot be read: it is no plain file")
        with path.open("rb") as file:
            return file.read(most)
    except OSError as error:
        raise ArenaFileError(f"{path}: cannot be read: {error.strerror or error}") from error


def read_yaml(path: Path) -> YamlValue:
    """Return the content of a YAML file.

    Raises:
        ArenaFileError: A file that is unreadable, is no YAML, or repeats a key; names the line.
    """
    text = read_bytes(path)
    try:
        loader = _BoundedLoader(text.decode("utf-8"), path)
        node = loader.get_single_node()
        if node is None:
            raise ArenaFileError(f"{path}: is empty; an arena is a mapping, as `name: mine`")
        return _YamlReader(path, loader).value(node, "")
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark else ""
        raise ArenaFileError(f"{path}{line}: is no YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ArenaFileError(f"{path}: is no YAML: {_first_line(error)}") from error
    except RecursionError as error:
        raise ArenaFileError(f"{path}: is nested too deeply") from error


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0]


class _BoundedLoader(yaml.SafeLoader):
    """A loader that refuses a file with too many values while it parses.

    Args:
        text: The file's text.
        path: The file, for messages.
    """

    def __init__(self, text: str, path: Path) -> None:
        super().__init__(text)
        self._path, self._count = path, 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:  # noqa: ANN401 - PyYAML's
        """Return the next value; called for each."""
        self._count += 1
        if self._count > 2 * MAX_VALUES:  # keys are among them
            raise ArenaFileError(f"{self._path}: more than {MAX_VALUES} values in one file")
        return super().compose_node(parent, index)


class _YamlReader:
    """Converter of a document's nodes to values; it counts them, as aliases can make many of few."""

    def __init__(self, path: Path, loader: yaml.SafeLoader) -> None:
        self._path, self._loader, self._count = path, loader, 0
        self._open: set[int] = set()
        self._flat: dict[int, dict[str, yaml.Node]] = {}

    def value(self, node: yaml.Node, name: str) -> YamlValue:
        line = self._counted(node)
        if id(node) in self._open:
            raise ArenaFileError(f"{self._path}:{line}: {name} contains itself")
        self._open.add(id(node))
        data = self._data(node, name)
        self._open.discard(id(node))
        return YamlValue(data, self._path, line, name)

    def _counted(self, node: yaml.Node, more: int = 1) -> int:
        """Count one value or more; return its line."""
        self._count += more
        line = node.start_mark.line + 1
        if self._count > MAX_VALUES:
            raise ArenaFileError(f"{self._path}:{line}: more than {MAX_VALUES} values in one file")
        return line

    def _data(self, node: yaml.Node, name: str) -> Plain:
        if isinstance(node, yaml.MappingNode):
            pairs = self._pairs(node).items()
            return {key: self.value(child, _joined(name, f".{key}").lstrip(".")) for key, child in pairs}
        if isinstance(node, yaml.SequenceNode):
            return [self.value(child, _joined(name, f"[{i}]")) for i, child in enumerate(node.value)]
        where = f"{self._path}:{node.start_mark.line + 1}: {name}"
        if len(node.value) > MAX_DIGITS and node.tag.endswith((":int", ":float")):
            raise ArenaFileError(f"{where}: a number of {len(node.value)} characters; at most {MAX_DIGITS}")
        try:
            data: object = cast("Any", self._loader).construct_object(node)
        except yaml.YAMLError:
            raise
        except Exception as error:  # PyYAML raises whatever a wrong date, number or tag makes it run into
            raise ArenaFileError(
                f"{where}: {node.value[:MAX_QUOTED]!r} is no {node.tag[-MAX_QUOTED:]}: {error}"
            ) from error
        return data if isinstance(data, (str, int, float)) or data is None else str(node.value)

    def _pairs(self, node: yaml.MappingNode) -> dict[str, yaml.Node]:
        """Return keys and values, after those of a merge (<<), which they replace."""
        if id(node) in self._flat:  # a repetition by an alias
            return self._flat[id(node)]
        self._check_keys(node)
        self._flat[id(node)] = {}  # ends the recursion of a mapping that merges itself
        merged: dict[str, yaml.Node] = {}
        for key, child in node.value:
            if key.tag == MERGE:
                for other in reversed(self._merged(child)):  # the first one has priority
                    pairs = self._pairs(other)
                    self._counted(other, len(pairs))
                    merged |= pairs
        self._flat[id(node)] = merged | {key.value: child for key, child in node.value if key.tag != MERGE}
        return self._flat[id(node)]

    def _merged(self, node: yaml.Node) -> list[yaml.MappingNode]:
        """Return the mappings of a merge: one, or a list of them."""
        named: list[yaml.Node] = node.value if isinstance(node, yaml.SequenceNode) else [node]
        found = [one for one in named if isinstance(one, yaml.MappingNode)]
        if len(found) < len(named):
            line = f"{self._path}:{node.start_mark.line + 1}"
            raise ArenaFileError(f"{line}: is no YAML: expected a mapping or a list of them to merge (<<)")
        return found

    def _check_keys(self, node: yaml.MappingNode) -> None:
        seen: set[str] = set()
        for key, _ in node.value:
            line = f"{self._path}:{key.start_mark.line + 1}"
            if not isinstance(key, yaml.ScalarNode):
                raise ArenaFileError(f"{line}: a key is a word, not a list or mapping")
            if len(key.value) > MAX_KEY_LENGTH:
                raise ArenaFileError(
                    f"{line}: a key of {len(key.value)} characters; at most {MAX_KEY_LENGTH}"
                )
            if key.value in seen:
                raise ArenaFileError(f"{line}: key {key.value!r} is there twice")
            seen.add(key.value)


def _joined(name: str, more: str) -> str:
    """Return the path of a value, cut short: every value keeps its own."""
    whole = name + more
    return whole if len(whole) <= MAX_QUOTED else "..." + whole[3 - MAX_QUOTED :]
