"""`usarmjx doctor`: what it finds where all is well, and where something is broken."""

import json
import re
import socket
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from tests.listening import COMPILED, compilations
from usarmjx.base import process
from usarmjx.cli import doctor
from usarmjx.cli.app import app
from usarmjx.cli.doctor import Finding, check_cache, check_ports, check_versions, requirements, run_checks
from usarmjx.sim.batch import Batch

FREE = {"--port": 0}
"""Ports of which the system picks one that is free."""


def verdicts(findings):
    return [(one.about, one.verdict) for one in findings]


def invoke(*words):
    return CliRunner().invoke(app, ["doctor", *words])


@pytest.fixture
def quick(monkeypatch):
    """Checks that do not depend on what else runs here."""
    fine = [Finding("all", "ok", "well")]
    monkeypatch.setattr(doctor, "CHECKS", (check_versions, lambda: iter(fine)))
    monkeypatch.setattr(doctor, "SELF_TEST", ())


def test_where_all_is_well_the_exit_code_is_0_and_json_says_the_same(quick):
    result = invoke()
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-1] == "nothing is wrong"
    result = invoke("--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert found["ok"]
    assert {"about": "all", "verdict": "ok", "text": "well", "advice": ""} in found["findings"]
    python = ".".join(map(str, sys.version_info[:3]))
    assert any(one["about"] == "python" and python in one["text"] for one in found["findings"])


def test_one_fault_is_exit_code_1_and_its_advice_is_told(monkeypatch, quick):
    fault = Finding("ports", "wrong", "3000 is taken", "take another")
    monkeypatch.setattr(doctor, "CHECKS", (lambda: iter([fault, Finding("x", "note", "by the way")]),))
    result = invoke()
    assert result.exit_code == 1
    assert result.stdout.splitlines()[-1] == "wrong: ports"
    assert "-> take another" in result.stdout
    result = invoke("--json")
    assert (result.exit_code, json.loads(result.stdout)["ok"]) == (1, False)


def test_a_taken_port_is_wrong_and_the_pages_only_noted():
    assert verdicts(check_ports(FREE, 0)) == [("ports", "ok")] * 2
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        first, page = check_ports({"--image-port": port}, port)
    assert (first.verdict, first.text) == ("wrong", f"{port} is taken")
    assert "--image-port" in first.advice
    assert page.verdict == "note"


def test_a_missing_package_is_named(monkeypatch):
    assert "wrong" not in dict(verdicts(check_versions())).values()
    needed, extras = requirements()
    assert {"jax", "mujoco", "viser", "typer"} <= {*needed}
    assert extras.keys() == {*doctor.USERS_EXTRAS}
    there = doctor.version_of
    monkeypatch.setattr(doctor, "version_of", lambda name: None if name == "viser" else there(name))
    (fault,) = (one for one in check_versions() if one.verdict == "wrong")
    assert fault.text == "missing: viser"
    assert "pip install viser" in fault.advice


def test_an_old_python_is_wrong(monkeypatch):
    monkeypatch.setattr(doctor, "OLDEST_PYTHON", (sys.version_info[0], sys.version_info[1] + 1))
    assert ("python", "wrong") in verdicts(check_versions())


def test_the_cache_is_told_with_its_size_or_why_nothing_is_kept(tmp_path):
    folder = tmp_path / "cache"
    (folder / "jax").mkdir(parents=True)
    (folder / "jax" / "program").write_bytes(bytes(3_000_000))
    (found,) = check_cache({"USARMJX_CACHE": str(folder)})
    assert (found.verdict, found.text) == ("ok", f"{folder}, 3 MB of compiled programs")
    (found,) = check_cache({"USARMJX_CACHE": "off"})
    assert found.verdict == "note"
    (tmp_path / "file").touch()
    (found,) = check_cache({"USARMJX_CACHE": str(tmp_path / "file" / "cache")})
    assert found.verdict == "wrong"
    assert "not kept" in found.text


def test_a_pool_that_is_too_small_is_wrong(monkeypatch):
    assert verdicts(doctor.check_threads()) == [("threads", "ok")]
    monkeypatch.setattr(process, "_started_before_us", True)
    (found,) = doctor.check_threads()
    assert (found.verdict, "NPROC=8" in found.advice) == ("wrong", True)


def test_a_gpu_that_jax_does_not_use_is_noted(monkeypatch):
    monkeypatch.setattr(doctor, "has_nvidia", lambda: True)
    assert ("devices", "note") in verdicts(doctor.check_devices())
    monkeypatch.setattr(doctor, "has_nvidia", lambda: False)
    assert verdicts(doctor.check_devices()) == [("devices", "ok")]


def test_what_auto_takes_and_why():
    (found,) = doctor.check_engines()
    assert found.text.startswith("auto is c to serve, c to train, jax for batches: ")


def test_a_check_that_breaks_is_a_finding_and_the_others_go_on():
    def check_that():
        raise RuntimeError("driver too old")
        yield

    found = run_checks([check_that, lambda: iter([Finding("x", "ok", "")])])
    assert verdicts(found) == [("that", "wrong"), ("x", "ok")]
    assert found[0].text == "RuntimeError: driver too old"


# The self-test


MOST_PROGRAMS = 30
"""XLA programs of a self-test, most of its work; `python -m benchmarks.doctor` measures the seconds."""
MOST_STEPS = 2 * 2 * 60
"""Control steps of worlds, on both engines."""


def test_a_self_test_compiles_few_programs_makes_few_steps_and_answers_on_standard_output(monkeypatch):
    """A cold one takes ten seconds of a processor."""
    monkeypatch.setattr(doctor, "SPEED_SECONDS", 0.05)
    made, step = [], Batch.step

    def counted(batch, state):
        made.append(batch.worlds)
        return step(batch, state)

    monkeypatch.setattr(Batch, "step", counted)
    with compilations(COMPILED) as compiled:
        done = invoke("--json")
    assert "usarmjx: step a batch on engine `c` ...\n" in done.stderr
    found = {one["about"]: one for one in json.loads(done.stdout)["findings"]}
    tried = ("engine c", "engine jax", "client", "rays", "speed")
    assert [found[name]["verdict"] for name in tried] == ["ok"] * 5, found
    assert re.match(r"engine c makes [\d,]+ steps/s of \d+ ms in 4 worlds x 4 P2AT: ", found["speed"]["text"])
    assert len(compiled) <= MOST_PROGRAMS
    assert 0 < sum(made) <= MOST_STEPS


def test_the_first_line_comes_before_numpy_and_jax():
    code = (
        "import sys, usarmjx.cli.common as waiting\n"
        "def first(text, **_):\n"
        "    print(text, sorted({'numpy', 'jax', 'mujoco'} & set(sys.modules)))\n"
        "    raise SystemExit\n"
        "waiting.announce = first\n"
        "from usarmjx.cli.doctor import doctor\n"
        "doctor()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "looking at packages, cache, ports and devices ... []\n"


def test_a_ball_that_does_not_lie_on_the_floor_is_found(monkeypatch):
    monkeypatch.setattr(doctor, "STEPS", 2)
    (engine,) = doctor.try_c()
    assert (engine.verdict, engine.about) == ("wrong", "engine c")
    assert "above it" in engine.text


def test_a_robot_that_goes_nowhere_and_a_wall_that_is_elsewhere_are_found(monkeypatch):
    monkeypatch.setattr(doctor, "REPORT_LIMIT", 2.0)
    monkeypatch.setattr(doctor, "WHEEL_SPEED", 0.0)
    monkeypatch.setattr(doctor, "SCANNER_REACH", 0.0)
    assert verdicts(doctor.try_client()) == [("client", "wrong"), ("rays", "wrong")]


def test_a_server_that_does_not_start_is_told(monkeypatch):
    monkeypatch.setattr(doctor, "HOST", "192.0.2.1")  # is nobody's
    (found,) = run_checks([doctor.try_client])
    assert (found.about, found.verdict) == ("client", "wrong")
    assert "cannot listen on 192.0.2.1" in found.text
