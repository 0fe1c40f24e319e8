"""The command line: `app` lists the commands, and each has a file of its name (`list` is in `listing`).

A command's file holds its options and little else; heavy imports stand inside the functions, so that `--help`
answers at once. Options of several commands are fields of dataclasses in `serving_options`, `viewer_options`
and `task_options`, single ones are in `common`. `tables` prints docs/all-robots.md and the like,
`known_names` has the names that shells complete. A program that registers sensors or robots of its own runs
the commands with them by `main`. Begin with `serve`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.cli.app import main as main
else:
    __getattr__, __dir__, __all__ = attach(__name__, {"usarmjx.cli.app": ("main",)})
