"""Exchanges of controllers with a server, written down: what is said, and what must come back.

A line begins with `>`: the client says it; with `~`: so many simulated seconds go by; with `<`: the server
says it, where `#` stands for a number and `#*` for numbers with commas between them; with `#`: nothing. Lines
of one shape stand there once in a step, however often they come.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent
NUMBER = r"-?\d+(?:\.\d+)?"


@dataclass
class Step:
    """What the client says, or how long it waits, and the shapes of the lines that come back."""

    say: str = ""
    wait: float = 0.0
    answers: list[str] = field(default_factory=list)


@dataclass
class Transcript:
    """A dialogue: how the client's lines end, what the server is set to speak, and the steps."""

    ends: bytes = b"\r\n"
    dialect: str = "manual"
    steps: list[Step] = field(default_factory=list)


def read_transcript(name: str | Path) -> Transcript:
    """Return the transcript of a file: one of this folder by its name, or any."""
    transcript = Transcript()
    file = name if isinstance(name, Path) else HERE / f"{name}.txt"
    for line in file.read_text().splitlines():
        mark, _, rest = line.partition(" ")
        if mark == ">":
            transcript.steps.append(Step(say=rest))
        elif mark == "~":
            transcript.steps.append(Step(wait=float(rest)))
        elif mark == "<":
            transcript.steps[-1].answers.append(rest)
        elif mark == "ends:":
            transcript.ends = rest.encode().decode("unicode_escape").encode()
        elif mark == "dialect:":
            transcript.dialect = rest
        else:
            assert mark in ("", "#"), line
    return transcript


def shape_of(line: str) -> str:
    """Return a line with its numbers left out, so that two of a kind are the same."""
    words = re.sub(rf"(?<=[ ,]){NUMBER}(?=[ ,}}])", "#", line)
    return re.sub(r"#(?:,#)+", "#*", words)


def shapes_of(lines: list[str]) -> list[str]:
    """Return the shapes of lines, each once, in the order in which they came first."""
    return list(dict.fromkeys(shape_of(line) for line in lines))
