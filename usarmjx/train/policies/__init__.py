"""Trained policies that come with the package: files as `usarmjx export` writes them, TASK.npz each."""

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
