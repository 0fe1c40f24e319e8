"""Where the time of a compiled function goes, kernel by kernel, as JAX's profiler sees it."""

import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from heapq import nlargest
from pathlib import Path
from typing import Any

import jax

from usarmjx.base.errors import EngineError

TOP = 25
"""Kernels that are told, those that take longest."""
NANOSECONDS = 1e6
"""In a millisecond."""
Span = tuple[str, float, float]
"""A name, when it began and how long it took [ns]."""


def profile_kernels(run: Callable[[Any], Any], state: Any) -> dict[str, Any]:  # noqa: ANN401
    """Call a function once more under the profiler, and return what ran for how long.

    On a GPU these are kernels and copies, on a CPU XLA's operations without those within them. What Warp
    launches as a CUDA graph is told kernel by kernel.

    Args:
        run: What was measured before, so that nothing is compiled now.
        state: What it is called with.

    Returns:
        All `calls` and their `ms`, the `span_ms` from the first's begin to the last's end, and the `top`:
        names with calls, ms and share of all.

    Raises:
        EngineError: The profiler saw nothing.
    """
    options = jax.profiler.ProfileOptions()
    options.python_tracer_level = 0
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder, profiler_options=options):
            jax.block_until_ready(run(state))
        files = list(Path(folder).rglob("*.xplane.pb"))
        if not files:
            raise EngineError("JAX's profiler left no trace")
        lines = [list(line) for line in _device_lines(str(files[0]))]
    return count_kernels(lines, nested=jax.default_backend() == "cpu")


def _device_lines(file: str) -> Iterator[Iterator[Span]]:
    """Yield the spans of each stream of a GPU; where there is none, XLA's of each thread of the CPU."""
    planes = list(jax.profiler.ProfileData.from_file(file).planes)
    on_gpu = [plane for plane in planes if "GPU" in plane.name]
    for plane in on_gpu or planes:
        for line in plane.lines:
            if not on_gpu or "Stream" in line.name:
                yield (
                    (event.name, event.start_ns, event.duration_ns)
                    for event in line.events
                    if on_gpu or "hlo_op" in dict(event.stats)
                )


def count_kernels(lines: Iterable[Iterable[Span]], nested: bool = True) -> dict[str, Any]:
    """Return what `profile_kernels` does, of the spans of each stream or thread.

    Args:
        lines: The spans.
        nested: Whether one within another is a part of it; kernels of a GPU that run at the same time are
            branches of a CUDA graph, each with a time of its own.

    Raises:
        EngineError: There are no spans.
    """
    took: defaultdict[str, float] = defaultdict(float)
    calls: Counter[str] = Counter()
    begin, end = float("inf"), 0.0
    for spans in lines:
        around: list[Span] = []
        for span in sorted(spans, key=lambda span: (span[1], -span[2])):
            name, start, duration = span
            while around and around[-1][1] + around[-1][2] <= start:
                around.pop()
            if around and nested:
                took[around[-1][0]] -= duration
            around.append(span)
            took[name] += duration
            calls[name] += 1
            begin, end = min(begin, start), max(end, start + duration)
    longest, total = nlargest(TOP, took, took.__getitem__), sum(took.values())
    if not total:
        raise EngineError("JAX's profiler saw no kernel")
    return {
        "calls": sum(calls.values()),
        "ms": total / NANOSECONDS,
        "span_ms": (end - begin) / NANOSECONDS,
        "top": [
            {"name": name, "calls": calls[name], "ms": took[name] / NANOSECONDS, "share": took[name] / total}
            for name in longest
        ],
    }


def kernel_lines(kernels: dict[str, Any]) -> list[str]:
    """Return the lines of a table for people."""
    head = f"{kernels['calls']:,} kernels took {kernels['ms']:,.1f} ms of {kernels['span_ms']:,.1f} ms:"
    rows = (
        f"{one['ms']:10.2f} ms {one['share']:6.1%} {one['calls']:8,} x {one['name'][:90]}"
        for one in kernels["top"]
    )
    return [head, *rows]
