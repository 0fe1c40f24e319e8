"""Files that robots and worlds name: `package://`, `model://`, `file://`, and relative names."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from usarmjx.base.errors import UsageError

PACKAGE_SCHEMES = ("package://", "model://")
"""Schemes whose first word is the name of a folder to be found."""
FIRST_VARIABLE = "USARMJX_PACKAGES"
"""Environment variable with the folders of `--packages`, which worker processes inherit."""
PIECES_VARIABLE = "USARMJX_MESH_PIECES"
"""Environment variable with the number of `--pieces`, which worker processes inherit."""
MAX_PIECES = 64
"""Largest number of convex pieces of a mesh: every ray meets each of them."""
PATH_VARIABLES = (
    FIRST_VARIABLE,
    "ROS_PACKAGE_PATH",
    "AMENT_PREFIX_PATH",
    "GZ_SIM_RESOURCE_PATH",
    "IGN_GAZEBO_RESOURCE_PATH",
    "GAZEBO_MODEL_PATH",
    "GAZEBO_RESOURCE_PATH",
)
"""Environment variables with folders that hold packages and models."""
MODEL_FOLDERS = ("models",)
"""Names of folders beside a world's that hold models."""
MEDIA_FOLDERS = ("Media", "media")
"""Names of folders of packages in whose `models` Gazebo finds `file://` names without a folder."""
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
                # Addresses escape blanks in names of models, as in My%20Model.
                package, _, inside = unquote(name.removeprefix(scheme)).lstrip("/").partition("/")
                found = (home / inside for home in self.packages(package, origin))
                return next((path for path in found if path.exists()), None)
        plain = Path(unquote(name.removeprefix("file://")))
        tries = (plain,) if plain.is_absolute() else self._places(plain, origin)
        return next((path for path in tries if path.exists()), None)

    def _places(self, name: Path, origin: Path) -> Iterator[Path]:
        """Yield the files that a relative name may mean: beside the file, then in folders of media."""
        for base in self._bases(origin):
            yield base / name
        for base in self._bases(origin):
            for folder in (base, *_folders(base)):
                for media in MEDIA_FOLDERS:
                    yield folder / media / "models" / name

    def named(self, stem: str, suffixes: Sequence[str]) -> Path | None:
        """Return the first file of a name, without its suffix, in the search path; None: there is none."""
        for base in self._search_path():
            for folder in _levels(base):
                for suffix in suffixes:
                    if (file := folder / f"{stem}{suffix}").is_file():
                        return file
        return None

    def packages(self, package: str, origin: Path) -> Iterator[Path]:
        """Yield the folders that a package's or a model's name may mean: above the file, then elsewhere."""
        # Such a name would mean the folder of the file itself, or the one above it.
        if not package or package in (".", ".."):
            return
        # Resolved: a link may lead into the package that the file belongs to.
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
                # ROS 2 names prefixes, in whose `share` the packages are.
                yield share if variable == "AMENT_PREFIX_PATH" and share.is_dir() else Path(text)


def search_first(folders: Iterable[Path]) -> Callable[[], None]:
    """Search packages and models in these folders first, also in worker processes.

    Returns:
        The function that restores the search path.
    """
    before = os.environ.get(FIRST_VARIABLE)
    # Absolute: workers may have another working directory.
    own = [str(folder.resolve()) for folder in folders]
    # The environment, not a variable here: worker processes inherit it.
    return _set_variable(FIRST_VARIABLE, os.pathsep.join([*own, *filter(None, [before])]))


def search_path() -> tuple[str, ...]:
    """Return the folders that environment variables name, as they are written there."""
    return tuple(os.environ.get(variable, "") for variable in PATH_VARIABLES)


def cut_meshes(pieces: int) -> Callable[[], None]:
    """Cut meshes of robots into up to some convex pieces, also in worker processes.

    Returns:
        The function that restores the number.
    """
    return _set_variable(PIECES_VARIABLE, str(pieces))


def mesh_pieces(pieces: int | None = None) -> int:
    """Return the largest number of convex pieces of a mesh.

    Args:
        pieces: The number; None: that of the environment, else 1.

    Raises:
        UsageError: No number from 1 to 64.
    """
    text = os.environ.get(PIECES_VARIABLE, "1") if pieces is None else str(pieces)
    if not (text.isdecimal() and 1 <= int(text) <= MAX_PIECES):
        raise UsageError(f"pieces of a mesh are {text!r}, expected a whole number from 1 to {MAX_PIECES}")
    return int(text)


def _set_variable(name: str, value: str) -> Callable[[], None]:
    """Set an environment variable; return the function that restores it."""
    before = os.environ.get(name)
    os.environ[name] = value

    def restore() -> None:
        if before is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = before

    return restore


def _below(base: Path, package: str) -> Iterator[Path]:
    """Yield folders of a name at or below another, level by level."""
    return (folder for folder in _levels(base) if folder.name == package)


def _levels(base: Path) -> Iterator[Path]:
    """Yield a folder and those below it, level by level."""
    yield base
    level, seen = [base], 0
    for _ in range(SEARCH_DEPTH):
        fresh: list[Path] = []
        for folder in level:
            fresh += _folders(folder)
        yield from fresh
        seen += len(fresh)
        # A search path may be the root of a disk, which must not be walked as a whole.
        if seen > MAX_SEARCHED_FOLDERS:
            return
        level = fresh


def _folders(folder: Path) -> Sequence[Path]:
    try:
        with os.scandir(folder) as found:
            # Sorted: file systems list in any order, and the first match counts.
            return sorted(Path(one.path) for one in found if one.is_dir() and not one.name.startswith("."))
    # A folder that may not be read holds nothing for this user.
    except OSError:
        return ()
