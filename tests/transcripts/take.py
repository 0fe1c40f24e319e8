"""Make a test of a record of `usarmjx console --transcript`: `python -m tests.transcripts.take RECORD NAME`.

The new file lies beside the other transcripts, and `test_transcripts.py` plays it from then on. Lines that
the client said and pauses between them are played; answers are kept by their shapes. It is played on the
course of these tests: record on it, or correct the tags of start poses.
"""

import re
import sys
from datetime import datetime
from pathlib import Path

from tests.transcripts.transcript import HERE, shapes_of

RECORD = re.compile(r"(\S+Z) ([><#]) (.*)")
SHORTEST_PAUSE = 0.1  # s: less is the time that an answer takes


def take(recorded, about="", dialect="manual"):
    """Return the text of a transcript of these tests for recorded lines."""
    steps, last = [], None
    for number, line in enumerate(recorded.splitlines(), start=1):
        match = RECORD.fullmatch(line)
        if match is None:
            raise ValueError(f"line {number} is none of a record: {line}")
        when, direction, text = match.groups()
        if direction == "#":
            continue
        if direction == ">":
            steps.append((f"> {text}", []))
        elif not steps:  # the greeting is tested by itself
            continue
        else:
            now = datetime.fromisoformat(when)
            pause = (now - last).total_seconds()
            if pause >= SHORTEST_PAUSE and steps[-1][0].startswith(">"):
                steps.append((f"~ {pause:.1f}", []))
            elif steps[-1][0].startswith("~"):
                steps[-1] = (f"~ {pause:.1f}", steps[-1][1])
            steps[-1][1].append(text)
        if direction == ">":
            last = datetime.fromisoformat(when)
    lines = [
        f"# {about or 'Recorded by usarmjx console --transcript.'}",
        r"ends: \r\n",
        f"dialect: {dialect}",
    ]
    for said, heard in steps:
        lines += [said, *(f"< {shape}" for shape in shapes_of(heard))]
    return "\n".join(lines) + "\n"


def main(recorded, name, dialect="manual"):
    """Write the transcript of a record."""
    (HERE / f"{name}.txt").write_text(take(Path(recorded).read_text(), dialect=dialect))


if __name__ == "__main__":
    main(*sys.argv[1:])
