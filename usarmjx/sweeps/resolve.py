"""What a cell's settings stand for: task, arenas of its episodes, ranges, driver; what of that is data."""

import hashlib
import json
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.models.compile.arena_set import arena_set
from usarmjx.models.compile.parts import parts_of as robot_parts
from usarmjx.models.compile.physics import PHYSICS, Physics
from usarmjx.models.compile.randomization import QUANTITY_RULES, DomainRandomization
from usarmjx.models.generate import KINDS
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.sweeps.drivers import CellDriver, contents, find_driver
from usarmjx.sweeps.spec import FIELDS, CellSettings
from usarmjx.train.envs.recipe import GeneratedArenas, resolve_arenas, spec_of
from usarmjx.train.envs.task import Task
from usarmjx.train.make import file_of, make_task
from usarmjx.train.tasks.buildings import Buildings
from usarmjx.train.tasks.equip import flies
from usarmjx.train.tasks.victim_search import FLIPPERS

RADIO_AS_DATA = ("pdo", "n", "cutoff", "atten_fac")
"""Constants of the radio that may differ between the worlds of a batch."""
STATIC_RANGES = ("mass", "latency")
"""Quantities whose ranges are compiled in: tables of masses, room for what motors have not heard of yet."""
TEAMS = {"wheeled": "on wheels", "tracked": "with flippers", "flying": "that fly"}
"""Fields of a task with a mixed team."""


@dataclass(frozen=True, kw_only=True)
class Resolved:
    """What a cell's settings stand for.

    Attributes:
        settings: The cell's settings.
        task: The task; where arenas are data, without them.
        arenas: The arenas of its episodes, in turn; None: it has one that is not data.
        ranges: What its worlds draw from, as data.
        driver: What drives the robots.
    """

    settings: CellSettings
    task: Task
    arenas: tuple[ArenaSpec, ...] | None
    ranges: Mapping[str, tuple[float, float]]
    driver: CellDriver

    @property
    def episodes(self) -> int:
        """How many episodes it has, each in a world of its own."""
        return int(self.settings["episodes"])

    def arena_of(self, episode: int) -> ArenaSpec | None:
        """Return the arena of an episode; None: that of the task."""
        return None if self.arenas is None else self.arenas[episode % len(self.arenas)]


def key_of(settings: CellSettings) -> str:
    """Return the name of a cell's result: a hash of its settings, and of the files that they name.

    Raises:
        UsageError: See `drivers.find_driver`.
    """
    files = {"policy": contents(settings["policy"], settings["task"])}
    if (own := file_of(settings["task"])) is not None and own.is_file():
        files["task"] = hashlib.sha256(own.read_bytes()).hexdigest()
    arena = settings.get("arena")
    if isinstance(arena, str) and Path(arena).is_file():
        files["arena"] = hashlib.sha256(Path(arena).read_bytes()).hexdigest()
    text = json.dumps([dict(settings), files], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def parts_of(settings: CellSettings, name: str) -> dict[str, Any]:
    """Return the settings `name.part`, by part."""
    start = f"{name}."
    return {key.removeprefix(start): value for key, value in settings.items() if key.startswith(start)}


def resolve(settings: CellSettings) -> Resolved:
    """Return what a cell's settings stand for.

    Raises:
        UsageError: Something that there is not, or that does not go together; says what does.
    """
    task = make_task(settings["task"])
    own = parts_of(settings, FIELDS)
    if own:
        task = make_task(settings["task"], **_typed(task, own))
    if "roster" in settings:
        task = with_roster(task, settings["roster"])
    task = replace(task, physics=_physics(settings, task))
    task, radio = _with_radio(settings, task)
    task, ranges = _with_ranges(settings, task, radio)
    arenas = _arenas(settings, task)
    if isinstance(arenas, tuple):
        task, specs = replace(task, arena="floor"), arenas
    else:
        task, specs = replace(task, arena=arenas), None
    driver = find_driver(settings["policy"], settings["task"])
    return Resolved(settings=settings, task=task, arenas=specs, ranges=ranges, driver=driver)


def _typed(task: Task, own: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields of a task as it has them: YAML's lists are tuples."""
    usual = {field.name: getattr(task, field.name) for field in fields(task)}
    found: dict[str, Any] = {}
    for name, value in own.items():
        known = usual.get(name)
        if name in ("arena", "radio", "physics", "vary", "mail", "sensors"):
            raise UsageError(f"{FIELDS}.{name}: what it is has settings of its own, or none in a sweep")
        if isinstance(known, tuple) and isinstance(value, list):
            value = tuple(value)
        if name in usual and not _alike(known, value):
            raise UsageError(f"{FIELDS}.{name} is {value!r}, expected something like {known!r}")
        found[name] = value
    return found


def _alike(known: object, value: object) -> bool:
    if isinstance(known, bool) or isinstance(value, bool):
        return isinstance(known, bool) and isinstance(value, bool)
    if isinstance(known, float):
        return isinstance(value, int | float)
    return known is None or isinstance(value, type(known))


def with_roster(task: Task, roster: object) -> Task:
    """Return a task with another team.

    Args:
        task: The task.
        roster: Robot classes and how many of each, or a list of classes.

    Raises:
        UsageError: No roster, or the task has no room for such a team; says for which it has.
    """
    if isinstance(roster, list) and all(isinstance(one, str) for one in roster):
        team = [str(one) for one in roster]
    elif isinstance(roster, Mapping) and all(isinstance(n, int) and n > 0 for n in roster.values()):
        team = [str(name) for name, count in roster.items() for _ in range(count)]
    else:
        raise UsageError(f"roster is {roster!r}, expected classes and how many of each, as {{P2AT: 4}}")
    if not team:
        raise UsageError("roster is empty, expected at least one robot")
    names = {field.name for field in fields(task)}
    kinds = list(dict.fromkeys(ROBOTS.get(name).name for name in team))
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
    robot = ROBOTS.get(name)
    if flies(robot):
        return "flying"
    return "tracked" if set(FLIPPERS) <= {part.name for part in robot_parts(robot)} else "wheeled"


def _physics(settings: CellSettings, task: Task) -> Physics:
    named = settings.get("physics", task.physics)
    if not isinstance(named, str | Physics):
        raise UsageError(f"physics is {named!r}, expected one of {', '.join(PHYSICS.names())}")
    base = PHYSICS.get(named) if isinstance(named, str) else named
    return replace(base, **parts_of(settings, "physics"))


def _with_radio(settings: CellSettings, task: Task) -> tuple[Task, dict[str, tuple[float, float]]]:
    """Return the task with its radio, and the constants of that which are data."""
    said = parts_of(settings, "radio")
    for name, value in said.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise UsageError(f"radio.{name} is {value!r}, expected a number")
    if not said:
        return task, {}
    radio = replace(task.radio or RadioSettings(), **said)
    data = {f"radio_{name}": (float(said[name]), float(said[name])) for name in RADIO_AS_DATA if name in said}
    return replace(task, radio=radio), data


def _with_ranges(
    settings: CellSettings, task: Task, radio: Mapping[str, tuple[float, float]]
) -> tuple[Task, dict[str, tuple[float, float]]]:
    """Return the task with its domain randomisation, and the ranges of that as data."""
    said, given = parts_of(settings, "vary"), dict(radio)
    classes = said.pop("classes", [])
    for name, value in said.items():
        span = tuple(value) if isinstance(value, list) else (value, value)
        if name in radio:
            raise UsageError(f"{name.replace('_', '.', 1)} and vary.{name} are both said: say one")
        given[name] = span  # type: ignore - what is no range is refused below
    if not given:
        return task, {}
    base = task.vary or DomainRandomization()
    vary = replace(base, **given, classes=tuple(classes) or base.classes)
    data = {
        name: (float(span[0]), float(span[1]))
        for name in QUANTITY_RULES
        if (span := vary.range_of(name)) is not None and name not in STATIC_RANGES
    }
    return replace(task, vary=vary), data


def _arenas(settings: CellSettings, task: Task) -> Any:  # noqa: ANN401 - specs of generated ones, else a name
    """Return the arenas of a cell's episodes, level by level in turn; or the one that it has."""
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
        return recipe if isinstance(recipe, str | ArenaSpec) else tuple(recipe)
    recipe = resolve_arenas(_said_recipe(recipe, said), robot, len(task.robots))
    return _generated(recipe, int(settings["episodes"]), "count" in said)


def _said_recipe(recipe: GeneratedArenas, said: dict[str, Any]) -> GeneratedArenas:
    if "level" in said:
        level = said.pop("level")
        if isinstance(level, bool) or not isinstance(level, int | float):
            raise UsageError(f"arena.level is {level!r}, expected a number from 0 to 1")
        said["levels"] = (float(level),)
    if "size" in said:
        said["size"] = tuple(said["size"]) if isinstance(said["size"], list) else said["size"]
        said["sizes"] = ()  # the task's own would go before
    known = {field.name for field in fields(recipe)}
    if missing := sorted(set(said) - known):
        raise UsageError(f"arena.{missing[0]}: the arenas of this task have: {', '.join(sorted(known))}")
    try:
        return replace(recipe, **said)
    except TypeError as error:
        raise UsageError(f"arena: {error}") from error


@lru_cache(maxsize=64)
def _generated(recipe: GeneratedArenas, episodes: int, counted: bool) -> tuple[ArenaSpec, ...]:
    """Return as many arenas as there are episodes, at most, of all levels in turn."""
    levels = len(recipe.levels)
    count = recipe.count if counted else -(-episodes // levels)
    try:
        made = replace(recipe, count=count).arenas()
    except (TypeError, ValueError) as error:
        raise UsageError(f"arena: {error}") from error
    order = [level * count + place for place in range(count) for level in range(levels)]
    return tuple(made[i] for i in order[:episodes])


def signature_of(cell: Resolved, engine: str) -> dict[str, Hashable]:
    """Return what must be alike in a batch, by what people call it.

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
        if field.name not in ("arena", "radio", "vary", "physics")
    }
    radio = task.radio
    if radio is not None and cell.ranges:
        data = [name for name in RADIO_AS_DATA if f"radio_{name}" in cell.ranges]
        radio = replace(radio, **dict.fromkeys(data, 0.0))
    varied = () if vary is None else tuple(name for name in QUANTITY_RULES if vary.range_of(name))
    static = () if vary is None else (*(vary.range_of(name) for name in STATIC_RANGES), vary.classes)
    return {
        "engine": engine,
        "task": cell.settings["task"].lower(),
        "team and fields of the task": repr(sorted(compiled.items(), key=lambda row: row[0])),
        "arena": repr(task.arena) if cell.arenas is None else arena_shape(cell.arenas),
        "radio": repr(radio),
        "physics": repr(task.physics),
        "what varies": (varied, repr(static)),
        "policy": repr(cell.driver.shape),
        "episodes": cell.episodes,
    }


@lru_cache(maxsize=256)
def arena_shape(arenas: tuple[ArenaSpec, ...]) -> Hashable:
    """Return what arenas must have in common to be data, beside the number of their boxes."""
    found = arena_set(arenas)
    states, template = found.states, found.template
    counts = tuple(
        np.shape(one)[1:]
        for one in (states.victims.size, states.victims.part, states.tags.pos, states.lamps, states.present)
    )
    forms = tuple(dict.fromkeys((shape.surface, shape.material) for shape in template.shapes))
    starts = {len(arena.starts) for arena in arenas}
    return (arenas[0].floor, arenas[0].has_floor, template.extent, counts, forms, min(starts))
