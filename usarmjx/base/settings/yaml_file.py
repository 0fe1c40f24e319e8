"""YAML files within limits, each value with its line; TOML files; and settings as YAML."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import yaml

from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.settings.files import MAX_QUOTED, FileValue, Plain, first_line, joined, read_bytes

MAX_VALUES = 500_000
"""Largest number of values in a file, repetitions by aliases included."""
MAX_DIGITS = 100
"""Largest length of a number [characters]; YAML's base 60 takes quadratic time."""
MAX_KEY_LENGTH = 100
"""Largest length of a key [characters]."""
FLOAT_TAG, MERGE_TAG = "tag:yaml.org,2002:float", "tag:yaml.org,2002:merge"
FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$")
"""Numbers of YAML 1.2, as 1e-3, that PyYAML, which is for YAML 1.1, takes for words."""


class _LimitedLoader(yaml.SafeLoader):
    """A loader that refuses a file with too many values while it parses.

    Args:
        text: The file's text.
        path: The file, for messages.
        refusal: Class of the errors.
    """

    def __init__(self, text: str, path: Path, refusal: type[UsageError]) -> None:
        super().__init__(text)
        self._path, self._refusal, self._count = path, refusal, 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:  # noqa: ANN401 - PyYAML's
        """Return the next value; called for each."""
        self._count += 1
        if self._count > 2 * MAX_VALUES:  # keys are among them
            raise self._refusal(f"{self._path}: more than {MAX_VALUES} values in one file")
        return super().compose_node(parent, index)


class _Dumper(yaml.SafeDumper):
    """Quotes the texts that the loader would take for numbers."""


for _class in (_LimitedLoader, _Dumper):
    cast(Any, _class).add_implicit_resolver(FLOAT_TAG, FLOAT, list("-+0123456789."))


def read_yaml(path: Path, refusal: type[UsageError] = SpecError) -> FileValue:
    """Return the content of a YAML file, or of a JSON file, which is one of YAML.

    Raises:
        UsageError: A file that is unreadable, is no YAML, or repeats a key; names the line.
    """
    text = read_bytes(path, refusal=refusal)
    try:
        loader = _LimitedLoader(text.decode("utf-8"), path, refusal)
        node = loader.get_single_node()
        if node is None:
            raise refusal(f"{path}: is empty; expected a mapping, as `name: mine`")
        return _NodeReader(path, loader, refusal).value(node, "")
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark else ""
        raise refusal(f"{path}{line}: is no YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise refusal(f"{path}: is no YAML: {first_line(error)}") from error
    except RecursionError as error:
        raise refusal(f"{path}: is nested too deeply") from error


class _NodeReader:
    """Converter of a document's nodes to values; it counts them, as aliases can make many of few."""

    def __init__(self, path: Path, loader: yaml.SafeLoader, refusal: type[UsageError]) -> None:
        self._path, self._loader, self._refusal, self._count = path, loader, refusal, 0
        self._open: set[int] = set()
        self._flat: dict[int, dict[str, yaml.Node]] = {}

    def value(self, node: yaml.Node, name: str) -> FileValue:
        line = self._counted(node)
        if id(node) in self._open:
            raise self._refusal(f"{self._path}:{line}: {name} contains itself")
        self._open.add(id(node))
        data = self._data(node, name)
        # Only nodes on the way down count: a value may be repeated beside itself.
        self._open.discard(id(node))
        return FileValue(data, self._path, line, name, self._refusal)

    def _counted(self, node: yaml.Node, more: int = 1) -> int:
        """Count a value, or several; return its line."""
        self._count += more
        line = node.start_mark.line + 1
        if self._count > MAX_VALUES:
            raise self._refusal(f"{self._path}:{line}: more than {MAX_VALUES} values in one file")
        return line

    def _data(self, node: yaml.Node, name: str) -> Plain:
        if isinstance(node, yaml.MappingNode):
            pairs = self._pairs(node).items()
            return {key: self.value(child, joined(name, f".{key}")) for key, child in pairs}
        if isinstance(node, yaml.SequenceNode):
            return [self.value(child, joined(name, f"[{i}]")) for i, child in enumerate(node.value)]
        where = f"{self._path}:{node.start_mark.line + 1}: {name}"
        if len(node.value) > MAX_DIGITS and node.tag.endswith((":int", ":float")):
            raise self._refusal(f"{where}: a number of {len(node.value)} characters; at most {MAX_DIGITS}")
        try:
            data = cast(Any, self._loader).construct_object(node)
        except yaml.YAMLError:
            raise
        except Exception as error:  # PyYAML raises whatever a wrong date, number or tag makes it run into
            tag = node.tag.rpartition(":")[2][-MAX_QUOTED:]
            raise self._refusal(f"{where}: {node.value[:MAX_QUOTED]!r} is no {tag}: {error}") from error
        # PyYAML makes objects of dates; here they stay words.
        return data if isinstance(data, (str, int, float)) or data is None else str(node.value)

    def _pairs(self, node: yaml.MappingNode) -> dict[str, yaml.Node]:
        """Return keys and values, after those of a merge (<<), which they replace."""
        if id(node) in self._flat:  # a repetition by an alias
            return self._flat[id(node)]
        self._check_keys(node)
        self._flat[id(node)] = {}  # ends the recursion of a mapping that merges itself
        merged: dict[str, yaml.Node] = {}
        for key, child in node.value:
            if key.tag == MERGE_TAG:
                for other in reversed(self._merged(child)):  # the first one has priority
                    pairs = self._pairs(other)
                    self._counted(other, len(pairs))
                    merged |= pairs
        own = {key.value: child for key, child in node.value if key.tag != MERGE_TAG}
        self._flat[id(node)] = merged | own
        return self._flat[id(node)]

    def _merged(self, node: yaml.Node) -> list[yaml.MappingNode]:
        """Return the mappings of a merge: one, or a list of them."""
        named: list[yaml.Node] = node.value if isinstance(node, yaml.SequenceNode) else [node]
        found = [one for one in named if isinstance(one, yaml.MappingNode)]
        if len(found) < len(named):
            line = f"{self._path}:{node.start_mark.line + 1}"
            raise self._refusal(f"{line}: is no YAML: expected a mapping or a list of them to merge (<<)")
        return found

    def _check_keys(self, node: yaml.MappingNode) -> None:
        seen: set[str] = set()
        for key, _ in node.value:
            line = f"{self._path}:{key.start_mark.line + 1}"
            if not isinstance(key, yaml.ScalarNode):
                raise self._refusal(f"{line}: a key is a word, not a list or mapping")
            if len(key.value) > MAX_KEY_LENGTH:
                raise self._refusal(f"{line}: a key of {len(key.value)} characters; at most {MAX_KEY_LENGTH}")
            if key.value in seen:
                raise self._refusal(f"{line}: key {key.value!r} is there twice")
            seen.add(key.value)


def dump_yaml(data: Mapping[str, object], comments: Mapping[str, str] | None = None) -> str:
    """Return plain data as YAML that `read_yaml` reads back.

    Args:
        data: Mappings, lists, texts, numbers, truth values and None.
        comments: Comment before a key of the outermost mapping, by key.
    """
    parts = list[str]()
    for key, value in data.items():
        comment = (comments or {}).get(key, "")
        body = yaml.dump({key: value}, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000)
        parts.append((f"# {comment}\n" if comment else "") + body)
    return "".join(parts)


def read_file(path: Path, refusal: type[UsageError] = SpecError) -> FileValue:
    """Return the content of a YAML, JSON or TOML file, by the end of its name; values of TOML know no line.

    Raises:
        UsageError: A file that does not read, or says a key twice; names the line.
    """
    if path.suffix.lower() != ".toml":
        return read_yaml(path, refusal)
    try:
        found = tomllib.loads(read_bytes(path, refusal=refusal).decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise refusal(f"{path}: is no TOML: {first_line(error)}") from error
    return _of_toml(found, FileValue(None, path, 0, "", refusal))


def _of_toml(data: Any, place: FileValue) -> FileValue:  # noqa: ANN401 - as tomllib gives it
    def inner(name: str, item: object) -> FileValue:
        return _of_toml(item, FileValue(None, place.path, 0, joined(place.name, name), place.refusal))

    if isinstance(data, dict):
        held: Plain = {str(key): inner(f".{key}", item) for key, item in data.items()}  # type: ignore - any
    elif isinstance(data, list):
        held = [inner(f"[{i}]", item) for i, item in enumerate(data)]  # type: ignore - of any type
    else:
        held = data if isinstance(data, str | int | float) else str(data)  # dates
    return FileValue(held, place.path, 0, place.name, place.refusal)
