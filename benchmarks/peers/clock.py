"""Timing of all peers: options, the clock, one line of JSON. The standard library alone.

Each peer runs in an environment of its own, so nothing of usarmjx is imported here.
"""

import argparse
import json
import platform
import sys
import time
from importlib.metadata import version

WARM_UP = 2
"""Calls before the clock starts: JAX compiles again where a step's state differs in kind from the first."""


def read_options():
    """Return what `usarmjx bench peers` asks a peer for."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--worlds", type=int, required=True)
    parser.add_argument("--robots", type=int, required=True)
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--repeats", type=int, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--variant", default="")
    parser.add_argument("--device", choices=("cpu", "gpu"), default="cpu")
    parser.add_argument("--model", default="", help="MuJoCo model of our scene, for those that take one.")
    return parser.parse_args()


def measure(run, state, options, period, packages, device, **more):
    """Time `run`, from a state to the next, and print what was found as the last line.

    Args:
        run: Makes `steps` steps of all worlds and waits until they are done.
        state: The first state.
        options: As `read_options` returns them.
        period: Simulated time of a step [s].
        packages: Names of the packages whose versions count.
        device: Machine, "cpu" or "host" for the processor.
        more: Anything else that the record shall say.
    """
    if options.device == "gpu" and device in ("cpu", "host"):
        sys.exit(f"asked for a GPU, has only {device}")  # before minutes are spent
    times = []
    for _ in range(options.repeats + WARM_UP):
        began = time.perf_counter()
        state = run(state)
        times.append(time.perf_counter() - began)
    found = {
        "warm_up": WARM_UP,
        "first_s": sum(times[:WARM_UP]),
        "times_s": times[WARM_UP:],
        "period_s": period,
        "steps": options.steps,
        "device": device,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in packages}},
        **more,
    }
    sys.stdout.write("\n" + json.dumps(found) + "\n")
