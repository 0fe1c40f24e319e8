"""Checksums around the compiled programs that are cached, so that a damaged one is compiled again.

XLA runs what it finds in its cache: one flipped bit computes other numbers or ends the process. JAX and Warp
check nothing; neither has a public place for a check. For JAX the class of its cache is changed when it is
imported; where another version of JAX has no such class, its cache is turned off. Warp's files are compared
with a list of checksums when Warp is imported, and listed when the process ends.
"""

import atexit
import hashlib
import importlib.util
import os
import shutil
import socket
import sys
import threading
import warnings
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any

from usarmjx.base.files import PARTIAL_MARK, WriteError, atomic_write

WARP_FOLDER = "WARP_CACHE_PATH"
"""Environment variable with the cache folder of Warp."""
PROGRAMS_FOLDER = "USARMJX_PROGRAMS"
"""Environment variable with the folder of `program_cache`, set only by `enable_compilation_cache`."""
JAX_MODULE, WARP_MODULE = "jax._src.compilation_cache", "warp"
"""Modules after whose import the checks are installed."""
MAGIC = b"usarmjx kept 1\n"
"""Start of a sealed entry."""
CHECKSUM_SIZE = 20
"""Size of a digest [bytes]."""
SUMS_FILE = "usarmjx-checksums"
"""List of checksums in a folder of Warp's cache."""
LOADING_FOLDER = "loading"
"""Folder with a file for each process that loads entries."""
WARNING = "Error reading the kept program {name}: {reason}"
"""Warning about a broken entry; `compilation` turns the first one into a line."""


def seal(data: bytes, key: str) -> bytes:
    """Return the content of a file that keeps data for a key, and for no other."""
    return MAGIC + _checksum(data, key) + data


def unseal(content: bytes, key: str) -> bytes:
    """Return the data of a sealed file.

    Raises:
        ValueError: It is not whole, or is kept for another key.
    """
    start = len(MAGIC)
    data = content[start + CHECKSUM_SIZE :]
    if content[:start] != MAGIC or content[start : start + CHECKSUM_SIZE] != _checksum(data, key):
        raise ValueError("it is not whole")
    return data


def _checksum(data: bytes, key: str) -> bytes:
    # The key is part of the checksum: a whole file under another's name does not pass.
    found = hashlib.blake2b(key.encode() + b"\0", digest_size=CHECKSUM_SIZE)
    found.update(data)
    return found.digest()


def read_sealed(path: Path, key: str) -> bytes | None:
    """Return the data of a sealed file; None: missing, or broken, which warns and removes the file."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    try:
        return unseal(content, key)
    except ValueError as error:
        discard(path, str(error))
        return None


def discard(path: Path, reason: str) -> None:
    """Remove a broken entry, with a warning."""
    with suppress(OSError):
        path.unlink(missing_ok=True)
    warnings.warn(WARNING.format(name=path.name, reason=reason), stacklevel=3)


def write_sealed(path: Path, data: bytes, key: str) -> None:
    """Write a sealed file.

    Raises:
        WriteError: It cannot be written.
    """
    with atomic_write(path) as fresh:
        fresh.write_bytes(seal(data, key))


class LoadingEntries:
    """Names of the entries that this process is loading, in a file that outlives a crash.

    Args:
        folder: Folder of the file.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / LOADING_FOLDER
        self._lock, self._paths = threading.Lock(), list[str]()
        self._file, self._process = -1, 0

    @contextmanager
    def loading(self, path: Path) -> Generator[None]:
        """Note an entry while it is loaded."""
        self._note(self._paths.append, path)
        try:
            yield
        finally:
            self._note(self._paths.remove, path)

    def _note(self, change: Callable[[str], None], path: Path) -> None:
        with self._lock, suppress(OSError):  # a full disk does not stop a start
            change(str(path))
            # A forked child has its parent's descriptor and needs a file of its own.
            if self._process != os.getpid():
                self._open()
            text = "\n".join(self._paths).encode()
            # Written through the descriptor, unbuffered: it must be in the file if the next call crashes.
            os.ftruncate(self._file, 0)
            os.pwrite(self._file, text, 0)

    def _open(self) -> None:
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Home folders may be shared by machines, whose process numbers mean nothing to each other.
        path = self._folder / f"{socket.gethostname()}-{os.getpid()}"
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        self._process = os.getpid()
        atexit.register(_remove_own, path, self._process)


def _remove_own(path: Path, process: int) -> None:
    if os.getpid() == process:  # a forked process runs the handlers of its parent
        path.unlink(missing_ok=True)


def remove_entries_of_crashes(folder: Path, cache: Path) -> list[str]:
    """Remove the entries that processes of this machine were loading when they ended.

    Args:
        folder: See `LoadingEntries`.
        cache: Folder of all entries.

    Returns:
        Names of the removed entries.
    """
    removed = list[str]()
    for note in (folder / LOADING_FOLDER).glob(f"{socket.gethostname()}-*"):
        # From the end: names of hosts may have hyphens.
        number = note.name.rpartition("-")[2]
        # Processes that end orderly remove their note: one without a process is of a crash.
        if not number.isdecimal() or _is_alive(int(number)):
            continue
        with suppress(OSError, ValueError):
            for line in note.read_text(encoding="utf-8").splitlines():
                path = Path(line)
                # A note may be as damaged as an entry: only files of the cache are removed.
                if cache.resolve() in path.resolve().parents and path.is_file():
                    path.unlink(missing_ok=True)
                    removed.append(path.name)
        note.unlink(missing_ok=True)
    return removed


def _is_alive(process: int) -> bool:
    try:
        # Signal 0 is not delivered: the system only checks for the process.
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    # It runs, but as another user.
    except OSError:
        return True
    return True


def check_warp_folder(folder: Path) -> list[str]:
    """Compare Warp's compiled modules with their checksums; remove those that differ, with a warning.

    Args:
        folder: Warp's cache.

    Returns:
        Names of the removed modules.
    """
    removed = list[str]()
    for sums in folder.glob(f"*/*/{SUMS_FILE}"):
        try:
            listed = _sums(unseal(sums.read_bytes(), sums.parent.name))
            whole = all(_digest(sums.parent / name) == known for name, known in listed.items())
        except (OSError, ValueError):
            whole = False
        if not whole:
            shutil.rmtree(sums.parent, ignore_errors=True)
            removed.append(sums.parent.name)
            reason = "it is not whole"
            warnings.warn(WARNING.format(name=sums.parent.name, reason=reason), stacklevel=2)
    return removed


def seal_warp_folder(folder: Path) -> None:
    """List the checksums of Warp's compiled modules that have none; see `check_warp_folder`."""
    # Checksums of what a process has compiled are written when it ends: Warp has no hook for it.
    for module in folder.glob("*/wp_*"):
        with suppress(OSError, ValueError, WriteError):
            sums = module / SUMS_FILE
            listed = _sums(unseal(sums.read_bytes(), module.name)) if sums.exists() else {}
            there = [
                file
                for file in module.iterdir()
                if file.name != SUMS_FILE and PARTIAL_MARK not in file.name and file.is_file()
            ]
            fresh = {file.name: _digest(file) for file in there if file.name not in listed}
            if fresh:
                lines = [f"{known} {name}" for name, known in {**listed, **fresh}.items()]
                write_sealed(sums, "\n".join(lines).encode(), module.name)


def _sums(data: bytes) -> dict[str, str]:
    rows = [line.partition(" ") for line in data.decode().splitlines()]
    return {name: known for known, _, name in rows}


def _digest(file: Path) -> str:
    return hashlib.blake2b(file.read_bytes(), digest_size=CHECKSUM_SIZE).hexdigest()


def guard_jax(module: Any, loading: LoadingEntries, own: Path) -> None:  # noqa: ANN401 - JAX's module
    """Make JAX seal the programs that it keeps in our folder, and check those that it loads from there.

    A folder that the user has named stays as JAX writes it: programs without usarmjx may share it.

    Args:
        module: JAX's `compilation_cache`.
        loading: Record of what is loaded.
        own: Folder below which our caches of JAX's are.
    """
    try:
        usual, load = module.LRUCache, module.get_executable_and_time
        checked = _checked_cache(usual, own)
    except AttributeError:
        # Entries without checksums might be half written: no cache is safer.
        module.config.config.update("jax_compilation_cache_dir", None)
        warnings.warn("this version of JAX keeps no compilations: its cache has no checksums", stacklevel=2)
        return

    def get_executable_and_time(key: str, *rest: Any, **more: Any) -> Any:  # noqa: ANN401 - JAX's own
        place = module.config.config.jax_compilation_cache_dir
        if not place:
            return load(key, *rest, **more)
        with loading.loading(_entry(Path(place), key)):
            return load(key, *rest, **more)

    module.LRUCache, module.get_executable_and_time = checked, get_executable_and_time
    _guarded.append(module)


def is_guarded(module: Any) -> bool:  # noqa: ANN401 - JAX's module
    """Return whether `guard_jax` has found what it guards in JAX's `compilation_cache`."""
    return any(one is module for one in _guarded)


def _entry(folder: Path, key: str) -> Path:
    return folder / f"{key}-cache"


def _checked_cache(usual: Any, own: Path) -> Any:  # noqa: ANN401 - JAX's class
    """Return JAX's class of caches with checksums around the entries of caches below a folder."""
    usual_get, usual_put = usual.get, usual.put

    def is_ours(folder: Path) -> bool:
        return own in folder.parents

    class CheckedCache(usual):
        """JAX's cache with a checksum around each entry, if it is ours."""

        def get(self, key: str) -> bytes | None:
            content, folder = usual_get(self, key), Path(str(self.path))
            try:
                return content if content is None or not is_ours(folder) else unseal(content, key)
            except ValueError as error:
                discard(_entry(folder, key), str(error))
                return None

        def put(self, key: str, value: bytes) -> None:
            folder = Path(str(self.path))
            if not is_ours(folder):
                usual_put(self, key, value)
                return
            if self.eviction_enabled:  # asked for by the user
                usual_put(self, key, seal(value, key))
                return
            path = _entry(folder, key)
            if not path.exists():  # JAX writes in place: another process would read the first half
                write_sealed(path, value, key)

    return CheckedCache


class _AfterImport(MetaPathFinder):
    """Calls a function with a module once it is imported.

    Args:
        name: Name of the module.
        call: The function.
    """

    def __init__(self, name: str, call: Callable[[Any], None]) -> None:
        self._name, self._call, self._finding = name, call, False

    def find_spec(self, fullname: str, path: object, target: object = None) -> ModuleSpec | None:
        """Return the module's own spec, with a loader that calls the function in the end."""
        del path, target
        if fullname != self._name or self._finding:
            return None
        self._finding = True  # the search below comes here again
        try:
            spec = importlib.util.find_spec(fullname)
        finally:
            self._finding = False
        if spec is None or spec.loader is None:
            return None
        run = spec.loader.exec_module

        def run_and_call(module: Any) -> None:  # noqa: ANN401 - any module
            run(module)
            self._call(module)

        # The module's own loader is kept: data files and `inspect` ask it for sources.
        spec.loader.exec_module = run_and_call  # pyright: ignore[reportAttributeAccessIssue]
        return spec


_installed, _guarded = set[Path](), list[Any]()


def install_cache_checks() -> None:
    """Check what this process loads from the cache that it, or its parent, has set up; else do nothing."""
    programs, warp = os.environ.get(PROGRAMS_FOLDER), os.environ.get(WARP_FOLDER)
    if programs:
        # The folder of programs is CACHE/programs/PROCESSOR, see `enable_compilation_cache`.
        cache = Path(programs).parents[1]
        # Folders that the user has named are not ours to clean.
        own_warp = cache / "warp" if warp == str(cache / "warp") else None
        install_checks(Path(programs), cache / "jax", own_warp)


def install_checks(folder: Path, jax_folder: Path, warp_folder: Path | None = None) -> None:
    """Check what JAX and Warp load in this process from now on; without effect the second time.

    Args:
        folder: See `LoadingEntries`.
        jax_folder: See `guard_jax`.
        warp_folder: Warp's cache; None: as Warp has it.
    """
    if _installed:
        return
    _installed.add(folder)
    loading = LoadingEntries(folder)
    _after_import(JAX_MODULE, lambda module: guard_jax(module, loading, jax_folder))
    if warp_folder is not None:
        _after_import(WARP_MODULE, lambda _: _guard_warp(warp_folder))


def _guard_warp(folder: Path) -> None:
    check_warp_folder(folder)
    atexit.register(seal_warp_folder, folder)


def _after_import(name: str, call: Callable[[Any], None]) -> None:
    if name in sys.modules:
        call(sys.modules[name])
    else:
        # Importing JAX here would cost commands that never need it seconds.
        sys.meta_path.insert(0, _AfterImport(name, call))
