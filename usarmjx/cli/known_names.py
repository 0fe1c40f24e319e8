"""Names on a command line: checked before slow imports, and completed by a shell.

`known_names.json` has the names of the registries: `python -m usarmjx.cli.known_names` writes it anew, and a
test compares it with them. A name that it lacks but that some source has between quotes may be new: the
command looks it up in the registry then.

A shell completes names from a file of the cache, because registries take seconds to import. A change of the
package's folders of robots, arenas, tasks, kinds, engines or policies makes that file anew.
"""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from usarmjx.base.errors import UnknownNameError, UsageError, WriteError
from usarmjx.base.files import atomic_write
from usarmjx.base.registry import Registry, newest_versions, unknown_name
from usarmjx.models.files.resources import search_path
from usarmjx.train.policies import POLICIES, no_policy

if TYPE_CHECKING:
    from usarmjx.base.settings import FileValue


PACKAGE = Path(__file__).parents[1]
FILE = Path(__file__).with_suffix(".json")
REGISTRIES: Mapping[str, tuple[str, str]] = {
    "arena": ("usarmjx.models.arenas", "ARENAS"),
    "baseline": ("usarmjx.train.baselines", "BASELINES"),
    "engine": ("usarmjx.engines.base", "ENGINES"),
    "kind of arena": ("usarmjx.models.generate.kinds", "KINDS"),
    "lane": ("usarmjx.models.arenas.lanes", "LANES"),
    "robot": ("usarmjx.models.robots", "ROBOTS"),
    "task": ("usarmjx.train.tasks", "TASKS"),
}
"""Module and attribute of the registry of each kind of names."""
FROM_FILES = {"arena": "arena files", "robot": "robot files"}
"""Kinds whose values files may have, and the entry of the table with the files' suffixes."""
IN_FILES = {"arena": "arena", "engine": "engine", "task": "task"}
"""Keys of a sweep's file whose values are names, and their kinds."""
VERSIONED = ("task", "baseline")
"""Kinds of names of which some have versions."""
AUTO = "auto"
"""Name of no engine: the best one for a purpose."""
AGENTS = ("zero", "random")
"""Policies without training, see `usarmjx.train.policies.sources`."""
RUN_KINDS = ("client", "run")
"""Kinds of runs before a colon, beside baselines."""
RUN_WORDS = ("baseline", "packaged", "random", "by-hand", "shipped")
"""Policies of `usarmjx suite run` and of sweeps that each task has one of."""
TEAM_WORDS = ("random", "one", "baseline", "perfect-radio", "packaged")
"""Teams of `usarmjx teams` that are no policies."""
GOAL_TEAM_WORDS = ("frontier", "courier", "assignment", "rendezvous", "chain", "oracle")
"""Further ones of tasks whose robots choose goals."""
FOLDERS = ("models/robots", "models/arenas", "models/generate", "engines", "train/tasks", "train/policies")
"""Folders whose files define the names."""
MOST_SECONDS = 60
"""Longest that a shell waits for the registries [s]."""
LISTING_NAMES = (
    "arenas",
    "commands",
    "engines",
    "everything",
    "policies",
    "robots",
    "sensors",
    "settings",
    "tasks",
)
"""Words after `usarmjx list`."""


@cache
def table() -> dict[str, list[str]]:
    """Return names by kind, those of aliases by kind and `aliases`, and suffixes of files."""
    return json.loads(FILE.read_text(encoding="utf-8"))


def registered() -> dict[str, list[str]]:
    """Return the table of this package as it is; imports all registries."""
    from usarmjx.models.files.find_robot import ROBOT_SUFFIXES
    from usarmjx.models.files.load import SUFFIXES

    found: dict[str, list[str]] = {}
    for kind, (module, attribute) in REGISTRIES.items():
        registry = getattr(import_module(module), attribute)
        found[kind] = registry.names()
        found[f"{kind} aliases"] = registry.aliases()
    return {**found, "arena files": [*SUFFIXES], "robot files": [*ROBOT_SUFFIXES]}


def check_name(kind: str, name: str) -> None:
    """Refuse a name that no registry has; one that may be new, or that of a file, passes.

    Args:
        kind: A key of `REGISTRIES`.
        name: The name, case ignored.

    Raises:
        UnknownNameError: No such name; gives the closest one and all.
    """
    module, attribute = REGISTRIES[kind]
    names, aliases = table()[kind], table()[f"{kind} aliases"]
    if loaded := sys.modules.get(module):  # a program may have added names
        registry: Registry[object] = getattr(loaded, attribute)
        names, aliases = registry.names(), registry.aliases()
    names = [*([AUTO] if kind == "engine" else ()), *names]
    if name.lower() in {one.lower() for one in (*names, *aliases)} or _may_be_new(kind, name):
        return
    refusal = unknown_name(kind, name, names, aliases)
    files = table()[FROM_FILES[kind]] if kind in FROM_FILES else []
    raise UnknownNameError(f"{refusal}; or a file: {', '.join(files)}" if files else refusal)


def full_name(kind: str, name: str) -> str:
    """Return the name of the newest version for a bare name of tasks or baselines; others as they are."""
    module, attribute = REGISTRIES[kind]
    if loaded := sys.modules.get(module):
        registry: Registry[object] = getattr(loaded, attribute)
        return registry.full_name(name) if registry.versioned and name in registry else name
    return newest_versions(table()[kind]).get(name.lower(), name) if kind in VERSIONED else name


def _may_be_new(kind: str, name: str) -> bool:
    """Return whether a file, a program or a source that is newer than the table may have a name."""
    # A suffix is enough: the reader of the file says better why it cannot be read.
    if kind in FROM_FILES and (Path(name).suffix or Path(name).is_file()):
        return True
    if kind == "robot" and any(search_path()):
        return True
    if kind == "arena" and name.lower() in {one.lower() for one in table()["lane aliases"]}:
        return True
    if kind in ("task", "baseline") and (":" in name or name.endswith(".py")):
        return True
    module, _ = REGISTRIES[kind]
    # Its registry was asked above: the sources have no more.
    if module in sys.modules:
        return False
    folder = PACKAGE.joinpath(*module.split(".")[1:])
    sources = sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]
    # Registries take their names as texts in double quotes, as the formatter writes them.
    quoted = f'"{name.lower()}"'
    return any(quoted in file.read_text(encoding="utf-8").lower() for file in sources)


def check_roster(roster: str, others: Iterable[object] | None = None) -> None:
    """Refuse a roster, as P2AT:4,P2DX:2, with a class of robots that there is not.

    Args:
        roster: The roster.
        others: Files that bring classes of their own; with one, any class may be theirs.

    Raises:
        UnknownNameError: No such class; gives the closest one and all.
    """
    if not [*(others or ())]:
        for part in filter(None, (part.strip() for part in roster.split(","))):
            check_name("robot", part.partition(":")[0])


def check_policy(policy: str, words: Sequence[str] = ()) -> None:
    """Refuse a policy that is no run, no file, no function and not packaged.

    Args:
        policy: As `usarmjx eval` takes it.
        words: Further names that the command takes.

    Raises:
        UnknownNameError: There is nothing of that name; gives the closest one and all.
    """
    name = full_name("task", policy)
    if Path(policy).exists() or ".py:" in policy or name in POLICIES or policy in words:
        return
    if "=" not in policy:
        teams = f"{policy} is none of the teams {', '.join(words)}; " if words else ""
        raise UnknownNameError(teams + no_policy(name, POLICIES, words))
    for part in policy.split(","):
        if source := part.partition("=")[2].strip():
            check_policy(source)


def check_run(run: str) -> None:
    """Refuse a run of a method that is nowhere.

    Args:
        run: As `usarmjx suite run` takes it: a policy, or `KIND:VALUE`; `{task}` stands for each task.

    Raises:
        UnknownNameError: There is nothing of that name; gives the closest one and all.
        UsageError: A function's file is not there.
    """
    kind, _, value = run.partition(":")
    if kind == "baseline" and value:
        check_name("baseline", value)
        return
    file, own, _ = run.rpartition(".py:")
    # With {task} in its name there is a file for each task, which is looked for when the task is played.
    if own and "{task}" not in file and not Path(f"{file}.py").is_file():
        raise UsageError(f"{file}.py: there is no such file")
    name = full_name("task", run)
    words = (*RUN_WORDS, *GOAL_TEAM_WORDS)
    known = run in words or name in POLICIES or Path(run).exists()
    if not (known or own or "{task}" in run or (kind in RUN_KINDS and value)):
        raise UnknownNameError(no_policy(name, POLICIES, words))


def check_file(found: "FileValue") -> None:
    """Refuse the file of a sweep that names a task, an arena, an engine or a robot that there is not.

    Raises:
        UsageError: Names file, line, the closest name and all.
    """
    if isinstance(found.data, list):
        for item in found.items():
            check_file(item)
    if not isinstance(found.data, dict):
        return
    for key, value in found.mapping().items():
        check_file(value)
        named = value.items() if isinstance(value.data, list) else [value]
        names = [(one, one.data) for one in named] if key in IN_FILES else []
        classes = value.mapping() if key == "roster" and isinstance(value.data, dict) else {}
        for place, name in [*names, *((one, robot) for robot, one in classes.items())]:
            if isinstance(name, str):
                try:
                    check_name(IN_FILES.get(key, "robot"), name)
                except UnknownNameError as error:
                    raise place.error(str(error)) from error


def registered_names() -> dict[str, list[str]]:
    """Return the names of all registries, by kind; imports JAX."""
    from usarmjx.engines import ENGINES
    from usarmjx.models.arenas import ARENAS
    from usarmjx.models.generate import KINDS
    from usarmjx.models.robots import ROBOTS
    from usarmjx.train.policies import POLICIES
    from usarmjx.train.tasks import TASKS

    bare = TASKS.aliases()
    return {
        "arenas": [*ARENAS.names(), *(alias for _, arena in ARENAS for alias in arena.aliases)],
        "robots": ROBOTS.names(),
        "tasks": sorted([*TASKS.names(), *bare]),
        "policies": sorted([*POLICIES.names(), *(one for one in bare if TASKS.full_name(one) in POLICIES)]),
        "engines": ["auto", *ENGINES.names()],
        "kinds": KINDS.names(),
    }


def names_of(kind: str) -> list[str]:
    """Return the names of a kind from the file, after making it if there is none of the package as it is."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "usarmjx"
    # With the fingerprint in the name, two versions of the package do not replace each other's file.
    file = folder / f"names-{_fingerprint()}.json"
    # The reader of other JSON files takes a tenth of a second to import, at each press of a key.
    with suppress(OSError, ValueError):
        checksum, _, text = file.read_text().partition("\n")
        # Two shells may write at once, or a disk be full: a file that is not whole counts as none.
        if checksum == _checksum(text):
            return list(json.loads(text)[kind])
    try:
        names = _asked()
    except (OSError, ValueError, subprocess.SubprocessError):
        # No completion is better than a traceback in the line that is being typed.
        return []
    with suppress(OSError, WriteError):  # a shell completes without the file, too, only slower
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_write(file) as fresh:
            text = json.dumps(names)
            fresh.write_text(f"{_checksum(text)}\n{text}")
    return names[kind]


def _checksum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _asked() -> dict[str, list[str]]:
    """Return the names of all registries from a process of its own: one that completes imports no JAX."""
    code = "import json; from usarmjx.cli.known_names import registered_names as f; print(json.dumps(f()))"
    # With the variable the process would complete a command line itself instead of running the code.
    environment = {name: text for name, text in os.environ.items() if name != "_USARMJX_COMPLETE"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=MOST_SECONDS,
        check=True,
        env=environment,
    )
    # The last line: libraries may print others while they are imported.
    return json.loads(done.stdout.splitlines()[-1])


def _fingerprint() -> str:
    """Return a hash of the files that define names: their paths, sizes and times."""
    files = [file for folder in FOLDERS for file in sorted((PACKAGE / folder).rglob("*")) if file.is_file()]
    # Compiled files change with every import, and define no names.
    kept = [(file, file.stat()) for file in files if "__pycache__" not in file.parts]
    rows = [(str(file), one.st_size, one.st_mtime_ns) for file, one in kept]
    return hashlib.sha256(repr(rows).encode()).hexdigest()[:16]


def complete_listings(incomplete: str) -> list[str]:
    """Return the listings whose names begin so."""
    return [name for name in LISTING_NAMES if name.startswith(incomplete)]


def complete_arenas(incomplete: str) -> list[str]:
    """Return the arenas whose names begin so."""
    return _beginning("arenas", incomplete)


def complete_robots(incomplete: str) -> list[str]:
    """Return the robot classes whose names begin so."""
    return _beginning("robots", incomplete)


def complete_tasks(incomplete: str) -> list[str]:
    """Return the tasks whose names begin so."""
    return _beginning("tasks", incomplete)


def complete_policies(incomplete: str) -> list[str]:
    """Return the packaged policies whose names begin so."""
    return _beginning("policies", incomplete)


def complete_engines(incomplete: str) -> list[str]:
    """Return the engines whose names begin so."""
    return _beginning("engines", incomplete)


def complete_kinds(incomplete: str) -> list[str]:
    """Return the kinds of generated arenas whose names begin so."""
    return _beginning("kinds", incomplete)


def _beginning(kind: str, incomplete: str) -> list[str]:
    return [name for name in names_of(kind) if name.startswith(incomplete)]


def main() -> None:
    """Write the table anew."""
    with atomic_write(FILE) as fresh:
        fresh.write_text(json.dumps(registered(), indent=1) + "\n", encoding="utf-8")
    print(f"wrote {FILE}")


if __name__ == "__main__":
    main()
