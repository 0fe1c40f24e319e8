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
REPORTS = re.compile(r"(?:STA|SEN|MISSTA|ASTA) ")
"""Lines that come as time goes by; others answer what was said, however long that took the server."""
TIME = re.compile(r"\{Time ([\d.]+)\}")
SHORTEST_PAUSE = 0.1  # s: the finest that is written down


def take(recorded, about="", dialect="manual"):
    """Return the text of a transcript of these tests for recorded lines.

    Pauses are simulated time, by the stamps of reports, from the last report before a saying: so sensors with
    longer intervals keep their order. The first pause, with no report before it, is of the recorder's clock.
    """
    steps, last, start, stamp = [], None, None, None
    for number, line in enumerate(recorded.splitlines(), start=1):
        match = RECORD.fullmatch(line)
        if match is None:
            raise ValueError(f"line {number} is none of a record: {line}")
        when, direction, text = match.groups()
        now = datetime.fromisoformat(when)
        if direction == ">":
            answers: list[str] = []
            steps.append((f"> {text}", answers))
            last, start = now, stamp
        elif direction == "#" or not steps:  # the greeting is tested by itself
            continue
        elif REPORTS.match(text) is None:
            answers.append(text)
        else:
            passed = (now - last).total_seconds()
            if found := TIME.search(text):
                stamp = float(found[1])
                passed = passed if start is None else stamp - start
            pause = f"~ {max(passed, SHORTEST_PAUSE):.1f}"
            if steps[-1][0].startswith(">"):
                steps.append((pause, []))
            elif found:
                steps[-1] = (pause, steps[-1][1])
            steps[-1][1].append(text)
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
