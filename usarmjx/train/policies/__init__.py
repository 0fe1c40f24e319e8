"""Trained policies that come with the package: files as `usarmjx export` writes them, TASK.npz each.

`export` writes them, `policy_file` runs them with NumPy alone, `sources` finds policies by folder, file or
name. Keys of the files are for good: robots elsewhere read them. A policy fits only the observation that it
was trained on, so a task whose observation changes needs a new policy. Begin with `policy_file.NumpyPolicy`.
"""

from collections.abc import Iterable
from pathlib import Path

from usarmjx.base.registry import Registry, closest

FOLDER = Path(__file__).parent


def policies_in(folder: Path) -> Registry[Path]:
    """Return the exported policies of a folder by the names of their tasks, which are those of the files."""
    found: Registry[Path] = Registry("packaged policy")
    for file in sorted(folder.glob("*.npz")):
        found.add(file.stem, file)
    return found


POLICIES = policies_in(FOLDER)
"""The packaged policies by the names of their tasks."""


def no_policy(name: str, packaged: Registry[Path], others: Iterable[str] = ()) -> str:
    """Return the refusal of a policy that is nowhere; the closest name may be one of some others, too."""
    names = packaged.names()
    hint = closest(name, [*others, *names])
    return (
        f"{name} is no folder of a run, no exported policy, nor a packaged one{hint}{'' if hint else ';'} "
        f"packaged: {', '.join(names) or 'none'}"
    )
