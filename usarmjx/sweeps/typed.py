"""Settings of all cells as they are typed: `--set` of `usarmjx sweep`."""

from collections.abc import Iterable, Mapping
from typing import Any

import yaml

from usarmjx.base.errors import UnknownNameError
from usarmjx.base.settings import default_reader, to_data
from usarmjx.base.type_guards import is_list
from usarmjx.sweeps.spec import FIELDS, NAMES, ArenaLevel, Cell, check_key, part_classes
from usarmjx.train.envs.task import Task
from usarmjx.train.make import make_task


def typed_settings(texts: Mapping[str, str], tasks: Iterable[str], where: str = "--set") -> dict[str, Any]:
    """Return settings of all cells by their flat names, each checked by its declaration.

    Args:
        texts: Texts by name. A name that cells do not have is a field of their tasks.
        tasks: Names of the tasks.
        where: Source of the texts, for messages.

    Raises:
        UnknownNameError: Neither a setting of cells nor a field of every task; lists the known ones.
        UsageError: A value that is not allowed; names its limits.
    """
    found: dict[str, Any] = {}
    for name, text in texts.items():
        first, _, part = name.partition(".")
        if first in NAMES and first != FIELDS:
            check_key(name, where)
            found[name] = _part(text, first, part, where) if part else _value(text, Cell, name, where)
            continue
        own = part if first == FIELDS else name
        for task in map(make_task, dict.fromkeys(tasks)):
            if own.partition(".")[0] not in default_reader().names(type(task)):
                known = ", ".join(
                    [*(one for one in NAMES if one != FIELDS), *default_reader().names(type(task))]
                )
                raise UnknownNameError(
                    f"{where}: cells of {type(task).__name__} have no setting {own!r}; they have: {known}"
                )
            found[f"{FIELDS}.{own}"] = _value(text, type(task), own, where, task)
    return found


def _part(text: str, name: str, part: str, where: str) -> Any:  # noqa: ANN401 - any data
    """Return the data of a part. One level stands for a list of it, one number for a range of no width."""
    kind = part_classes()[name]
    if (name, part) == ("arena", "level"):
        return _value(text, ArenaLevel, part, where)
    if name == "vary" and part != "classes" and "," not in text:
        return _value(f"[{text}, {text}]", kind, part, where)[0]
    return _value(text, kind, part, where)


def _value(text: str, kind: type, name: str, where: str, base: Task | None = None) -> Any:  # noqa: ANN401 - data
    """Return the data of a text, as files of sweeps have it.

    The key of a cell's result is a hash of its settings as data. Those that YAML reads as numbers, lists or
    mappings stay as YAML has them, so that results of earlier versions are found.
    """
    reader = default_reader()
    try:
        data: Any = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):  # ValueError: no such date, or too many digits
        data = text
    words = data if is_list(data) else [data]
    if any(isinstance(word, str) or word is None for word in words):
        return to_data(reader.text_values(kind, {name: text}, where=where, base=base)[name])
    reader.values(kind, {name: data}, where=where, base=base)
    return data
