"""Lengths of files and functions, and one meaning of each class name in a package."""

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

import dev

SOURCES = sorted(
    path for root in ("usarmjx", "benchmarks", "tools") for path in (dev.ROOT / root).rglob("*.py")
)
TESTS = sorted((dev.ROOT / "tests").rglob("*.py"))
MAX_FILE_LINES = 800
MAX_FUNCTION_LINES = 60
HOMONYMS = {
    "Values": "in usarmjx.train: by agents' names, PettingZoo has anything, JaxMARL arrays",
}
"""Names of types that may mean two things in a package, and why."""


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def types_of(tree: ast.Module, module: str) -> Iterator[tuple[str, str]]:
    """Public classes and aliases of a module, each with what it means.

    A class is itself and no other; an alias is what it stands for, so `GeomType = mujoco.mjtGeom` may be
    written in many modules.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, f"a class of {module}, line {node.lineno}"
    for node in tree.body:
        target = node.targets[0] if isinstance(node, ast.Assign) else None
        if isinstance(target, ast.Name) and target.id[0].isupper() and not target.id.isupper():
            yield target.id, ast.unparse(node.value)


def homonyms(modules: Iterable[tuple[ast.Module, str]]) -> dict[str, set[str]]:
    """Names of types that mean several things in these modules."""
    meanings = defaultdict(set)
    for tree, module in modules:
        for name, meaning in types_of(tree, module):
            meanings[name].add(meaning)
    return {name: found for name, found in meanings.items() if len(found) > 1}


def package_of(path: Path) -> str:
    """The top-level package of a file: a folder of usarmjx, or benchmarks or tools."""
    parts = path.relative_to(dev.ROOT).with_suffix("").parts
    return ".".join(parts[:2]) if parts[0] == "usarmjx" else parts[0]


def name_of(path: Path) -> str:
    return str(path.relative_to(dev.ROOT))


def long_functions(tree: ast.Module) -> dict[str, int]:
    """Functions that are too long, by name and line, with their length in lines."""
    return {
        f"{node.name}:{node.lineno}": length
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if (length := (node.end_lineno or 0) - node.lineno + 1) > MAX_FUNCTION_LINES
    }


def edits_path(text: str) -> bool:
    """Whether a module changes where Python looks for modules."""
    return "sys.path" in text and any(
        ast.unparse(node).startswith(("sys.path.", "sys.path[", "sys.path +", "sys.path ="))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr | ast.Assign | ast.AugAssign)
    )


@pytest.mark.parametrize("package", sorted({package_of(path) for path in SOURCES}))
def test_no_two_types_of_a_package_have_the_same_name(package: str):
    found = homonyms((tree_of(path), name_of(path)) for path in SOURCES if package_of(path) == package)
    assert {name: found[name] for name in found.keys() - HOMONYMS} == {}


def test_exceptions_are_still_needed():
    packages = defaultdict(list)
    for path in SOURCES:
        packages[package_of(path)].append((tree_of(path), name_of(path)))
    assert {name for files in packages.values() for name in homonyms(files)} >= HOMONYMS.keys()


def test_no_file_is_longer_than_one_reads():
    lengths = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in SOURCES}
    assert {name: length for name, length in lengths.items() if length > MAX_FILE_LINES} == {}


def test_no_function_is_longer_than_a_screen():
    found = {name_of(path): long_functions(tree_of(path)) for path in SOURCES}
    assert {name: functions for name, functions in found.items() if functions} == {}


def test_tests_import_each_other_from_the_root():
    """Not by adding folders to sys.path, where two files of the same name are one."""
    assert [path.name for path in TESTS if edits_path(path.read_text(encoding="utf-8"))] == []


# The checks above must be able to fail.


def test_homonyms_are_found():
    first = "class A: pass\nclass _P: pass\nGeom = mujoco.Geom\nBit = int\nLIMIT = 1\n"
    second = "class _P: pass\nGeom = mujoco.Geom\nBit = float\nLIMIT = 2\nclass C:\n    class A: pass\n"
    assert homonyms([(ast.parse(first), "one"), (ast.parse(second), "two")]).keys() == {"A", "Bit"}


def test_long_functions_are_found():
    body = "    pass\n" * (MAX_FUNCTION_LINES - 1)
    assert long_functions(ast.parse(f"def f():\n{body}")) == {}
    longer = ast.parse(f"class A:\n  async def f(self):\n{body}    pass\n")
    assert long_functions(longer) == {"f:2": MAX_FUNCTION_LINES + 1}


def test_edits_of_the_path_are_found():
    assert all(
        map(edits_path, ("sys.path.append('.')", "def f():\n    sys.path[:0] = ['.']", "sys.path += []"))
    )
    assert not any(map(edits_path, ("print(sys.path)", "'sys.path.append'", "os.path.join('a')")))
