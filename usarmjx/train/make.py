"""Environments by the name of their task."""

import hashlib
import importlib
import importlib.util
import math
import sys
import traceback
import warnings
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from usarmjx.base.compilation import NOTICE
from usarmjx.base.errors import UnknownNameError, UsageError, quoted
from usarmjx.base.settings import default_reader, validate
from usarmjx.base.settings.files import shown
from usarmjx.models.compile.physics import PHYSICS, Physics
from usarmjx.sim.calibration import build_calibrated
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Policy, Task
from usarmjx.train.task_names import full_name, is_own, path_of
from usarmjx.train.tasks import TASKS

MAX_NAME = 500
"""Longest name of a task that a file may give [characters]."""


def find_task(name: str) -> Task:
    """Return the task of a name, with its usual settings.

    A user's own one is made by its class without arguments. If that has a function `baseline` that takes an
    `Env` and returns a `Policy`, this is the baseline from now on; so is one of the old name `by_hand`.

    Raises:
        UnknownNameError: No such task of the package; lists those there are.
        UsageError: A user's own one without file or class, or with a fault; names it and its line.
    """
    if not is_own(name):
        return TASKS.get(name)
    place, _, wanted = name.rpartition(":")
    if not place:
        place, wanted = name, ""
    module = _module(name, place)
    if not wanted:
        raise UsageError(f"task {name}: name its class, as {name}:{next(iter(_tasks_in(module)), 'CLASS')}")
    found = getattr(module, wanted, None)
    if found is None:
        tasks = ", ".join(_tasks_in(module)) or "none"
        raise UsageError(f"task {name}: {place} has no {wanted!r}; its tasks: {tasks}")
    task = _made(name, found)
    make_baseline: Callable[[Env], Policy] | None = getattr(task, "baseline", None)
    if make_baseline is None and (make_baseline := getattr(task, "by_hand", None)) is not None:
        warnings.warn(
            f"task {name}: `by_hand` is called `baseline` since 0.1; the old name goes with 0.2",
            DeprecationWarning,
            stacklevel=2,
        )
    if make_baseline is not None:
        # Replaced, as an edited file is imported anew.
        BASELINES.replace(full_name(name), make_baseline)
    return task


def find_baseline(name: str, task: str | None = None) -> str:
    """Return the full name of a baseline, after importing the files of users' own tasks, which may have it.

    Args:
        name: Name of the baseline, or of a user's own task that has one.
        task: Name of the task to evaluate it on; None: its own.

    Raises:
        UnknownNameError: No such baseline; lists those there are.
        UsageError: An own task that has none, or cannot be imported.
    """
    for one in (name, task):
        if one is not None and is_own(one):
            find_task(one)
    if is_own(name) and full_name(name) not in BASELINES:
        raise UsageError(f"task {name} has no baseline: give its class a function baseline(env)")
    BASELINES.get(full_name(name))
    return full_name(name)


def check_named(name: str, source: str) -> None:
    """Refuse a task that only a file names, if its code does not run in this process already.

    Policies and runs come from other people; importing the task that one names would run their code.

    Args:
        name: Recorded name of the task.
        source: Run or policy that needs the task.

    Raises:
        UsageError: Names the missing file, or the option that names the task.
    """
    if not is_own(name):
        return
    if len(name) > MAX_NAME or not name.isprintable():
        raise UsageError(f"{source} names the task {shown(name)}, which no file or module has")
    place, _, wanted = name.rpartition(":")
    in_file = place.endswith(".py")
    if in_file and not path_of(place).is_file():
        raise UsageError(
            f"{source} is for the task {wanted} of {place}, which does not exist; if it has moved, add "
            f"--task FILE.py:{wanted}"
        )
    if (_module_name(path_of(place)) if in_file else place) not in sys.modules:
        raise UsageError(
            f"{source} names the task {shown(name)}, whose code it does not run by itself; if you trust that "
            f"code, name it: --task {shown(name)}"
        )


def file_of(name: str) -> Path | None:
    """Return the file that an own task is in; None: it is not named by one."""
    place = name.rpartition(":")[0]
    return path_of(place) if place.endswith(".py") else None


def _tasks_in(module: ModuleType) -> list[str]:
    """Return the names of the tasks that a module defines."""
    # Its own only, not the classes that it imports.
    return [
        name
        for name, value in vars(module).items()
        if isinstance(value, type) and issubclass(value, Task) and value.__module__ == module.__name__
    ]


def _made(name: str, found: object) -> Task:
    """Return the task that a class or an object stands for."""
    if isinstance(found, Task):
        return found
    if not (isinstance(found, type) and issubclass(found, Task)):
        kind = "a class" if isinstance(found, type) else f"of type {type(found).__name__}"
        raise UsageError(
            f"task {name}: that is {kind}, expected a class that extends usarmjx.train.envs.task.Task"
        )
    try:
        return found()
    except TypeError as error:  # an abstract one, or one with fields that have no value
        raise UsageError(f"task {name}: cannot be made without arguments: {quoted(error)}") from error


def _module(name: str, place: str) -> ModuleType:
    """Return a module, imported once for each content that its file had.

    Raises:
        UsageError: There is none, or importing it fails; names the line.
    """
    in_file = place.endswith(".py")
    if in_file and not path_of(place).is_file():
        raise UsageError(f"task {name}: there is no file {path_of(place)}")
    try:
        return _from_file(path_of(place)) if in_file else importlib.import_module(place)
    # A file that calls `sys.exit` when it is imported has a fault; it must not end the program.
    except (Exception, SystemExit) as error:
        raise UsageError(f"task {name}: {_fault(error, place)}") from error


class SourceLoader(SourceFileLoader):
    """Loader that compiles the source each time.

    Python takes compiled code for fresh if the source has the same size and changed in the same second.
    """

    def get_code(self, fullname: str) -> CodeType:
        """Return the code of the source as it is now."""
        del fullname
        return self.source_to_code(self.get_data(self.path), self.path)


def _module_name(path: Path) -> str:
    """Return the name of the module that a file with its content is imported as."""
    return f"usarmjx_own_{hashlib.sha256(bytes(path) + path.read_bytes()).hexdigest()[:16]}"


def _from_file(path: Path) -> ModuleType:
    known = _module_name(path)
    if known in sys.modules:
        return sys.modules[known]
    spec = importlib.util.spec_from_file_location(known, path, loader=SourceLoader(known, str(path)))
    assert spec is not None  # as the name ends in .py
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    if str(path.parent) not in sys.path:  # for modules beside it, as when Python runs the file
        # At the end: files beside it must not hide installed modules.
        sys.path.append(str(path.parent))
    sys.modules[known] = module  # where dataclasses look for annotations
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[known]
        raise
    return module


def _fault(error: BaseException, place: str) -> str:
    """Return in a line where an import failed, and why."""
    why = f"{type(error).__name__}: {quoted(error) if isinstance(error, Exception) else error}"
    if isinstance(error, SyntaxError) and error.lineno is not None:
        return f"{error.filename}, line {error.lineno}: {type(error).__name__}: {error.msg}"
    if not place.endswith(".py"):
        return f"cannot import {place}: {why}"
    # The last line within the file: deeper ones are in libraries.
    own = [one for one in traceback.extract_tb(error.__traceback__) if one.filename == str(path_of(place))]
    return f"{own[-1].filename}, line {own[-1].lineno}: {why}" if own else f"{path_of(place)}: {why}"


def make_task(name: str, **overrides: object) -> Task:
    """Return a task with overrides of its fields.

    Under other physics an action lasts as long as before, unless `repeat` is set too.

    Args:
        name: Name of a registered task, or of a user's own: `FILE.py:CLASS`, `MODULE:CLASS`.
        overrides: Overrides of the task's fields; see `Task` and the task's own.

    Raises:
        UnknownNameError: No such task, or a field that it does not have; lists those there are.
        UsageError: A user's own one that cannot be imported, or physics with no whole number of steps
            in an action; gives the reason.
    """
    task = find_task(name)
    known = sorted(field.name for field in fields(task))
    if bad := sorted(set(overrides) - set(known)):
        raise UnknownNameError(f"task {name} has no field {', '.join(bad)}; it has: {', '.join(known)}")
    chosen = replace(task, **overrides)
    validate(chosen)  # a task of one's own may have a `__post_init__` that does not
    if "physics" not in overrides or "repeat" in overrides:
        return chosen
    return replace(chosen, repeat=_steps_per_action(name, task, chosen.physics_settings))


def task_values(task: Task, texts: Mapping[str, str], where: str = "--set") -> dict[str, Any]:
    """Return overrides of a task's fields, for `make_task`, from texts by name.

    Args:
        task: The task.
        texts: Texts by name; those of nested settings have dots, as `radio.cutoff`, and change only these.
            Parts of `physics` change the settings of the name that is given beside them.
        where: Source of the texts, for messages.

    Raises:
        UnknownNameError: A field that the task does not have; lists those there are.
        UsageError: A value that is not allowed; names its limits.
    """
    named = texts.get("physics")
    if named is not None and any(name.startswith("physics.") for name in texts):
        texts = {name: text for name, text in texts.items() if name != "physics"}
        task = replace(task, physics=PHYSICS.get(named))
    else:
        task = replace(task, physics=task.physics_settings)
    return default_reader().text_values(type(task), texts, where=where, base=task)


def _steps_per_action(name: str, task: Task, physics: Physics) -> int:
    """Return the number of control steps of some physics that last as long as an action of a task."""
    lasts = task.repeat * task.physics_settings.period
    steps = round(lasts / physics.period)
    # Periods are decimal fractions: their multiples are off by rounding.
    if not math.isclose(steps * physics.period, lasts, rel_tol=1e-6):
        raise UsageError(
            f"an action of {name} lasts {lasts:g} s, which is no whole number of control steps of "
            f"{physics.period:g} s: set repeat, the control steps of an action, beside physics"
        )
    return steps


def build_env(
    task: Task, worlds: int, *, name: str, engine: str = "auto", seed: int = 0, first: int = 0
) -> Env:
    """Return the environment of a task, after measuring robots of which engine `planar` has no figures.

    The arguments are those of `Env`.

    Raises:
        UsageError: A scene that cannot be built, or not run on this engine.
    """
    env = build_calibrated(lambda: Env(task, worlds, name=name, engine=engine, seed=seed, first=first))
    _ = env.groups  # a task that cannot be observed is refused here, not in the first step
    return env


GUESSES = {"num_envs", "num_worlds", "n_envs", "batch_size"}
"""Names of the number of worlds in other libraries."""


def make(
    name: str,
    worlds: int = 1,
    engine: str = "auto",
    seed: int = 0,
    first: int = 0,
    **overrides: object,
) -> Env:
    """Return the environment of a task, as `make("drive-to-goal", worlds=64, engine="c", arena="maze")`.

    Args:
        name: Name of the task, case ignored; without a version it is the newest. Or of a user's own, as
            `my_task.py:MyTask`.
        worlds: Number of worlds.
        engine: `warp`, `jax`, `c`, or `auto`.
        seed: Seed of all random numbers, unless `reset` gets another.
        first: Number of the first world. World k is the same alone as in a batch.
        overrides: Overrides of the task's fields; see `Task` and the task's own.

    Raises:
        UnknownNameError: No such task, or a field that it does not have; lists those there are.
        UsageError: A scene that cannot be built, or not run on this engine.
    """
    if guessed := sorted(GUESSES & overrides.keys()):
        raise UsageError(f"{guessed[0]}: the argument is called worlds, as worlds=4")
    with NOTICE.building(f"make({name!r}, worlds={worlds}, engine={engine!r})"):
        task = make_task(name, **overrides)
        return build_env(task, worlds, name=full_name(name), engine=engine, seed=seed, first=first)
