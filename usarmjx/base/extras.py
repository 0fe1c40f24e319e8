"""Libraries that the base installation does without: whoever needs one is told which extra brings it."""

from importlib.util import find_spec
from types import TracebackType

from usarmjx.base.errors import UsageError


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
