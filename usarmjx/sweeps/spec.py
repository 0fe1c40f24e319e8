"""A sweep as data: a YAML file, and the settings of the cells that it stands for."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from usarmjx.base.errors import SpecError, UnknownNameError, UsageError
from usarmjx.base.files import read_bounded

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


BUNDLED = Path(__file__).parent / "bundled"
KEYS = ("about", "common", "product", "list", "sample", "worlds")
METHODS = ("latin-hypercube", "random")
SAMPLE_KEYS = ("count", "method", "seed", "ranges")
MAX_BYTES = 1_000_000
MAX_CELLS = 1_000_000


@dataclass(frozen=True, kw_only=True)
class SweepSpec:
    """A sweep.

    Attributes:
        name: Of its file.
        about: What it asks, in a sentence.
        cells: The settings of each cell, all that are in force.
        axes: CellSettings that differ between cells, in the order of the file.
        worlds: How many worlds a batch has at most; None: as the machine likes it.
    """

    name: str
    about: str
    cells: tuple[dict[str, Any], ...]
    axes: tuple[str, ...]
    worlds: int | None = None


def find_spec(what: str) -> Path:
    """Return a sweep's file: a path, or the name of a bundled one.

    Raises:
        UnknownNameError: Neither; lists the bundled ones.
    """
    if Path(what).is_file():
        return Path(what)
    if (bundled := BUNDLED / f"{what}.yaml").is_file():
        return bundled
    known = ", ".join(sorted(file.stem for file in BUNDLED.glob("*.yaml")))
    raise UnknownNameError(f"{what} is no file, and no bundled sweep; those are: {known}")


def load_spec(path: Path, common: Mapping[str, Any] | None = None) -> SweepSpec:
    """Read a sweep's file.

    Args:
        path: The file.
        common: CellSettings that replace those of all cells.

    Raises:
        UsageError: It cannot be read, or something in it is not allowed; names file and key, and what is.
    """
    try:
        given = yaml.safe_load(read_bounded(path, MAX_BYTES))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f" line {mark.line + 1}:" if mark else ""
        problem = getattr(error, "problem", None) or "it does not read"
        raise SpecError(f"{path}:{line} no YAML: {problem}") from error
    try:
        return read_spec(given, path.stem, common)
    except UsageError as error:
        raise SpecError(f"{path}: {error}") from error


def read_spec(given: object, name: str = "sweep", common: Mapping[str, Any] | None = None) -> SweepSpec:
    """Return a sweep from what its file holds.

    Raises:
        UsageError: Something is not allowed; names the key, and what is.
    """
    if not isinstance(given, Mapping):
        raise UsageError(f"expected a mapping with {', '.join(KEYS)}")
    if unknown := [str(key) for key in given if key not in KEYS]:
        raise UsageError(f"no key {', '.join(unknown)}; there are: {', '.join(KEYS)}")
    parts = [_rows(given.get("list")), _product(given.get("product")), _sample(given.get("sample"))]
    count = int(np.prod([len(rows) for rows in parts]))
    if count > MAX_CELLS:
        raise UsageError(f"{count} cells, expected at most {MAX_CELLS}")
    base = flatten(given.get("common") or {}, "common")
    over = flatten(common or {}, "the command line")
    cells = [complete({**base, **_joined(rows), **over}, "a cell") for rows in itertools.product(*parts)]
    unique = list({repr(cell): cell for cell in cells}.values())
    names = dict.fromkeys(key for rows in parts for row in rows for key in row)
    axes = tuple(key for key in names if len({repr(cell.get(key)) for cell in unique}) > 1)
    worlds = given.get("worlds")
    if worlds is not None and (isinstance(worlds, bool) or not isinstance(worlds, int) or worlds < 1):
        raise UsageError(f"worlds is {worlds!r}, expected a whole number from 1")
    about = " ".join(str(given.get("about", "")).split())
    return SweepSpec(name=name, about=about, cells=tuple(unique), axes=axes, worlds=worlds)


def _joined(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    joined: dict[str, Any] = {}
    for row in rows:
        if twice := sorted(set(joined) & set(row)):
            raise UsageError(f"{', '.join(twice)} is in two of list, product and sample: say it once")
        joined |= row
    return joined


def _rows(given: object) -> list[dict[str, Any]]:
    if given is None:
        return [{}]
    if not isinstance(given, list) or not given:
        raise UsageError(f"list is {given!r}, expected settings of cells, one after the other")
    return [flatten(row, f"list, row {i + 1}") for i, row in enumerate(given)]


def _product(given: object) -> list[dict[str, Any]]:
    if given is None:
        return [{}]
    axes = flatten(given, "product")
    for key, values in axes.items():
        if not isinstance(values, list) or not values:
            raise UsageError(f"product: {key} is {values!r}, expected a list of values")
    return [dict(zip(axes, row, strict=True)) for row in itertools.product(*axes.values())]


def _sample(given: object) -> list[dict[str, Any]]:
    """Return points of ranges; whole numbers where both ends are."""
    if given is None:
        return [{}]
    if not isinstance(given, Mapping):
        raise UsageError(f"sample is {given!r}, expected a mapping with {', '.join(SAMPLE_KEYS)}")
    if unknown := [str(key) for key in given if key not in SAMPLE_KEYS]:
        raise UsageError(f"sample has no key {', '.join(unknown)}; there are: {', '.join(SAMPLE_KEYS)}")
    count, seed = given.get("count"), given.get("seed", 0)
    method = given.get("method", METHODS[0])
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MAX_CELLS:
        raise UsageError(f"sample: count is {count!r}, expected a whole number from 1 to {MAX_CELLS}")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise UsageError(f"sample: seed is {seed!r}, expected a whole number from 0")
    if method not in METHODS:
        raise UsageError(f"sample: method is {method!r}, expected {' or '.join(METHODS)}")
    ranges = flatten(given.get("ranges") or {}, "sample: ranges")
    if not ranges:
        raise UsageError("sample: ranges is empty, expected key: [lowest, highest]")
    for key, span in ranges.items():
        check_key(key, "sample: ranges")
        _check_span(key, span)
    points = _points(count, len(ranges), method, seed)
    return [
        {key: _at(span, share) for (key, span), share in zip(ranges.items(), row, strict=True)}
        for row in points
    ]


def _check_span(key: str, span: object) -> None:
    pair: list[Any] = span if isinstance(span, list) and len(span) == 2 else [None, None]
    fine = all(isinstance(one, int | float) and not isinstance(one, bool) for one in pair)
    if not fine or not np.isfinite(pair).all() or pair[0] > pair[1]:
        raise UsageError(f"sample: {key} is {span!r}, expected two numbers [lowest, highest]")


def _points(count: int, size: int, method: str, seed: int) -> np.ndarray:
    """Return points of the unit cube (count, size)."""
    if method == "random":
        return np.random.default_rng(seed).random((count, size))
    from scipy.stats import qmc

    return qmc.LatinHypercube(size, rng=seed).random(count)


def _at(span: Sequence[Any], share: float) -> float | int:
    low, high = span
    if isinstance(low, int) and isinstance(high, int):
        return min(high, low + int(share * (high - low + 1)))
    return float(low + share * (high - low))
