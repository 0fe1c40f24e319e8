"""Kernels of solver `block` as a GPU's threads run them, with barriers; see `gpu_threads`."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from benchmarks.islands.rows import data_of, exact, model_of
from tests.engines.block_rows import random_states, solve_in_c
from tests.engines.gpu_threads import COMPILER, run_struct_as_on_a_gpu
from usarmjx.engines.block import islands, newton, solver
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


@pytest.mark.parametrize("lanes", [8, 16, 32, 128])
def test_threads_find_what_one_alone_finds(lanes: int, monkeypatch: pytest.MonkeyPatch):
    scene = build_scene("yellow", ["P2AT", "P2AT"])
    x, y, _ = scene.arena.starts[0].at
    places = np.array([[x, y, 0.0], [x + 0.45, y + 0.1, 0.0]])
    model = exact(scene.model)
    solved = [solve_in_c(model, state) for state in random_states(model, places, 3, seed=1)]
    m, d = model_of(model), data_of(model, solved)
    problems = []
    make = solver.make_problem

    def keep(m: Any, d: Any) -> Any:
        problems.append(make(m, d))
        return problems[-1]

    monkeypatch.setattr(solver, "make_problem", keep)
    solver.solve(m, d)
    problem = problems[0]
    names = list(solver.problem_type().vars)
    alone = arrays_of(problem, dict.fromkeys(names))
    emptied = ("roots", "counts", "tasks", "acceleration", "force")
    fields = {**alone, **{name: np.zeros_like(alone[name]) for name in emptied}}
    code = expand_macros(islands.CODE, solver.MACROS)
    run_struct_as_on_a_gpu(code, fields, 3 * islands.THREADS, islands.THREADS)
    for name in ("roots", "counts", "islands"):
        np.testing.assert_array_equal(fields[name], alone[name], name)
    trees = 3 * model.ntree
    for which in range(3):
        words = {"LANES": lanes, "BLOCK": lanes, "SIZE_CLASS": which, "SLOT": solver.CLASSES[which].slot}
        native = expand_macros(newton.CODE, {**solver.MACROS, **words})
        run_struct_as_on_a_gpu(native, fields, trees * lanes, lanes, groups=trees)
    np.testing.assert_array_equal(fields["iterations"], alone["iterations"])
    for name in ("acceleration", "force", "momentum", "constraint_force"):
        alone[name] = np.nan_to_num(alone[name])  # rows beyond the last
        size = np.abs(alone[name]).max()
        np.testing.assert_allclose(fields[name], alone[name], atol=1e-5 * size, err_msg=name)
