"""Measurements of the reports that a robot gets beside an attack: waits, order and form."""

import re
from dataclasses import asdict, dataclass

LINE = re.compile(r"[A-Z]{2,8}( \{[^{}]*\})* *")
"""A whole message of Gamebots (manual 9.3): a type, and segments in braces."""
TIME = re.compile(r"\{Time ([0-9.]+)\}")
TOLERANCE = 0.0051  # s, of a simulated interval: times have two decimals


@dataclass
class Lap:
    """Measurements of a neighbour since its last line of output."""

    reports: int = 0
    """Lines STA and SEN."""
    gap: float = 0.0
    """Longest wait between two of them [s]."""
    processor: float = 0.0
    """Most time of the server's main thread on a processor between two of them [s]."""
    process: float = 0.0
    """Most time of all its threads [s]."""
    irregular: int = 0
    """Times of STA that do not follow the one before by the usual interval."""
    damaged: int = 0
    """Lines that are no message."""
    lost: int = 0
    """Connections that the server has closed."""


class GapMeter:
    """Measures the reports in a stream of bytes.

    Args:
        interval: Simulated time between two STA [s].
    """

    def __init__(self, interval: float = 0.2) -> None:
        self.interval = interval
        self.lap = Lap()
        self._rest = b""
        self._before: tuple[float, float, float] | None = None
        self._time: float | None = None

    def feed(self, data: bytes, now: float, processor: float, process: float) -> None:
        """Take bytes, their time of arrival, and the processor time of the server until then [s]."""
        *lines, self._rest = (self._rest + data).split(b"\r\n")
        for line in lines:
            self._line(line.decode("latin-1"), (now, processor, process))

    def finish(self, now: float, processor: float, process: float) -> dict[str, float]:
        """Return the measurements up to now, with an unfinished wait, and begin the next lap."""
        if self._before is not None:
            self._widen((now, processor, process))
        done, self.lap = asdict(self.lap), Lap()
        return done

    def forget(self) -> None:
        """Begin a new connection; its times do not continue those of the last one."""
        self._rest, self._time = b"", None

    def _line(self, line: str, mark: tuple[float, float, float]) -> None:
        if not LINE.fullmatch(line):
            self.lap.damaged += 1
        if not line.startswith(("STA ", "SEN ")):
            return
        self._widen(mark)
        self.lap.reports += 1
        self._before = mark
        if line.startswith("STA ") and (found := TIME.search(line)):
            time, before, self._time = float(found[1]), self._time, float(found[1])
            if before is not None and abs(time - before - self.interval) > TOLERANCE:
                self.lap.irregular += 1

    def _widen(self, mark: tuple[float, float, float]) -> None:
        gap, processor, process = (
            now - before for now, before in zip(mark, self._before or mark, strict=True)
        )
        self.lap.gap = max(self.lap.gap, gap)
        self.lap.processor = max(self.lap.processor, processor)
        self.lap.process = max(self.lap.process, process)
