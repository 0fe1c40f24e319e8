"""Public names of a package, each imported from its module on first use (PEP 562).

The `__init__` of a package is its face: it lists public names and loads none of them. Type checkers and the
API reference read the imports of its TYPE_CHECKING branch, Python runs `attach` in the other branch;
`tests/test_public_names.py` compares the two.
"""

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any

PublicNames = Mapping[str, Iterable[str]]
"""Names by the module that defines them."""


def attach(
    package: str, names: PublicNames, *eager: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package whose names load on first use.

    Nothing is cached: after a test replaces an attribute of a module, the package gives the new one.

    Args:
        package: Full name of the package.
        names: Its public names. None may be a submodule's, which Python binds over it.
        eager: Further public names, which the package defines itself.
    """
    modules = {name: module for module, entries in names.items() for name in entries}
    exported = sorted([*modules, *eager])

    def get_attribute(name: str) -> Any:  # noqa: ANN401 - any public object
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(modules[name]), name)

    def list_names() -> list[str]:
        # Completion must offer names that have not been loaded yet, too.
        return sorted({*vars(sys.modules[package]), *exported})

    return get_attribute, list_names, exported
