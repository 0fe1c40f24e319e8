"""A sweep as data: a YAML file, and the settings of the cells that it stands for."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.registry import closest
from usarmjx.base.settings import (
    AT_LEAST_ONE,
    NOT_NEGATIVE,
    SHARE,
    FileValue,
    Setting,
    default_reader,
    describe,
    read_file,
)
from usarmjx.base.settings.files import is_list, is_mapping, is_tuple, shown
from usarmjx.train.task_names import newest_name, policy_name

FIELDS = "fields"
"""`fields.NAME` sets any other field of the task."""
CellSettings = Mapping[str, Any]
"""A cell's settings by their flat names, as they were given: the key of its result is a hash of them."""
Named = str | Mapping[str, Any]
"""A name, or the parts of what it names."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Settings of a cell. Those with parts are given as `name.part`, or nested.

    Attributes:
        task: Name of the task, or FILE.py:CLASS.
        policy: Policy that drives: `baseline`, `packaged`, `random`, a planner such as `oracle`, a run's
            folder, an exported file, FILE.py:FUNCTION, or a kind with its name.
        method: Policies that are runs of one method, as {name: NAME, runs: [POLICY, ...]}: each is a cell.
        episodes: Episodes of the cell, each in a world of its own.
        seed: Seed of all random numbers.
        engine: Physics engine, or `auto`.
        arena: Arena, or parts of the recipe of generated ones.
        split: Split of generated arenas: `test`, `validation`, `train`, or `fresh`, which `arena.seed` draws.
            None: `test` where arenas are generated.
        roster: Robot classes and how many of each, or a list of classes.
        physics: Name of the physics settings, or parts of them.
        radio: Parts of the radio's constants.
        vary: Parts of the domain randomisation.
        fields: Other fields of the task.
    """

    task: str
    policy: Named = "baseline"
    episodes: Annotated[int, AT_LEAST_ONE] = 20
    seed: Annotated[int, NOT_NEGATIVE] = 0
    method: Named | None = None
    engine: str = "auto"
    arena: Named | None = None
    split: Annotated[str | None, Setting(choices=("train", "validation", "test", "fresh"))] = None
    roster: Mapping[str, int] | list[str] | None = None
    physics: Named | None = None
    radio: Mapping[str, Any] | None = None
    vary: Mapping[str, Any] | None = None
    fields: Mapping[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class ArenaLevel:
    """Setting `arena.level`: one level in place of a recipe's levels."""

    level: Annotated[float, SHARE]


NAMES = tuple(one.name for one in describe(Cell))
"""Settings of a cell."""
DEFAULTS: dict[str, Any] = {
    one.name: one.default for one in describe(Cell) if one.name in ("policy", "episodes", "seed", "engine")
}
"""Settings that every cell has, and their values if they are not given."""
EARLIER_POLICIES = {"by-hand": "baseline", "shipped": "packaged"}
"""Names of policies by their earlier ones, which files of sweeps and results may have."""


def rename_policy(policy: Any, names: Mapping[str, str] = EARLIER_POLICIES) -> Any:  # noqa: ANN401 - any data
    """Return a setting `policy`, or its kind if it is a mapping, under another name.

    Args:
        policy: The setting.
        names: Names by those that they replace.
    """
    if is_mapping(policy):
        return {names.get(key, key): value for key, value in policy.items()}
    return names.get(policy, policy) if isinstance(policy, str) else policy


def rename_tasks(settings: CellSettings, rename: Callable[[str], str]) -> dict[str, Any]:
    """Return a cell's settings with other names of its task, and of tasks that `policy` names.

    Args:
        settings: The settings.
        rename: Returns the other name of a task.
    """
    found = dict(settings)
    if isinstance(task := found.get("task"), str):
        found["task"] = rename(task)
    if is_mapping(policy := found.get("policy")):
        named = {kind: policy[kind] for kind in ("baseline", "file") if isinstance(policy.get(kind), str)}
        found["policy"] = {**policy, **{kind: policy_name(name, rename) for kind, name in named.items()}}
    elif isinstance(policy, str):
        found["policy"] = policy_name(policy, rename)
    return found


def rename_keys(scores: Any, rename: Callable[[str], str]) -> Any:  # noqa: ANN401 - a name stays
    """Return scores by task with other names of the tasks; anything else as it is."""
    return {rename(task): score for task, score in scores.items()} if is_mapping(scores) else scores


@cache
def part_classes() -> dict[str, type]:
    """Return the classes that declare the parts of settings; imports MuJoCo."""
    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.models.compile.physics import Physics
    from usarmjx.models.compile.randomization import DomainRandomization
    from usarmjx.train.tasks.buildings import Buildings

    return {"arena": Buildings, "radio": RadioSettings, "physics": Physics, "vary": DomainRandomization}


NO_PARTS = (
    *("levels", "robot", "starts", "split", "renewable", "sizes", "near_victims", "together"),
    *("listen_port", "debug"),
)
"""Fields of `part_classes` that a cell does not set: it has one level of its arenas, and serves nothing."""


@cache
def parts() -> dict[str, tuple[str, ...]]:
    """Return the parts of the settings that have some."""
    found = {
        name: tuple(one.name for one in describe(kind) if one.name not in NO_PARTS)
        for name, kind in part_classes().items()
    }
    # `level` stands for the field `levels`, which `NO_PARTS` takes out.
    return {**found, "arena": ("level", *found["arena"])}


def flatten(given: object, where: str) -> dict[str, Any]:
    """Return settings by their flat names.

    Args:
        given: Settings as YAML gives them, nested or flat; a value of a file knows its line.
        where: Part of the file, for messages.

    Raises:
        UsageError: No mapping, or a key that there is not; names the known ones.
    """
    place = f"{given.place}: {where}" if isinstance(given, FileValue) else where
    rows = given.data if isinstance(given, FileValue) else given
    if not is_mapping(rows):
        raise UsageError(f"{place} is {shown(rows)}, expected settings as key: value")
    flat: dict[str, Any] = {}
    for key, item in rows.items():
        line = f"{item.place}: {where}" if isinstance(item, FileValue) else where
        value = item.plain() if isinstance(item, FileValue) else item
        # Only parts nest: a roster is a mapping, too, but one value.
        nested = is_mapping(value) and (key in parts() or key == FIELDS)
        within = {f"{key}.{p}": v for p, v in value.items()} if nested else {str(key): value}
        for name, own in within.items():
            check_key(name, line)
            # The nested and the flat form of a name may stand side by side in one mapping.
            if name in flat:
                raise UsageError(f"{line} has {name} twice")
            flat[name] = own
    return flat


def check_key(key: str, where: str) -> None:
    """Refuse a setting that there is not.

    Raises:
        UnknownNameError: Names the key, and the known ones.
    """
    first, dot, part = key.partition(".")
    # The task decides which fields there are: `resolve` checks these.
    if dot and first == FIELDS and part:
        return
    if dot and first in parts():
        if part not in parts()[first]:
            other = f"; {part} is a setting of its own" if part in NAMES else ""
            raise UnknownNameError(
                f"{where} has no setting {key!r}; {first} has: {', '.join(parts()[first])}{other}"
            )
        return
    # The three in brackets have parts only: a bare name sets nothing.
    if dot or key not in NAMES or key in (FIELDS, "radio", "vary"):
        known = [one for one in NAMES if one not in (FIELDS, "radio", "vary")]
        rest = [*(f"{name}.*" for name in parts() if name not in known), f"{FIELDS}.*"]
        raise UnknownNameError(f"{where} has no setting {key!r}; known: {', '.join([*known, *rest])}")


def complete(settings: CellSettings, where: str) -> dict[str, Any]:
    """Return the settings with defaults and full names of tasks, in the order of their names.

    Raises:
        UsageError: No task, or a value that is not allowed; names its limits.
    """
    full = {"task": None, **DEFAULTS, **settings}
    # Dotted names belong to other classes, not to `Cell`.
    whole = {name: value for name, value in full.items() if name in NAMES}
    default_reader().values(Cell, whole, where=where)
    full["policy"] = rename_policy(full["policy"])
    # In one order: `read_spec` compares cells by their text.
    return dict(sorted(rename_tasks(full, newest_name).items()))


def as_text(value: object) -> str:
    """Return a setting's value in a table: a mapping as `P2AT x 4`, numbers short."""
    if is_mapping(value):
        return ", ".join(f"{key} x {own}" if isinstance(own, int) else str(own) for key, own in value.items())
    if is_list(value) or is_tuple(value):
        return "[" + ", ".join(map(as_text, value)) + "]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


BUNDLED, SUITES = (Path(__file__).parent / name for name in ("bundled", "suites"))
SPLITS_OF_SUITES = ("validation", "test")
"""Splits that a suite is played on."""
MAX_CELLS = 1_000_000
"""Most cells of a sweep."""


@dataclass(frozen=True, kw_only=True)
class SampleSettings:
    """Part `sample` of a sweep's file: points of ranges.

    Attributes:
        count: Number of points.
        method: Method by which the points are drawn.
        seed: Seed of the points.
        ranges: Lowest and highest number by setting.
    """

    count: Annotated[int, Setting(ge=1, le=MAX_CELLS)]
    method: Annotated[str, Setting(choices=("latin-hypercube", "random"))] = "latin-hypercube"
    seed: Annotated[int, NOT_NEGATIVE] = 0
    ranges: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class SweepFile:
    """A sweep's file. Cells are all combinations of `list`, `product` and `sample`.

    Attributes:
        about: Question that the sweep answers, in a sentence.
        common: Settings of all cells.
        product: Values by setting, of which all combinations are played.
        list: Settings of cells, one after the other.
        sample: Points of ranges.
        worlds: Most worlds of a batch; None: by the memory of the machine.
        normalise: `zero` and `one`: policies or methods of the sweep whose scores count as 0 and as 1 in
            aggregates over tasks, or such scores by task.
    """

    about: str = ""
    common: Any = None
    product: Any = None
    list: Any = None
    sample: Any = None
    worlds: Annotated[int | None, AT_LEAST_ONE] = None
    normalise: Any = None


@dataclass(frozen=True, kw_only=True)
class Anchors:
    """Part `normalise` of a sweep's file.

    Attributes:
        zero: Policy or method whose score counts as 0, or such a score by task.
        one: Policy or method whose score counts as 1, or such a score by task.
    """

    zero: str | Mapping[str, float]
    one: str | Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class SweepSpec:
    """A sweep.

    Attributes:
        name: Name of its file.
        about: Question that it answers, in a sentence.
        cells: Settings of each cell, with the defaults.
        axes: Settings that differ between cells, in the order of the file.
        sampled: Lowest and highest number of each setting that is sampled.
        normalise: Policies or scores that count as 0 and as 1, see `SweepFile`.
        worlds: Most worlds of a batch; None: by the memory of the machine.
    """

    name: str
    about: str
    cells: tuple[dict[str, Any], ...]
    axes: tuple[str, ...]
    worlds: int | None = None
    sampled: Mapping[str, Any] = field(default_factory=dict[str, Any])
    normalise: Mapping[str, Any] = field(default_factory=dict[str, Any])


def find_spec(what: str) -> Path:
    """Return a sweep's file: a path, or the name of a bundled one.

    Raises:
        UnknownNameError: Neither; lists the bundled ones.
    """
    return _find_file(what, BUNDLED, "sweep")


def find_suite(what: str) -> Path:
    """Return a suite's file: a path, or the name of a bundled one.

    Raises:
        UnknownNameError: Neither; lists the bundled ones.
    """
    return _find_file(what, SUITES, "suite")


def _find_file(what: str, folder: Path, noun: str) -> Path:
    if Path(what).is_file():
        return Path(what)
    if (bundled := folder / f"{what}.yaml").is_file():
        return bundled
    known = sorted(file.stem for file in folder.glob("*.yaml"))
    hint = closest(what, known) or ";"
    raise UnknownNameError(f"{what} is no file, and no bundled {noun}{hint} those are: {', '.join(known)}")


def load_spec(path: Path, common: Mapping[str, Any] | None = None) -> SweepSpec:
    """Read a sweep's file.

    Args:
        path: The file.
        common: Settings that replace those of all cells.

    Raises:
        UsageError: It cannot be read, or something in it is not allowed; names file, line, key and limits.
    """
    return read_spec(read_file(path), path.stem, common)


def read_spec(given: object, name: str = "sweep", common: Mapping[str, Any] | None = None) -> SweepSpec:
    """Return a sweep from the data of its file.

    Args:
        given: The data; a `FileValue` knows its lines.
        name: Name of the sweep.
        common: Settings that replace those of all cells.

    Raises:
        UsageError: Something is not allowed; names the key, the value and its limits.
    """
    rows = given.data if isinstance(given, FileValue) else given
    file, found = default_reader().from_data(SweepFile, given), dict[str, Any](rows)  # type: ignore - a mapping
    sample, axes = _sample_settings(found.get("sample")), _axes(found.get("product"))
    # A row of nothing keeps the product's place until the number of cells is known.
    parts: list[list[dict[str, Any]]] = [_rows(found.get("list")), [{}], _sample(sample)]
    count = math.prod([*map(len, parts), *map(len, axes.values())])
    if count > MAX_CELLS:  # before they are built: five axes of 40 values are 100 million
        place = f"{given.path}: " if isinstance(given, FileValue) else ""
        raise UsageError(f"{place}{count} cells, expected at most {MAX_CELLS}")
    parts[1] = [dict(zip(axes, row, strict=True)) for row in itertools.product(*axes.values())]
    base = flatten(found["common"], "common") if file.common else {}
    over = flatten(common or {}, "the command line")
    where = f"{given.path}: a cell" if isinstance(given, FileValue) else "a cell"
    # Later ones win: the command line over the cells, these over the file's common settings.
    joined = ({**base, **_joined(rows), **over} for rows in itertools.product(*parts))
    cells = [complete(cell, where) for row in joined for cell in with_runs(row, where)]
    # By text, as settings hold lists and mappings, which have no hash.
    unique = list({repr(cell): cell for cell in cells}.values())
    names = dict.fromkeys(key for rows in [[base], *parts] for row in rows for key in row)
    # The runs of a method differ by their policy, which no part of the file names.
    if "method" in names:
        names["policy"] = None
    return SweepSpec(
        name=name,
        about=" ".join(file.about.split()),
        cells=tuple(unique),
        axes=tuple(key for key in names if len({repr(cell.get(key)) for cell in unique}) > 1),
        worlds=file.worlds,
        sampled={} if sample is None else {key: list(span) for key, span in _spans(sample).items()},
        normalise=_anchors(found.get("normalise")),
    )


def with_runs(settings: CellSettings, where: str) -> list[dict[str, Any]]:
    """Return a cell's settings, or those of one cell for each run of its method.

    Raises:
        UsageError: A method without name or runs, or beside a policy.
    """
    method = settings.get("method")
    if method is None or isinstance(method, str):
        return [dict(settings)]
    form = "expected {name: NAME, runs: [POLICY, ...]}"
    runs: object = method.get("runs") if is_mapping(method) else None
    if set(method) != {"name", "runs"} or not isinstance(method["name"], str):
        raise UsageError(f"{where}: method is {method!r}, {form}")
    if not is_list(runs) or not runs:
        raise UsageError(f"{where}: method {method['name']}: runs is {runs!r}, {form}")
    if "policy" in settings:
        raise UsageError(f"{where}: method and policy are both given: give one")
    return [{**settings, "method": method["name"], "policy": run} for run in runs]


def _anchors(given: object) -> dict[str, Any]:
    if _is_empty(given):
        return {}
    found = default_reader().from_data(Anchors, given, where="normalise")
    return {name: rename_keys(one, newest_name) for name, one in vars(found).items()}


def _joined(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    joined: dict[str, Any] = {}
    for row in rows:
        if twice := sorted(set(joined) & set(row)):
            raise UsageError(f"{', '.join(twice)} is in two of list, product and sample: give it once")
        joined |= row
    return joined


def _plain(value: object) -> Any:  # noqa: ANN401 - any data
    return value.plain() if isinstance(value, FileValue) else value


def _is_empty(value: object) -> bool:
    return _plain(value) is None


def _rows(given: object) -> list[dict[str, Any]]:
    if _is_empty(given):
        return [{}]
    rows = given.data if isinstance(given, FileValue) else given
    if not is_list(rows) or not rows:
        raise UsageError(f"list is {shown(rows)}, expected settings of cells, one after the other")
    return [flatten(row, f"list, row {i + 1}") for i, row in enumerate(rows)]


def _axes(given: object) -> dict[str, Any]:
    """Return the values of each axis of a product."""
    if _is_empty(given):
        return {}
    axes = flatten(given, "product")
    for key, values in axes.items():
        if not isinstance(values, list) or not values:
            raise UsageError(f"product: {key} is {values!r}, expected a list of values")
    return axes


def _sample_settings(given: object) -> SampleSettings | None:
    return None if _is_empty(given) else default_reader().from_data(SampleSettings, given, where="sample")


def _spans(sample: SampleSettings) -> dict[str, Any]:
    """Return lowest and highest number of each setting that is sampled."""
    ranges = flatten(sample.ranges, "sample: ranges")
    if not ranges:
        raise UsageError("sample: ranges is empty, expected key: [lowest, highest]")
    for key, span in ranges.items():
        _check_span(key, span)
    return ranges


def _sample(sample: SampleSettings | None) -> list[dict[str, Any]]:
    """Return points of ranges; whole numbers where both ends are."""
    if sample is None:
        return [{}]
    ranges = _spans(sample)
    points = _points(sample.count, len(ranges), sample.method, sample.seed)
    return [
        {key: _at(span, share) for (key, span), share in zip(ranges.items(), row, strict=True)}
        for row in points
    ]


def _check_span(key: str, span: object) -> None:
    # A stand-in for another form, which fails the check below, so that one message serves for all faults.
    pair: list[Any] = span if is_list(span) and len(span) == 2 else [None, None]
    fine = all(isinstance(one, int | float) and not isinstance(one, bool) for one in pair)
    if not fine or not np.isfinite(pair).all() or pair[0] > pair[1]:
        raise UsageError(f"sample: {key} is {span!r}, expected two numbers [lowest, highest]")


def _points(count: int, size: int, method: str, seed: int) -> np.ndarray:
    """Return points of the unit cube (count, size)."""
    if method == "random":
        return np.random.default_rng(seed).random((count, size))
    # SciPy's statistics take a second or two to import, and most sweeps draw no points.
    from scipy.stats import qmc

    # One point in each of `count` slices of every range: few points then cover each range evenly.
    return qmc.LatinHypercube(size, rng=seed).random(count)


def _at(span: Sequence[Any], share: float) -> float | int:
    low, high = span
    if isinstance(low, int) and isinstance(high, int):
        # One more than the span, so that the highest is as likely as the others.
        return min(high, low + int(share * (high - low + 1)))
    return float(low + share * (high - low))
