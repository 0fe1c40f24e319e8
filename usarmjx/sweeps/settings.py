"""The settings of a cell: flat, as `radio.cutoff: -49`; which there are, and what is wrong with others."""

from collections.abc import Mapping
from typing import Any

from usarmjx.base.errors import UsageError

PLAIN = ("task", "policy", "episodes", "seed", "engine", "arena", "roster", "physics")
"""Settings without parts."""
PARTS = {
    "arena": (
        *("kind", "level", "seed", "count", "size", "victims", "reachable"),
        *("roughness", "clutter", "dead_ends", "radio_shadow"),
    ),
    "radio": ("pdo", "do", "n", "cutoff", "max_obs", "atten_fac", "period", "shadowing", "loss_band"),
    "physics": (
        *("timestep", "substeps", "solver", "iterations", "ls_iterations", "cone", "impratio"),
        *("contacts_per_robot", "pairs_per_robot"),
    ),
    "vary": (
        *("friction", "mass", "wheel", "torque", "speed", "noise", "latency"),
        *("radio_pdo", "radio_n", "radio_cutoff", "radio_atten_fac", "classes"),
    ),
}
"""Settings that are said as `name.part`, or nested."""
FIELDS = "fields"
"""`fields.NAME` sets any other field of the task."""
DEFAULTS: dict[str, Any] = {"policy": "by-hand", "episodes": 20, "seed": 0, "engine": "auto"}
WHOLE = {"episodes": 1, "seed": 0}
"""Settings that are whole numbers, and the lowest they may be."""

CellSettings = Mapping[str, Any]
"""A cell's settings by their flat names."""


def flatten(given: object, where: str) -> dict[str, Any]:
    """Return settings by their flat names.

    Args:
        given: As YAML gives them, nested or flat.
        where: Where they stand, for messages.

    Raises:
        UsageError: No mapping, or a key that there is not; says which there are.
    """
    if not isinstance(given, Mapping):
        raise UsageError(f"{where} is {given!r}, expected settings as key: value")
    flat: dict[str, Any] = {}
    for key, value in given.items():
        nested = isinstance(value, Mapping) and (key in PARTS or key == FIELDS)
        rows = {f"{key}.{part}": own for part, own in value.items()} if nested else {str(key): value}
        for name, own in rows.items():
            check_key(name, where)
            if name in flat:
                raise UsageError(f"{where} says {name} twice")
            flat[name] = own
    return flat


def check_key(key: str, where: str) -> None:
    """Refuse a setting that there is not.

    Raises:
        UsageError: Names the key, and what is allowed.
    """
    first, dot, part = key.partition(".")
    if not dot and key in PLAIN:
        return
    if dot and first == FIELDS and part:
        return
    if dot and first in PARTS:
        if part not in PARTS[first]:
            raise UsageError(f"{where} has no setting {key!r}; {first} has: {', '.join(PARTS[first])}")
        return
    known = [*PLAIN, *(f"{name}.*" for name in PARTS if name not in PLAIN), f"{FIELDS}.*"]
    raise UsageError(f"{where} has no setting {key!r}; there are: {', '.join(known)}")


def complete(settings: CellSettings, where: str) -> dict[str, Any]:
    """Return the settings with the usual ones for what they do not say.

    Raises:
        UsageError: No task, or a number that is none; says what is allowed.
    """
    full = {**DEFAULTS, **settings}
    if not isinstance(full.get("task"), str):
        raise UsageError(f"{where}: task is {full.get('task')!r}, expected the name of a task")
    for name, least in WHOLE.items():
        value = full[name]
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise UsageError(f"{where}: {name} is {value!r}, expected a whole number from {least}")
    return dict(sorted(full.items()))


def as_text(value: object) -> str:
    """Return a setting's value in a table: a mapping as `P2AT x 4`, numbers short."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} x {own}" if isinstance(own, int) else str(own) for key, own in value.items())
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(as_text, value)) + "]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
