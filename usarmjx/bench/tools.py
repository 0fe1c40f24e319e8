"""What every benchmark needs: the clock, what it ran on, and the file of records."""

import json
import platform
import subprocess
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

from usarmjx.base.files import AppendedFile


def versions() -> dict[str, str]:
    """Return the versions of what decides the figures."""
    found = {"python": platform.python_version()}
    for name in ("jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "usarmjx"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def commit(folder: Path = Path(__file__).parent) -> str:
    """Return the commit of the code in a folder, this one by default, if it is a checkout."""
    try:
        asked = ["git", "-C", str(folder), "rev-parse", "--short", "HEAD"]
        return subprocess.run(asked, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def device(*, host: bool = False) -> str:
    """Return the name of jax's device, as its driver has it; of the processor if the work is on the host."""
    kind = jax.devices()[0].device_kind
    return platform.processor() or platform.machine() if host or kind == "cpu" else kind


def record_header(benchmark: str, *, host: bool = False) -> dict[str, Any]:
    """Return the first entries of a record: which benchmark, when, where, of what."""
    return {
        "benchmark": benchmark,
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "device": device(host=host),
        "commit": commit(),
        "versions": versions(),
    }


def append_record(record: Mapping[str, Any], file: Path | None) -> None:
    """Append a record to a file as a line of JSON; None: do not."""
    if file is not None:
        lines = AppendedFile(file)
        lines.append(json.dumps(record).encode() + b"\n")
        lines.close()


def time_repeats(run: Callable[[Any], Any], state: Any, repeats: int) -> tuple[float, list[float], Any]:  # noqa: ANN401
    """Return the first call's time (with compilation), the later ones', and the last state [s]."""
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        state = jax.block_until_ready(run(state))
        times.append(time.perf_counter() - began)
    return times[0], times[1:], state
