"""The one settings mechanism: a dataclass declares its settings once, and every door reads them alike.

`Setting` declares a field's limits, unit, help and names, and `describe` returns all of that. `from_text`
reads command lines and ini files, `from_data` YAML, JSON and TOML, `validate` checks instances that are built
in Python, and `to_data` and `to_yaml` write. The grammar of texts is the table in `text`. Begin with
`declaration`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.settings.declaration import (
    ANY_PARAMETERS,
    AT_LEAST_ONE,
    NOT_NEGATIVE,
    POSITIVE,
    SHARE,
    Parameters,
    RenamedSettingWarning,
    Setting,
    SettingField,
    describe,
    members_of,
)
from usarmjx.base.settings.files import FileValue
from usarmjx.base.settings.text import Text, nested_texts, parse_assignments
from usarmjx.base.settings.writing import (
    json_schema,
    rows_of,
    settings_markdown,
    settings_table,
    summary,
    to_data,
    to_text,
    to_yaml,
)

if TYPE_CHECKING:
    from usarmjx.base.settings.reader import Reader

T = TypeVar("T")

__all__ = [
    "ANY_PARAMETERS",
    "AT_LEAST_ONE",
    "NOT_NEGATIVE",
    "POSITIVE",
    "SHARE",
    "FileValue",
    "Parameters",
    "RenamedSettingWarning",
    "Setting",
    "SettingField",
    "Text",
    "default_reader",
    "describe",
    "from_data",
    "from_text",
    "json_schema",
    "members_of",
    "nested_texts",
    "parse_assignments",
    "read_file",
    "rows_of",
    "settings_markdown",
    "settings_table",
    "summary",
    "to_data",
    "to_text",
    "to_yaml",
    "validate",
]


def default_reader() -> "Reader":
    """Return the reader of the functions here; `reader.Reader` makes one with rules and types of its own."""
    from usarmjx.base.settings.reader import DEFAULT  # pydantic-core takes 40 ms to import

    return DEFAULT


def read_file(path: Path, refusal: type[UsageError] = SpecError) -> FileValue:
    """Return the content of a YAML, JSON or TOML file; see `yaml_file.read_file`."""
    from usarmjx.base.settings import yaml_file  # PyYAML takes 10 ms to import

    return yaml_file.read_file(path, refusal)


def from_data(kind: type[T], data: object, *, where: str = "", base: T | None = None) -> T:
    """Return a dataclass from data of YAML, JSON, TOML or Python; see `Reader.from_data`."""
    return default_reader().from_data(kind, data, where=where, base=base)


def from_text(kind: type[T], texts: Mapping[str, str], *, where: str = "", base: T | None = None) -> T:
    """Return a dataclass from texts by name, dots before those of nested settings; see `Reader.from_text`."""
    return default_reader().from_text(kind, texts, where=where, base=base)


def validate(instance: Any) -> None:  # noqa: ANN401 - any dataclass
    """Check an instance that was built in Python, from its `__post_init__`; see `Reader.validate`."""
    default_reader().validate(instance)
