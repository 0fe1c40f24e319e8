"""What `usarmjx doctor` looks at before it tries anything: packages, devices, cache, ports, engines."""

import importlib.metadata
import importlib.util
import os
import platform
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import usarmjx
from usarmjx.base import threads
from usarmjx.base.compilation import VARIABLE, cache_folder, keep_compilations
from usarmjx.base.errors import UsarmjxError, one_line
from usarmjx.server.ports import (
    BOT_PORT,
    IMAGE_PORT,
    POSITION_PORT,
    VIEWER_PORT,
    WSS2_PORT,
    WSS_PORT,
    bound_socket,
)

Verdict = Literal["ok", "note", "wrong"]
HOST = "127.0.0.1"
OLDEST_PYTHON = (3, 11)
PORTS = {
    "--port": BOT_PORT,
    "--wss-port": WSS_PORT,
    "--wss2-port": WSS2_PORT,
    "--position-port": POSITION_PORT,
    "--image-port": IMAGE_PORT,
}
"""The usual ports of `usarmjx serve` by the options that move them."""
REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^\]]*\])?([^;]*)(?:;(.*))?")
EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)")
USERS_EXTRAS = ("cuda", "rl", "train", "warp")
SHOWN = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "viser")
"""Packages whose versions are told."""


@dataclass(frozen=True)
class Finding:
    """What was found of one thing.

    Attributes:
        about: Which thing.
        verdict: How it is: fine, worth knowing, or wrong.
        text: What was found.
        advice: What to do about it, if anything.
    """

    about: str
    verdict: Verdict
    text: str
    advice: str = ""


Check = Callable[[], Iterator[Finding]]
"""Looks at something."""


def version_of(package: str) -> str | None:
    """Return the version of an installed package, or None."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def check_versions() -> Iterator[Finding]:
    """Look whether Python and all packages are there; say which extras are."""
    python = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info[:2] < OLDEST_PYTHON:
        yield Finding("python", "wrong", f"Python {python}", "usarmjx needs Python 3.11 or newer")
    else:
        yield Finding("python", "ok", f"Python {python} on {platform.system()} {platform.machine()}")
    found = {name: version_of(name) for name in SHOWN}
    shown = ", ".join(f"{name} {version}" for name, version in found.items() if version)
    yield Finding("packages", "ok", f"usarmjx {usarmjx.__version__}, {shown}")
    needed, extras = requirements()
    missing = [name for name in needed if version_of(name) is None]
    if missing:
        advice = f"pip install {' '.join(missing)}; or install usarmjx again"
        yield Finding("packages", "wrong", f"missing: {', '.join(missing)}", advice)
    there = [extra for extra, names in extras.items() if all(version_of(name) for name in names)]
    absent = [extra for extra in extras if extra not in there]
    text = f"extras installed: {', '.join(there) or 'none'}"
    yield Finding("extras", "ok", text + (f"; not: {', '.join(absent)}" if absent else ""))


def requirements() -> tuple[list[str], dict[str, list[str]]]:
    """Return the packages that usarmjx needs, and those of each extra for users."""
    try:
        lines = importlib.metadata.requires("usarmjx") or []
    except importlib.metadata.PackageNotFoundError:
        lines = []
    needed: list[str] = []
    extras: dict[str, list[str]] = {}
    for line in lines:
        found = REQUIREMENT.match(line)
        if found is None:
            continue
        extra = EXTRA.search(found[3] or "")
        if extra is None:
            needed.append(found[1])
        elif extra[1] in USERS_EXTRAS:
            # jax[cuda13] is there when its plugin is.
            name = "jax-cuda13-plugin" if "cuda13" in line else found[1]
            extras.setdefault(extra[1], []).append(name)
    return needed, extras


def check_devices() -> Iterator[Finding]:
    """Look at what JAX computes on, and whether a GPU lies idle."""
    try:
        import jax

        devices = jax.devices()
    except (ImportError, RuntimeError) as error:
        yield Finding("devices", "wrong", f"JAX does not start: {one_line(error)}", "install jax again")
        return
    kinds = ", ".join(sorted({f"{one.platform} ({one.device_kind})" for one in devices}))
    yield Finding("devices", "ok", f"JAX computes on {len(devices)}: {kinds}; {threads.cores()} cores")
    if has_nvidia() and all(one.platform != "gpu" for one in devices):
        advice = "pip install 'usarmjx[cuda]', or unset JAX_PLATFORMS if that says cpu"
        yield Finding("devices", "note", "there is an NVIDIA GPU that JAX does not use", advice)


def has_nvidia() -> bool:
    """Return whether there is an NVIDIA GPU's driver."""
    return shutil.which("nvidia-smi") is not None or Path("/proc/driver/nvidia/version").exists()


def check_engines() -> Iterator[Finding]:
    """Say which engine `auto` takes, and why."""
    from usarmjx.engines import choose_engine

    chosen = tuple(choose_engine("auto", purpose) for purpose in ("serve", "train", "batch"))
    if chosen[0] == "warp":
        why = "an NVIDIA GPU and Warp are there"
    elif importlib.util.find_spec("warp") is None:
        why = "without Warp a GPU's engine cannot run, and c serves one world fastest on a CPU"
    else:
        why = "JAX has no NVIDIA GPU here, and c serves one world fastest on a CPU"
    serve, train, batch = chosen
    yield Finding("engines", "ok", f"auto is {serve} to serve, {train} to train, {batch} for batches: {why}")


def check_cache(environment: Mapping[str, str] = os.environ) -> Iterator[Finding]:
    """Look whether what is compiled is kept, where, and how large that is."""
    folder = cache_folder(dict(environment))
    if folder is None:
        advice = f"unset {VARIABLE} so that the next start compiles nothing"
        yield Finding("cache", "note", f"compilations are not kept: {VARIABLE} says so", advice)
        return
    complaint = keep_compilations(dict(environment))
    if complaint:
        yield Finding("cache", "wrong", complaint, f"free the disk or set {VARIABLE} to another folder")
        return
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    yield Finding("cache", "ok", f"{folder}, {size / 1e6:.0f} MB of compiled programs")


def check_threads() -> Iterator[Finding]:
    """Look whether JAX's pool of threads is safe from a deadlock."""
    try:
        threads.check_pool_size()
    except UsarmjxError as error:
        yield Finding("threads", "wrong", str(error), f"set NPROC={threads.MIN_THREADS}")
        return
    asked = os.environ.get("NPROC")
    text = f"NPROC={asked}" if asked else f"{threads.cores()} cores"
    yield Finding("threads", "ok", f"JAX's pool is large enough: {text}")


def check_ports(ports: Mapping[str, int] = PORTS, viewer: int = VIEWER_PORT) -> Iterator[Finding]:
    """Look whether the usual ports are free."""
    taken = {option: port for option, port in ports.items() if not is_free(port)}
    for option, port in taken.items():
        advice = f"end what listens there, or {option} PORT, or --port-offset 100 for all ports"
        yield Finding("ports", "wrong", f"{port} is taken", advice)
    if not taken:
        yield Finding("ports", "ok", f"{', '.join(map(str, ports.values()))} are free")
    if is_free(viewer):
        yield Finding("ports", "ok", f"{viewer} is free for the live page")
    else:
        yield Finding("ports", "note", f"{viewer} is taken: the live page gets another port, and says so")


def is_free(port: int) -> bool:
    """Return whether one can listen at a port of this machine."""
    try:
        bound_socket(HOST, port).close()
    except UsarmjxError:
        return False
    return True


def run_checks(checks: Sequence[Check]) -> list[Finding]:
    """Return what checks have found; one that fails is a finding itself."""
    found: list[Finding] = []
    for check in checks:
        try:
            found += check()
        except Exception as error:  # whatever is broken, the others are still looked at
            about = check.__name__.removeprefix("check_").removeprefix("try_")
            found.append(Finding(about, "wrong", f"{type(error).__name__}: {one_line(error)}"))
    return found


CHECKS: tuple[Check, ...] = (
    check_versions,
    check_threads,
    check_cache,
    check_ports,
    check_devices,
    check_engines,
)
