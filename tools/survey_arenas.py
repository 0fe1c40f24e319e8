"""Arenas of public packages, one after the other: what loads, what is left out, whether a robot drives.

    python -m tools.survey_arenas FOLDER ... --markdown benchmarks/results/arenas.md

Each folder under a FOLDER is a package; its files of arenas are tried, nothing of them is kept.
"""

import argparse
import math
import re
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsarmjxError
from usarmjx.base.transforms import quat_from_angles
from usarmjx.models.check import check_arena
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.files.load import read_arena
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec
from usarmjx.sim.control import CommandUpdate, update_command
from usarmjx.sim.scene import build_scene
from usarmjx.sim.single_world import SingleWorld

PATTERNS = ("*.world", "*.sdf", "*.map", "*.scen", "*.rndf", "*.yaml", "*.yml", "*.dae", "*.xml", "*.inc")
SCENE_WORDS = re.compile(r"arena|scene|world|kitchen|maze|stadium|soccer|field|sawyer_xyz")
"""Words in the path of an MJCF file that is a scene, not a robot or a part of one."""
ROBOT_WORDS = re.compile(r"description|robots?/|kuka|gripper")
"""Words in the path of a COLLADA file that is a part of a robot."""
TRIED = {".scen": 1, ".dae": 10, ".xml": 10}
"""Number of files of a folder that are tried, by suffix: a benchmark has hundreds of scenarios on one map."""
SETTLE_STEPS, DRIVE_STEPS = 50, 150
"""Control steps of 20 ms: to settle, and of each drive."""
SPIN = 2.0
"""Speed of the wheels [rad/s]."""
LEAST_WAY, MOST_FALL = 0.2, 0.3
"""Way that counts as driven, and fall that counts as fallen [m]."""
MAX_DRIVEN = 1500
"""Number of solids up to which a robot drives among them: more take minutes to compile."""
MAX_CELL = 90
"""Longest text in a cell of the table."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """An arena of a package.

    Attributes:
        package: Name of the package.
        file: Its file in the package.
        refusal: Why it does not load; empty: it loads.
        solids: Number of fixed solids.
        loose: Number of loose objects and doors.
        size: Lengths of the extent [m].
        starts: Number of start poses.
        notes: Elements left out, in words.
        drives: Result of the drive of a P2AT.
        seconds: Time to load [s].
    """

    package: str
    file: str
    refusal: str = ""
    solids: int = 0
    loose: int = 0
    size: tuple[float, float] = (0.0, 0.0)
    starts: int = 0
    notes: tuple[str, ...] = ()
    drives: str = "-"
    seconds: float = 0.0


def main() -> None:
    """Survey the folders of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--markdown", type=Path, help="page to write")
    options = parser.parse_args()
    rows: list[Row] = []
    for package, file in files_of(options.folders):
        row = survey(package, file)
        rows.append(row)
        print(f"{row.package} {row.file}: {row.refusal or row.drives} ({row.seconds:.1f} s)", flush=True)
        for note in row.notes:
            print(f"    {note}", flush=True)
    if options.markdown is not None:
        options.markdown.write_text(page(rows), encoding="utf-8")


def files_of(folders: Sequence[Path]) -> Iterator[tuple[Path, Path]]:
    """Yield the packages in folders, and the files of arenas in each."""
    for folder in folders:
        for package in sorted(one for one in folder.iterdir() if one.is_dir()):
            tried: Counter[tuple[Path, str]] = Counter()
            for file in sorted({file for pattern in PATTERNS for file in package.rglob(pattern)}):
                if not _is_arena(package, file):
                    continue
                tried[file.parent, file.suffix] += 1
                if tried[file.parent, file.suffix] <= TRIED.get(file.suffix, math.inf):
                    yield package, file


def _is_arena(package: Path, file: Path) -> bool:
    """Return whether a file of a common suffix is an arena: a map, a scene, no part of a robot."""
    text = file.read_text(encoding="utf-8", errors="replace")
    match file.suffix:
        case ".yaml" | ".yml":
            return re.search(r"^image:", text, re.MULTILINE) is not None and "resolution:" in text
        case ".xml":
            inside = str(file.relative_to(package)).lower()
            return (
                re.search(r"<mujoco[\s>]", text) is not None
                and "<worldbody" in text
                and SCENE_WORDS.search(inside) is not None
            )
        case ".dae":
            return ROBOT_WORDS.search(str(file.relative_to(package)).lower()) is None
        case ".map":
            return not text.startswith("{")  # a source map of JavaScript
        case _:
            return True


def survey(package: Path, file: Path) -> Row:
    """Return what becomes of an arena."""
    name, begin = re.sub(r"-py3.*|-cp\d.*|\.tar$", "", package.name), time.perf_counter()
    inside = str(file.relative_to(package))
    try:
        arena, notes = read_arena(file, packages=[package])
    except UsarmjxError as error:
        return Row(package=name, file=inside, refusal=str(error).replace(f"{package}/", ""))
    seconds = time.perf_counter() - begin
    (x0, x1), (y0, y1) = arena.extent
    return Row(
        package=name,
        file=inside,
        solids=len(arena.shapes),
        loose=len(arena.loose) + len(arena.doors),
        size=(x1 - x0, y1 - y0),
        starts=len(arena.starts),
        notes=tuple(note.replace(f"{package}/", "") for note in notes),
        drives=drive(arena),
        seconds=seconds,
    )


def drive(arena: ArenaSpec) -> str:
    """Return whether a P2AT stands at the first start pose and drives from there, in words."""
    if len(arena.shapes) > MAX_DRIVEN:
        return "not tried"
    robot = ROBOTS.get("P2AT")
    mine = f"start {arena.starts[0].tag!r}"
    faults = [
        fault for fault in check_arena(replace(arena, starts=arena.starts[:1])) if fault.startswith(mine)
    ]
    if faults:
        return f"no: {faults[0]}"
    try:
        world = SingleWorld(build_scene(arena, ()), seed=0, seats=1)
        start = arena.starts[0]
        x, y, z = start.at
        height = z - START_ELEVATION + kinematic_tree_of(robot).clearance + arena.floor
        slot = world.add(robot, "P2AT", [((x, y, height), np.asarray(quat_from_angles(0.0, 0.0, start.yaw)))])
    except (UsarmjxError, ValueError) as error:
        return f"no: {error}"
    before = _run(world, slot, SETTLE_STEPS, 0.0)
    if abs(before[2] - height) > MOST_FALL:
        return f"no: falls {height - before[2]:.2f} m"
    way = 0.0
    for spin in (SPIN, -SPIN):
        begin = _run(world, slot, 1, 0.0)
        end = _run(world, slot, DRIVE_STEPS, spin)
        way = max(way, float(np.linalg.norm(end[:2] - begin[:2])))
        if abs(end[2] - height) > MOST_FALL:
            return f"no: falls {height - end[2]:.2f} m"
        if way >= LEAST_WAY:
            return "yes"
    return f"no: moves {way:.2f} m"


def _run(world: SingleWorld, slot: int, steps: int, spin: float) -> np.ndarray:
    """Drive for some steps and return the chassis' position (3,)."""
    group, member = world.scene.group_of(slot)
    with numpy_backend():
        plan = world.scene.groups[group].plan
        update = CommandUpdate(drive={"Left": spin, "Right": spin})
        world.edit(slot, command=update_command(plan, world.state_of(slot).command, update))
    for _ in range(steps):
        world.step()
    root = world.scene.groups[group].indices[member].root_qposadr
    return np.array(world.physics.qpos[root : root + 3], float)


def page(rows: Sequence[Row]) -> str:
    """Return the table of arenas as a page."""
    loads = [row for row in rows if not row.refusal]
    drives = [row for row in loads if row.drives == "yes"]
    packages = sorted({row.package for row in rows})
    lines = [
        "# Arenas of other packages",
        "",
        f"Of {len(rows)} arenas in {len(packages)} public packages {len(loads)} load, and in {len(drives)}",
        "of these a P2AT stands at the first start pose and drives. `python -m tools.survey_arenas FOLDER`",
        "writes the table for packages that are unpacked in a folder; nothing of them is in the repository.",
        "A start pose may face a wall: then the robot drives backwards. What is left out is what the reader",
        "says, each with file and line.",
        "",
        "Arenas that others made for Gazebo after NIST's test methods are not among them: no package in the",
        "lists of PyPI, npm, NuGet and Maven that were searched for USARSim, RoboCup, rescue robots, step",
        "fields and NIST's arenas ships one. The repository `hector_nist_arenas_gazebo` has 60 worlds:",
        "SDF that places COLLADA elements by `file://NAME` of a package's `Media/models`. Its world",
        "continuous_ramps with its ramps, and walls of our own, loads as 80 solids; the reader names the two",
        "meshes that were missing, and a P2AT drives. The other worlds were not loaded.",
        "tests/models/files/test_gazebo_media.py has a lane of the same structure with",
        "elements of its own, in which a P2AT climbs a ramp, crosses blocks and stops at a wall. The arenas",
        "`yellow_2025`, `orange_2025` and `red_2025` have the elements of NIST's.",
        "",
        "No package has worlds of Stage. The worlds simple, autolab and circuit of Stage's repository load",
        "with bitmaps of our own, and a P2AT drives in them.",
        "",
        "Refused are mostly files that are no arenas: grippers and arms, skins, cameras, templates; and",
        "scenes with buttons on slides or equality constraints, which arenas do not have. The maps of",
        "cartoblobpy are transparent where they are free, which map_server averages with black: all is wall.",
        "",
        *_formats(rows),
        "",
        "| package | arena | solids | loose | size [m] | starts | left out | P2AT drives |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row.refusal:
            lines.append(
                f"| {row.package} | {row.file} | - | - | - | - | refused: {_cell(row.refusal)} | - |"
            )
            continue
        size = " x ".join(f"{length:.3g}" for length in row.size)
        said = _cell("; ".join(re.sub(r"^\S+:\d+: |^\S+: ", "", note) for note in row.notes)) or "nothing"
        lines.append(
            f"| {row.package} | {row.file} | {row.solids} | {row.loose} | {size} | {row.starts} | {said} | "
            f"{_cell(row.drives)} |"
        )
    return "\n".join(lines) + "\n"


def _formats(rows: Sequence[Row]) -> list[str]:
    """Return the lines of a table of the files' suffixes."""
    lines = ["| files | arenas | load | P2AT drives |", "|---|---|---|---|"]
    for suffix in sorted({Path(row.file).suffix for row in rows}):
        some = [row for row in rows if Path(row.file).suffix == suffix]
        loads = sum(not row.refusal for row in some)
        lines.append(f"| {suffix} | {len(some)} | {loads} | {sum(row.drives == 'yes' for row in some)} |")
    return lines


def _cell(text: str) -> str:
    plain = text.replace("|", "/").replace("<", "&lt;").replace("\n", " ")
    return plain if len(plain) <= MAX_CELL else f"{plain[:MAX_CELL]}..."


if __name__ == "__main__":
    main()
