"""Files that robots and worlds name: `package://`, `model://`, `file://`, and relative names."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

PACKAGE_SCHEMES = ("package://", "model://")
"""Schemes whose first word is the name of a folder to be found."""
FIRST_VARIABLE = "USARMJX_PACKAGES"
"""Environment variable with the folders of `--packages`, which worker processes inherit."""
PATH_VARIABLES = (
    FIRST_VARIABLE,
    "ROS_PACKAGE_PATH",
    "AMENT_PREFIX_PATH",
    "GZ_SIM_RESOURCE_PATH",
    "IGN_GAZEBO_RESOURCE_PATH",
    "GAZEBO_MODEL_PATH",
)
"""Environment variables with folders that hold packages and models."""
MODEL_FOLDERS = ("models",)
"""Names of folders beside a world's that hold models."""
SEARCH_DEPTH = 3
"""Levels of folders searched below each such folder."""
MAX_SEARCHED_FOLDERS = 20_000
"""Largest number of folders searched."""


@dataclass(frozen=True, kw_only=True)
class Resources:
    """Folders in which packages and models are found.

    Attributes:
        folders: Folders that the caller names, searched first.
    """

    folders: tuple[Path, ...] = ()

    def file(self, name: str, origin: Path) -> Path | None:
        """Return the file that a name means within another file; None: it is not there.

        Args:
            name: The name, with or without a scheme.
            origin: The file that names it.
        """
        for scheme in PACKAGE_SCHEMES:
            if name.startswith(scheme):
                package, _, inside = unquote(name.removeprefix(scheme)).lstrip("/").partition("/")
                found = (home / inside for home in self.packages(package, origin))
                return next((path for path in found if path.exists()), None)
        plain = Path(unquote(name.removeprefix("file://")))
        tries = (plain,) if plain.is_absolute() else (base / plain for base in self._bases(origin))
        return next((path for path in tries if path.exists()), None)

    def packages(self, package: str, origin: Path) -> Iterator[Path]:
        """Yield the folders that a package's or a model's name may mean: above the file, then elsewhere."""
        if not package or package in (".", ".."):
            return
        for folder in origin.resolve().parents:
            if folder.name == package:
                yield folder
            for home in (folder / package, *(folder / name / package for name in MODEL_FOLDERS)):
                if home.is_dir():
                    yield home
        for base in self._search_path():
            yield from _below(base, package)

    def _bases(self, origin: Path) -> Iterator[Path]:
        yield origin.parent
        yield from origin.resolve().parent.parents[:2]
        yield from self._search_path()

    def _search_path(self) -> Iterator[Path]:
        yield from self.folders
        for variable in PATH_VARIABLES:
            for text in filter(None, os.environ.get(variable, "").split(os.pathsep)):
                share = Path(text) / "share"
                yield share if variable == "AMENT_PREFIX_PATH" and share.is_dir() else Path(text)


def search_first(folders: Iterable[Path]) -> Callable[[], None]:
    """Search packages and models in these folders first, also in worker processes.

    Returns:
        The function that restores the search path.
    """
    before = os.environ.get(FIRST_VARIABLE)
    own = [str(folder.resolve()) for folder in folders]
    os.environ[FIRST_VARIABLE] = os.pathsep.join([*own, *filter(None, [before])])

    def end() -> None:
        if before is None:
            os.environ.pop(FIRST_VARIABLE, None)
        else:
            os.environ[FIRST_VARIABLE] = before

    return end


def _below(base: Path, package: str) -> Iterator[Path]:
    """Yield folders of a name at or below another, level by level."""
    if base.name == package:
        yield base
    level, seen = [base], 0
    for _ in range(SEARCH_DEPTH):
        fresh: list[Path] = []
        for folder in level:
            fresh += _folders(folder)
        yield from (folder for folder in fresh if folder.name == package)
        seen += len(fresh)
        if seen > MAX_SEARCHED_FOLDERS:
            return
        level = fresh


def _folders(folder: Path) -> Sequence[Path]:
    try:
        with os.scandir(folder) as found:
            return sorted(Path(one.path) for one in found if one.is_dir() and not one.name.startswith("."))
    except OSError:
        return ()
