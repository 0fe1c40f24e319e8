"""Gravity compensation beside solver `block`: left out where no body has any."""

from importlib import import_module
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

import warp as wp

from usarmjx.engines import mjx_warp
from usarmjx.models.compile.physics import Physics
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

BODIES = """<mujoco><worldbody>
  <body pos="0 0 1"><joint type="hinge" axis="0 1 0" damping="0.3" stiffness="2"/>
    <geom size="0.1" pos="0.2 0 0"/><body><joint type="slide" damping="0.2"/><geom size="0.1"/></body></body>
</worldbody></mujoco>"""


def test_passive_forces_without_the_kernel_are_the_same(monkeypatch):
    mjw: Any = import_module("mujoco.mjx.third_party.mujoco_warp")
    passive = import_module("mujoco.mjx.third_party.mujoco_warp._src.passive")
    model = mujoco.MjModel.from_xml_string(BODIES)
    m, d = mjw.put_model(model), mjw.make_data(model, nworld=2)
    d.qpos.assign(np.array([[0.3, 0.1], [-0.2, 0.4]], np.float32))
    d.qvel.assign(np.array([[1.0, -0.5], [0.2, 0.7]], np.float32))
    mjw.fwd_position(m, d)
    found, launched, launch = [], [], wp.launch

    def count(kernel: Any, *args: Any, **kwargs: Any) -> None:
        launched[-1].append(kernel)
        launch(kernel, *args, **kwargs)

    monkeypatch.setattr(wp, "launch", count)
    for function in (passive.passive, mjx_warp._passive_without_gravcomp()):
        launched.append([])
        d.qfrc_passive.fill_(9.0)
        function(m, d)
        found.append(d.qfrc_passive.numpy())
    np.testing.assert_array_equal(found[0], found[1])
    assert found[0].any()
    assert set(launched[0]) - set(launched[1]) == {passive._gravity_force}


@pytest.mark.parametrize("gravcomp", [0.0, 1.0])
def test_bodies_that_compensate_for_gravity_keep_the_kernel(gravcomp, monkeypatch):
    chosen: list[bool] = []
    monkeypatch.setattr(mjx_warp, "_step_by_blocks", lambda *args: chosen.append(args[1]))
    engine = Batch(build_scene("yellow", ["P2DX"], Physics(solver="block")), 1, engine="warp").engine
    engine.model.body_gravcomp[1] = gravcomp
    engine._step_and_count()
    assert chosen == [bool(gravcomp)]
