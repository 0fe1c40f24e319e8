"""Names of tasks: users' own, those in files, and bare ones, for which alone the tasks are imported."""

from collections.abc import Callable
from pathlib import Path


def is_own(name: str) -> bool:
    """Return whether a name is that of a user's own task."""
    return ":" in name or name.endswith(".py")


RECORDED = {
    "explore": "explore-v1",
    "relay-chain": "relay-chain-v1",
    "soccer": "soccer-v1",
    "victim-search": "victim-search-v1",
}
"""Meanings of bare names in files: earlier releases wrote them for version 1, this one writes full names."""


def recorded_name(name: str) -> str:
    """Return the full name of a task that a file names; see `RECORDED`."""
    return RECORDED.get(name.lower(), name)


def newest_name(name: str) -> str:
    """Return a task's full name: a bare one is that of the newest version, an unknown or own one stays."""
    # Here: names in files and own ones are read without any task, and so without JAX.
    from usarmjx.train.tasks import TASKS

    return TASKS.full_name(name) if name in TASKS else name


def full_name(name: str) -> str:
    """Return a task's name as records have it: with its version, an own one with the path of its file."""
    place, _, found = name.rpartition(":")
    return f"{path_of(place)}:{found}" if place.endswith(".py") else newest_name(name)


def policy_name(policy: str, rename: Callable[[str], str] = newest_name) -> str:
    """Return a policy's name, with the full name of its task if the package has it by that.

    Args:
        policy: A task's name; or a folder, a file, or any other text, which stays.
        rename: Returns the full name of a task.
    """
    return policy if Path(policy).exists() else rename(policy)


def same_class(one: str, other: str) -> bool:
    """Return whether two names are of the same task, own ones perhaps in files that are elsewhere."""
    if is_own(one) and is_own(other):
        return one.rpartition(":")[2] == other.rpartition(":")[2]
    return one.lower() == other.lower()


def path_of(place: str) -> Path:
    """Return the whole path of a file of tasks."""
    return Path(place).expanduser().absolute()
