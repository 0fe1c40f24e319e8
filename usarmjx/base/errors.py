"""The exception tree of usarmjx.

UsarmjxError
├── UsageError              our caller's fault: propagates
│   ├── UnknownNameError    a name that no registry entry has
│   ├── SpecError           a robot, arena or scene description that cannot be built
│   │   ├── ArenaFileError            an arena's file that does not read
│   │   ├── UnsupportedFeatureError   the chosen engine would ignore or refuse it
│   │   └── UnsupportedGeomError      a geom type that the raycaster cannot hit
│   ├── PlaceError          a position where nothing can be put; its axes can be changed
│   ├── EngineError         the engine cannot run here, or overflowed its buffers
│   └── WriteError          a file that cannot be written: no room, no right
└── PeerError               a network peer's fault: logged, the peer is dropped, nobody else notices
"""

from collections.abc import Callable
from importlib.util import find_spec
from types import TracebackType

MAX_QUOTATION = 200
"""Longest quotation of a foreign exception's message [characters]."""


class UsarmjxError(Exception):
    """Base of all exceptions that usarmjx raises deliberately."""


def quoted(error: Exception) -> str:
    """Return a foreign exception's message as the end of one line."""
    # Messages of other libraries may have many lines; ours have one.
    return " ".join(str(error)[:MAX_QUOTATION].split()) or type(error).__name__


def one_line(text: str) -> str:
    r"""Return a message with characters of control escaped, as \n: names of files may have any."""
    return "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


class UsageError(UsarmjxError):
    """Wrong call or description; the message names the fault and the allowed values."""


class PlaceError(UsageError):
    """Position where nothing can be put; the message names it in the world's axes, or in others'.

    Args:
        text: The message, with {} for the position.
        pos: The position in the world's axes [m].
    """

    def __init__(self, text: str, pos: tuple[float, float, float]) -> None:
        # Both arguments: unpickling in another process calls the class with the arguments of its base.
        super().__init__(text, pos)
        self._text, self._pos = text, pos

    def __str__(self) -> str:
        """Return the message in the world's axes."""
        return self.in_axes(lambda pos: pos)

    def in_axes(self, convert: Callable[[tuple[float, float, float]], tuple[float, float, float]]) -> str:
        """Return the message with the position in other axes, to which `convert` converts."""
        return self._text.format(",".join(f"{value:.2f}" for value in convert(self._pos)))


class UnknownNameError(UsageError, KeyError):
    """Name that is not registered; the message lists the registered ones."""

    def __str__(self) -> str:
        """Return the plain sentence (KeyError would quote it)."""
        return str(self.args[0]) if self.args else ""


class SpecError(UsageError):
    """Robot, arena or scene description that cannot be built."""


class ArenaFileError(SpecError):
    """Arena file that cannot be parsed; the message names file, line and allowed values."""


class UnsupportedFeatureError(SpecError):
    """Model feature that the chosen engine refuses or would silently ignore."""


class UnsupportedGeomError(SpecError):
    """Geom type for which the ray caster has no kernel."""


class EngineError(UsageError):
    """Engine that cannot run on this machine, overflowed a buffer, or diverged."""


class WriteError(UsageError):
    """File that cannot be written: no space or no permission; the message names path and reason."""


class PeerError(UsarmjxError):
    """Protocol violation of a network peer; only that peer is dropped."""


class MissingExtraError(UsageError, ImportError):
    """Missing library of an extra; the message names both."""


class extra:
    """Context for imports that an extra of usarmjx installs: `with extra("train"): import optax`.

    Args:
        name: Name of the extra in pyproject.toml.
    """

    def __init__(self, name: str) -> None:
        from usarmjx.base.installation import without_notes  # `import usarmjx` needs none

        self._name, self._quiet = name, without_notes()

    def __enter__(self) -> None:
        """Keep notes on missing optional packages off the standard output."""
        self._quiet.__enter__()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Turn a missing module into one line that names the extra.

        Raises:
            MissingExtraError: A module was not found, and it is not part of usarmjx.
        """
        self._quiet.__exit__(None, None, None)
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        # A module of our own that is missing is a fault of ours, which no extra mends.
        if missing and missing.partition(".")[0] != "usarmjx":
            from usarmjx.base.installation import install_command

            raise MissingExtraError(
                f"this needs {missing.partition('.')[0]}: {install_command(self._name)}"
            ) from error


def need_module(name: str) -> None:
    """Check that a module can be imported without importing it, which may take seconds.

    Raises:
        ModuleNotFoundError: It is not installed; same message as an import.
    """
    if find_spec(name) is None:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
