"""Needs of every benchmark: the clock, what it ran on, and the file of records."""

import json
import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

from benchmarks.cases import BaselineOptions
from usarmjx.base.files import AppendedFile, atomic_write
from usarmjx.base.process import cores

FORM = 2
"""Of records; those without the number, older, have the header up to `versions` and keys of their own."""
WARM_UP = 1
"""Calls before the clock starts: the first one compiles."""
PROCESSOR_FILE, MEMORY_FILE = Path("/proc/cpuinfo"), Path("/proc/meminfo")
GIGABYTE = 1e9
PREALLOCATE = "XLA_PYTHON_CLIENT_PREALLOCATE"
"""Environment variable: whether JAX takes three quarters of a GPU's memory at once; unless set it does."""


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


def processor() -> str:
    """Return the processor's name, as the system has it."""
    return _entry(PROCESSOR_FILE, "model name") or platform.processor() or platform.machine()


def _entry(file: Path, name: str) -> str:
    """Return what a file of the system says under a name; nothing where there is no such file."""
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except OSError:
        return ""
    return next((line.partition(":")[2].strip() for line in lines if line.startswith(name)), "")


def hardware() -> dict[str, Any]:
    """Return what a benchmark ran on; the load at its end is filled in by `append_record`."""
    devices = [device for device in jax.devices() if device.platform != "cpu"]
    memory = _entry(MEMORY_FILE, "MemTotal").removesuffix(" kB")
    return {
        "accelerator": devices[0].device_kind if devices else None,
        "accelerators": len(devices),
        "processor": processor(),
        "cores": cores(),
        "memory_gb": round(1024 * float(memory) / GIGABYTE, 1) if memory else None,
        "load_average": {"begin": load(), "end": None},
    }


def load() -> float | None:
    """Return how many processes wanted a core in the last minute, where the system tells."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def record_header(benchmark: str, *, host: bool = False, note: str = "") -> dict[str, Any]:
    """Return the first entries of a record: which benchmark, when, where, of what.

    Args:
        benchmark: Its name.
        host: Whether the work is the host's alone.
        note: Remarks for readers of the record.
    """
    return {
        "form": FORM,
        "benchmark": benchmark,
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "note": note,
        "device": device(host=host),
        "commit": commit(),
        "versions": versions(),
        "hardware": hardware(),
    }


def spare_memory() -> None:
    """Let JAX find its devices now, so that this process takes a GPU's memory only as it needs it.

    It shall come before anything else that asks for devices. Processes that are started later do as the
    environment says.
    """
    said = os.environ.get(PREALLOCATE)
    os.environ[PREALLOCATE] = "false"
    try:
        jax.devices()
    finally:
        if said is None:
            del os.environ[PREALLOCATE]
        else:
            os.environ[PREALLOCATE] = said


def append_record(record: dict[str, Any], file: Path | None) -> None:
    """Append a record to a file as a line of JSON, the load by now in it; None: do not."""
    if "hardware" in record:  # samples of a soak say it once
        record["hardware"]["load_average"]["end"] = load()
    if file is not None:
        lines = AppendedFile(file)
        lines.append(json.dumps(record).encode() + b"\n")
        lines.close()


def run_case(
    benchmark: str,
    options: BaselineOptions,
    measure: Callable[[], dict[str, Any]],
    summary: Callable[[dict[str, Any]], str],
    *,
    host: bool = False,
) -> str:
    """Measure a case, append its record to a file, and return a summary for people.

    Args:
        benchmark: Its name.
        options: Of the record.
        measure: Returns the entries after the header: `case`, `scene`, `rates`, `baselines` and others.
        summary: Turns the record into a text.
        host: Whether the work is the host's alone.

    Raises:
        UsageError: No such word for baselines.
    """
    options.check()
    header = record_header(benchmark, host=host, note=options.note)
    record = {**header, **measure()}
    append_record(record, options.json)
    return summary(record)


def rewrite_record(record: dict[str, Any], file: Path, before: bytes = b"") -> bytes:
    """Put a record that has grown into a file of records, in one piece; return its line.

    Args:
        record: The record; the load by now is put in it.
        file: Of records, which may be missing.
        before: The line that it had there; empty, or not there any more: it comes last.

    Raises:
        WriteError: The file is as it was.
    """
    record["hardware"]["load_average"]["end"] = load()
    line = json.dumps(record).encode() + b"\n"
    said = file.read_bytes() if file.exists() else b""
    with atomic_write(file) as fresh:
        fresh.write_bytes(said.replace(before, line) if before and before in said else said + line)
    return line


def time_repeats(
    run: Callable[[Any], Any],
    state: Any,  # noqa: ANN401
    repeats: int,
    look: Callable[[Any], None] | None = None,
) -> tuple[float, list[float], Any]:
    """Return the first call's time (with compilation), the later ones', and the last state [s].

    Args:
        run: Function to measure: from a state to the next.
        state: The first.
        repeats: Calls after the first.
        look: Sees the state after each call, while the clock stands.
    """
    times = []
    for _ in range(repeats + WARM_UP):
        began = time.perf_counter()
        state = jax.block_until_ready(run(state))
        times.append(time.perf_counter() - began)
        if look is not None:
            look(state)
    return times[0], times[WARM_UP:], state


def rate_of(
    unit: str, work: float, first: float, times: Sequence[float], warm_up: int = WARM_UP
) -> dict[str, Any]:
    """Return a rate as records have it: the median of the repeats and their spread, compilation apart.

    Args:
        unit: Of the rate, as `robot-steps/s`.
        work: Done in each repeat, in that unit times a second.
        first: Time of the calls before, which compiled [s].
        times: Of the repeats [s].
        warm_up: Number of calls before.
    """
    return {
        "unit": unit,
        "rate": work / statistics.median(times),
        "least": work / max(times),
        "most": work / min(times),
        "repeats": len(times),
        "warm_up": warm_up,
        "compile_s": first - warm_up * times[0],
        "times_s": list(times),
    }


def spread_of(unit: str, rates: Sequence[float]) -> dict[str, Any]:
    """Return rates that were measured otherwise than by `time_repeats`, in the same form."""
    spread = {"rate": statistics.median(rates), "least": min(rates), "most": max(rates)}
    return {"unit": unit, **spread, "repeats": len(rates), "warm_up": 0, "compile_s": None}
