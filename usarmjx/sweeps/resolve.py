"""Resolved settings of a cell: task, arenas of its episodes, ranges, driver; settings as they are typed."""

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
import yaml

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.settings import default_reader, to_data
from usarmjx.base.settings.files import is_list, is_mapping, is_tuple
from usarmjx.models.compile.arena_set import arena_set
from usarmjx.models.compile.parts import parts_of as robot_parts
from usarmjx.models.compile.physics import PHYSICS
from usarmjx.models.compile.randomization import (
    QUANTITY_RULES,
    DomainRandomization,
    check_randomization,
)
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.generate import KINDS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sweeps.drivers import CellDriver, find_driver
from usarmjx.sweeps.spec import FIELDS, NAMES, ArenaLevel, Cell, CellSettings, check_key, part_classes
from usarmjx.train.baselines.planners import knowing
from usarmjx.train.envs.membership import building_label
from usarmjx.train.envs.recipe import SPLITS, TEST, GeneratedArenas, resolve_arenas, spec_of
from usarmjx.train.envs.task import Task
from usarmjx.train.make import make_task
from usarmjx.train.tasks.buildings import Buildings
from usarmjx.train.tasks.equip import flies
from usarmjx.train.tasks.victim_search import FLIPPERS

RADIO_AS_DATA = ("pdo", "n", "cutoff", "atten_fac")
"""Constants of the radio that may differ between the worlds of a batch."""
OF_RADIO = ("radio.", "vary.radio_")
"""Prefixes of the settings of the radio."""
STATIC_RANGES = ("mass", "latency")
"""Quantities whose ranges are compiled in: tables of masses, room for what motors have not heard of yet."""
TEAMS = {"wheeled": "on wheels", "tracked": "with flippers", "flying": "that fly"}
"""Fields of a task with a mixed team."""


@dataclass(frozen=True, kw_only=True)
class LabelledArenas:
    """Arenas, which are compared by their labels: walls of many are slow to compare.

    Attributes:
        arenas: The arenas.
        labels: Name and hash of each.
    """

    arenas: tuple[ArenaSpec, ...] = field(compare=False)
    labels: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Resolved:
    """Resolved settings of a cell.

    Attributes:
        settings: The cell's settings.
        task: The task; where arenas are data, without them.
        arenas: The arenas of its episodes, in turn; None: it has one that is not data.
        ranges: Source of its worlds, as data.
        driver: Driver of the robots.
        split: Split of its arenas; empty: they are not generated.
        labels: Name and hash of each of `arenas`.
        levels: Number of levels and sizes that `arenas` have in turn.
    """

    settings: CellSettings
    task: Task
    arenas: tuple[ArenaSpec, ...] | None
    ranges: Mapping[str, tuple[float, float]]
    driver: CellDriver
    split: str = ""
    labels: tuple[str, ...] = ()
    levels: int = 1

    @property
    def strata(self) -> int:
        """Number of strata of its buildings; 1 where a level has less than two."""
        return self.levels if self.episodes >= 2 * self.levels else 1

    @property
    def episodes(self) -> int:
        """Number of episodes, each in a world of its own."""
        return int(self.settings["episodes"])

    def arena_of(self, episode: int) -> ArenaSpec | None:
        """Return the arena of an episode; None: that of the task."""
        return None if self.arenas is None else self.arenas[episode % len(self.arenas)]

    @property
    def buildings(self) -> tuple[str, ...]:
        """Name and hash of the building of each episode; empty where its arena is not data (episodes,)."""
        return tuple(
            self.labels[episode % len(self.labels)] for episode in range(self.episodes) if self.labels
        )

    @property
    def training_note(self) -> str:
        """A warning if its policy was trained in buildings that it plays, in a line; else empty."""
        source = self.driver.source
        return "" if source is None else source.training_note(self.labels)


def parts_of(settings: CellSettings, name: str) -> dict[str, Any]:
    """Return the settings `name.part`, by part."""
    start = f"{name}."
    return {key.removeprefix(start): value for key, value in settings.items() if key.startswith(start)}


def base_settings(settings: CellSettings) -> CellSettings:
    """Return the settings that `base_task` reads."""
    named = ("task", "roster", "physics")
    return {name: value for name, value in settings.items() if name in named or name.startswith(f"{FIELDS}.")}


def base_task(settings: CellSettings) -> Task:
    """Return the task of a cell with its fields, team and named physics, before its other settings.

    Raises:
        UsageError: See `resolve`.
    """
    task = _with_fields(make_task(settings["task"]), settings)
    if "roster" in settings:
        task = with_roster(task, settings["roster"])
    named = settings.get("physics", task.physics)
    physics = PHYSICS.get(named) if isinstance(named, str) else named
    # The task itself, if nothing changes: a copy would not be found in caches that compare by identity.
    return task if physics is task.physics else replace(task, physics=physics)


def resolve(settings: CellSettings, base: Task | None = None) -> Resolved:
    """Return the resolved settings of a cell.

    Args:
        settings: The settings.
        base: Result of `base_task`; None: it is made.

    Raises:
        UsageError: A name that is unknown, or settings that do not go together; names them.
    """
    task = base_task(settings) if base is None else base
    driver = find_driver(settings["policy"], settings["task"])
    heard = settings
    if driver.knows:
        task = knowing(task)
        # It hears all, whatever the radio of the cell.
        heard = {name: one for name, one in settings.items() if not name.startswith(OF_RADIO)}
    parts, ranges = _parts(task, heard)
    arenas, split, levels = _arenas(settings, task)
    if is_tuple(arenas):
        arenas = LabelledArenas(arenas=arenas, labels=_labels(arenas))
    data = isinstance(arenas, LabelledArenas)
    return Resolved(
        settings=settings,
        # A stand-in where arenas are data, so that tasks do not differ by them.
        task=replace(task, **parts, arena="floor" if data else arenas),
        arenas=arenas.arenas if data else None,
        ranges=ranges,
        driver=driver,
        split=split,
        labels=arenas.labels if data else (),
        levels=levels,
    )


OWN_SETTINGS = ("arena", "radio", "physics", "vary", "mail", "sensors")
"""Fields of a task that a cell has settings of its own for, or cannot set."""


def _with_fields(task: Task, settings: CellSettings) -> Task:
    """Return a task with the fields that a cell sets as `fields.NAME`."""
    own = parts_of(settings, FIELDS)
    if wrong := [name for name in own if name in OWN_SETTINGS]:
        raise UsageError(f"{FIELDS}.{wrong[0]}: a cell has {wrong[0]} as a setting of its own, or not at all")
    return replace(task, **default_reader().values(type(task), own, where=FIELDS)) if own else task


def with_roster(task: Task, roster: object) -> Task:
    """Return a task with another team.

    Args:
        task: The task.
        roster: Robot classes and how many of each, or a list of classes.

    Raises:
        UsageError: No roster, or the task has no room for such a team; lists those it has.
    """
    if is_list(roster) and all(isinstance(one, str) for one in roster):
        team = [str(one) for one in roster]
    elif is_mapping(roster) and all(isinstance(n, int) and n > 0 for n in roster.values()):
        team = [str(name) for name, count in roster.items() for _ in range(count)]
    else:
        raise UsageError(f"roster is {roster!r}, expected classes and their numbers, as {{P2AT: 4}}")
    if not team:
        raise UsageError("roster is empty, expected at least one robot")
    names = {field.name for field in fields(task)}
    kinds = list(dict.fromkeys(find_robot(name).name for name in team))
    if {"robot", "count"} <= names:
        if len(kinds) > 1:
            raise UsageError(f"roster has {', '.join(kinds)}: the task takes robots of one class")
        return replace(task, robot=team[0], count=len(team))
    if set(TEAMS) <= names:
        sides: dict[str, tuple[str, ...]] = dict.fromkeys(TEAMS, ())
        for name in team:
            sides[_side(name)] += (name,)
        return replace(task, **sides)
    if "robot" in names and len(team) == 1:
        return replace(task, robot=team[0])
    raise UsageError(f"roster: this task has no team to choose; its fields are {', '.join(sorted(names))}")


def _side(name: str) -> str:
    robot = find_robot(name)
    if flies(robot):
        return "flying"
    return "tracked" if set(FLIPPERS) <= {part.name for part in robot_parts(robot)} else "wheeled"


def _parts(task: Task, settings: CellSettings) -> tuple[dict[str, Any], dict[str, tuple[float, float]]]:
    """Return the task's physics, radio and randomisation that a cell sets, and the ranges that are data."""
    radio, vary = parts_of(settings, "radio"), parts_of(settings, "vary")
    data = {f"radio_{name}": radio[name] for name in RADIO_AS_DATA if name in radio}
    if both := [name for name in data if name in vary]:
        raise UsageError(f"{both[0].replace('_', '.', 1)} and vary.{both[0]} are both given: give one")
    spans = {name: [value, value] if _is_number(value) else value for name, value in (data | vary).items()}
    varied = bool(spans.keys() - {"classes"})
    given = {"physics": parts_of(settings, "physics"), "radio": radio, "vary": spans if varied else {}}
    given = {name: own for name, own in given.items() if own}
    found = default_reader().values(type(task), given, base=task) if given else {}
    if not varied:
        return found, {}
    ranges = found["vary"] or DomainRandomization()
    radio_there = found.get("radio", task.radio) is not None
    check_randomization(ranges, [spec_of(robot) for robot in task.robots], radio_there)
    return found, {
        name: (float(span[0]), float(span[1]))
        for name in QUANTITY_RULES
        if (span := ranges.range_of(name)) is not None and name not in STATIC_RANGES
    }


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _arenas(settings: CellSettings, task: Task) -> tuple[Any, str, int]:
    """Return the arenas of a cell's episodes, level by level in turn, or its only one; split; levels."""
    said, named = parts_of(settings, "arena"), settings.get("arena", task.arena)
    robot = spec_of(task.robots[0]).name if task.robots else "P2AT"
    if (kind := said.get("kind", "maze")) not in KINDS:
        raise UsageError(f"arena.kind is {kind!r}, expected one of {', '.join(KINDS.names())}")
    recipe = named
    if isinstance(named, str):
        recipe = resolve_arenas(named, robot, len(task.robots))
    if said and ("kind" in said or not isinstance(recipe, Buildings)):
        kind = said.get("kind", recipe.kind if isinstance(recipe, GeneratedArenas) else "")
        recipe = Buildings(kind=str(kind), robot=robot) if kind in KINDS else recipe
    if not isinstance(recipe, GeneratedArenas):
        if said:
            known = ", ".join(KINDS.names())
            raise UsageError(f"arena.{next(iter(said))}: not of generated arenas; arena.kind may be {known}")
        if (split := settings.get("split")) is not None:
            raise UsageError(f"split is {split!r}, but the arenas are not generated: leave split out")
        return (recipe if isinstance(recipe, str | ArenaSpec) else tuple(recipe)), "", 1
    split = settings.get("split") or TEST
    if "seed" in said and not SPLITS.get(split).drawn:
        drawn = ", ".join(name for name, one in SPLITS if one.drawn)
        raise UsageError(
            f"arena.seed: the buildings of split {split} are fixed; a seed draws those of {drawn}: set split"
        )
    # Never renewable: the buildings of a measured episode are fixed.
    recipe = replace(_changed_recipe(recipe, said), split=split, renewable=False)
    levels, sizes = len(recipe.levels), max(len(recipe.sizes), 1) if isinstance(recipe, Buildings) else 1
    recipe = resolve_arenas(recipe, robot, len(task.robots))
    own = _generated(recipe, int(settings["episodes"]), "count" in said)
    # Strata only if all of them have as many buildings; else a level's sizes count as one stratum.
    return own, split, levels * sizes if len(own.labels) % (levels * sizes) == 0 else levels


def _changed_recipe(recipe: GeneratedArenas, given: dict[str, Any]) -> GeneratedArenas:
    """Return a recipe of generated arenas with the parts that a cell sets."""
    reader = default_reader()
    if "level" in given:
        level = reader.from_data(ArenaLevel, {"level": given.pop("level")}, where="arena").level
        given["levels"] = [level]
    if "size" in given and isinstance(recipe, Buildings):
        given["sizes"] = []  # the task's own would go before
    return reader.from_data(type(recipe), given, where="arena", base=recipe)


@lru_cache(maxsize=64)
def _labels(arenas: tuple[ArenaSpec, ...]) -> tuple[str, ...]:
    return tuple(map(building_label, arenas))


@lru_cache(maxsize=256)
def _generated(recipe: GeneratedArenas, episodes: int, counted: bool) -> LabelledArenas:
    """Return as many arenas as there are episodes, at most, of all levels in turn."""
    levels = len(recipe.levels)
    # Rounded up, so that there is a building for each episode.
    count = recipe.count if counted else -(-episodes // levels)
    try:
        made = replace(recipe, count=count).arenas()
    except (TypeError, ValueError) as error:
        raise UsageError(f"arena: {error}") from error
    # Level by level in turn, so that any number of episodes is spread over all difficulties.
    order = [level * count + place for place in range(count) for level in range(levels)]
    arenas = tuple(made[i] for i in order[:episodes])
    return LabelledArenas(arenas=arenas, labels=tuple(map(building_label, arenas)))


def signature_of(cell: Resolved, engine: str) -> dict[str, Hashable]:
    """Return the settings that all cells of a batch share, by their names.

    Args:
        cell: The cell.
        engine: The physics engine that it runs on.

    Raises:
        SpecError: Its arenas cannot be in one batch.
    """
    task = cell.task
    vary = task.vary
    compiled = {
        field.name: getattr(task, field.name)
        for field in fields(task)
        # These have entries of their own below.
        if field.name not in ("arena", "radio", "vary", "physics")
    }
    radio = task.radio
    if radio is not None and cell.ranges:
        data = [name for name in RADIO_AS_DATA if f"radio_{name}" in cell.ranges]
        # Constants that are data do not tell batches apart: any value will do here, as long as it is the
        # same.
        radio = replace(radio, **dict.fromkeys(data, 0.0))
    varied = () if vary is None else tuple(name for name in QUANTITY_RULES if vary.range_of(name))
    static = () if vary is None else (*(vary.range_of(name) for name in STATIC_RANGES), vary.classes)
    return {
        "engine": engine,
        "task": cell.settings["task"].lower(),
        # By text, as fields may hold what has no hash.
        "team and fields of the task": repr(sorted(compiled.items(), key=lambda row: row[0])),
        "arena": repr(task.arena)
        if cell.arenas is None
        else arena_shape(LabelledArenas(arenas=cell.arenas, labels=cell.labels)),
        "radio": repr(radio),
        "physics": repr(task.physics),
        "randomisation": (varied, repr(static)),
        "policy": repr(cell.driver.shape),
        "episodes": cell.episodes,
    }


@lru_cache(maxsize=256)
def arena_shape(one: LabelledArenas) -> Hashable:
    """Return the facts that arenas must share to be data, beside the number of their boxes."""
    arenas = one.arenas
    found = arena_set(arenas)
    states, template = found.states, found.template
    counts = tuple(
        np.shape(one)[1:]
        for one in (states.victims.size, states.victims.part, states.tags.pos, states.lamps, states.present)
    )
    forms = tuple(dict.fromkeys((shape.surface, shape.material) for shape in template.shapes))
    starts = {len(arena.starts) for arena in arenas}
    return (arenas[0].floor, arenas[0].has_floor, template.extent, counts, forms, min(starts))


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
    # YAML takes 1e-3 for a word: what is a number is for the field's own reader to say.
    if any(isinstance(word, str) or word is None for word in words):
        return to_data(reader.text_values(kind, {name: text}, where=where, base=base)[name])
    reader.values(kind, {name: data}, where=where, base=base)
    return data
