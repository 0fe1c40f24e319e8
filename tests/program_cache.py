"""The folder of compiled programs that the processes of a test run share."""

from collections.abc import Mapping
from pathlib import Path

KEPT = "USARMJX_TEST_CACHE"
"""Environment variable: a folder that runs share, too; unset: a run begins with an empty one."""


def folder_of_programs(environ: Mapping[str, str], own: Path) -> Path:
    """Return the folder for a process of a run.

    Args:
        environ: Its environment: a worker of xdist finds the folder of its run there.
        own: Folder of the process, which it deletes.
    """
    is_worker = "PYTEST_XDIST_WORKER" in environ
    folder = environ.get("JAX_COMPILATION_CACHE_DIR" if is_worker else KEPT)
    return Path(folder).expanduser().resolve() if folder else own / "compiled"
