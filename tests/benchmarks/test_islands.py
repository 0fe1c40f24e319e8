"""`benchmarks.islands`: solver `block` beside C MuJoCo on a sample of the states, and the benchmark."""

import json

import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

import dev
from benchmarks.islands import __main__ as islands
from benchmarks.islands import rows
from benchmarks.islands.compare import errors
from benchmarks.islands.states import StateMaker
from tests.benchmarks.records import faults
from usarmjx.models.compile.physics import Physics
from usarmjx.sim.scene import build_scene


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("arena", "robot", "cone"),
    [
        ("DM-USAR_red", "Talon", "elliptic"),
        ("DM-Factory", "Soryu", "elliptic"),
        ("DM-Outdoor", "QRIO", "pyramidal"),
        ("DM-Soccer", "Sedan", "elliptic"),
    ],
)
def test_accelerations_are_those_of_c_mujoco(arena: str, robot: str, cone: islands.Cone):
    """Cars deep in each other push so hard that their rows in single precision have roots 1e-4 off."""
    line = islands.play(arena, robot, 0, 3, cone)
    assert sum(line["states"].values()) > 12
    assert line["touching"] > 12
    assert line["worst"]["island"] < islands.BOUND
    for state in line["beyond"]:
        assert state["solver"]["root"] < 1e-5, "the solver's, of the rows that it was given"


def test_an_error_is_found_and_so_is_its_cause():
    scene = build_scene("yellow", ["P2AT", "P2AT"], Physics(solver="block"))
    model = rows.exact(scene.model)
    maker = StateMaker(model, scene.arena, 2)
    data = [rows.keep(data) for data in maker.trajectory("driving", np.random.default_rng(0), 3)][-1]
    wrong = data.qacc.copy()
    wrong[maker.robots[1].dof] += 0.5
    assert errors(model, [data], wrong[None])[0] > 1e-5
    assert errors(model, [data], data.qacc[None])[0] == 0.0
    found = islands.causes(model, data, wrong)
    root = maker.robots[1].dof
    size = max(9.81, float(np.linalg.norm(data.qacc[root : root + 3])))
    assert found["solver"]["root"] == pytest.approx(0.5 / size, rel=0.01)
    assert found["rounding"]["root"] < 1e-5
    assert found["c"]["root"] < 1e-5


CLASSES, NUM_ARENAS = 27, 12
"""Of the package: tests in the same process may register others."""


def test_the_records_have_all_robots_in_all_arenas():
    """On the elliptic cone the solver is exact; on pyramids of little friction rounding decides."""
    lines = (dev.ROOT / "benchmarks" / "results" / "islands.jsonl").read_text(encoding="utf-8").splitlines()
    records = {record["case"]["cone"]: record for record in map(json.loads, lines)}
    assert sum(record["states"] for record in records.values()) >= 100_000
    for record in records.values():
        assert not faults(record)
        assert record["pairs"] == CLASSES * NUM_ARENAS
        assert min(record["by_kind"].values()) > 7000
        assert record["beyond"]["most"]["c"]["island"] < 2e-4
    elliptic = records["elliptic"]["beyond"]
    assert elliptic["solver_beyond"]["island"] == 0
    assert elliptic["most"]["solver"]["island"] < 1e-5
    assert elliptic["by_measure"]["island"] < 1e-3 * records["elliptic"]["states"]
