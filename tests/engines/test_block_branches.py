"""Branches of a step of solver `block`: what is launched beside others finds the same."""

from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

import warp as wp

from tests.engines.block_rows import random_states
from usarmjx.engines.block import branches, smooth, solver
from usarmjx.engines.block.branches import Branches
from usarmjx.engines.block.broad_phase import BroadPhase, make_table
from usarmjx.engines.mjx_warp import _step_by_blocks
from usarmjx.models.compile.physics import Physics
from usarmjx.sim.scene import build_scene


class Stream:
    """Stand-in for a stream: its launches are at once; it notes for whom it waits."""

    def __init__(self, name: str, waits: list[tuple[str, str]], main: Any = None) -> None:
        self.name, self._waits, self.device = name, waits, SimpleNamespace(stream=main)

    def wait_stream(self, other: "Stream") -> None:
        """Note that this stream waits for another."""
        self._waits.append((self.name, other.name))


def test_the_current_stream_waits_for_those_that_were_used_and_no_others():
    waits = list[tuple[str, str]]()
    main = Stream("main", waits)
    both = Branches([Stream(name, waits, main) for name in ("one", "other")])
    assert both.stream(1).name == "other"
    assert both.stream(3).name == "other"
    both.join()
    both.join()
    assert waits == [("other", "main"), ("other", "main"), ("main", "other")]
    assert Branches([]).stream(0) is None


def test_steps_with_branches_find_what_those_without_find(monkeypatch: pytest.MonkeyPatch):
    """Each kind of the convex collider has memory of its own; launches of branches are noted."""
    scene = build_scene("yellow", ["P2AT", "P2AT"], Physics(solver="block"))
    model: Any = scene.model
    model.opt.solver = 1
    x, y, _ = scene.arena.starts[0].at
    places = np.array([[x, y, 0.0], [x + 0.45, y + 0.1, 0.0]])
    states = random_states(model, places, 3, seed=1)
    mjw = import_module("mujoco.mjx.third_party.mujoco_warp")
    m = mjw.put_model(model)
    pairs, own = m.nxn_geom_pair_filtered.numpy(), m.nxn_pairid_filtered.numpy()
    near = BroadPhase(make_table(model, pairs, (own >= 0).any(1)))
    step = _step_by_blocks(near, False, smooth.SmoothDynamics(model))
    waits, found, streams, launch = list[tuple[str, str]](), [], list[str](), wp.launch
    main = Stream("main", waits)
    some = Branches([Stream(name, waits, main) for name in "abc"])

    def launch_on(*args: Any, stream: Any = None, **kwargs: Any) -> None:
        streams.append("main" if stream is None else stream.name)
        launch(*args, **kwargs)

    for used in (Branches([]), some):
        for module in (branches, smooth, solver):
            monkeypatch.setattr(module, "branches_of", lambda device, used=used: used)
        monkeypatch.setattr(wp, "ScopedStream", lambda stream: wp.ScopedDevice("cpu"))
        monkeypatch.setattr(wp, "launch", launch_on)
        d = mjw.make_data(model, nworld=len(states), naconmax=600, naccdmax=400, njmax=1500)
        d.qpos.assign(np.array([qpos for qpos, *_ in states], np.float32))
        for _ in range(3):
            step(m, d)
        found.append((d.qpos.numpy().copy(), d.nacon.numpy().copy(), d.qacc.numpy().copy()))
        assert set(streams) == ({"main", "a", "b", "c"} if len(used) else {"main"})
    for without, beside in zip(*found, strict=True):
        np.testing.assert_array_equal(without, beside)
    assert found[0][1] > 0
    assert waits[-1][0] == "main"
    assert {one for one, other in waits if other == "main"} == {"a", "b", "c"}
