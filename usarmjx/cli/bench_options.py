"""Options that all commands of `usarmjx bench` have in common, by one name each."""

from pathlib import Path
from typing import Annotated

import typer

from usarmjx.base.errors import UsageError

JsonOption = Annotated[Path | None, typer.Option(help="Append the record to this file.")]
NoteOption = Annotated[str, typer.Option(help="What a reader of the record must know.")]
StepsOption = Annotated[int, typer.Option(min=1, help="Control steps, scans or rounds of a repeat.")]
RepeatsOption = Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")]
BaselinesOption = Annotated[
    str,
    typer.Option(help="What is measured beside it: all, cpu (C MuJoCo on all cores, not bare MJX) or none."),
]
RosterOption = Annotated[str, typer.Option(help="Robots of each world, as P2AT:4,Zerg:2.")]
SceneArenaOption = Annotated[str, typer.Option(help="Arena name, or with --generated the kind.")]
GeneratedOption = Annotated[
    int, typer.Option(min=0, help="So many generated arenas, which the worlds have in turn.")
]
SizeOption = Annotated[
    str | None,
    typer.Option(help="Cells of a generated arena, as 12x8; else 8x6, or 3 for each robot of a larger team."),
]
RadioOption = Annotated[bool, typer.Option("--radio", help="Evaluate all radio links too.")]
PhysicsOption = Annotated[
    str,
    typer.Option(help="Settings of the physics: reference, fast, sleeping (warp), coarse (planar)."),
]
SubstepsOption = Annotated[
    int | None, typer.Option(min=1, help="Physics steps per control step; else those of 50 ms.")
]
LimitOption = Annotated[float, typer.Option(min=1.0, help="Seconds after which a wait is given up.")]


def one_class(roster: str) -> tuple[str, int]:
    """Return the class of a roster's robots, and how many there are.

    Raises:
        UsageError: They are of several classes, or there are none.
    """
    from usarmjx.server.worlds.make import parse_roster

    names = parse_roster(roster)
    if len({*names}) != 1:
        raise UsageError(f"--roster: expected robots of one class, as P2AT:16; got {roster!r}")
    return names[0], len(names)
