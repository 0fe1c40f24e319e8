"""Optional packages: the pip command that adds extras, and imports without notes on missing ones.

The project owns no name on a package index: `pip install usarmjx[...]` fails, or installs a stranger's code.
"""

import builtins
import json
import sys
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

PACKAGE = Path(__file__).resolve().parents[1]
"""Folder of the package."""


def install_command(*extras: str) -> str:
    """Return the command that installs extras beside what is there."""
    names = f"[{','.join(extras)}]" if extras else ""
    root = PACKAGE.parent
    # Only a checkout has both files beside the package.
    if (root / "pyproject.toml").is_file() and (root / "constraints.txt").is_file():
        if Path.cwd() == root:
            return f'pip install -c constraints.txt -e ".{names}"'
        return f'pip install -c "{root / "constraints.txt"}" -e "{root}{names}"'
    return f'pip install "{_wheel()}{names}"'


def _wheel() -> str:
    """Return the path of the wheel that was installed, else the name of the wheel of this version."""
    try:
        # pip notes there from which file or address it installed a package (PEP 610).
        record = json.loads(metadata.distribution("usarmjx").read_text("direct_url.json") or "{}")
        path = unquote(urlsplit(str(record.get("url", ""))).path)
    except (metadata.PackageNotFoundError, ValueError, AttributeError):
        path = ""
    # An import of the package above would make everything that needs errors depend on all of it.
    version = sys.modules["usarmjx"].__version__
    return path if path.endswith(".whl") else f"usarmjx-{version}-py3-none-any.whl"


NOTE = "Failed to import"


class _Filter:
    """The replacement of `print` while a thread imports; others print as usual."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._usual: Callable[..., Any] = builtins.print

    def begin(self) -> None:
        """Drop notes until the last user ends."""
        with self._lock:
            self._users += 1
            # Only the first: a second one would take our function for the usual one, which then calls itself.
            if self._users == 1:
                self._usual, builtins.print = builtins.print, self._print_other

    def end(self) -> None:
        """Print notes again, unless another user goes on."""
        with self._lock:
            self._users -= 1
            if not self._users:
                builtins.print = self._usual

    def _print_other(self, *words: object, **options: object) -> None:
        if not (words and str(words[0]).startswith(NOTE)):
            self._usual(*words, **options)


_FILTER = _Filter()


@contextmanager
def without_notes() -> Generator[None]:
    """Drop what MJX prints of optional packages."""
    _FILTER.begin()
    try:
        yield
    finally:
        _FILTER.end()
