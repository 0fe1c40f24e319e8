"""One name, one thing, and files that one reads in a sitting."""

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

import dev

SOURCES = sorted((dev.ROOT / "usarmjx").rglob("*.py"))
TESTS = sorted((dev.ROOT / "tests").rglob("*.py"))
MOST_LINES = 400
SEVERAL_MEANINGS = {
    "Values": "what a library of environments has by agents' names: PettingZoo anything, JaxMARL arrays",
}
"""Names that may mean different things in different modules, and why."""


def types_of(text: str, module: str) -> Iterator[tuple[str, str]]:
    """Public classes and aliases of a module, each with what it means.

    A class is itself and no other; an alias is what it stands for, so `GeomType = mujoco.mjtGeom` may be
    written in many modules.
    """
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, f"a class of {module}, line {node.lineno}"
    for node in tree.body:
        target = node.targets[0] if isinstance(node, ast.Assign) else None
        if isinstance(target, ast.Name) and target.id[0].isupper() and not target.id.isupper():
            yield target.id, ast.unparse(node.value)


def homonyms(modules: Iterable[tuple[str, str]]) -> dict[str, set[str]]:
    """Names of types that mean several things in these modules (text, name)."""
    meanings = defaultdict(set)
    for text, module in modules:
        for name, meaning in types_of(text, module):
            meanings[name].add(meaning)
    return {name: found for name, found in meanings.items() if len(found) > 1}


def lines_of(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()


def edits_path(text: str) -> bool:
    """Whether a module changes where Python looks for modules."""
    return any(
        ast.unparse(node).startswith(("sys.path.", "sys.path[", "sys.path +", "sys.path ="))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr | ast.Assign | ast.AugAssign)
    )


def test_no_two_types_have_the_same_name():
    found = homonyms((path.read_text(encoding="utf-8"), str(path.relative_to(dev.ROOT))) for path in SOURCES)
    assert {name: found[name] for name in found.keys() - SEVERAL_MEANINGS} == {}
    assert found.keys() >= SEVERAL_MEANINGS.keys(), "an exception that is none any more"


def test_no_file_is_longer_than_one_reads():
    lengths = {str(path.relative_to(dev.ROOT)): len(lines_of(path)) for path in SOURCES}
    assert {name: length for name, length in lengths.items() if length > MOST_LINES} == {}


def test_tests_import_each_other_from_the_root():
    """Not by adding folders to sys.path, where two files of the same name are one."""
    assert [path.name for path in TESTS if edits_path(path.read_text(encoding="utf-8"))] == []


# The checks above must be able to fail.


def test_homonyms_are_found():
    first = "class A: pass\nclass _P: pass\nGeom = mujoco.Geom\nBit = int\nLIMIT = 1\n"
    second = "class _P: pass\nGeom = mujoco.Geom\nBit = float\nLIMIT = 2\nclass C:\n    class A: pass\n"
    assert homonyms([(first, "one"), (second, "two")]).keys() == {"A", "Bit"}


def test_edits_of_the_path_are_found():
    assert all(
        map(edits_path, ("sys.path.append('.')", "def f():\n    sys.path[:0] = ['.']", "sys.path += []"))
    )
    assert not any(map(edits_path, ("print(sys.path)", "'sys.path.append'", "os.path.join('a')")))
