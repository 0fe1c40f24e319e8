"""What `import usarmjx` gives, and what it costs."""

import ast
import inspect
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import dev
import usarmjx
from usarmjx.client import UsarsimClient

SOURCE = Path(usarmjx.__file__).read_text(encoding="utf-8")
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
        "usarmjx.base.errors",
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


def test_type_checkers_see_the_names_that_python_finds():
    """The imports for type checkers and the table for Python agree, and each name is what it says."""
    (block,) = [node for node in ast.parse(SOURCE).body if isinstance(node, ast.If)]
    seen = {}
    for node in block.body:
        (alias,) = node.names
        seen[alias.asname] = node.module, alias.name
    assert sorted([*seen, "__version__"]) == sorted(usarmjx.__all__)
    for name, (module, there) in seen.items():
        assert getattr(usarmjx, name) is getattr(sys.modules[module], there), name
    assert set(usarmjx.__all__) <= set(dir(usarmjx))
    with pytest.raises(AttributeError, match="has no attribute 'Btach'"):
        _ = usarmjx.Btach


def test_what_there_is_is_listed_by_name_without_importing_anything_else():
    code = "import usarmjx; print(json.dumps(usarmjx.TASKS.names()), file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys, json\n{code}"], capture_output=True, text=True, check=True
    )
    tasks = json.loads(done.stderr)
    assert {"drive-to-goal", "explore", "soccer"} <= set(tasks)
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
