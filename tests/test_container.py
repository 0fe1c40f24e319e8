"""What is not built here is at least consistent: the container, the development container, the workflow."""

import fnmatch
import json
import re
import tomllib

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import dev
import usarmjx
from tests.test_docs import command_problem
from tools import trial
from usarmjx.cli.app import app
from usarmjx.cli.listing import commands_of
from usarmjx.cli.serve import WorldsOptions
from usarmjx.server.network import ports

DOCKERFILE = (dev.ROOT / "Dockerfile").read_text(encoding="utf-8")
PROJECT = tomllib.loads((dev.ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_what_the_container_copies_is_there_and_not_left_out():
    lines = re.findall(r"^COPY (?!--)(.*)", DOCKERFILE, re.M)
    copied = [word for line in lines for word in line.split()[:-1]]
    ignored = (dev.ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    kept = [line[1:] for line in ignored if line.startswith("!")]
    assert len(copied) > 4
    for name in copied:
        assert (dev.ROOT / name).exists(), name
        assert any(fnmatch.fnmatch(name, one) for one in kept), f"{name} is left out by .dockerignore"
    assert set(PROJECT["license-files"]) <= set(copied)


def test_what_the_container_runs_and_opens_exists():
    (entry,) = re.findall(r"^ENTRYPOINT (.*)", DOCKERFILE, re.M)
    commands = re.findall(r"^CMD (.*)", DOCKERFILE, re.M)
    assert len(commands) == 2
    for command in commands:
        assert command_problem([*json.loads(entry), *json.loads(command)]) == ""
    (opened,) = re.findall(r"^EXPOSE (.*)", DOCKERFILE, re.M)
    assert {int(port) for port in opened.split()} == {
        ports.BOT_PORT,
        ports.WSS_PORT,
        ports.WSS2_PORT,
        ports.POSITION_PORT,
        ports.IMAGE_PORT,
        ports.VIEWER_PORT,
    }
    (extras,) = re.findall(r"\[([\w,]+)\]\"", DOCKERFILE)
    assert set(extras.split(",")) <= PROJECT["optional-dependencies"].keys()


def test_the_gpu_image_has_the_kernels_of_what_it_serves():
    """Of the arena of its command, and of the robots and of the GPUs that its build names."""
    (line,) = re.findall(r"^RUN JAX_PLATFORMS=cpu usarmjx kernels (.*)", DOCKERFILE, re.M)
    (default,) = re.findall(r'^ARG GPU_ARCHITECTURES="(.*)"', DOCKERFILE, re.M)
    command = dict(commands_of(app))["kernels"]
    options = command.make_context("kernels", line.replace("$GPU_ARCHITECTURES", default).split()).params
    served = next(json.loads(line) for line in re.findall(r"^CMD (.*)", DOCKERFILE, re.M) if "warp" in line)
    assert options["arena"] == served[served.index("--arena") + 1]
    assert "--roster" not in served
    assert options["roster"] == WorldsOptions.roster
    assert options["architectures"] == [80, 89, 90, 100]


def test_the_containers_python_is_one_that_we_name_and_has_a_pin_of_all_that_we_need():
    """One that applies to it and is within our bounds: jax has a line for each Python that needs another."""
    (python,) = re.findall(r"^ARG PYTHON=(\S+)", DOCKERFILE, re.M)
    told = json.loads((dev.ROOT / ".devcontainer" / "devcontainer.json").read_text(encoding="utf-8"))
    assert told["image"] == f"python:{python}"
    assert f"Programming Language :: Python :: {python}" in PROJECT["classifiers"]
    where = {"python_version": python, "python_full_version": f"{python}.0", "sys_platform": "linux"}
    lines = (dev.ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if line.strip() and not line.startswith("#")]
    (extras,) = re.findall(r"\[([\w,]+)\]\"", DOCKERFILE)
    wanted = [*PROJECT["dependencies"]]
    for extra in extras.split(","):
        wanted += PROJECT["optional-dependencies"][extra]
    for need in map(Requirement, wanted):
        fitting = [
            one
            for one in pins
            if canonicalize_name(one.name) == canonicalize_name(need.name)
            and (one.marker is None or one.marker.evaluate(where))
        ]
        assert len(fitting) == 1, need
        (version,) = [clause.version for clause in fitting[0].specifier]
        assert need.specifier.contains(version), (need, version)


def test_the_wheel_is_made_of_what_dev_py_try_makes_it_of_and_installed_under_the_pins():
    (sources,) = re.findall(r"^COPY (pyproject.*) \./$", DOCKERFILE, re.M)
    assert set(sources.split()) == set(trial.SOURCES)
    assert re.search(r"^COPY usarmjx usarmjx$", DOCKERFILE, re.M)
    (folder,) = re.findall(r"^COPY constraints.txt (\S+)$", DOCKERFILE, re.M)
    (made,) = re.findall(r"--wheel-dir (\S+)", DOCKERFILE)
    assert re.findall(r"^COPY --from=wheel (\S+) (\S+)$", DOCKERFILE, re.M) == [(made, folder)]
    installs = re.findall(r"^RUN pip install (.*)", DOCKERFILE, re.M)
    assert len(installs) == 2
    for line in installs:
        assert f"-c {folder}constraints.txt" in line
        assert f"{folder}*.whl" in line


def test_the_development_container_uses_our_verbs_and_ports():
    told = json.loads((dev.ROOT / ".devcontainer" / "devcontainer.json").read_text(encoding="utf-8"))
    assert command_problem(told["postCreateCommand"].split()) == ""
    assert set(told["forwardPorts"]) == {ports.BOT_PORT, ports.VIEWER_PORT}


def test_the_workflow_runs_what_there_is_on_each_python_that_we_name():
    text = (dev.ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    jobs = yaml.safe_load(text)["jobs"]
    named = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", line)]
    for name, job in jobs.items():
        assert name == "clients" or job["strategy"]["matrix"]["python"] == named
    runs = {name: [step["run"] for step in job["steps"] if "run" in step] for name, job in jobs.items()}
    assert set(runs) == {"check", "wheel", "adapters", "clients"}
    assert runs["check"] == [".ci/run"]
    assert runs["wheel"] == ["python dev.py try --python python"]
    assert "python -m pytest -n0 tests/train/adapters" in runs["adapters"]
    *_, tests, none_is_skipped = runs["clients"]
    assert none_is_skipped == "! grep SKIPPED clients.txt"
    assert all((dev.ROOT / word).exists() for word in tests.split() if word.startswith("tests/"))
    assert (dev.ROOT / ".ci" / "run").exists()
    assert command_problem(["python", "dev.py", "try", "--python", "python"]) == ""


def test_the_citation_is_of_this_version():
    told = yaml.safe_load((dev.ROOT / "CITATION.cff").read_text(encoding="utf-8"))

    assert told["version"] == usarmjx.__version__
    assert told["license"] == PROJECT["license"]
    assert [one["name"] for one in told["authors"]] == [one["name"] for one in PROJECT["authors"]]
