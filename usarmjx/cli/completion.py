"""Names that a shell completes: those of the registries, kept in a file; registries take seconds to import.

A change of the package's folders of robots, arenas, tasks, kinds, engines or policies makes the file anew.
"""

import hashlib
import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from usarmjx.base.errors import WriteError
from usarmjx.base.files import atomic_write

PACKAGE = Path(__file__).parents[1]
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
    file = folder / f"names-{_fingerprint()}.json"
    # The reader of other JSON files takes a tenth of a second to import, at each press of a key.
    with suppress(OSError, ValueError):
        checksum, _, text = file.read_text().partition("\n")
        if checksum == _checksum(text):
            return list(json.loads(text)[kind])
    try:
        names = _asked()
    except (OSError, ValueError, subprocess.SubprocessError):
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
    code = "import json; from usarmjx.cli.completion import registered_names as f; print(json.dumps(f()))"
    environment = {name: text for name, text in os.environ.items() if name != "_USARMJX_COMPLETE"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=MOST_SECONDS,
        check=True,
        env=environment,
    )
    return json.loads(done.stdout.splitlines()[-1])


def _fingerprint() -> str:
    """Return a hash of the files that define names: their paths, sizes and times."""
    files = [file for folder in FOLDERS for file in sorted((PACKAGE / folder).rglob("*")) if file.is_file()]
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
