"""A joystick by the system's device file, where there is one (Linux: /dev/input/js0)."""

import asyncio
import os
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from usarmjx.base.errors import UsageError
from usarmjx.console.driving import Pilot

FOLDER = Path("/dev/input")
EVENT = struct.Struct("=IhBB")
"""An event of the system: time [ms], value, kind, number (joystick-api.txt of the Linux kernel)."""
BUTTON, AXIS, AT_FIRST = 0x01, 0x02, 0x80
"""Kinds of events; `AT_FIRST` is added where it tells how things are when the file is opened."""
FULL = 32767
"""Value of an axis all the way."""
DEAD_ZONE = 0.15
"""A stick that is out of its middle by less rests there."""
ROUNDED = 20
"""Deflections are sent in so many steps: a stick that trembles sends nothing."""
TURN_AXIS, DRIVE_AXIS, CLIMB_AXIS, PAN_AXIS, TILT_AXIS = 0, 1, 3, 6, 7
"""Numbers of the axes: the stick, the second one up and down, and the POV button."""
BUTTONS = {0: "stop", 1: "light", 2: "zoom_in", 3: "zoom_out"}
"""What buttons do."""


def find_joystick(folder: Path = FOLDER) -> Path | None:
    """Return the first joystick that can be read; None: there is none."""
    return next((path for path in sorted(folder.glob("js[0-9]*")) if os.access(path, os.R_OK)), None)


@dataclass
class Stick:
    """Turns a joystick's events into lines to send.

    Attributes:
        pilot: Drives.
        axes: How far axes are from their middle, by number.
    """

    pilot: Pilot
    axes: dict[int, float] = field(default_factory=dict[int, float])
    _rest: bytes = b""

    def feed(self, data: bytes) -> list[str]:
        """Take bytes of the device; return what to send."""
        data = self._rest + data
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        before, lines = self._deflection(), list[str]()
        for _, value, kind, number in EVENT.iter_unpack(data[:whole]):
            lines += self._take(value, kind, number)
        after = self._deflection()
        return (self.pilot.steer(*after) if after != before else []) + lines

    def _take(self, value: int, kind: int, number: int) -> list[str]:
        if kind & ~AT_FIRST == AXIS:
            self.axes[number] = value / FULL
            if not kind & AT_FIRST and abs(value) > FULL / 2:
                if number == PAN_AXIS:
                    return self.pilot.press("pan_right" if value > 0 else "pan_left")
                if number == TILT_AXIS:
                    return self.pilot.press("tilt_down" if value > 0 else "tilt_up")
        elif kind == BUTTON and value and number in BUTTONS:
            return self.pilot.press(BUTTONS[number])
        return []

    def _deflection(self) -> tuple[float, float, float]:
        """Return how far to go ahead, to the left and up, -1 to 1; axes are positive right and back."""
        ahead, left, up = (self._axis(number) for number in (DRIVE_AXIS, TURN_AXIS, CLIMB_AXIS))
        return -ahead, -left, -up

    def _axis(self, number: int) -> float:
        value = self.axes.get(number, 0.0)
        return 0.0 if abs(value) < DEAD_ZONE else round(value * ROUNDED) / ROUNDED


class JoystickDevice:
    """A joystick's device file, read by the event loop.

    Args:
        path: The file.
        take: Takes its bytes; none when it has gone.

    Raises:
        UsageError: It cannot be read.
    """

    def __init__(self, path: Path, take: Callable[[bytes], None]) -> None:
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise UsageError(f"--joystick: cannot read {path}: {error.strerror}") from error
        self._take, self._loop = take, asyncio.get_running_loop()
        self._loop.add_reader(self._file, self._read)
        self._is_open = True

    def _read(self) -> None:
        try:
            data = os.read(self._file, EVENT.size * 64)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.close()
        self._take(data)

    def close(self) -> None:
        """Close the file."""
        if self._is_open:
            self._is_open = False
            self._loop.remove_reader(self._file)
            os.close(self._file)


def joystick_path(option: str, found: Callable[[], Path | None] = find_joystick) -> Path | None:
    """Return the joystick that an option asks for: `auto`, `off`, or a file; None: none.

    Raises:
        UsageError: There is no such file.
    """
    if option == "off":
        return None
    if option == "auto":
        return found()
    if not Path(option).exists():
        raise UsageError(f"--joystick: no {option!r}; expected auto, off or a device as /dev/input/js0")
    return Path(option)
