"""What is not built here is at least consistent: the container, the development container, the workflow."""

import fnmatch
import json
import re
import tomllib

import yaml

import dev
import usarmjx
from tests.test_docs import command_problem
from usarmjx.server import ports

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


def test_the_development_container_uses_our_verbs_and_ports():
    told = json.loads((dev.ROOT / ".devcontainer" / "devcontainer.json").read_text(encoding="utf-8"))
    assert command_problem(told["postCreateCommand"].split()) == ""
    assert set(told["forwardPorts"]) == {ports.BOT_PORT, ports.VIEWER_PORT}


def test_the_workflow_runs_what_there_is_on_each_python_that_we_name():
    text = (dev.ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    jobs = yaml.safe_load(text)["jobs"]
    named = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", line)]
    for job in jobs.values():
        assert job["strategy"]["matrix"]["python"] == named
    commands = {step["run"] for job in jobs.values() for step in job["steps"] if "run" in step}
    assert commands == {".ci/run", "python dev.py try --python python"}
    assert (dev.ROOT / ".ci" / "run").exists()
    assert command_problem(["python", "dev.py", "try", "--python", "python"]) == ""


def test_the_citation_is_of_this_version():
    told = yaml.safe_load((dev.ROOT / "CITATION.cff").read_text(encoding="utf-8"))

    assert told["version"] == usarmjx.__version__
    assert told["license"] == PROJECT["license"]
    assert [one["name"] for one in told["authors"]] == [one["name"] for one in PROJECT["authors"]]
