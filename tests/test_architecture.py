"""docs/architecture.md and docs/glossary.md against the code: files, names, and who may import whom."""

import ast
import re
import tomllib
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from prometheus_client import CollectorRegistry, ProcessCollector

import dev
from usarmjx.server.runtime.metrics import WorldCollector

PACKAGE = dev.ROOT / "usarmjx"
SOURCES = sorted(path for path in PACKAGE.rglob("*.py") if path.name != "__init__.py")
PAGES = ("architecture.md", "glossary.md")
TICKS = re.compile(r"`([^`\n]+)`")
PATH = re.compile(r"[a-z_]+(/[a-z_]+)*(/|\.py)")
ANYWHERE = {*dev.VERBS, "usarmjx", "GETSS"}
"""What may stand in ticks without being a name of ours."""


def page(name: str) -> str:
    return re.sub(r"```.*?```", "", (dev.ROOT / "docs" / name).read_text(encoding="utf-8"), flags=re.DOTALL)


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def names() -> frozenset[str]:
    """Everything that the package defines: modules and folders, classes, functions, fields, parameters."""
    found = {
        part for path in PACKAGE.rglob("*.py") for part in path.relative_to(PACKAGE).with_suffix("").parts
    }
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                found.add(node.name)
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                found.add(node.target.id)
            elif isinstance(node, ast.Assign):
                targets = [name for target in node.targets for name in ast.walk(target)]
                found |= {name.id for name in targets if isinstance(name, ast.Name)}
    return frozenset(found)


def is_there(path: str) -> bool:
    """Whether a path names something of the package, in full or by its end."""
    return any((PACKAGE / path).exists() for path in [path]) or any(PACKAGE.rglob(path.rstrip("/")))


@pytest.mark.parametrize("name", PAGES)
def test_the_files_that_the_pages_name_exist(name: str):
    named = [text for text in TICKS.findall(page(name)) if PATH.fullmatch(text)]
    assert len(named) > 30
    assert [path for path in named if not is_there(path)] == []


@pytest.mark.parametrize("name", PAGES)
def test_the_names_that_the_pages_use_are_defined(name: str):
    words = {text for text in TICKS.findall(page(name)) if re.fullmatch(r"[A-Za-z_]+(\.[A-Za-z_]+)*", text)}
    parts = {part for word in words if not word.endswith((".py", ".md", ".toml")) for part in word.split(".")}
    engines = {"c", "jax", "planar", "warp"}
    assert sorted(parts - names() - ANYWHERE - engines) == []


def test_the_order_of_imports_is_the_one_that_is_checked():
    project = tomllib.loads((dev.ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (contract,) = [c for c in project["tool"]["importlinter"]["contracts"] if c["type"] == "layers"]
    shown = re.search(
        r"## Import rules.*?```text\n(.*?)```",
        (dev.ROOT / "docs/architecture.md").read_text(),
        re.DOTALL,
    )
    assert shown is not None
    assert [f"usarmjx.{name}" for name in shown[1].split()] == contract["layers"]
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} == set(shown[1].split())


def imports_of(tree: ast.AST, for_types: bool = False):
    """Yield each import of a module, with the module, and whether only type checkers need it."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ImportFrom):
            yield from ((f"{node.module}.{alias.name}", node.module, for_types) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, alias.name, for_types) for alias in node.names)
        else:
            typing_only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
            yield from imports_of(node, for_types or typing_only)


def test_modules_import_each_other_in_circles_for_types_only():
    files = {".".join(path.relative_to(dev.ROOT).with_suffix("").parts): path for path in SOURCES}
    needs: dict[str, set[str]] = {name: set() for name in files}
    wants: dict[str, set[str]] = {name: set() for name in files}
    for name, path in files.items():
        for full, module, for_types in imports_of(tree_of(path)):
            other = full if full in files else module
            if other in files and other != name:
                (wants if for_types else needs)[name].add(other)
    below: dict[str, set[str]] = {}
    for name in TopologicalSorter(needs).static_order():  # a CycleError names a circle
        below[name] = needs[name].union(*(below[other] for other in needs[name]))
    circles = sorted(
        (name, other) for name, found in wants.items() for other in found if name in below[other]
    )
    assert len(circles) <= 2, circles


def test_every_package_says_what_is_in_it():
    """In a few lines: what it holds, what may be touched, where to begin."""
    short = {}
    for path in sorted(PACKAGE.rglob("__init__.py")):
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        if len([line for line in text.splitlines() if line]) < 3:
            short[str(path.relative_to(dev.ROOT))] = text
    assert short == {}


def test_paths_of_modules_in_all_documents_exist():
    pages = [
        *dev.ROOT.glob("*.md"),
        *(dev.ROOT / "docs").rglob("*.md"),
        *(dev.ROOT / "benchmarks").glob("*.md"),
    ]
    gone = {}
    for file in pages:
        text = file.read_text(encoding="utf-8")
        for path in re.findall(r"\b(?:usarmjx|tests|examples)/[\w/.-]*\w", text):
            is_task = re.fullmatch(r"usarmjx/[a-z-]+-v\d+", path)  # an id of Gymnasium or of JaxMARL
            if not is_task and not Path(dev.ROOT / path).exists():
                gone.setdefault(file.name, set()).add(path)
    assert gone == {}


def metric_names() -> set[str]:
    """Names of the figures of a server, as Prometheus reads them."""
    registry = CollectorRegistry()
    registry.register(WorldCollector({}))
    ProcessCollector(namespace="usarmjx", registry=registry)
    return {family.name + "_total" * (family.type == "counter") for family in registry.collect()}


def documented_names() -> frozenset[str]:
    """What code and documents may mean by a word in ticks: any name, parameter or text of the package."""
    found = {*names(), *metric_names(), *dev.VERBS, *vars(dev)}
    checkout = [path for folder in ("benchmarks", "tools") for path in (dev.ROOT / folder).rglob("*.py")]
    for path in [*PACKAGE.rglob("*.py"), *checkout]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.arg):
                found.add(node.arg)
            elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                found.add(node.attr)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "`" not in node.value:
                found |= set(re.findall(r"\w+", node.value))
    return frozenset(found)


FOREIGN = re.compile(
    r"(mj|mjt|mjx|jax|jnp|lax|gymnasium|vmas|geom|Auto|Episode|Vmap|Vector|Wireless|Tarantula)\w*(\..*)?"
    r"|DiameterError|SeparationError|MaxIncidence|OmniCam|RearTrack|Generator|Union|asdict|end_|nW|rl|U|USARBot"
    r"|nohup|ab|value_obs_key|rmw_\w+|USARSensor|AddParts|p2at\.p"
)
"""Names of other libraries and of USARSim's files."""
FILE = re.compile(r".*\.(py|md|ini|yaml|toml|npz|png|json|jsonl|txt|html|uc|c|MTL)")


def test_names_in_docstrings_and_documents_are_those_of_the_code():
    """A word in ticks is a name that exists: what was renamed is renamed in the texts as well."""
    known, stale = documented_names(), {}
    pages = [dev.ROOT / "README.md", dev.ROOT / "CONTRIBUTING.md", *(dev.ROOT / "docs").rglob("*.md")]
    for path in [*PACKAGE.rglob("*.py"), *(page for page in pages if page.parent.name != "conformance")]:
        text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
        for word in re.findall(r"`([A-Za-z_][\w.]*)`", text):
            parts = [part for part in word.split(".") if part]
            if (
                not FILE.fullmatch(word)
                and not FOREIGN.fullmatch(word.rstrip("."))
                and not known.issuperset(parts)
            ):
                stale.setdefault(path.name, set()).add(word)
    assert stale == {}
