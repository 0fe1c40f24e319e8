"""Processor time of `usarmjx doctor` with an empty cache: python -m benchmarks.doctor."""

import os
import resource
import subprocess
import sys
import tempfile
import time


def measure() -> tuple[float, float]:
    """Return processor time and time of a cold `usarmjx doctor` [s].

    Raises:
        SystemExit: The doctor found a fault.
    """
    with tempfile.TemporaryDirectory() as cache:
        began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "usarmjx", "doctor"]
        done = subprocess.run(
            command, capture_output=True, text=True, env={**os.environ, "USARMJX_CACHE": cache}
        )
        after, ended = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return used, ended - began


if __name__ == "__main__":
    used, took = measure()
    print(f"usarmjx doctor took {took:.1f} s, and {used:.1f} s of a processor, with an empty cache")
