"""Trained policies that come with the package: files as `usarmjx export` writes them, TASK.npz each.

`export` writes and runs them with NumPy alone, `sources` finds policies by folder, file or name. Keys of the
files are for good: robots elsewhere read them. A policy fits only the observation that it was trained on, so
whoever changes a task's observation trains its policy again. Begin with `export.NumpyPolicy`.
"""

from pathlib import Path

from usarmjx.base.registry import Registry

FOLDER = Path(__file__).parent


def policies_in(folder: Path) -> Registry[Path]:
    """Return the exported policies of a folder by the names of their tasks, which are those of the files."""
    found: Registry[Path] = Registry("packaged policy")
    for file in sorted(folder.glob("*.npz")):
        found.add(file.stem, file)
    return found


POLICIES = policies_in(FOLDER)
"""The packaged policies by the names of their tasks."""
