"""Registry of named entries: explicit `add`, names matched without case as in USARSim.

In some a bare name, as `explore` of `explore-v1` and `explore-v2`, stands for the newest version.
"""

import re
from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Generic, TypeVar

from usarmjx.base.errors import UnknownNameError, UsageError

# In ASCII the braces stand between z and | and between | and ~.
_NAME = re.compile(r"[!-z|~]+")
_VERSION = re.compile(r"(.+)-v(\d+)")
T = TypeVar("T")


def is_name(text: str) -> bool:
    """Return whether a text is one word of ASCII 33 to 126 without braces, which end a message segment."""
    return _NAME.fullmatch(text) is not None


def unknown_name(kind: str, name: str, known: Iterable[str], aliases: Iterable[str] = ()) -> str:
    """Return a refusal of a name: the closest one or alias that is known, if one is close, and all names."""
    names = list(known)
    hint = closest(name, [*names, *aliases])
    return f"unknown {kind} {name!r}{hint or ';'} known: {', '.join(names) or 'none'}"


def closest(name: str, known: Iterable[str]) -> str:
    """Return the question whether the closest known name was meant; empty: none is close."""
    candidates = list(known)
    # In lower case: the comparison takes letters of another case for different ones.
    near = get_close_matches(name.lower(), [one.lower() for one in candidates], n=1)
    return next((f"; did you mean {one!r}?" for one in candidates if [one.lower()] == near), "")


def version_of(name: str) -> tuple[str, int]:
    """Return the bare name and the number of a version, as of `explore-v2`; 0: the name has none."""
    match = _VERSION.fullmatch(name)
    return (match[1], int(match[2])) if match else (name, 0)


def newest_versions(names: Iterable[str]) -> dict[str, str]:
    """Return the name of the newest version by bare names in lower case that are no names themselves."""
    # Ascending: of several versions the last one stays in the mapping below.
    known = sorted(names, key=lambda name: version_of(name)[1])
    found = {version_of(name)[0].lower(): name for name in known if version_of(name)[1]}
    return {bare: name for bare, name in found.items() if bare not in {one.lower() for one in known}}


class Registry(Generic[T]):
    """Table of named entries that refuses duplicates and lists its names.

    Args:
        kind: Noun for the entries in error messages ("robot", "sensor").
        versioned: Whether a bare name, unless it is an entry itself, stands for the newest version.
    """

    def __init__(self, kind: str, *, versioned: bool = False) -> None:
        self.kind, self.versioned = kind, versioned
        self._entries: dict[str, tuple[str, T]] = {}
        self._aliases: dict[str, str] = {}

    def add(self, name: str, entry: T, *, aliases: tuple[str, ...] = ()) -> T:
        """Register `entry` under `name` and its aliases and return it.

        Raises:
            UsageError: The name or an alias is taken.
        """
        # All are checked before one is entered: a refused entry leaves nothing behind.
        for candidate in (name, *aliases):
            key = candidate.lower()
            if key in self._entries or key in self._aliases:
                raise UsageError(f"{self.kind} {candidate!r} is registered already")
        self._entries[name.lower()] = (name, entry)
        self._aliases.update({alias.lower(): name.lower() for alias in aliases})
        return entry

    def replace(self, name: str, entry: T) -> T:
        """Register `entry` under a name, replacing the entry of that name or alias if there is one."""
        key = self._key(name)
        spelt = self._entries[key][0] if key in self._entries else name
        self._entries[key] = (spelt, entry)
        return entry

    def get(self, name: str) -> T:
        """Return the entry of a name or alias, case ignored.

        Raises:
            UnknownNameError: No such name; the message lists the registered ones.
        """
        return self._entry(name)[1]

    def full_name(self, name: str) -> str:
        """Return the registered name that a name, an alias or a bare name stands for, as it was spelt.

        Raises:
            UnknownNameError: No such name; the message lists the registered ones.
        """
        return self._entry(name)[0]

    def _entry(self, name: str) -> tuple[str, T]:
        key = self._key(name)
        if key not in self._entries:
            raise UnknownNameError(unknown_name(self.kind, name, self.names(), self.aliases()))
        return self._entries[key]

    def _key(self, name: str) -> str:
        key = name.lower()
        key = self._aliases.get(key, key)
        # An entry of exactly that name comes first: a bare name is the newest version's only if nobody has
        # it.
        return key if key in self._entries else self._newest().get(key, key).lower()

    def _newest(self) -> dict[str, str]:
        return newest_versions(self.names()) if self.versioned else {}

    def find(self, name: str) -> T | None:
        """Return the entry of a name or alias, case ignored; None: no such name."""
        return self.get(name) if name in self else None

    def names(self) -> list[str]:
        """Return the registered names in their original spelling, sorted without case."""
        return sorted((name for name, _ in self._entries.values()), key=str.lower)

    def aliases(self) -> list[str]:
        """Return the aliases and the bare names of versions, in lower case."""
        return [*self._aliases, *self._newest()]

    def discard(self, name: str) -> None:
        """Remove the entry of a name, case ignored, if there is one."""
        self._entries.pop(name.lower(), None)

    def copy(self) -> "Registry[T]":
        """Return a registry of the same entries and aliases."""
        other: Registry[T] = Registry(self.kind, versioned=self.versioned)
        # Tables of its own: entries that are added later stay in one of the two registries.
        other._entries, other._aliases = dict(self._entries), dict(self._aliases)
        return other

    def __repr__(self) -> str:
        """Return the names."""
        return f"Registry of {self.kind}s: {', '.join(self.names())}"

    def __contains__(self, name: str) -> bool:
        """Return whether a name or alias is registered, case ignored."""
        return self._key(name) in self._entries

    def __iter__(self) -> Iterator[tuple[str, T]]:
        """Iterate over (name, entry), sorted by name, case ignored."""
        return iter(sorted(self._entries.values(), key=lambda pair: pair[0].lower()))

    def __len__(self) -> int:
        """Return the number of entries, aliases not counted."""
        return len(self._entries)


def values_in(package: ModuleType, kind: type[T]) -> list[T]:
    """Return the public module-level values of a type in a package's modules, by module and definition.

    A value that several modules import appears once. Subpackages and names with an underscore are skipped.
    """
    found: dict[int, T] = {}
    for info in iter_modules(package.__path__):
        if not info.ispkg:
            module = import_module(f"{package.__name__}.{info.name}")
            for name, value in vars(module).items():
                if isinstance(value, kind) and not name.startswith("_"):
                    # By identity: equal descriptions under two names are two entries.
                    found.setdefault(id(value), value)
    return list(found.values())
