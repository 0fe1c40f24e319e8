"""What computes: versions that decide the last bit."""

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

PACKAGES = ("usarmjx", "mujoco", "mujoco-mjx", "numpy", "jax", "jaxlib")


@cache
def versions() -> dict[str, str]:
    """Return the versions of what computes here, and the kind of machine, by name."""
    found = {"machine": f"{platform.system()} {platform.machine()}", "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found
