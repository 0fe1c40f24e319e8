"""What of a robot's cameras is shown, and whose view an image client has: what SET changes (manual 9.4)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from usarmjx.base.errors import PeerError
from usarmjx.server.protocol.reports import STATUS_FAILED, STATUS_OK

SINGLE, QUAD = "SingleView", "QuadView"
CONFIGS = {"0": SINGLE, "singleview": SINGLE, "1": QUAD, "quadview": QUAD}
DISABLE, DISABLED, UNKNOWN_CAMERA = "disable", "Disabled", "None"
"""What switches a viewport off, how that is reported, and what one with an unknown camera reports."""
VIEWPORT_COUNT = 4


@dataclass
class Viewports:
    """A robot's viewports.

    Attributes:
        config: `SINGLE`, where the first fills the picture, or `QUAD`, where each has a quarter.
        shown: Name of the camera of each of the four, `DISABLED` or `UNKNOWN_CAMERA`.
    """

    config: str
    shown: list[str]

    @classmethod
    def of(cls, cameras: Sequence[str]) -> "Viewports":
        """Return those that a robot with these cameras starts with: four with more than one camera."""
        return cls(
            QUAD if len(cameras) > 1 else SINGLE, [*cameras, *[DISABLED] * VIEWPORT_COUNT][:VIEWPORT_COUNT]
        )

    def arrange(
        self, cameras: Sequence[str], config: str, changes: Sequence[tuple[int, str]]
    ) -> tuple[str, list[str]]:
        """Change them.

        Args:
            cameras: Names of the robot's cameras.
            config: A key of `CONFIGS` in any case; "" keeps what there is.
            changes: Number of a viewport, from 1, and the name of a camera or `DISABLE`, in any case.

        Returns:
            The status of the configuration, and of each viewport.
        """
        known = {name.lower(): name for name in reversed(cameras)} | {DISABLE: DISABLED, "disabled": DISABLED}
        status = STATUS_OK if not config or config.lower() in CONFIGS else STATUS_FAILED
        self.config = CONFIGS.get(config.lower(), self.config)
        for number, name in changes:
            self.shown[number - 1] = known.get(name.lower(), UNKNOWN_CAMERA)
        return status, [STATUS_FAILED if shown == UNKNOWN_CAMERA else STATUS_OK for shown in self.shown]

    def tiles(self) -> tuple[tuple[str, int, int, int], ...]:
        """Return which cameras show where: name, column, row, and how many columns and rows there are."""
        if self.config == SINGLE:
            tiles = [(self.shown[0], 0, 0, 1)]
        else:
            tiles = [(name, index % 2, index // 2, 2) for index, name in enumerate(self.shown)]
        return tuple(tile for tile in tiles if tile[0] not in (DISABLED, UNKNOWN_CAMERA))


@dataclass
class ViewBindings:
    """Which image clients' views are bound to which robot's camera.

    Attributes:
        limit: Most of them.
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
        """Return robot and camera that a connection's view is bound to; one of its port counts first."""
        return self._bound.get(f"{address}:{port}", self._bound.get(address))
