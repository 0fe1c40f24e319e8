"""The package `benchmarks`, which a checkout has and an installed wheel has not."""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import typer

import usarmjx
from usarmjx.base.errors import UsageError
from usarmjx.cli.common import ErrorExit

ROOT = Path(usarmjx.__file__).resolve().parents[1]
"""Folder of the package: of a checkout, or of installed packages."""


def has_benchmarks() -> bool:
    """Return whether the package stands in a checkout, beside its benchmarks."""
    return (ROOT / "benchmarks" / "commands.py").is_file()


def import_benchmarks(name: str) -> ModuleType:
    """Import a module of the checkout's package `benchmarks`.

    Raises:
        UsageError: There is no checkout; names what to do.
    """
    if not has_benchmarks():
        raise UsageError(
            "benchmarks are a folder of the sources, which no wheel has: clone the repository and run "
            "`python3 dev.py bench` there"
        )
    # A folder of the same name where Python runs, or an installed package, must not pass for ours.
    sys.path.insert(0, str(ROOT))
    try:
        return import_module(name)
    finally:
        sys.path.remove(str(ROOT))


def needs_checkout(name: str, summary: str) -> Any:  # noqa: ANN401 - click's command, or typer's own copy
    """Return a command that takes any words and ends with the line of `import_benchmarks`."""
    stub = typer.Typer(add_completion=False)
    anything = {"allow_extra_args": True, "ignore_unknown_options": True}

    @stub.command(name, help=f"{summary} Needs a checkout.", context_settings=anything)
    def refuse() -> None:
        with ErrorExit():
            import_benchmarks("benchmarks")

    return typer.main.get_command(stub)
