"""MJX, imported without its notes on the standard output that Warp is missing."""

import builtins
from collections.abc import Generator
from contextlib import contextmanager

__all__ = ["collision_driver", "mjx"]

NOTE = "Failed to import"


@contextmanager
def _without_notes() -> Generator[None]:
    """Drop what MJX prints of optional packages; other threads print as usual."""
    usual = builtins.print

    def print_other(*words: object, **options: object) -> None:
        if not (words and str(words[0]).startswith(NOTE)):
            usual(*words, **options)  # pyright: ignore[reportCallIssue, reportArgumentType]

    builtins.print = print_other
    try:
        yield
    finally:
        builtins.print = usual


with _without_notes():
    from mujoco import mjx
    from mujoco.mjx._src import collision_driver
