"""Public names: the faces of the packages, what imports cost, and what pages teach."""

import ast
import importlib
import inspect
import json
import re
import shutil
import subprocess
import sys
import tomllib
from types import ModuleType

import pytest

import dev
import usarmjx
from usarmjx.client import UsarsimClient

FACES = (
    "usarmjx",
    "usarmjx.cli",
    "usarmjx.client",
    "usarmjx.comms",
    "usarmjx.engines",
    "usarmjx.models",
    "usarmjx.models.arenas",
    "usarmjx.models.drives",
    "usarmjx.models.effecters",
    "usarmjx.models.generate",
    "usarmjx.models.roads",
    "usarmjx.models.robots",
    "usarmjx.plots",
    "usarmjx.recording",
    "usarmjx.sensors",
    "usarmjx.sensors.cameras",
    "usarmjx.server",
    "usarmjx.sim",
    "usarmjx.sweeps",
    "usarmjx.train",
    "usarmjx.train.adapters",
    "usarmjx.train.baselines",
    "usarmjx.train.tasks",
    "usarmjx.view",
)
"""The packages whose names are public."""
HEAVY = ("jax", "jaxlib", "mujoco", "numpy", "flax", "rich", "typer", "matplotlib", "usarmjx.sim")


def modules_after(code):
    """What Python has imported after some code, in a process of its own."""
    code = f"import sys, json\n{code}\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))


@pytest.mark.parametrize(
    "code", ["import usarmjx, usarmjx.client", "from usarmjx import UsageError, __version__"]
)
def test_importing_costs_next_to_nothing(code):
    loaded = modules_after(code)
    assert not loaded & set(HEAVY)
    assert len({name for name in loaded if name.startswith("usarmjx")}) < 10


def test_the_client_library_uses_the_standard_library_alone():
    loaded = modules_after("import usarmjx.client.wander")
    ours = {name for name in loaded if name.startswith("usarmjx")}
    assert {name.partition(".")[0] for name in modules_of(dev.ROOT / "usarmjx" / "client")} <= {
        *sys.stdlib_module_names,
        "usarmjx",
        "usarsim_client",  # the copy beside it, where there is no usarmjx
    }
    assert ours <= {
        "usarmjx",
        "usarmjx.base",
        "usarmjx.base.early_signals",
        "usarmjx.base.errors",
        "usarmjx.base.lazy",
        "usarmjx.base.process",
        *(f"usarmjx.client{end}" for end in ("", ".usarsim_client", ".usarsim_radio", ".wander")),
    }


def modules_of(folder):
    """What the modules of a folder import."""
    for file in folder.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                yield node.module


def help_of(script):
    """What a script answers to --help where nothing is installed."""
    command = [sys.executable, "-E", "-S", str(script), "--help"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=script.parent)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_copies_of_the_client_library_work_alone(tmp_path):
    for name in ("client/usarsim_client.py", "client/usarsim_radio.py", "client/wander.py"):
        shutil.copy(dev.ROOT / "usarmjx" / name, tmp_path)
    shutil.copy(dev.ROOT / "examples" / "ers_walk.py", tmp_path)
    assert help_of(tmp_path / "wander.py").startswith("usage: wander.py")
    assert help_of(tmp_path / "ers_walk.py").startswith("usage: ers_walk.py")
    code = "import usarsim_radio; print(usarsim_radio.WirelessA.__mro__[2].__module__)"
    command = [sys.executable, "-E", "-S", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout == "usarsim_client\n", done.stderr


@pytest.mark.parametrize("name", ["wander", "ers_walk", "qrio_wave", "radio_drive"])
def test_examples_run_in_a_clone_that_is_not_installed(name):
    assert help_of(dev.ROOT / "examples" / f"{name}.py").startswith(f"usage: {name}.py")


def parsed(module):
    """The syntax tree of a module of the package."""
    path = dev.ROOT.joinpath(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.parse(file.read_text(encoding="utf-8"))


def statements(body, following=None):
    """Statements of a module with those of its branches, each with the statement after it."""
    for node, after in zip(body, [*body[1:], following], strict=False):
        yield node, after
        if isinstance(node, ast.If | ast.Try | ast.With | ast.For):
            yield from statements(node.body, after)
            yield from statements(getattr(node, "orelse", []), after)


def imported(tree):
    """Names that a module imports from the package, and from which module under which name."""
    return {
        alias.asname or alias.name: (node.module, alias.name)
        for node, _ in statements(tree.body)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("usarmjx")
        for alias in node.names
    }


def assigned(node):
    """Names that a statement assigns."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return {part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)}


def docstring_of(module, name):
    """The docstring of a name, where it is defined; None: it has none.

    Raises:
        LookupError: The module does not define the name.
    """
    tree = parsed(module)
    if name in imported(tree):
        return docstring_of(*imported(tree)[name])
    found = []
    for node, after in statements(tree.body):
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            found.append(ast.get_docstring(node))  # an overload has none
        if isinstance(node, ast.Assign | ast.AnnAssign) and name in assigned(node):
            text = after.value if isinstance(after, ast.Expr) else None
            found.append(text.value if isinstance(text, ast.Constant) else None)
    if not found:
        raise LookupError(f"{module} has no {name}")
    return next(filter(None, found), None)


def names_of(face):
    """The public names of a package."""
    return importlib.import_module(face).__all__


def origin(module, name):
    """The module that defines a public name, and its name there."""
    there = imported(parsed(module)).get(name, (module, name))
    return there if there == (module, name) else origin(*there)


def test_faces_are_the_packages_that_list_their_names():
    files = (dev.ROOT / "usarmjx").rglob("__init__.py")
    packages = {".".join(file.parent.relative_to(dev.ROOT).parts) for file in files}
    listing = {name for name in packages if hasattr(importlib.import_module(name), "__all__")}
    assert {name for name in listing if not name.startswith("usarmjx.base.")} == set(FACES)


@pytest.mark.parametrize("face", FACES)
def test_public_names_are_what_type_checkers_see_and_have_docstrings(face):
    module, seen = importlib.import_module(face), imported(parsed(face))
    public = [name for name in module.__all__ if name != "__version__"]
    assert sorted(set(module.__all__)) == sorted(module.__all__)
    assert set(module.__all__) <= set(dir(module))
    if "attach" in seen:
        assert set(seen) - {"attach", "process", "early_signals"} == set(public)
    assert [name for name in public if not docstring_of(face, name)] == []
    for name in public:
        try:
            found = getattr(module, name)
        except usarmjx.MissingExtraError:
            continue
        assert type(found) is not ModuleType, f"a submodule hides {face}.{name}"
        if name in seen:
            there, known_as = seen[name]
            assert found is getattr(importlib.import_module(there), known_as), name


def test_a_name_that_is_not_public_is_no_attribute():
    with pytest.raises(AttributeError, match="'usarmjx' has no attribute 'Btach'"):
        _ = usarmjx.Btach
    with pytest.raises(ImportError, match="select_worlds"):
        exec("from usarmjx.sim import select_worlds", {})


def test_the_reference_lists_all_public_names_once():
    page = (dev.ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    listed = [tuple(name.rsplit(".", 1)) for name in re.findall(r"^::: (\S+)$", page, re.MULTILINE)]
    public = [(face, name) for face in FACES for name in names_of(face) if name != "__version__"]
    assert set(listed) <= set(public)
    assert {origin(*name) for name in listed} == {origin(*name) for name in public}
    assert len({origin(*name) for name in listed}) == len(listed)


# What pages and examples teach.

PAGES = [dev.ROOT / "README.md", *(dev.ROOT / "docs").rglob("*.md"), *(dev.ROOT / "benchmarks").glob("*.md")]
NOTEBOOKS = [*(dev.ROOT / "docs").glob("*.ipynb"), *(dev.ROOT / "examples").glob("*.ipynb")]
EXAMPLES = [*(dev.ROOT / "examples").rglob("*.py")]
FENCE = re.compile(r"^```\w*[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)


def programs(path):
    """The programs of a page, notebook or example."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return [text]
    if path.suffix == ".ipynb":
        return ["".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    return [re.sub(r"^(>>>|\.\.\.) ?", "", body, flags=re.MULTILINE) for body in FENCE.findall(text)]


def not_public(program):
    """What a program takes of the package that is not public: imports, and attributes of `usarmjx`."""
    try:
        nodes = list(ast.walk(ast.parse(program)))
    except SyntaxError:  # prompts with their output, or another language: its imports stand alone
        lines = [line for line in program.splitlines() if re.match(r"(from|import) usarmjx\b", line)]
        nodes = list(ast.walk(ast.parse("\n".join(lines))))
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "usarmjx":
            for alias in node.names:
                if node.module not in FACES or alias.name not in (*names_of(node.module), "*"):
                    yield f"{node.module}.{alias.name}"
        elif isinstance(node, ast.Import):
            yield from (
                alias.name
                for alias in node.names
                if alias.name.partition(".")[0] == "usarmjx" and alias.name not in FACES
            )
        elif (
            isinstance(node, ast.Attribute)
            and ast.unparse(node.value) == "usarmjx"
            and not {node.attr, f"usarmjx.{node.attr}"} & {"__file__", *usarmjx.__all__, *FACES}
        ):
            yield f"usarmjx.{node.attr}"


@pytest.mark.parametrize("path", [*PAGES, *NOTEBOOKS, *EXAMPLES], ids=lambda path: path.name)
def test_what_is_taught_is_public(path):
    assert [name for program in programs(path) for name in not_public(program)] == []


def test_what_is_not_public_is_found():
    assert [*not_public("from usarmjx.sim import Batch\nimport usarmjx.client, usarmjx\nusarmjx.Batch")] == []
    for wrong, name in [
        ("from usarmjx.sim.batch import Batch", "usarmjx.sim.batch.Batch"),
        ("from usarmjx.sim import select_worlds", "usarmjx.sim.select_worlds"),
        ("import usarmjx.sim.batch", "usarmjx.sim.batch"),
        ("import usarmjx\nusarmjx.Btach", "usarmjx.Btach"),
        ("from usarmjx.sim.batch import Batch\nwhat it prints", "usarmjx.sim.batch.Batch"),
    ]:
        assert [*not_public(wrong)] == [name]


def test_what_there_is_is_listed_by_name_without_importing_anything_else():
    code = "import usarmjx; print(json.dumps(usarmjx.TASKS.names()), file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys, json\n{code}"], capture_output=True, text=True, check=True
    )
    tasks = json.loads(done.stderr)
    assert {"drive-to-goal", "explore-v1", "soccer-v1"} <= set(tasks)
    assert "P2AT" in usarmjx.ROBOTS
    assert "yellow" in usarmjx.ARENAS
    assert {"Sonar", "RangeScanner"} <= set(usarmjx.SENSORS.names())
    assert set(usarmjx.POLICIES.names()) <= set(tasks)
    assert {"c", "jax", "planar", "warp"} <= set(usarmjx.ENGINES.names())


def test_types_in_public_signatures_are_public():
    known = set(usarmjx.__all__) | {"Any", "Sequence", "Path", "Mapping"}
    found = set()
    for name in ("make", "build_scene", "serve", "sweep", "load_policy", "Batch"):
        for part in inspect.signature(getattr(usarmjx, name)).parameters.values():
            found |= set(re.findall(r"\b[A-Z]\w+", inspect.formatannotation(part.annotation)))
    assert {"Scene", "ArenaSpec", "RosterEntry"} <= found <= known | {"None"}


def test_the_version_is_the_one_of_the_package():
    settings = tomllib.loads((dev.ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert settings["project"]["dynamic"] == ["version"]
    assert settings["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "usarmjx.__version__"}
    changes = (dev.ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## {usarmjx.__version__}" in changes


def test_a_program_serves_a_world_and_goes_on():
    with usarmjx.serve("yellow", port=0, realtime_factor=0) as served:
        assert served.running
        with UsarsimClient("127.0.0.1", served.port) as robot:
            status = robot.init("USARBot.P2AT", "R1", (4.5, 1.9, 1.8))
            assert status.kind == "STA"
            with pytest.raises(usarmjx.UsageError, match=str(served.port)):
                usarmjx.serve(port=served.port)
        port = served.port
    assert not served.running
    with pytest.raises(ConnectionRefusedError):
        UsarsimClient("127.0.0.1", port)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"instances": ()}, "at least one world"),
        ({"instances": (-1,)}, "instance -1"),
        ({"what": "atlantis"}, "unknown arena 'atlantis'"),
    ],
)
def test_what_cannot_be_served_is_named(wrong, said):
    with pytest.raises(usarmjx.UsageError, match=said):
        usarmjx.serve(port=0, **wrong)
