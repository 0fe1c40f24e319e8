"""XLA compilation: flags, the on-disk cache of compiled programs, fusion hints, and a notice of waits.

JAX and Warp read their cache folders from environment variables when they are imported, so these are set
before; child processes inherit them. Variables that the user has set stay. The cache is in the user's cache
folder.

Commands say what they do, see `cli.common`; a script that calls `make` or `Batch` would wait half a
minute in silence. The line comes once in a process. The environment variable `USARMJX_QUIET` keeps it away.
"""

import contextlib
import hashlib
import logging
import multiprocessing
import os
import platform
import re
import shutil
import stat
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, MutableMapping
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar, cast

from usarmjx.base.checked_cache import (
    JAX_MODULE,
    PROGRAMS_FOLDER,
    WARP_FOLDER,
    install_cache_checks,
    is_guarded,
    remove_entries_of_crashes,
)
from usarmjx.base.process import pool_fits_cores

T = TypeVar("T")
CACHE_VARIABLE = "USARMJX_CACHE"
"""Environment variable with another cache folder, or one of `OFF_VALUES`."""
OFF_VALUES = ("off", "no", "0")
"""Values of `CACHE_VARIABLE` that disable the cache."""
JAX_FOLDER = "JAX_COMPILATION_CACHE_DIR"
"""Environment variable with the cache folder of JAX."""
CACHE_KINDS = ("jax", "programs", "warp", "planar")
"""Folders of a cache."""
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
"""Permissions that let others change a folder."""
MIN_COMPILE_TIME = ("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
"""Environment variable with the shortest compilation that JAX caches [s]. Its default is 1 s, but a start has
a hundred programs that take less."""
MAX_CACHE_SIZE = 2_000_000_000
"""Cache size above which a start removes the least recently used entries [bytes]. JAX can prune, too, but a
process killed while it writes then leaves a cache that is never written again."""
_asked = False
COMPILE_EVENT_PREFIX = "/jax/core/compile/"
"""Prefix of the names of JAX's events that report durations of compilation stages."""
NO_OPTIMIZATION, NO_FUSION_EMITTERS = (
    "--xla_backend_optimization_level=0",
    "--xla_cpu_use_fusion_emitters=false",
)
"""XLA flags that compile a task's observation function in a quarter of the time."""
EMITTER_FLAG_REMOVED_IN = (0, 11)
"""First jaxlib version without `NO_FUSION_EMITTERS`; XLA aborts the process on an unknown flag."""
CACHE_WARNING = re.compile(r"persistent compilation cache entry for '([^']+)'|the kept program ()")
"""Warnings of JAX and of `program_cache` about broken entries; the latter removes its own."""
QUIET = "USARMJX_QUIET"
"""Environment variable that keeps the line away; any value but nothing and 0."""
AFTER, POLL, IDLE = 0.5, 0.1, 2.0
"""Length of work that is worth the line, interval of looks at it, and pause after which nobody looks [s]."""


def materialize(tree: T) -> T:
    """Return arrays that a GPU computes once and stores; on a CPU, return them unchanged.

    XLA fuses a producer into every consumer that reads it in another order or in another reduction, and so
    computes it again for each of them. The barrier stops that fusion.

    Args:
        tree: PyTree of arrays.
    """
    import jax  # not before the cache folders are set

    if jax.default_backend() != "gpu":
        return tree
    return jax.lax.optimization_barrier(tree)  # pyright: ignore[reportUnknownMemberType] - JAX has no type


def unroll_on_gpu(count: int) -> int:
    """Return the unroll factor of a small loop: `count` on a GPU, 1 elsewhere.

    On a GPU an iteration costs kernel launches of its own, more than its arithmetic.

    Args:
        count: Factor on a GPU.
    """
    import jax

    return count if jax.default_backend() == "gpu" else 1


def cache_folder(environment: MutableMapping[str, str]) -> Path | None:
    """Return the cache folder according to the environment; None: the cache is off."""
    asked = environment.get(CACHE_VARIABLE, "").strip()
    if asked.lower() in OFF_VALUES:
        return None
    if asked:
        return Path(asked).expanduser()
    return Path(environment.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "usarmjx"


def own_cache_folder(environment: MutableMapping[str, str] = os.environ) -> Path | None:
    """Return the cache folder; None: the cache is off, or others may write to it."""
    folder = cache_folder(environment)
    return None if folder is None or writable_by_others(folder) else folder


def writable_by_others(folder: Path) -> str | None:
    """Return why others may put files into a cache folder, in a line; None: only this user and root may.

    Cached programs are machine code and pickled objects: a file from somebody else runs in this user's name.
    """
    if os.name != "posix":
        return None
    # Links are resolved first: the parents that count are those of the real folder.
    folder = Path(os.path.realpath(folder))
    for path in (folder, *(folder / kind for kind in CACHE_KINDS)):
        try:
            found = path.stat()
        except FileNotFoundError:
            continue
        # Root is trusted: it could replace this program, too.
        if found.st_uid not in (os.geteuid(), 0):
            return f"{path} belongs to another user"
        if found.st_mode & OTHERS_WRITE:
            return f"others may write to {path}: chmod -R go-w {path}"
    for path in folder.parents:
        mode = path.stat().st_mode if path.exists() else 0
        # The sticky bit, as of /tmp, keeps others from renaming what is not theirs.
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            return f"anybody may rename the files in {path}: chmod o-w {path}"
    return None


def enable_compilation_cache(
    environment: MutableMapping[str, str] = os.environ, max_bytes: int = MAX_CACHE_SIZE
) -> str | None:
    """Make JAX and Warp cache what they compile; call it before they are imported.

    Args:
        environment: Variables to set.
        max_bytes: Size to which the cache is pruned [bytes].

    Returns:
        One line with the reason why nothing is cached, or with what a crash has made unusable; None if there
        is nothing to say.
    """
    try:
        folder = cache_folder(environment)
        if folder is None:
            return None
        if complaint := writable_by_others(folder):
            return f"compilations are not kept, the next start will take as long: {complaint}"
        # XLA divides loops by the size of the thread pool, which is not part of JAX's cache key.
        programs = folder / "jax" / (processor() + ("-cores" if pool_fits_cores() else ""))
        for place in (folder, folder / "jax", folder / "programs", folder / "warp", programs):
            place.parent.mkdir(parents=True, exist_ok=True)
            # Only the folders of the cache are private; parents such as ~/.cache keep the usual mode.
            place.mkdir(mode=0o700, exist_ok=True)
        # Fails here, not at the first compilation, where the folder is read-only or the disk is full.
        with tempfile.TemporaryFile(dir=programs):
            pass
        crashed = remove_entries_of_crashes(folder / "programs" / processor(), folder)
        prune_cache(folder, max_bytes)
    except (OSError, RuntimeError) as error:
        return f"compilations are not kept, the next start will take as long: {error}"
    # After everything that can fail: variables of a folder that cannot be used would mislead children.
    environment.setdefault(JAX_FOLDER, str(programs))
    environment.setdefault(PROGRAMS_FOLDER, str(folder / "programs" / processor()))
    environment.setdefault(*MIN_COMPILE_TIME)
    environment.setdefault(WARP_FOLDER, str(folder / "warp"))
    if environment is os.environ:
        install_cache_checks()
    if crashed:
        return f"the last start ended while it loaded {crashed[0][:100]}, which is compiled again"
    return None


def enable_cache_after_import() -> None:
    """Make JAX cache what it compiles in a program that has imported it already; the second time do nothing.

    Commands enable the cache before they import JAX. A cache folder that the program has set stays. Children
    inherit the variables.
    """
    global _asked
    if _asked or os.environ.get(PROGRAMS_FOLDER):
        return
    _asked = True
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    if complaint := enable_compilation_cache():
        logging.getLogger(__name__).warning("%s", complaint)
    folder, settings = os.environ.get(JAX_FOLDER), cast(Any, jax.config)
    # A folder that the program has set for itself stays.
    if folder is None or not os.environ.get(PROGRAMS_FOLDER) or settings.jax_compilation_cache_dir:
        return
    if not is_guarded(sys.modules.get(JAX_MODULE)):  # another version of JAX, which keeps nothing
        return
    settings.update("jax_compilation_cache_dir", folder)
    settings.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    compilation_cache.reset_cache()  # JAX decides at its first compilation whether there is a cache


def fast_compilation_flags(version: str | None = None) -> list[str]:
    """Return the flags of fast compilation for a jaxlib version; None: the installed one."""
    numbers = (version or metadata.version("jaxlib")).split(".")
    older = (int(numbers[0]), int(numbers[1])) < EMITTER_FLAG_REMOVED_IN
    return [NO_OPTIMIZATION, NO_FUSION_EMITTERS] if older else [NO_OPTIMIZATION]


def disable_optimization(environment: MutableMapping[str, str] = os.environ) -> None:
    """Make XLA compile without optimisation, for programs that run once; call it before JAX is imported."""
    environment.setdefault("XLA_FLAGS", " ".join(fast_compilation_flags()))


def processor() -> str:
    """Return a name for this machine's instruction set: programs for another one may not run here."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        # Called flags of x86, and Features of ARM.
        able = next(line for line in lines if line.lower().startswith(("flags", "features")))
    except (OSError, StopIteration):
        able = platform.processor()
    return f"{platform.machine()}-{hashlib.sha256(able.encode()).hexdigest()[:8]}"


def prune_cache(folder: Path, max_bytes: int) -> None:
    """Remove the least recently used entries of a cache until its size is at most `max_bytes` [bytes]."""
    entries = [(*_use(path), path) for path in _entries(folder)]
    size = sum(one[1] for one in entries)
    for _, own, path in sorted(entries):
        if size <= max_bytes:
            return
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        size -= own


def _entries(folder: Path) -> Iterator[Path]:
    """Yield the entries that can be removed separately: single files, and Warp's module folders."""
    for kind in ("jax", "programs"):
        yield from (path for path in folder.glob(f"{kind}/**/*") if path.is_file())
    # Warp loads a module from several files: without one of them it would fail.
    yield from (path for path in folder.glob("warp/*/*") if path.is_dir())


def _use(path: Path) -> tuple[float, int]:
    """Return an entry's last use [s since the epoch] and size [bytes]; (0, 0) if it no longer exists."""
    files = [one for one in path.rglob("*") if one.is_file()] if path.is_dir() else [path]
    try:
        found = [one.stat() for one in files]
    except FileNotFoundError:
        return 0.0, 0
    # Both times: file systems mounted with noatime never change the first.
    return max((max(s.st_atime, s.st_mtime) for s in found), default=0.0), sum(s.st_size for s in found)


def warn_once_of_broken_entries(say: Callable[[str], None], folder: Path) -> None:
    """Replace JAX's warnings about unreadable cache entries by one line, and remove those entries.

    JAX compiles such a program again but never overwrites an existing file, so a file left broken by a killed
    writer would stay broken.

    Args:
        say: Takes a line.
        folder: JAX's cache folder.
    """
    usual, said = warnings.showwarning, False

    def show(message: Warning | str, *rest: object, **more: object) -> None:
        nonlocal said
        found = CACHE_WARNING.search(str(message))
        if found is None:
            usual(message, *rest, **more)  # type: ignore - as it was called
            return
        if not said:
            say(f"note: a compilation is not kept, or was broken and is done anew: {str(message)[:200]}")
        said = True
        # Warnings about writing leave no broken entry behind.
        if str(message).startswith("Error reading") and found[1]:
            for path in folder.glob(f"{found[1]}-*"):
                path.unlink(missing_ok=True)

    warnings.showwarning = show


def is_compiling(thread: int) -> bool:
    """Return whether a thread is in JAX's compiler, by its stack."""
    # JAX tells when a stage ends, not when it begins: a long compilation shows on the stack alone.
    frame = sys._current_frames().get(thread)  # pyright: ignore[reportPrivateUsage]
    while frame is not None:
        if frame.f_code.co_filename.replace(os.sep, "/").endswith("jax/_src/compiler.py"):
            return True
        frame = frame.f_back
    return False


def write_line(text: str) -> None:
    """Write a line to the error stream, if there is one that takes it."""
    # The stream may be closed, or None under pythonw.
    with contextlib.suppress(OSError, ValueError, AttributeError):
        print(f"usarmjx: {text}", file=sys.stderr, flush=True)


class CompileNotice:
    """Says once what is being built or compiled, when that has taken `AFTER`.

    Args:
        write: Takes the line.
        at_work: Whether a thread, by number, compiles just now.
        is_quiet: Whether the line is kept away, asked when work begins.
    """

    def __init__(
        self,
        write: Callable[[str], None] = write_line,
        at_work: Callable[[int], bool] = is_compiling,
        is_quiet: Callable[[], bool] = bool,
    ) -> None:
        self._write, self._at_work, self._is_quiet = write, at_work, is_quiet
        self._lock = threading.Lock()
        self._subject = ""
        self._building = 0
        self._heard: set[int] = set()  # threads with an event since the last look
        self._compiling: set[int] = set()  # threads that had one
        self._watched = self._listens = self.shown = False

    def expect(self, subject: str) -> None:
        """Note what compilations from now on are for.

        Args:
            subject: A few words. While something is being built, its subject stays.
        """
        self.shown = self.shown or self._is_quiet()
        if self.shown or self._building:
            return
        self._subject = subject
        if not self._listens:
            self._listens = True
            from jax import monitoring

            monitoring.register_event_duration_secs_listener(self._hear)

    @contextlib.contextmanager
    def building(self, subject: str) -> Generator[None]:
        """Count the context as work.

        Args:
            subject: A few words for the object that is built.
        """
        if self.shown:
            yield
            return
        self.expect(subject)
        with self._lock:
            self._building += 1
            self._watch()
        try:
            yield
        finally:
            with self._lock:
                self._building -= 1

    def _hear(self, event: str, duration_secs: float, **_: object) -> None:
        del duration_secs
        if self.shown or not event.startswith(COMPILE_EVENT_PREFIX):
            return
        with self._lock:
            self._heard.add(threading.get_ident())
            self._watch()

    def _watch(self) -> None:
        if not (self._watched or self.shown):
            self._watched = True
            # A daemon: it must not keep a finished program alive.
            threading.Thread(target=self._look, name="compile notice", daemon=True).start()

    def _look(self) -> None:
        busy = idle = 0.0
        while True:
            time.sleep(POLL)
            with self._lock:
                works = bool(self._heard) or self._building > 0
                self._compiling |= self._heard
                self._heard.clear()
            # Outside the lock: looking at stacks takes time, and listeners would wait.
            works = works or any(map(self._at_work, self._compiling))
            busy, idle = (busy + POLL, 0.0) if works else (busy, idle + POLL)
            with self._lock:
                if self.shown or idle >= IDLE:
                    self._watched = False
                    return
                self.shown = busy >= AFTER
            if self.shown:
                self._write(
                    f"building and compiling {self._subject}; later starts take less time "
                    f"({QUIET}=1 hides this line)"
                )


def silence(environment: MutableMapping[str, str] = os.environ) -> None:
    """Keep the line away from this process and its children, which report in another way or not at all."""
    environment.setdefault(QUIET, "1")
    NOTICE.shown = True


def _is_quiet() -> bool:
    """Return whether the user or the parent asks for silence, or nobody reads what this process writes."""
    asked = os.environ.get(QUIET, "").strip()
    return asked not in ("", "0") or multiprocessing.parent_process() is not None


NOTICE = CompileNotice(is_quiet=_is_quiet)
"""The notice of this process."""
