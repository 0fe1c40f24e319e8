"""Discovery of the values of a package: a new robot or arena is registered by its module alone."""

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import TypeVar

T = TypeVar("T")


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
                    found.setdefault(id(value), value)
    return list(found.values())
