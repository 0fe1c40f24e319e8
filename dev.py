"""The commands of a contributor; `python3 dev.py --help` lists them.

Only the standard library is used, so that this file runs before anything is installed: the first
verb creates `.venv` next to this file and installs usarmjx and its pinned dependencies there.
"""

import sys


def python_problem(version: tuple) -> str:
    """Return why this version of Python cannot run usarmjx, or "" when it can."""
    if tuple(version[:2]) >= (3, 11):
        return ""
    found = ".".join(str(part) for part in version[:3])
    return f"usarmjx needs Python 3.11 or newer; {sys.executable} is Python {found}"


# Before everything else: the lines below would fail on an old Python with a worse message.
if python_problem(sys.version_info):
    sys.exit(python_problem(sys.version_info))

import argparse
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tools import checks
from tools.environment import Environment, SetupError, run_steps, say

ROOT = Path(__file__).resolve().parent


def module(*words: str) -> Callable[..., list[list[str]]]:
    """Return the steps of a verb that runs one module, with the arguments of the verb at the end."""
    return lambda *args: [["-m", *words, *args]]


@dataclass(frozen=True)
class Verb:
    """One command of this file.

    Attributes:
        summary: What it does, for the help.
        steps: Python command lines to run, given the arguments that followed the verb.
        extras: Optional dependencies that it needs; None: not even .venv, but this Python.
    """

    summary: str
    steps: Callable[..., list[list[str]]]
    extras: frozenset[str] | None = frozenset({"dev"})


VERBS = {
    "demo": Verb(
        "run the main job, checked (arguments go to `usarmjx demo --headless`)",
        module("usarmjx", "demo", "--headless"),
        extras=frozenset(),
    ),
    "test": Verb(
        "lint, format check, types, layers and tests; --quick: what needs no compilation; --all: wheel,"
        " site, Ray and thorough tests too; other arguments: pytest with them",
        checks.everything,
    ),
    "fuzz": Verb(
        "property tests with other examples each time (arguments go to pytest)",
        module("pytest", "-m", "hypothesis", "--hypothesis-profile", "fuzz"),
    ),
    "check": Verb("the same as test --all", lambda *args: checks.everything(*(args or ("--all",)))),
    "format": Verb("rewrite the code with ruff format", module("ruff", "format")),
    "lint": Verb("ruff check", module("ruff", "check")),
    "types": Verb("pyright", module("pyright")),
    "layers": Verb("import-linter: who may import whom", lambda *args: [checks.layers(*args)]),
    "oracle": Verb(
        "the tests that compare us with C MuJoCo and closed forms",
        module("pytest", "-m", "oracle"),
    ),
    "bench": Verb("benchmarks (arguments go to `usarmjx bench`)", module("usarmjx", "bench")),
    "docs": Verb(
        "documents: a site in build/site, length, examples, links (with arguments: pytest with them)",
        lambda *args: [
            *([] if args else [["-m", "tools.documents"], ["-m", "tools.prose"]]),
            checks.pytest("tests/test_docs.py", *args),
        ],
    ),
    "try": Verb(
        "a stranger's steps, in empty environments: the wheel, the demo, extras, first page (see --help)",
        module("tools.trial"),
        extras=None,
    ),
    "audit": Verb(
        "known vulnerabilities of the pinned packages, where pip-audit can run (status 2: it cannot)",
        module("tools.dependencies", "audit"),
    ),
    "sbom": Verb(
        "the pinned packages as CycloneDX JSON, with licences; to the file that is named, if any",
        module("tools.dependencies", "sbom"),
    ),
}


def parse(argv: Sequence[str]) -> tuple[Verb, list[str]]:
    """Return the verb and the arguments that go to its tool; argparse exits on a wrong verb."""
    parser = argparse.ArgumentParser(
        prog="dev.py",
        usage="python3 dev.py VERB [arguments for the tool]",
        description="What a contributor runs. The first use creates .venv and fills it.",
        epilog="verbs:\n" + "\n".join(f"  {name:8}{VERBS[name].summary}" for name in VERBS),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("verb", metavar="VERB", choices=VERBS, help="one of the verbs below")
    parser.add_argument("args", nargs=argparse.REMAINDER, help="passed on unchanged")
    options = parser.parse_args(argv)
    return VERBS[options.verb], options.args


def main(argv: Sequence[str]) -> int:
    """Run one verb and return its exit status."""
    verb, args = parse(argv)
    environment = Environment(ROOT, ROOT / ".venv")
    try:
        if verb.extras is None:
            (step,) = verb.steps(*args)
            return subprocess.run([sys.executable, *step], cwd=ROOT).returncode
        environment.ensure(verb.extras)
        return run_steps(environment, verb.steps(*args))
    except SetupError as error:
        say(str(error))
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
