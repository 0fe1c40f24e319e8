"""The folder of compiled programs that the processes of a test run share."""

from collections.abc import Mapping
from pathlib import Path

from usarmjx.base.compilation import OFF_VALUES, processor, prune_cache

KEPT = "USARMJX_TEST_CACHE"
"""Environment variable: a folder that runs share, too; unset or one of `OFF_VALUES`: a run begins with none.

`dev.py test` sets it to `usarmjx-tests` in the user's cache folder.
"""
MAX_KEPT_SIZE = 1_500_000_000
"""Size above which a run first removes the least recently used programs of a kept folder [bytes]."""


def kept_folder(environ: Mapping[str, str]) -> Path | None:
    """Return the folder that runs share, by an environment; None: they share none."""
    folder = environ.get(KEPT, "").strip()
    return None if not folder or folder.lower() in OFF_VALUES else Path(folder).expanduser().resolve()


def folder_of_programs(environ: Mapping[str, str], own: Path) -> Path:
    """Return the folder for a process of a run.

    Args:
        environ: Its environment: a worker of xdist finds the folder of its run there.
        own: Folder of the process, which it deletes.
    """
    if "PYTEST_XDIST_WORKER" in environ and environ.get("JAX_COMPILATION_CACHE_DIR"):
        return Path(environ["JAX_COMPILATION_CACHE_DIR"]).expanduser().resolve()
    kept = kept_folder(environ)
    if kept is None:
        return own / "compiled"
    # JAX's keys of programs contain neither the instruction set nor the size of the thread pool.
    return kept / "jax" / f"{processor()}-{environ.get('NPROC', '')}"


def limit_kept(environ: Mapping[str, str], max_bytes: int = MAX_KEPT_SIZE) -> None:
    """Remove the least recently used programs of a kept folder; only the process that begins a run does."""
    kept = kept_folder(environ)
    if kept is not None and "PYTEST_XDIST_WORKER" not in environ:
        prune_cache(kept, max_bytes)
