"""Names of tasks, read before anything is built; nothing heavy is imported."""

from pathlib import Path


def is_own(name: str) -> bool:
    """Return whether a name is that of a user's own task."""
    return ":" in name or name.endswith(".py")


def full_name(name: str) -> str:
    """Return a task's name as records have it: of a user's own task with the whole path of its file."""
    place, _, found = name.rpartition(":")
    return f"{path_of(place)}:{found}" if place.endswith(".py") else name


def same_class(one: str, other: str) -> bool:
    """Return whether two names are of the same task, own ones perhaps in files that are elsewhere."""
    if is_own(one) and is_own(other):
        return one.rpartition(":")[2] == other.rpartition(":")[2]
    return one.lower() == other.lower()


def path_of(place: str) -> Path:
    """Return the whole path of a file of tasks."""
    return Path(place).expanduser().absolute()
