"""Options in groups: a command takes dataclasses, whose fields typer shows as options of their own."""

import inspect
from collections.abc import Callable
from copy import copy
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

from typer.models import OptionInfo

F = TypeVar("F", bound=Callable[..., Any])


def grouped(command: F) -> F:
    """Return a command for typer with all fields of the groups that the given one takes as its options.

    Args:
        command: A function. A parameter whose type is a dataclass is a group: each field, annotated as an
            option of typer's, becomes an option, shown under the group's `panel` in the help. Other
            parameters stay as they are.
    """
    kinds = get_type_hints(command, include_extras=True)
    parameters: list[inspect.Parameter] = []
    groups: dict[str, type] = {}
    for name, parameter in inspect.signature(command).parameters.items():
        kind = kinds[name]
        if is_dataclass(kind) and isinstance(kind, type):
            groups[name] = kind
            parameters += _options_of(kind)
        else:
            parameters.append(parameter.replace(annotation=kind, kind=inspect.Parameter.KEYWORD_ONLY))

    def run(**values: Any) -> Any:  # noqa: ANN401 - what the command returns
        for name, kind in groups.items():
            values[name] = kind(**{one.name: values.pop(one.name) for one in fields(kind)})
        return command(**values)

    run.__name__, run.__doc__, run.__module__ = command.__name__, command.__doc__, command.__module__
    run.__signature__ = inspect.Signature(parameters)  # type: ignore - as inspect looks for it
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    return run  # type: ignore - called by typer only, with options


def _options_of(group: type) -> list[inspect.Parameter]:
    """Return the fields of a group as parameters, each with the group's panel."""
    kinds, panel = get_type_hints(group, include_extras=True), getattr(group, "panel", None)
    return [
        inspect.Parameter(
            one.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=_default(one),
            annotation=_in_panel(kinds[one.name], panel),
        )
        for one in fields(group)
    ]


def _default(field: Field[Any]) -> Any:  # noqa: ANN401 - of any type
    return inspect.Parameter.empty if field.default is MISSING else field.default


def _in_panel(kind: Any, panel: str | None) -> Any:  # noqa: ANN401 - annotations
    """Return an annotation whose option is shown in a panel of the help, unless it has one of its own."""
    for info in get_args(kind)[1:]:
        if isinstance(info, OptionInfo) and panel and info.rich_help_panel is None:
            moved = copy(info)
            moved.rich_help_panel = panel
            return Annotated[get_args(kind)[0], moved]
    return kind
