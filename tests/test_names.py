"""Lengths of files and functions, one meaning of each class name, and what texts refer to."""

import ast
import re
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
REFERENCE = re.compile(r"`([a-z_]\w*(?:\.[A-Za-z_]\w*)+)`")
FOREIGN = {"brax", "foxglove", "gymnasium", "torchrl"}
"""Modules of ours with the name of a library, which texts mean in such references."""
NOT_NAMES = {"jsonl", "py", "NAME"}
"""Ends of what is no reference: files, and words that stand for others."""


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


def identifiers(tree: ast.Module) -> set[str]:
    """All that a module defines or names."""
    found = set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.alias):
            found.add((node.asname or node.name).rpartition(".")[2])
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value)  # of what loads on first use
    return found


@cache
def known_modules() -> dict[str, set[str]]:
    """Return the names in each module by its full name; packages have those of their modules, too."""
    found = dict[str, set[str]]()
    for path in SOURCES:
        if package_of(path).startswith("usarmjx"):
            found[name_of(path).removesuffix(".py").removesuffix("/__init__").replace("/", ".")] = (
                identifiers(tree_of(path))
            )
    for name in found:
        above, _, last = name.rpartition(".")
        found.get(above, set()).add(last)
    return found


def lost_references(source: str, modules: dict[str, set[str]]) -> list[str]:
    """References `module.name` in a source to a name that no such module has."""
    lost = list[str]()
    for reference in REFERENCE.findall(source):
        parts = reference.split(".")
        for count in range(len(parts) - 1, 0, -1):
            end = "." + ".".join(parts[:count])
            named = [names for module, names in modules.items() if f".{module}".endswith(end)]
            if named:
                lost += [reference] * (not any(parts[count] in names for names in named))
                break
    lost = [one for one in lost if one.split(".")[0] not in FOREIGN and one.split(".")[-1] not in NOT_NAMES]
    # An argument may have the name of a module.
    arguments = (
        {node.arg for node in ast.walk(ast.parse(source)) if isinstance(node, ast.arg)} if lost else set()
    )
    return [one for one in lost if one.split(".")[0] not in arguments]


ENTRY = re.compile(r"    (\w+(?:, \w+)*): ")


def entries(node: ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef, title: str) -> Iterator[str]:
    """Names that a section of a docstring describes."""
    if f"{title}:\n" not in (ast.get_docstring(node, clean=False) or ""):  # cleaning takes its time
        return
    _, _, section = f"{ast.get_docstring(node)}\n".partition(f"\n{title}:\n")
    for line in section.splitlines():
        if line and not line.startswith(" "):
            return
        if found := ENTRY.match(line):
            yield from found[1].split(", ")


def arguments_of(node: ast.FunctionDef | ast.AsyncFunctionDef) -> set[str]:
    return {one.arg for one in ast.walk(node.args) if isinstance(one, ast.arg)}


def held_by(node: ast.ClassDef) -> set[str]:
    """Return the names that a class defines or sets, in its body or in its methods."""
    found = {one.attr for one in ast.walk(node) if isinstance(one, ast.Attribute)}
    for one in node.body:
        if isinstance(one, ast.FunctionDef):
            found.add(one.name)
        elif isinstance(one, ast.AnnAssign | ast.Assign):
            found |= {part.id for part in ast.walk(one) if isinstance(part, ast.Name)}
    return found


def gone_entries(tree: ast.Module) -> list[str]:
    """Arguments and attributes that docstrings describe, and that there are not."""
    gone = list[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            known = {"Attributes": held_by(node)}
            for maker in node.body:
                if isinstance(maker, ast.FunctionDef) and maker.name == "__init__":
                    known["Args"] = arguments_of(maker)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            known = {"Args": arguments_of(node)}
        else:
            continue
        for title, names in known.items():
            gone += [f"{node.name}: {name}" for name in entries(node, title) if name not in names]
    return gone


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


def test_what_texts_refer_to_exists():
    modules = known_modules()
    texts = {name_of(path): path.read_text(encoding="utf-8") for path in SOURCES}
    lost = {name: lost_references(text, modules) for name, text in texts.items() if "`" in text}
    assert {name: references for name, references in lost.items() if references} == {}


def test_docstrings_describe_what_there_is():
    gone = {name_of(path): gone_entries(tree_of(path)) for path in SOURCES}
    assert {name: found for name, found in gone.items() if found} == {}


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


def test_lost_references_are_found():
    modules = {"usarmjx.sim": {"scene"}, "usarmjx.sim.scene": {"Scene"}, "usarmjx.scene": {"Other"}}
    source = '''
def f(batch):
    """As `scene.Scene`, `scene.Other` and `sim.scene.Scene`, not `sim.scene.Other` or `scene.Gone`."""
    # See `batch.scene`, `scene.py` and `numpy.zeros`, not `sim.gone`.
'''
    assert lost_references(source, modules) == ["sim.scene.Other", "scene.Gone", "sim.gone"]


def test_gone_entries_are_found():
    source = '''
class A:
    """One.

    Args:
        one, two: Numbers.
        three: Another.

    Attributes:
        four: A number:
            and more: of it.
        five: Another.
    """

    four: int

    def __init__(self, one, *, two):
        self.six = one

    def run(self, seven, *eight):
        """Run.

        Args:
            seven: A number.
            eight: Others.
            nine: Another.

        Returns:
            ten: A number.
        """
'''
    assert gone_entries(ast.parse(source)) == ["A: five", "A: three", "run: nine"]
