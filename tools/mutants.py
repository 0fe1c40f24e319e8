"""A check that the tests notice faults: each mutant is a small fault, and its tests must fail with it.

The lists are `tests/mutants/*.toml`, one for each area. An entry is a table:

    [[mutant]]
    name = "protocol-yaw-sign"         # unique
    file = "usarmjx/.../frames.py"     # below the root of the checkout
    find = "flip_angles(angles)"       # occurs exactly once in the file
    replace = "angles"
    tests = ["tests/.../test_x.py"]    # as few and as fast as notice it
    why = "what is wrong now"          # may be left out

Every mutant gets one line: `killed` (its tests fail, as they must), `SURVIVED` (they pass), `broken` (they
cannot run, with or without the mutant) or `stale` (the text is not in the file exactly once). The mutants
live in a copy of the tracked files, so the checkout stays as it is.

    python3 tools/mutants.py --list
    python3 tools/mutants.py --area comms --area planar
    python3 tools/mutants.py --only train-advantages-run-over-ends
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LISTS = "tests/mutants"
"""Folder of the lists, below the root of a checkout."""
KILLED, SURVIVED, BROKEN, STALE = "killed", "SURVIVED", "broken", "stale"
"""What becomes of a mutant."""
PASSED, FAILED = 0, 1
"""Exit statuses of pytest; all others say that it could not run the tests."""
TIMEOUT = 600.0
"""Tests that take longer count as broken, unless the command line says otherwise [s]."""
NEEDED, OPTIONAL = {"name", "file", "find", "replace", "tests"}, {"why"}
"""Keys of an entry."""


class ListError(Exception):
    """A list that makes no sense; says where and why."""


@dataclass(frozen=True)
class Mutant:
    """One fault.

    Attributes:
        area: Name of its list.
        name: Its name, unique in all lists.
        file: The file that has the fault, below the root.
        find: The sound text, which occurs exactly once in the file.
        replace: The faulty text.
        tests: Arguments for pytest: files and node ids.
        why: Its fault.
    """

    area: str
    name: str
    file: str
    find: str
    replace: str
    tests: tuple[str, ...]
    why: str = ""

    def problem(self, root: Path) -> str:
        """Return why it cannot be applied to a checkout, and where its text may be; "" if it can."""
        count = self._count(root / self.file)
        if count == 1:
            return ""
        folder = root / Path(self.file).parts[0]
        others = [path.relative_to(root).as_posix() for path in folder.rglob("*.py") if self._count(path)]
        found = f"the text is in {', '.join(sorted(others))}" if others else "the text is nowhere"
        return f"its file has the text {count} times; {found}"

    def _count(self, path: Path) -> int:
        """Return how often a file has the text."""
        return path.read_text(encoding="utf-8").count(self.find) if path.is_file() else 0


def _read_entry(path: Path, entry: dict[str, object]) -> Mutant:
    """Return one entry of a list.

    Raises:
        ListError: A key is missing, unknown or of the wrong type, or the entry changes nothing.
    """
    where = f"{path.name}: {entry.get('name', 'an entry without a name')}"
    if wrong := (NEEDED - entry.keys()) | (entry.keys() - NEEDED - OPTIONAL):
        raise ListError(f"{where}: missing or unknown: {', '.join(sorted(wrong))}")
    tests = entry["tests"]
    if not isinstance(tests, list) or not tests or not all(isinstance(test, str) for test in tests):
        raise ListError(f"{where}: tests must be a list of texts, and not empty")
    texts = {key: value for key, value in entry.items() if key != "tests"}
    told = {key: value for key, value in texts.items() if isinstance(value, str)}
    if told != texts:
        raise ListError(f"{where}: everything but tests must be a text")
    if not told["find"] or told["find"] == told["replace"]:
        raise ListError(f"{where}: it changes nothing")
    return Mutant(area=path.stem, tests=tuple(map(str, tests)), **told)


def read_lists(root: Path) -> list[Mutant]:
    """Return all mutants of a checkout, by area.

    Raises:
        ListError: There is no list, one cannot be read, or two mutants have the same name.
    """
    found: list[Mutant] = []
    for path in sorted((root / LISTS).glob("*.toml")):
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except tomllib.TOMLDecodeError as error:
            raise ListError(f"{path.name}: {error}") from error
        found += [_read_entry(path, entry) for entry in table.get("mutant", [])]
    if not found:
        raise ListError(f"no mutants in {root / LISTS}")
    names = [mutant.name for mutant in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ListError(f"names that occur twice: {', '.join(twice)}")
    return found


def copy_tracked(root: Path, folder: Path) -> None:
    """Copy the tracked files of a checkout, as they are now, to a folder."""
    command = ["git", "ls-files", "-z"]
    listed = subprocess.run(command, cwd=root, capture_output=True, check=True).stdout
    for name in listed.decode().split("\0"):
        source, target = root / name, folder / name
        if name and source.is_file():  # a file may be deleted and tracked still
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)


@dataclass(frozen=True)
class Run:
    """Output of a run of pytest.

    Attributes:
        status: Its exit status; -1: it took too long.
        output: All that it printed.
    """

    status: int
    output: str

    @property
    def verdict(self) -> str:
        """Fate of a mutant with which the tests run so.

        Only a test that fails kills. With -x pytest has status 1 for errors outside of tests as well.
        """
        if self.status == PASSED:
            return SURVIVED
        failed = any(line.startswith("FAILED ") for line in self.output.splitlines())
        return KILLED if self.status == FAILED and failed else BROKEN

    @property
    def summary(self) -> str:
        """The line that says which test failed and why, else the last line."""
        lines = self.output.strip().splitlines() or ["no output"]
        if self.status < 0:
            return "it took too long"
        told = [line for kind in ("FAILED ", "ERROR ") for line in lines if line.startswith(kind)]
        return told[0] if told else lines[-1]


class Laboratory:
    """A copy of a checkout in which mutants live.

    Args:
        root: The checkout.
        folder: Folder of the copy.
        timeout: Most time for one run of pytest [s].
    """

    def __init__(self, root: Path, folder: Path, timeout: float = TIMEOUT) -> None:
        copy_tracked(root, folder)
        self._folder, self._timeout = folder, timeout
        self._clean: dict[tuple[str, ...], Run] = {}
        self._clock = int(time.time())

    def run_tests(self, tests: Sequence[str]) -> Run:
        """Run pytest in the copy."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
        paths = [str(self._folder), *filter(None, [os.environ.get("PYTHONPATH")])]
        settings = {"NPROC": "8", **os.environ, "PYTHONPATH": os.pathsep.join(paths)}
        try:
            done = subprocess.run(
                command,
                cwd=self._folder,
                env=settings,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                timeout=self._timeout,
            )
        except subprocess.TimeoutExpired:
            return Run(-1, "")
        return Run(done.returncode, done.stdout)

    def run_clean(self, tests: tuple[str, ...]) -> Run:
        """Run tests without a mutant, each list of tests once."""
        if tests not in self._clean:
            self._clean[tests] = self.run_tests(tests)
        return self._clean[tests]

    @contextmanager
    def infected(self, mutant: Mutant) -> Iterator[None]:
        """Let the copy have a mutant for a while."""
        path = self._folder / mutant.file
        sound, stamp = path.read_bytes(), path.stat()
        # Python takes compiled code for that of a source of the same size and second: no two have the same.
        self._clock += 1
        try:
            path.write_bytes(sound.replace(mutant.find.encode(), mutant.replace.encode()))
            os.utime(path, (self._clock, self._clock))
            yield
        finally:
            path.write_bytes(sound)
            os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))

    def judge(self, mutant: Mutant, check_clean: bool = True) -> tuple[str, str]:
        """Return what becomes of a mutant, and a line that says why."""
        if problem := mutant.problem(self._folder):
            return STALE, problem
        if check_clean:
            clean = self.run_clean(mutant.tests)
            if clean.status != PASSED:
                return BROKEN, f"without the mutant: {clean.summary}"
        with self.infected(mutant):
            found = self.run_tests(mutant.tests)
        return found.verdict, found.summary


@dataclass(frozen=True)
class Clock:
    """A moment, by two clocks: on a busy machine tests take long, and no more of a processor than usual.

    Attributes:
        wall: The time that passes [s].
        processor: Processor time of this program's children [s].
    """

    wall: float
    processor: float

    @classmethod
    def now(cls) -> "Clock":
        """Return the present moment."""
        spent = os.times()
        return cls(time.monotonic(), spent.children_user + spent.children_system)

    def since(self, other: "Clock") -> str:
        """Return how long ago another moment is, by both."""
        return f"{self.wall - other.wall:6.1f} s ({self.processor - other.processor:5.1f} s of CPU)"


def judge_all(
    mutants: Sequence[Mutant], laboratory: Laboratory, check_clean: bool, say: Callable[[str], None]
) -> dict[str, int]:
    """Judge mutants, say a line about each, and return how many end how."""
    counts: dict[str, int] = dict.fromkeys((KILLED, SURVIVED, BROKEN, STALE), 0)
    began = Clock.now()
    for mutant in mutants:
        start = Clock.now()
        verdict, reason = laboratory.judge(mutant, check_clean)
        counts[verdict] += 1
        say(f"{verdict:8} {Clock.now().since(start)}  {mutant.area:8} {mutant.name}: {reason}")
    told = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    say(f"{len(mutants)} mutants: {told}; {Clock.now().since(began).strip()}")
    return counts


def choose(mutants: Sequence[Mutant], areas: Sequence[str], names: Sequence[str]) -> list[Mutant]:
    """Return the mutants that are asked for; all if nothing is.

    Raises:
        ListError: There is no such area or name; lists those known.
    """
    for kind, asked, known in (
        ("area", areas, {mutant.area for mutant in mutants}),
        ("mutant", names, {mutant.name for mutant in mutants}),
    ):
        if unknown := sorted(set(asked) - known):
            raise ListError(f"no {kind} {', '.join(unknown)}; known: {', '.join(sorted(known))}")
    return [
        mutant
        for mutant in mutants
        if (not areas or mutant.area in areas) and (not names or mutant.name in names)
    ]


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Return the options of a command line."""
    parser = argparse.ArgumentParser(prog="mutants.py", description="Do the tests notice faults?")
    parser.add_argument("--area", action="append", default=[], help="a list, such as comms; may be repeated")
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help="a mutant; the same")
    parser.add_argument("--list", action="store_true", help="show the mutants and run nothing")
    parser.add_argument(
        "--check-clean",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="run the tests without a mutant first: they must pass",
    )
    parser.add_argument("--timeout", type=float, default=TIMEOUT, help="most time for one run of pytest [s]")
    return parser.parse_args(argv)


def main(argv: Sequence[str], root: Path = ROOT) -> int:
    """Judge the mutants of a checkout.

    Returns:
        0: all are killed; 1: some are not; 2: the command line or a list makes no sense.
    """
    options = parse(argv)
    try:
        mutants = choose(read_lists(root), options.area, options.only)
    except ListError as error:
        print(f"mutants.py: {error}", file=sys.stderr)
        return 2
    if options.list:
        for mutant in mutants:
            print(f"{mutant.area:8} {mutant.name}: {mutant.file}: {' '.join(mutant.tests)}")
        return 0
    with tempfile.TemporaryDirectory(prefix="usarmjx-mutants-") as folder:
        laboratory = Laboratory(root, Path(folder).resolve(), options.timeout)
        counts = judge_all(mutants, laboratory, options.check_clean, lambda text: print(text, flush=True))
    return 0 if counts[KILLED] == len(mutants) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
