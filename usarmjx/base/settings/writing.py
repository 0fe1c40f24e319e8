"""Settings as data, as YAML and JSON schema, and as tables of what there is to set."""

import dataclasses
import math
import re
from collections.abc import Mapping, Set
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import Any, Literal, cast, get_args, get_origin

from usarmjx.base.errors import UsageError
from usarmjx.base.settings.declaration import (
    MAPPINGS,
    SEQUENCES,
    Setting,
    SettingField,
    bare,
    choices_of,
    describe,
    is_record,
    members_of,
    note_of,
)
from usarmjx.base.tables import markdown_table

WIDEST = 32
"""Characters of a column of a table for a terminal, but for the last one."""
_UNIT_AT_END = re.compile(r" \[[^\]]*\]$")


def to_data(value: object, *, changed_only: bool = False) -> Any:  # noqa: ANN401 - any data
    """Return settings as data that JSON, YAML and TOML hold and `from_data` reads back.

    Args:
        value: An instance, or a value of one: lists for tuples, texts for paths and for infinity.
        changed_only: Leave out the settings that have their defaults.

    Raises:
        UsageError: A value that is no data, as an array.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        rows = [(one, getattr(value, one.name)) for one in describe(type(value))]
        kept = [(one.name, item) for one, item in rows if not (changed_only and _same(item, one.default))]
        return {name: to_data(item, changed_only=changed_only) for name, item in kept}
    if isinstance(value, Enum):
        return value.value if isinstance(value.value, str | int) else value.name
    # Before the numbers: a bool is an int in Python.
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int | str):  # not one of a class derived from them, as `Text`
        return str(value) if isinstance(value, str) else int(value)
    if isinstance(value, float):
        # JSON has no infinity; a subclass of float, such as NumPy's, would not be written as a number.
        return str(float(value)) if math.isinf(value) else float(value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        pairs = cast(Mapping[object, object], value).items()
        return {str(key): to_data(item, changed_only=changed_only) for key, item in pairs}
    if isinstance(value, list | tuple | Set):
        items = cast("list[object]", value)
        # The order of sets differs between processes: files would differ without a change.
        items = sorted(items, key=repr) if isinstance(value, Set) else items
        return [to_data(item, changed_only=changed_only) for item in items]
    if type(value).__module__ == "numpy" and getattr(value, "shape", None) == ():
        return to_data(cast(Any, value).item())
    raise UsageError(f"a value of type {type(value).__name__} cannot be written as a setting")


def _same(one: object, other: object) -> bool:
    # The type too: True equals 1, and 1 equals 1.0.
    return type(one) is type(other) and one == other


def to_yaml(instance: object, *, comments: bool = True) -> str:
    """Return an instance as YAML, for `--print-config`; a comment before each setting has its help."""
    from usarmjx.base.settings.yaml_file import dump_yaml

    notes = {one.name: summary(one) for one in describe(type(instance))} if comments else None
    return dump_yaml(to_data(instance), notes)


def to_text(value: object) -> str:
    """Return a value as one types it on a command line.

    A value that is no data, as a description built in Python, is the name of its type.
    """
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple | Set):
        words = [to_text(item) for item in cast("list[object]", value)]
        nested = any(isinstance(item, list | tuple) for item in cast("list[object]", value))
        brackets = nested or not words
        words = [f"[{word}]" if nested and not word.startswith("[") else word for word in words]
        return f"[{','.join(words)}]" if brackets else ",".join(words)
    if isinstance(value, Mapping):
        pairs = cast(Mapping[object, object], value).items()
        return "{" + ", ".join(f"{key}: {to_text(item)}" for key, item in pairs) + "}"
    if isinstance(value, float):
        # Six digits if they say all: 0.1 rather than the whole of its binary fraction.
        return f"{value:g}" if float(f"{value:g}") == value else repr(value)
    if dataclasses.is_dataclass(value):
        return type(value).__name__
    try:
        return str(to_data(value))
    except UsageError:
        return type(value).__name__


def summary(one: SettingField) -> str:
    """Return the first sentence of a setting's help, and what is allowed."""
    first = _sentence(one.note.help)
    return f"{first}: {one.expects}" if first else one.expects


def _sentence(text: str) -> str:
    """Return the first sentence of a help text, without the unit at its end: the limits name it."""
    return _UNIT_AT_END.sub("", text.partition(". ")[0].rstrip(". "))


def rows_of(kind: type, base: object = None, prefix: str = "") -> list[tuple[str, str, str, str]]:
    """Return name, type and limits, default and help of all settings, those of nested ones by dotted names.

    Args:
        kind: The dataclass.
        base: Instance whose values stand for the defaults.
        prefix: Put before the names.
    """
    rows: list[tuple[str, str, str, str]] = []
    for one in describe(kind):
        value = one.default if base is None else getattr(base, one.name)
        shown = "required" if base is None and one.required else to_text(value)
        rows.append((prefix + one.name, one.expects, shown, one.note.help))
        # A class that holds itself would have rows without end.
        if one.nested is not None and one.nested is not kind:
            inner = value if isinstance(value, one.nested) else None
            if any(part.required for part in describe(one.nested)):
                continue  # a description as a whole, which nobody sets by parts
            rows += rows_of(one.nested, inner, f"{prefix}{one.name}.")
    return rows


def settings_table(kind: type, base: object = None) -> str:
    """Return the settings of a dataclass as a plain table for a terminal, one line each."""
    rows = [(name, default, expects, _sentence(text)) for name, expects, default, text in rows_of(kind, base)]
    widths = [min(max((len(row[i]) for row in rows), default=0), WIDEST) for i in range(3)]
    padded = [[cell.ljust(width) for cell, width in zip(row, (*widths, 0), strict=True)] for row in rows]
    return "\n".join("  ".join(cells).rstrip() for cells in padded)


def settings_markdown(kind: type, base: object = None) -> str:
    """Return the settings of a dataclass as a Markdown table, for the pages."""
    head = ("Setting", "Default", "Value", "Meaning")
    rows = [
        (f"`{name}`", f"`{default}`", expects, text) for name, expects, default, text in rows_of(kind, base)
    ]
    return markdown_table(head, rows)


def json_schema(kind: type) -> dict[str, Any]:
    """Return a JSON schema of a dataclass' settings, for editors that complete and check YAML files."""
    found: dict[str, Any] = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    inner: dict[str, Any] = {}
    found |= _object_schema(kind, inner)
    return found | ({"$defs": inner} if inner else {})


def _object_schema(kind: type, inner: dict[str, Any]) -> dict[str, Any]:
    properties: dict[str, Any] = {}
    for one in describe(kind):
        schema = _type_schema(one.hint, one.note, inner)
        if one.note.help:
            schema["description"] = one.note.help
        with suppress(UsageError):  # a default that is built in Python has no place in a file
            schema |= {} if one.required else {"default": to_data(one.default)}
        properties[one.name] = schema
        properties |= {alias: {**schema, "deprecated": True} for alias in one.note.aliases}
    required = [one.name for one in describe(kind) if one.required]
    return {
        **{"title": kind.__name__, "type": "object", "properties": properties},
        **{"additionalProperties": False, "required": required},
    }


def _type_schema(hint: Any, note: Setting, inner: dict[str, Any]) -> dict[str, Any]:  # noqa: ANN401 - a type hint
    hint, note = bare(hint), note_of(hint, note)
    origin, items = get_origin(hint) or hint, get_args(hint)
    if members := members_of(hint):
        return {"anyOf": [_type_schema(one, note, inner) for one in members]}
    if hint in (int, float):
        return _number_schema(hint, note)
    if hint in _TYPES and not (hint is str and note.words):
        return {"type": _TYPES[hint], **_counts(note, "Length")}
    if origin is Literal or choices_of(hint, note):
        return {"enum": list(items) if origin is Literal else list(choices_of(hint, note))}
    if origin in SEQUENCES:
        return _list_schema(hint, note, inner)
    if origin in MAPPINGS:
        value = _type_schema(items[1] if items else Any, note.of_items, inner)
        return {"type": "object", "additionalProperties": value}
    if is_record(hint):
        if hint.__name__ not in inner:
            inner[hint.__name__] = {}  # classes may hold each other
            inner[hint.__name__] = _object_schema(hint, inner)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    return {}


def _list_schema(hint: Any, note: Setting, inner: dict[str, Any]) -> dict[str, Any]:  # noqa: ANN401 - a type
    items, counts = get_args(hint), _counts(note, "Items")
    if (get_origin(hint) or hint) is tuple and items and items[-1] is not Ellipsis:
        each = [_type_schema(one, note.of_items, inner) for one in items]
        return {"type": "array", "prefixItems": each, "minItems": len(each), "maxItems": len(each)}
    one = _type_schema(items[0] if items else Any, note.of_items, inner)
    return {"type": "array", "items": one, **counts}


_TYPES = {bool: "boolean", type(None): "null", str: "string", Path: "string"}


def _counts(note: Setting, what: str) -> dict[str, int]:
    counts = {f"min{what}": note.min_length, f"max{what}": note.max_length}
    return {name: count for name, count in counts.items() if count is not None}


def _number_schema(hint: type, note: Setting) -> dict[str, Any]:
    limits = {
        **{"exclusiveMinimum": note.gt, "minimum": note.ge},
        **{"exclusiveMaximum": note.lt, "maximum": note.le},
    }
    schema: dict[str, Any] = {"type": "integer" if hint is int else "number"}
    schema |= {name: limit for name, limit in limits.items() if limit is not None}
    # A number with a unit, and infinity, are texts in a file.
    plain = hint is int or (note.finite and not note.unit)
    return schema if plain else {"anyOf": [schema, {"type": "string"}]}
