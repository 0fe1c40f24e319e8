"""Solver `block` of engine `warp` against C MuJoCo's Newton solver, converged to 1e-10, on the same rows.

`block_rows.error` defines errors of accelerations.
"""

import logging

import jax
import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from benchmarks.islands.rows import exact, solved_alone
from tests.engines.block_rows import error, islands_of, random_states, roll_out, scattered, solve_in_c
from usarmjx.engines import block
from usarmjx.engines.mjx_warp import WarpEngine
from usarmjx.models.compile.physics import Physics
from usarmjx.sim.scene import build_scene

ERROR = 1e-5
"""Of accelerations: single precision, and steps of Newton's method end below it."""
FORCE_ERROR = 1e-4
"""Of constraint forces, relative to the largest of a state: those of stiff rows amplify roundings."""
STATES = 8
"""Of each case, 0.1 s apart."""

MECHANISM = """
<mujoco>
  <option timestep="0.005" cone="{cone}" impratio="2"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" condim="{condim}"/>
    <body pos="0 0 .11"><freejoint/><geom type="box" size=".2 .1 .1" mass="3" condim="{condim}"/>
      <body pos=".3 0 0"><joint name="a" axis="0 1 0" range="-20 20" limited="true" frictionloss=".3"/>
        <geom type="box" size=".1 .05 .05" mass=".5"/></body>
      <body pos="0 .2 0"><joint name="b" axis="0 1 0" frictionloss=".1"/><geom size=".05" mass=".2"/></body>
    </body>
    <body name="one" pos="0 .5 .2"><freejoint/>
      <geom size=".1" mass="1" friction="1 .02 .01" condim="{condim}"/></body>
    <body name="two" pos=".25 .5 .3"><freejoint/>
      <geom size=".1" mass="2" friction="1 .02 .01" condim="{condim}"/></body>
    <body pos="2 0 1"><joint axis="0 1 0"/><geom type="box" size=".1 .02 .02" pos=".1 0 0" mass="2"/></body>
  </worldbody>
  <equality><joint joint1="a" joint2="b"/><connect body1="one" body2="two" anchor=".12 0 0"/></equality>
  <actuator><motor joint="a" gear="2"/></actuator>
</mujoco>
"""
"""Joint limits, friction losses, equalities of joints and bodies, contacts, a tree without constraints."""


def check(model: mujoco.MjModel, solved: list[mujoco.MjData], sparse: bool = True) -> None:
    """Compare what the solver finds with what C MuJoCo found."""
    found = solved_alone(model, solved, sparse)
    for k, data in enumerate(solved):
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        acceleration, rows = found.qacc.numpy()[k].astype(float), data.nefc
        assert error(model, data, acceleration) < ERROR
        strong = np.abs(data.efc_force).max(initial=1.0)
        np.testing.assert_allclose(
            found.efc.force.numpy()[k, :rows], data.efc_force, atol=FORCE_ERROR * strong
        )
        np.testing.assert_array_equal(found.efc.state.numpy()[k, :rows], data.efc_state)
        np.testing.assert_allclose(
            found.qfrc_constraint.numpy()[k], data.qfrc_constraint, atol=FORCE_ERROR * strong
        )
        momentum = mass @ acceleration
        np.testing.assert_allclose(found.efc.Ma.numpy()[k], momentum, atol=1e-4 * np.abs(momentum).max())
    assert found.solver_niter.numpy().max() < 20


def places_of(arena: tuple, count: int, seed: int, crowd: bool) -> np.ndarray:
    """Return places of robots: of the arena's starts, or all at the first."""
    starts = np.array([start.at for start in arena]) * [1.0, 1.0, 0.0]
    if not crowd:
        return starts[:count]
    return starts[0] + np.random.default_rng(seed).uniform(-0.4, 0.4, (count, 3)) * [1.0, 1.0, 0.0]


@pytest.mark.oracle
@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize(
    ("robots", "crowd"),
    [
        (("P2AT", "P2DX", "P2AT"), False),
        (("P2AT", "P2AT", "P2AT"), True),
        (("P2AT", "Talon", "ERS", "Lisa"), True),
        (("Talon", "Tarantula", "kenaf"), False),
        (("QRIO", "ERS", "AirRobot"), False),
        (("Sedan", "UnitLoader"), True),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, tuple) else "crowd" if value else "apart",
)
def test_accelerations_and_forces_are_those_of_c_mujoco(robots: tuple[str, ...], crowd: bool, cone: str):
    """Robots that drive, fall, climb, stick in each other and in walls, and lie on loose objects."""
    scene = build_scene("yellow", list(robots), Physics(cone=cone))
    model = exact(scene.model)
    places = places_of(scene.arena.starts, len(robots), 0, crowd)
    check(model, [solve_in_c(model, state) for state in random_states(model, places, STATES, seed=0)])


@pytest.mark.oracle
@pytest.mark.parametrize("sparse", [True, False])
@pytest.mark.parametrize(
    ("cone", "condim"), [("elliptic", 1), ("elliptic", 4), ("elliptic", 6), ("pyramidal", 3)]
)
def test_limits_friction_and_equalities_are_those_of_c_mujoco(cone: str, condim: int, sparse: bool):
    model = exact(mujoco.MjModel.from_xml_string(MECHANISM.format(cone=cone, condim=condim)))
    states = random_states(model, np.zeros((0, 3)), 12, seed=0)
    solved = [solve_in_c(model, state) for state in states]
    kinds = {int(kind) for data in solved for kind in data.efc_type}
    assert len(kinds) == 4, "equalities, friction losses, limits, contacts"
    check(model, solved, sparse)


def test_robots_in_touch_are_one_island_and_others_their_own():
    scene = build_scene("yellow", ["P2AT"] * 3)
    model, start = exact(scene.model), np.array(scene.arena.starts[0].at) * [1.0, 1.0, 0.0]
    places = start + np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [5.0, 0.0, 0.0]])
    data = mujoco.MjData(model)
    data.qpos[:] = scattered(model, places, np.random.default_rng(0), gap=0.0)
    mujoco.mj_forward(model, data)
    roots = islands_of(model, [data])[0]
    loose = model.ntree - 3
    assert roots.tolist() == [*range(loose), loose, loose, loose + 2]


SLIDE = """
<mujoco>
  <worldbody>
    <body name="cart" pos="0 0 .1"><joint type="slide" axis="1 0 0"/>
      <geom type="box" size=".2 .2 .1" mass="2"/></body>
    <body name="load" pos="0 0 .299"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
  </worldbody>
</mujoco>
"""
"""A load on a cart, whose rail is at right angles to the normals of the contacts."""


@pytest.mark.oracle
@pytest.mark.parametrize("sparse", [True, False])
def test_friction_alone_makes_an_island_of_what_touches(sparse: bool):
    model = exact(mujoco.MjModel.from_xml_string(SLIDE))
    data = mujoco.MjData(model)
    data.qvel[0] = 1.0
    mujoco.mj_forward(model, data)
    assert abs(data.qacc[0]) > 1.0
    check(model, [data], sparse)


def test_a_batch_finds_what_each_of_its_worlds_finds_alone():
    scene = build_scene("yellow", ["P2AT", "Talon"])
    model = exact(scene.model)
    places = places_of(scene.arena.starts, 2, 1, crowd=True)
    solved = [solve_in_c(model, state) for state in random_states(model, places, 5, seed=2)]
    together = solved_alone(model, solved)
    for k, data in enumerate(solved):
        np.testing.assert_array_equal(solved_alone(model, [data]).qacc.numpy()[0], together.qacc.numpy()[k])


@pytest.mark.oracle
@pytest.mark.parametrize("turn", [1.0, -1.0], ids=["ahead", "spin"])
def test_a_robot_drives_as_on_c_mujoco(turn: float):
    """Within 2 % of the way in 1 s; it is within 0.1 %, as rows are those of C MuJoCo."""
    scene = build_scene("yellow", ["P2AT"])
    model = exact(scene.model)
    qpos = scattered(model, places_of(scene.arena.starts, 1, 0, crowd=False), np.random.default_rng(0))
    names = [model.actuator(a).name for a in range(model.nu)]
    speeds = [1.0 if name.endswith("/hold") else 4.0 if "/Left" in name else 4.0 * turn for name in names]
    ctrl = np.where(["Camera" in name and not name.endswith("/hold") for name in names], 0.0, speeds)
    one, other = (roll_out(model, qpos, ctrl, 200, block) for block in (False, True))
    moved = np.abs(one.qpos - qpos).max()
    assert moved > 0.3
    np.testing.assert_allclose(other.qpos, one.qpos, atol=1e-3 * moved)


@pytest.mark.oracle
def test_what_nobody_drives_gains_no_energy():
    """Robots fall on each other; friction and soft contacts take the energy, as on C MuJoCo."""
    scene = build_scene("yellow", ["P2AT", "P2DX"])
    model = exact(scene.model)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    over = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.5]])
    places = places_of(scene.arena.starts, 1, 0, crowd=False) + over
    qpos = scattered(model, places, np.random.default_rng(3))
    before = roll_out(model, qpos, np.zeros(model.nu), 1, block=False).energy.sum()
    energies = []
    for steps in (40, 80, 120):
        one, other = (
            roll_out(model, qpos, np.zeros(model.nu), steps, block).energy.sum() for block in (False, True)
        )
        energies.append(other)
        assert other - before == pytest.approx(one - before, rel=0.02)
    assert before > energies[0] > energies[1] > energies[2]


ARM = """
<mujoco>
  <option solver="{solver}"/>
  <custom><numeric name="max_contact_points" data="8"/><numeric name="max_geom_pairs" data="8"/></custom>
  <worldbody><body><joint name="j" axis="0 1 0"/><geom size=".1"/></body></worldbody>
  {tendon}
</mujoco>
"""
TENDON = '<tendon><fixed range="-1 1"><joint joint="j" coef="1"/></fixed></tendon>'


def test_what_is_not_covered_is_named_and_left_to_mujoco_warp(caplog: pytest.LogCaptureFixture):
    spec = mujoco.MjSpec.from_string(ARM.format(solver="Newton", tendon=TENDON))
    assert block.why_not(spec.compile()) == "tendons"
    with caplog.at_level(logging.WARNING):
        engine = WarpEngine(spec, Physics(solver="block"), 1)
    assert (engine.solver, engine.uncovered) == ("Newton", "tendons")
    assert "does not cover tendons" in caplog.text


def test_auto_is_this_solver_on_gpus_and_mujoco_warps_cg_elsewhere(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    arm, tied = (mujoco.MjSpec.from_string(ARM.format(solver="CG", tendon=text)) for text in ("", TENDON))
    assert WarpEngine(arm, Physics(), 1).solver == "CG", "on a CPU"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    engine = WarpEngine(arm, Physics(), 1)
    assert (engine.solver, engine.uncovered) == ("block", None)
    with caplog.at_level(logging.INFO):
        engine = WarpEngine(tied, Physics(), 1)
    assert (engine.solver, engine.uncovered) == ("CG", "tendons")
    assert "MuJoCo Warp's CG solves all" in caplog.text


@pytest.mark.parametrize(
    ("cone", "condim", "rows"), [("elliptic", 3, 32_767), ("elliptic", 6, 18_724), ("pyramidal", 6, 65_535)]
)
def test_a_world_may_have_as_many_rows_as_places_in_hessians_have_bits(cone: str, condim: int, rows: int):
    """Contacts of n rows have n (n + 1) / 2 numbers there, a place has 16 bits."""
    model = mujoco.MjModel.from_xml_string(MECHANISM.format(cone=cone, condim=condim))
    assert block.why_not(model, rows) is None
    assert block.why_not(model, rows + 1) == f"room for more than {rows} constraint rows"
    per_contact = condim if cone == "elliptic" else 1
    assert rows // per_contact * (per_contact * (per_contact + 1) // 2) < 1 << 16


def test_what_is_covered_is_solved_by_it():
    scene = build_scene("yellow", ["P2AT"], Physics(solver="block"))
    assert block.why_not(scene.model) is None
    assert scene.model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON, "as engine c has it"
