"""Settings of a robot's pictures that SET changes (manual 9.4): viewports, and views of image clients."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from usarmjx.base.errors import PeerError, SpecError
from usarmjx.models.ini.parse import as_bool, as_whole, fail, read_ini
from usarmjx.server.protocol.reports import STATUS_FAILED, STATUS_OK

SECTION = "USARBot.MultiView"
"""Section of the ini files (manual 3.2.6.3)."""
KEYS = {
    "cameranum": "camera_num",
    "widemode": "wide_mode",
    "cameraxres": "camera_x_res",
    "camerayres": "camera_y_res",
}
"""Keys of the section, lower case, and the fields of `MultiView`."""
LOCKED = "iscameralocked"
"""A key without a meaning here: it is for Unreal's zone optimisation (manual 3.2.6.3)."""
SINGLE, QUAD = "SingleView", "QuadView"
CONFIGS = {"0": SINGLE, "singleview": SINGLE, "1": QUAD, "quadview": QUAD}
"""Layouts by their number or name in lower case."""
DISABLE, DISABLED, UNKNOWN_CAMERA = "disable", "Disabled", "None"
"""Request that switches a viewport off, its report, and the report of an unknown camera."""
VIEWPORT_COUNT = 4


@dataclass(frozen=True)
class MultiView:
    """Division of the shared picture (manual 3.2.6.3).

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
        """Number of pictures in a row."""
        # The box pattern of WideMode 0 (manual 3.2.6.3): as near to a square as the cameras allow.
        return self.wide_mode or math.ceil(math.sqrt(self.camera_num))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return -(-self.camera_num // self.columns)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the whole at full resolution [pixels]."""
        return self.columns * self.camera_x_res, self.rows * self.camera_y_res

    def tile(self, number: int, size: tuple[int, int]) -> tuple[int, int, int, int]:
        """Return left, top, width and height of a robot's picture [pixels].

        Pictures go from left to right, then down, from the top left corner on. If not all fit, they shrink
        and keep their shape.

        Args:
            number: Index of the tile, from 0: the View of the robot's STA.
            size: Width and height of the whole.
        """
        shrink = min(1.0, size[0] / self.size[0], size[1] / self.size[1])
        # The margin keeps an exact product such as 319.9999999 from losing a pixel.
        width = max(1, math.floor(self.camera_x_res * shrink + 1e-9))
        height = max(1, math.floor(self.camera_y_res * shrink + 1e-9))
        return number % self.columns * width, number // self.columns * height, width, height


def read_multi_view(paths: Iterable[str | Path]) -> MultiView:
    """Read `[USARBot.MultiView]` of ini files; a later file overrides.

    Raises:
        SpecError: A file cannot be read, or the section has a wrong key or value; names file and line.
    """
    values: dict[str, int] = {}
    for path in paths:
        for line in read_ini(Path(path)).section(SECTION).lines:
            key = line.key.lower()
            if key == LOCKED:
                # Read only to refuse a wrong value, as with every other key.
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
    # A raw picture of 16384 pixels on each side has 805 MB, which no client reads.
    if max(multi.size) > 1 << 14:
        raise SpecError(f"[{SECTION}]: {multi.size[0]} x {multi.size[1]} pixels are too many")
    return multi


@dataclass
class Viewports:
    """Viewports of a robot.

    Attributes:
        config: `SINGLE`: the first fills the picture, or `QUAD`: each has a quarter.
        shown: Name of the camera of each of the four, `DISABLED` or `UNKNOWN_CAMERA`.
    """

    config: str
    shown: list[str]

    @classmethod
    def of(cls, cameras: Sequence[str]) -> "Viewports":
        """Return the initial viewports of a robot with these cameras: four with more than one camera."""
        return cls(
            QUAD if len(cameras) > 1 else SINGLE, [*cameras, *[DISABLED] * VIEWPORT_COUNT][:VIEWPORT_COUNT]
        )

    def arrange(
        self, cameras: Sequence[str], config: str, changes: Sequence[tuple[int, str]]
    ) -> tuple[str, list[str]]:
        """Change the layout and the cameras of viewports.

        Args:
            cameras: Names of the robot's cameras.
            config: A key of `CONFIGS` in any case; "" keeps the layout.
            changes: Number of a viewport, from 1, and the name of a camera or `DISABLE`, in any case.

        Returns:
            The status of the configuration, and of each viewport.
        """
        # Reversed, so that of cameras with one name the first counts.
        known = {name.lower(): name for name in reversed(cameras)} | {DISABLE: DISABLED, "disabled": DISABLED}
        # An unknown layout fails and leaves the present one; the viewports of the line count all the same.
        status = STATUS_OK if not config or config.lower() in CONFIGS else STATUS_FAILED
        self.config = CONFIGS.get(config.lower(), self.config)
        for number, name in changes:
            self.shown[number - 1] = known.get(name.lower(), UNKNOWN_CAMERA)
        return status, [STATUS_FAILED if shown == UNKNOWN_CAMERA else STATUS_OK for shown in self.shown]

    def tiles(self) -> tuple[tuple[str, int, int, int], ...]:
        """Return the visible tiles: camera, column, row, and the number of columns and rows."""
        if self.config == SINGLE:
            tiles = [(self.shown[0], 0, 0, 1)]
        else:
            # Viewport 2 is at the top right, 3 at the bottom left (manual 9.4).
            tiles = [(name, index % 2, index // 2, 2) for index, name in enumerate(self.shown)]
        return tuple(tile for tile in tiles if tile[0] not in (DISABLED, UNKNOWN_CAMERA))


@dataclass
class ViewBindings:
    """Cameras that the views of image clients are bound to.

    Attributes:
        limit: Largest number of bindings.
    """

    limit: int = 256
    _bound: dict[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])

    def bind(self, client: str, robot: str, camera: str) -> None:
        """Bind a client's view to a camera, or to the viewports of the robot if no camera is named.

        Raises:
            PeerError: There are too many.
        """
        if client not in self._bound and len(self._bound) >= self.limit:
            raise PeerError(f"{self.limit} views are tied already")
        self._bound[client] = (robot, camera)

    def unbind(self, client: str) -> None:
        """Unbind a client's view; nothing if it was not bound."""
        self._bound.pop(client, None)

    def get(self, address: str, port: int) -> tuple[str, str] | None:
        """Return robot and camera of a connection's view; a binding of its port comes before its address."""
        return self._bound.get(f"{address}:{port}", self._bound.get(address))
