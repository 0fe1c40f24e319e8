"""Number of steps in one call of MuJoCo Warp, or in one CUDA graph; see test_weight.py."""

import jax
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from tests.engines.test_weight import engine_of
from usarmjx.base.errors import EngineError, UnknownNameError, UnsupportedFeatureError
from usarmjx.engines.mjx_warp import multi_step
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene


def test_without_a_word_there_is_a_graph_for_each_physics_step(monkeypatch):
    """On a GPU; a CPU replays its launches, see test_launch_replay.py."""
    engine = engine_of()
    before = engine.mx.opt._impl.graph_mode
    if jax.default_backend() == "cpu":
        assert engine._step_and_count() == (multi_step(engine.physics.substeps, engine._own_step), 1)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert engine._step_and_count()[1] == engine.physics.substeps == 4
    monkeypatch.undo()
    engine.select_graphs("step")
    assert engine.mx.opt._impl.graph_mode is before


def test_an_unknown_graph_is_refused_and_engines_without_any_refuse_all():
    with pytest.raises(UnknownNameError, match=r"kind of CUDA graphs 'action'; known: .*control-staged-ex"):
        engine_of().select_graphs("action")
    with pytest.raises(UnsupportedFeatureError, match=r"engine 'c' launches no CUDA graphs .'control'."):
        Batch(build_scene("yellow", ["P2AT"]), 1, engine="c").engine.select_graphs("control")


def test_another_version_of_mjx_is_refused(monkeypatch):
    monkeypatch.setattr("usarmjx.engines.cylinder_box.MJX_VERSION", "3.16.0")
    with pytest.raises(EngineError, match=r"found mujoco-mjx .*; .* needs exactly 3\.16\.0"):
        multi_step(17, print)
