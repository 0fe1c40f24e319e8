"""MultiView: the cameras of several robots in one picture (manual 3.2.6)."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from usarmjx.base.errors import SpecError
from usarmjx.models.ini.parse import read_ini
from usarmjx.models.ini.read import as_bool, as_whole, fail

SECTION = "USARBot.MultiView"
KEYS = {
    "cameranum": "camera_num",
    "widemode": "wide_mode",
    "cameraxres": "camera_x_res",
    "camerayres": "camera_y_res",
}
LOCKED = "iscameralocked"
"""A key without a meaning here: it is for Unreal's zone optimisation (manual 3.2.6.3)."""


@dataclass(frozen=True)
class MultiView:
    """How the picture is divided (manual 3.2.6.3).

    Attributes:
        camera_num: Most cameras at once.
        wide_mode: Number of columns; 0 for a box pattern.
        camera_x_res: Width of a robot's picture [pixels], if all of them fit.
        camera_y_res: Its height.
    """

    camera_num: int = 4
    wide_mode: int = 0
    camera_x_res: int = 320
    camera_y_res: int = 240

    @property
    def columns(self) -> int:
        """How many pictures are side by side."""
        return self.wide_mode or math.ceil(math.sqrt(self.camera_num))

    @property
    def rows(self) -> int:
        """How many rows of them there are."""
        return -(-self.camera_num // self.columns)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the whole at full resolution."""
        return self.columns * self.camera_x_res, self.rows * self.camera_y_res

    def tile(self, number: int, size: tuple[int, int]) -> tuple[int, int, int, int]:
        """Return left, top, width and height of a robot's picture.

        Pictures go from left to right, then down, from the top left corner on. If not all fit, they shrink
        and keep their shape.

        Args:
            number: Which one, from 0: the View of the robot's STA.
            size: Width and height of the whole.
        """
        shrink = min(1.0, size[0] / self.size[0], size[1] / self.size[1])
        width = max(1, math.floor(self.camera_x_res * shrink + 1e-9))
        height = max(1, math.floor(self.camera_y_res * shrink + 1e-9))
        return number % self.columns * width, number // self.columns * height, width, height


def read_multi_view(paths: Iterable[str | Path]) -> MultiView:
    """Return what `[USARBot.MultiView]` of ini files says; a later file overrides.

    Raises:
        SpecError: A file cannot be read, or the section has a wrong key or value; names file and line.
    """
    values: dict[str, int] = {}
    for path in paths:
        for line in read_ini(Path(path)).section(SECTION).lines:
            key = line.key.lower()
            if key == LOCKED:
                as_bool(line, line.value, line.key)
            elif key in KEYS:
                values[KEYS[key]] = as_whole(line, 0 if key == "widemode" else 1, 4096)
            else:
                fail(
                    line,
                    f"[{SECTION}] has no key {line.key}",
                    "CameraNum, WideMode, CameraXres or CameraYres",
                )
    multi = MultiView(**values)
    if max(multi.size) > 1 << 14:
        raise SpecError(f"[{SECTION}]: {multi.size[0]} x {multi.size[1]} pixels are too many")
    return multi
