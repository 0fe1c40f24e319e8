"""The exception tree of usarmjx.

UsarmjxError
├── UsageError              our caller's fault: propagates
│   ├── UnknownNameError    a name that no registry entry has
│   ├── SpecError           a robot, arena or scene description that cannot be built
│   │   ├── ArenaFileError            an arena's file that does not read
│   │   ├── UnsupportedFeatureError   the chosen engine would ignore or refuse it
│   │   └── UnsupportedGeomError      a geom type that the raycaster cannot hit
│   ├── EngineError         the engine cannot run here, or overflowed its buffers
│   └── WriteError          a file that cannot be written: no room, no right
└── PeerError               a network peer's fault: logged, the peer is dropped, nobody else notices
"""

from importlib.util import find_spec
from types import TracebackType

LONGEST = 200
"""So much of what others' exceptions say is quoted [characters]."""


class UsarmjxError(Exception):
    """Base of everything that usarmjx raises on purpose."""


def one_line(error: Exception) -> str:
    """Return what somebody else's exception says, as the end of a line of ours."""
    return " ".join(str(error)[:LONGEST].split()) or type(error).__name__


class UsageError(UsarmjxError):
    """A call or a description was wrong; the message names what and what is allowed."""


class UnknownNameError(UsageError, KeyError):
    """A name that is not registered; the message lists the names that are."""

    def __str__(self) -> str:
        """Return the sentence itself (KeyError would show it quoted)."""
        return str(self.args[0]) if self.args else ""


class SpecError(UsageError):
    """A robot, arena or scene description that cannot be built."""


class ArenaFileError(SpecError):
    """A file of an arena that does not read; the message names file, line and what is allowed there."""


class UnsupportedFeatureError(SpecError):
    """A model feature that the chosen engine refuses or would silently ignore."""


class UnsupportedGeomError(SpecError):
    """A geom type for which the raycaster has no kernel."""


class EngineError(UsageError):
    """An engine cannot run on this machine, one of its buffers overflowed, or its physics went bad."""


class WriteError(UsageError):
    """A file cannot be written: no room, or no right; the message names the path and the reason."""


class PeerError(UsarmjxError):
    """A network peer broke a rule of the protocol; only that peer is dropped."""


class MissingExtraError(UsageError, ImportError):
    """A library of an extra is not installed; the message names both."""


class extra:
    """Around imports that only an extra of usarmjx brings, as `with extra("train"): import optax`.

    Args:
        name: Of the extra, as in pyproject.toml.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Say in one line what is missing.

        Raises:
            MissingExtraError: A module was not found, and it is not one of ours.
        """
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing and missing.partition(".")[0] != "usarmjx":
            raise MissingExtraError(
                f'this needs {missing.partition(".")[0]}: pip install "usarmjx[{self._name}]"'
            ) from error


def need_module(name: str) -> None:
    """Do nothing where a module could be imported, and do not import it: that may take seconds.

    Raises:
        ModuleNotFoundError: It is not installed, as an import would say.
    """
    if find_spec(name) is None:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
