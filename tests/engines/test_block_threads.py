"""Kernels of solver `block` as a GPU's threads run them, with barriers; see `gpu_threads`."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from benchmarks.islands.rows import data_of, exact, model_of
from tests.engines.block_rows import random_states, solve_in_c
from tests.engines.gpu_threads import COMPILER, run_struct_as_on_a_gpu
from usarmjx.engines.block import islands, solver
from usarmjx.engines.block.solver import CLASSES, LARGE, VARIANTS, SizeClass, small_class
from usarmjx.engines.planar.warp_solids import expand_macros
from usarmjx.sim.scene import build_scene

pytestmark = pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")


def arrays_of(problem: Any, values: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a problem as NumPy has them."""
    return {
        name: field.numpy().copy()
        if hasattr(field := getattr(problem, name), "numpy")
        else np.zeros(1, np.float32)
        if field is None
        else int(field)
        for name in values
    }


FIRST = (
    *(replace(LARGE[0], lanes=lanes, block=lanes) for lanes in (8, 16, 32, 128)),
    small_class(12, 8, 648, 32),
    small_class(12, 4, 648, 32),
    small_class(24, 16, 1448, 32),
)
"""Size classes with memory of either kind, in place of the solver's first."""


def two_robots_in_touch(count: int) -> tuple[mujoco.MjModel, list[mujoco.MjData]]:
    """Return states of two robots that touch sometimes, so that islands have one or both."""
    scene = build_scene("yellow", ["P2AT", "P2AT"])
    x, y, _ = scene.arena.starts[0].at
    places = np.array([[x, y, 0.0], [x + 0.45, y + 0.1, 0.0]])
    model = exact(scene.model)
    return model, [solve_in_c(model, state) for state in random_states(model, places, count, seed=1)]


@pytest.mark.every_run("16-0", "8-12")
@pytest.mark.parametrize("first", FIRST, ids=lambda one: f"{one.lanes}-{one.dofs}")
def test_threads_find_what_one_alone_finds(first: SizeClass, monkeypatch: pytest.MonkeyPatch):
    """All islands that fit are of the class that is tested; accelerations are those of one lane."""
    model, solved = two_robots_in_touch(3)
    m, d = model_of(model), data_of(model, solved)
    problems = []
    make = solver.make_problem

    def keep(m: Any, d: Any) -> Any:
        problems.append(make(m, d))
        return problems[-1]

    monkeypatch.setattr(solver, "make_problem", keep)
    classes = (first, *LARGE[:1], LARGE[-1])
    monkeypatch.setattr(solver, "CLASSES", CLASSES if first.dofs else VARIANTS["shared"])
    solver.solve(m, d)
    monkeypatch.setattr(solver, "CLASSES", classes)
    problem = make(m, d)
    names = list(solver.problem_type().vars)
    alone = arrays_of(problems[0], dict.fromkeys(names))
    fields = arrays_of(problem, dict.fromkeys(names))
    emptied = (
        "roots",
        "counts",
        "tasks",
        "acceleration",
        "force",
        "momentum",
        "constraint_force",
        "iterations",
    )
    fields |= {name: np.zeros_like(fields[name]) for name in emptied}
    run_struct_as_on_a_gpu(solver.islands_code(classes), fields, 3 * islands.THREADS, islands.THREADS)
    np.testing.assert_array_equal(fields["roots"], alone["roots"])
    whole = fields["roots"] == np.tile(np.arange(model.ntree), 3)
    fields["islands"], alone["islands"] = (
        one["islands"].reshape(-1, islands.TASK_NUMBERS) for one in (fields, alone)
    )
    np.testing.assert_array_equal(fields["islands"][whole, :5], alone["islands"][whole, :5])
    trees = 4 * model.ntree
    assert fields["counts"][0] > 3
    assert fields["counts"][2] == 0
    for which, one in enumerate(classes[:2]):
        native = expand_macros(one.code(), one.words(which))
        run_struct_as_on_a_gpu(native, fields, trees * one.lanes, one.block, groups=trees)
    alone["force"] = np.nan_to_num(alone["force"])  # of rows beyond the last
    # Forces of robots in each other cancel in generalized forces; each is rounded by itself.
    rounding = {"constraint_force": 4 * np.spacing(np.abs(alone["force"]).max())}
    for name in ("acceleration", "force", "momentum", "constraint_force"):
        most = 1e-5 * np.abs(alone[name]).max() + rounding.get(name, 0.0)
        np.testing.assert_allclose(fields[name], alone[name], atol=most, err_msg=name)
