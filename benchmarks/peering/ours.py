"""This package as `usarmjx bench peers` measures it: in a process of its own, with the peers' options."""

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax

from benchmarks.cases import SceneCase
from benchmarks.scenes import bare_step, batch_of, repeat_loop, scene_of, whole_step
from benchmarks.tools import WARM_UP, time_repeats, versions
from usarmjx.sim.configure import configure


@dataclass(frozen=True, kw_only=True)
class Workload:
    """Measured part of our step, and its machine.

    Attributes:
        has: Contents.
        lacks: Omissions.
        beams: Rays of a robot.
        arena: Arena, whichever the others use; "": that of all.
        generated: Number of such arenas to generate; 0: none.
        physics: Settings of the physics.
        ini: File beside the peers' folder with the robot's sensors; "": its own.
        engines: Of which this is measured; none: all.
    """

    has: str
    lacks: str
    beams: int = 0
    arena: str = ""
    generated: int = 0
    physics: str = "reference"
    ini: str = ""
    engines: tuple[str, ...] = ()


_ONE_SCANNER = "random commands, control, physics in steps of 50 ms, {}, resets of 1 % of the worlds"
WORKLOADS = {
    "whole": Workload(
        has="random commands, control, physics, all sensors when due (181 laser beams, 144 sonar rays, "
        "RFID, odometry, INS), resets of 1 % of the worlds",
        lacks="radio, pictures",
        beams=181 + 144,
    ),
    "blind": Workload(
        has="random commands, control, physics, resets of 1 % of the worlds", lacks="sensors, radio, pictures"
    ),
    "bare": Workload(
        has="physics under random wheel speeds", lacks="commands, sensors, radio, pictures, resets"
    ),
    "12 beams, open ground": Workload(
        has=_ONE_SCANNER.format("12 laser beams in each"),
        lacks="walls, other sensors, radio, pictures",
        beams=12,
        arena="field",
        physics="coarse",
        ini="twelve_beams.ini",
        engines=("planar",),
    ),
    "200 beams, mazes": Workload(
        has=_ONE_SCANNER.format("200 laser beams in each, 64 mazes"),
        lacks="other sensors, radio, pictures",
        beams=200,
        arena="maze",
        generated=64,
        physics="coarse",
        ini="two_hundred_beams.ini",
        engines=("planar",),
    ),
}
"""A whole step, one without sensors, the engine alone; and with what VMAS's and JaxMARL's robots sense."""


def measure(  # noqa: PLR0913 - as the command line has them
    engine: str,
    part: str,
    worlds: int,
    robots: int,
    steps: int,
    repeats: int,
    seed: int,
    arena: str,
    ini: Path | None = None,
) -> dict[str, Any]:
    """Return first call and repeats of a part of the step, as a peer's script prints them."""
    chosen = WORKLOADS[part]
    if ini is not None:
        configure([ini])
    case = SceneCase(
        worlds=worlds,
        roster=f"P2AT:{robots}",
        arena=chosen.arena or arena,
        generated=chosen.generated,
        physics=chosen.physics,
        engine=engine,
        seed=seed,
    )
    scene = scene_of(case)
    batch, key = batch_of(case, scene), jax.random.key(seed + 1)
    state: Any = batch.reset()
    if part == "bare":
        (body, given), state = bare_step(batch, key, state), state.physics
    else:
        body, given = whole_step(batch, key, sensing=part != "blind"), ()
    first, times, end = time_repeats(repeat_loop(batch, body, steps, given), state, repeats)
    if part != "bare":
        batch.check_overflow(end)
    return {
        "warm_up": WARM_UP,
        "first_s": first,
        "times_s": times,
        "period_s": scene.physics.period,
        "steps": steps,
        "device": "host" if engine == "c" else jax.devices()[0].device_kind,
        "versions": versions(),
    }


def main() -> None:
    """Measure what the command line asks for; print a line of JSON."""
    parser = argparse.ArgumentParser()
    for name in ("engine", "part", "arena"):
        parser.add_argument(f"--{name}", required=True)
    for name in ("worlds", "robots", "steps", "repeats", "seed"):
        parser.add_argument(f"--{name}", type=int, required=True)
    parser.add_argument("--ini", type=Path)
    sys.stdout.write("\n" + json.dumps(measure(**vars(parser.parse_args()))) + "\n")


if __name__ == "__main__":
    main()
