"""YAML text to values that know where they stand, so that a mistake can be named by file and line."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml

from usarmjx.base.errors import ArenaFileError

MOST_BYTES = 16_000_000
"""Of a YAML file."""
MOST_VALUES = 500_000
"""In a YAML file, repeated ones counted each time."""

Plain = dict[str, "YamlValue"] | list["YamlValue"] | str | int | float | bool | None


@dataclass(frozen=True, eq=False)
class YamlValue:
    """A value of a YAML file.

    Attributes:
        data: The value; what it holds are values in turn.
        path: The file.
        line: Where it begins, from 1.
        name: What leads to it, as shapes[3].size; empty: the whole file.
    """

    data: Plain
    path: Path
    line: int
    name: str = ""

    def error(self, text: str) -> ArenaFileError:
        """Return an error at this place."""
        name = f"{self.name}: " if self.name else ""
        return ArenaFileError(f"{self.path}:{self.line}: {name}{text}")

    def mapping(self) -> dict[str, "YamlValue"]:
        """Return the keys and their values.

        Raises:
            ArenaFileError: It is something else.
        """
        if isinstance(self.data, dict):
            return self.data
        raise self.error(f"{self.shown} is not a mapping of keys to values")

    def items(self) -> list["YamlValue"]:
        """Return the items of a list.

        Raises:
            ArenaFileError: It is something else.
        """
        if isinstance(self.data, list):
            return self.data
        raise self.error(f"{self.shown} is not a list")

    @property
    def shown(self) -> str:
        """The value as errors quote it."""
        if isinstance(self.data, dict):
            return "a mapping"
        if isinstance(self.data, list):
            return f"a list of {len(self.data)}"
        return repr(self.data) if self.data is not None else "nothing"


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return what a file holds.

    Raises:
        ArenaFileError: It is not there, cannot be read, or has more bytes than `most`.
    """
    try:
        size = path.stat().st_size
        if size > most:
            raise ArenaFileError(f"{path}: {size} bytes are too many; at most {most}")
        return path.read_bytes()
    except OSError as error:
        raise ArenaFileError(f"{path}: cannot be read: {error.strerror or error}") from error


def read_yaml(path: Path) -> YamlValue:
    """Return what a YAML file holds.

    Raises:
        ArenaFileError: A file that does not read, is no YAML, or says a key twice; names the line.
    """
    text = read_bytes(path)
    try:
        loader = yaml.SafeLoader(text.decode("utf-8"))
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


class _YamlReader:
    """Turns the nodes of a document into values, and counts them: aliases can make many of few."""

    def __init__(self, path: Path, loader: yaml.SafeLoader) -> None:
        self._path, self._loader, self._count = path, loader, 0
        self._open: set[int] = set()
        self._flat: set[int] = set()

    def value(self, node: yaml.Node, name: str) -> YamlValue:
        self._count += 1
        line = node.start_mark.line + 1
        if self._count > MOST_VALUES:
            raise ArenaFileError(f"{self._path}:{line}: more than {MOST_VALUES} values in one file")
        if id(node) in self._open:
            raise ArenaFileError(f"{self._path}:{line}: {name} contains itself")
        self._open.add(id(node))
        data = self._data(node, name)
        self._open.discard(id(node))
        return YamlValue(data, self._path, line, name)

    def _data(self, node: yaml.Node, name: str) -> Plain:
        if isinstance(node, yaml.MappingNode):
            return {key: self.value(child, f"{name}.{key}".lstrip(".")) for key, child in self._pairs(node)}
        if isinstance(node, yaml.SequenceNode):
            return [self.value(child, f"{name}[{i}]") for i, child in enumerate(node.value)]
        try:
            data = self._loader.construct_object(node)
        except (ValueError, OverflowError) as error:  # a date that does not exist, a number too long
            line = node.start_mark.line + 1
            raise ArenaFileError(f"{self._path}:{line}: {name}: {node.value!r}: {error}") from error
        return data if isinstance(data, (str, int, float)) or data is None else str(node.value)

    def _pairs(self, node: yaml.MappingNode) -> Iterator[tuple[str, yaml.Node]]:
        """Yield keys and values, after those of a merge (<<), which they replace."""
        if id(node) not in self._flat:  # else it stands here again, by an alias
            self._flat.add(id(node))
            self._check_keys(node)
            self._loader.flatten_mapping(node)
        for key, child in node.value:
            yield str(key.value), child

    def _check_keys(self, node: yaml.MappingNode) -> None:
        seen: set[str] = set()
        for key, _ in node.value:
            line = f"{self._path}:{key.start_mark.line + 1}"
            if not isinstance(key, yaml.ScalarNode):
                raise ArenaFileError(f"{line}: a key is a word, not a list or mapping")
            if key.value in seen:
                raise ArenaFileError(f"{line}: key {key.value!r} is there twice")
            seen.add(key.value)
