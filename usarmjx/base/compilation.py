"""How programs are compiled, and where they are kept for the next start: in the user's cache folder.

All of it is said to JAX and Warp by their environment variables, before either is imported, and so holds for
processes that this one starts, too. What the user has set himself stays.
"""

import hashlib
import os
import platform
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator, MutableMapping
from importlib import metadata
from pathlib import Path
from typing import TypeVar

import jax

from usarmjx.base.process import fits_cores

T = TypeVar("T")


def kept_on_gpu(tree: T) -> T:
    """Return arrays that a GPU works out once and keeps; on a CPU they are what they were.

    What is made of many worlds' numbers and read in another order, or in sums beside, XLA works out again for
    each of those: it puts all that leads there into the kernel that reads it.

    Args:
        tree: A PyTree of arrays.
    """
    if jax.default_backend() != "gpu":
        return tree
    return jax.lax.optimization_barrier(tree)  # pyright: ignore[reportUnknownMemberType] - JAX has no type


def rounds_at_once(count: int) -> int:
    """Return how many rounds of a small loop are to be one: on a GPU so many, elsewhere each is by itself.

    On a GPU a round costs launches of its own, more than what is in it.

    Args:
        count: How many on a GPU.
    """
    return count if jax.default_backend() == "gpu" else 1


VARIABLE = "USARMJX_CACHE"
"""Environment variable with another folder, or one of `OFF`."""
OFF = ("off", "no", "0")
JAX_FOLDER, WARP_FOLDER = "JAX_COMPILATION_CACHE_DIR", "WARP_CACHE_PATH"
PROGRAMS_FOLDER = "USARMJX_PROGRAMS"
"""Environment variable with the folder of `kept_programs`."""
MIN_COMPILE_TIME = ("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
"""JAX keeps what took so long, a second if nothing is said; a start has a hundred programs that take less."""
MAX_SIZE = 2_000_000_000
"""At a start what was not used for longest goes until the cache is no larger than this [bytes]. JAX can see
to that, too; but then a process that is killed while it writes leaves a cache that is never written again."""
COMPILATION = "/jax/core/compile/"
"""What the names of JAX's events begin with that tell how long a part of a compilation took."""
QUICKLY, OLDER_EMITTERS = "--xla_backend_optimization_level=0", "--xla_cpu_use_fusion_emitters=false"
"""Flags with which XLA compiles what a task observes in a quarter of the time."""
WITHOUT_OLDER_EMITTERS = (0, 11)
"""From this version on jaxlib has no such flag, and XLA ends a process over a flag that it does not know."""
JAX_COMPLAINT = re.compile(r"persistent compilation cache entry for '([^']+)'|the kept program ()")
"""What JAX warns of, and `kept_programs`; the latter removes what is broken itself."""


def cache_folder(environment: MutableMapping[str, str]) -> Path | None:
    """Return the folder that environment variables ask for; None: nothing is to be kept."""
    asked = environment.get(VARIABLE, "").strip()
    if asked.lower() in OFF:
        return None
    if asked:
        return Path(asked).expanduser()
    return Path(environment.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "usarmjx"


def keep_compilations(environment: MutableMapping[str, str] = os.environ, most: int = MAX_SIZE) -> str | None:
    """Have JAX and Warp keep what they compile; call it before they are imported.

    Args:
        environment: Where to say so.
        most: Size that the cache is cut down to [bytes].

    Returns:
        Why nothing is kept, in a line; None where nothing is wrong.
    """
    try:
        folder = cache_folder(environment)
        if folder is None:
            return None
        # Loops are divided by the pool's threads, which is not in what JAX finds a program by.
        programs = folder / "jax" / (processor() + ("-cores" if fits_cores() else ""))
        programs.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=programs):
            pass
        prune(folder, most)
    except (OSError, RuntimeError) as error:
        return f"compilations are not kept, the next start will take as long: {error}"
    environment.setdefault(JAX_FOLDER, str(programs))
    environment.setdefault(PROGRAMS_FOLDER, str(folder / "programs" / processor()))
    environment.setdefault(*MIN_COMPILE_TIME)
    environment.setdefault(WARP_FOLDER, str(folder / "warp"))
    return None


def quick_flags(version: str | None = None) -> list[str]:
    """Return the flags of quick compilation that a version of jaxlib has; None: the one that is installed."""
    numbers = (version or metadata.version("jaxlib")).split(".")
    older = (int(numbers[0]), int(numbers[1])) < WITHOUT_OLDER_EMITTERS
    return [QUICKLY, OLDER_EMITTERS] if older else [QUICKLY]


def compile_quickly(environment: MutableMapping[str, str] = os.environ) -> None:
    """Have XLA compile without optimisation: for what runs once. Call it before JAX is imported."""
    environment.setdefault("XLA_FLAGS", " ".join(quick_flags()))


def processor() -> str:
    """Return a name for what this machine's processor can do: programs for another one may not run here."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        able = next(line for line in lines if line.lower().startswith(("flags", "features")))
    except (OSError, StopIteration):
        able = platform.processor()
    return f"{platform.machine()}-{hashlib.sha256(able.encode()).hexdigest()[:8]}"


def prune(folder: Path, most: int) -> None:
    """Remove what was not used for longest from a cache, until it is no larger than so many bytes."""
    entries = [(*_use(path), path) for path in _entries(folder)]
    size = sum(one[1] for one in entries)
    for _, own, path in sorted(entries):
        if size <= most:
            return
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        size -= own


def _entries(folder: Path) -> Iterator[Path]:
    """Return what of a cache can go by itself: JAX's files and ours, and Warp's folders, one for a module."""
    for kind in ("jax", "programs"):
        yield from (path for path in folder.glob(f"{kind}/**/*") if path.is_file())
    yield from (path for path in folder.glob("warp/*/*") if path.is_dir())


def _use(path: Path) -> tuple[float, int]:
    """Return when an entry was last used, and its size [bytes]; one that is gone by now has none."""
    files = [one for one in path.rglob("*") if one.is_file()] if path.is_dir() else [path]
    try:
        found = [one.stat() for one in files]
    except FileNotFoundError:
        return 0.0, 0
    return max((max(s.st_atime, s.st_mtime) for s in found), default=0.0), sum(s.st_size for s in found)


def tell_once_of_broken_entries(say: Callable[[str], None], folder: Path) -> None:
    """Say in one line, once, what JAX would warn of for each program; what it cannot read it compiles again.

    A file that is broken, as one is when its writer was killed, would stay so, as JAX writes none that is
    there: it is removed.

    Args:
        say: Takes a line.
        folder: JAX's.
    """
    usual, said = warnings.showwarning, False

    def show(message: Warning | str, *rest: object, **more: object) -> None:
        nonlocal said
        found = JAX_COMPLAINT.search(str(message))
        if found is None:
            usual(message, *rest, **more)  # type: ignore - as it was called
            return
        if not said:
            say(f"note: a compilation is not kept, or was broken and is done anew: {str(message)[:200]}")
        said = True
        if str(message).startswith("Error reading") and found[1]:
            for path in folder.glob(f"{found[1]}-*"):
                path.unlink(missing_ok=True)

    warnings.showwarning = show
