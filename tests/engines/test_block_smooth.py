"""Smooth dynamics beside solver `block`, against MuJoCo Warp's kernels and C MuJoCo."""

import copy
from importlib import import_module
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

import warp as wp

from tests.engines.block_rows import random_states
from tests.engines.gpu_threads import COMPILER, run_struct_as_on_a_gpu
from usarmjx.engines import mjx_warp
from usarmjx.engines.block import advance, smooth
from usarmjx.models.compile.physics import Physics
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

_MUJOCO: Any = mujoco  # more of it than its stubs have
ROUNDING = 2e-6
"""Difference of single precision, relative to the largest number of an array: sums have another order, and
bodies up to five levels below the first ones have products of as many rotations."""
ERROR = 1e-5
"""Likewise, of C MuJoCo's double precision."""
JOINTS = """<mujoco><option timestep="0.01"/><worldbody>
  <body name="held" mocap="true" pos="0 0 2"><geom size="0.1" contype="0" conaffinity="0"/></body>
  <body name="wall" pos="3 0 0" euler="0 0 30"><geom type="box" size="0.1 1 1"/>
    <body pos="0 1 0"><joint type="hinge" axis="0 0 1" pos="0 -0.5 0" stiffness="3 2 1" springref="20"/>
      <geom type="box" size="0.1 0.5 1" pos="0 0.5 0"/></body></body>
  <body name="loose" pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.2 0.3" pos="0.05 0 0"/></body>
  <body name="robot" pos="1 0 1" euler="10 20 30"><joint type="free" damping="0.2"/>
    <geom type="box" size="0.3 0.2 0.1"/>
    <body pos="0.3 0 0.1" euler="0 0 40"><joint name="slide" type="slide" axis="1 1 0" damping="2"/>
      <joint name="turn" type="hinge" axis="0 1 0" pos="0.1 0 0" damping="0.4 0.3 0.2" armature="0.1"/>
      <geom type="capsule" size="0.05 0.2" pos="0 0 0.2"/>
      <body pos="0 0 0.4"><joint type="ball" pos="0 0 -0.1" damping="0.1"/><geom size="0.1" pos="0.1 0.05 0"/>
        <body pos="0.2 0 0"><joint name="tip" type="hinge" axis="1 0 1" actuatorfrcrange="-0.5 0.5"
          actuatorfrclimited="true"/><geom size="0.07" pos="0 0.1 0"/></body></body></body></body>
</worldbody><actuator>
  <position joint="slide" kp="20" kv="1" ctrlrange="-0.3 0.3"/>
  <general joint="turn" dyntype="filter" dynprm="0.2" gainprm="3" gear="2" forcerange="-1 1"/>
  <general joint="turn" dyntype="integrator" gaintype="affine" gainprm="1 2 3" biastype="affine"
    biasprm="1 2 3"/>
  <motor joint="tip" gear="-4"/>
  <general joint="tip" dyntype="filterexact" dynprm="0.1"/>
</actuator></mujoco>"""
CASES = ("joints", "P2AT P2DX", "Kenaf Talon", "Hummer ERS P2AT")
"""Models: one of all kinds of joints, and rosters in `yellow`."""
GIVEN = ["qpos", "qvel", "act", "ctrl", "xfrc_applied", "qfrc_applied", "mocap_pos", "mocap_quat"]
FOUND = [name for names in smooth.DATA_KINDS for name in names.split() if name not in GIVEN]


def model_of(case: str) -> mujoco.MjModel:
    """Return the model of a case."""
    if case == "joints":
        return mujoco.MjModel.from_xml_string(JOINTS)
    return build_scene("yellow", case.split(), Physics(solver="block")).model


def states_of(case: str, model: Any) -> dict[str, np.ndarray]:
    """Return random states of four worlds and what acts on them, by field."""
    rng, worlds = np.random.default_rng(3), 4
    if case == "joints":
        qpos = np.tile(model.qpos0, (worlds, 1)) + rng.normal(size=(worlds, model.nq))
    else:
        robots = len(case.split())
        qpos = np.array([qpos for qpos, *_ in random_states(model, np.zeros((robots, 3)), worlds, seed=2)])
    sizes = {"qvel": model.nv, "act": model.na, "ctrl": model.nu, "qfrc_applied": model.nv}
    given = {name: rng.normal(size=(len(qpos), size)) for name, size in sizes.items()}
    given["xfrc_applied"] = rng.normal(size=(len(qpos), model.nbody, 6))
    given["mocap_pos"] = rng.normal(size=(len(qpos), model.nmocap, 3))
    turn = rng.normal(size=(len(qpos), model.nmocap, 4))
    given["mocap_quat"] = turn / np.linalg.norm(turn, axis=-1, keepdims=True)
    return {"qpos": qpos, **given}


def worlds_of(case: str, model: mujoco.MjModel) -> tuple[Any, Any]:
    """Return MuJoCo Warp's model and data of random states; masses differ between worlds."""
    mjw, states = import_module("mujoco.mjx.third_party.mujoco_warp"), states_of(case, model)
    m, d = mjw.put_model(model), mjw.make_data(model, nworld=len(states["qpos"]))
    for name, value in states.items():
        if value.size:
            getattr(d, name).assign(value.astype(np.float32))
    for name in ("body_mass", "body_subtreemass"):  # both the same way: centres of mass stay
        masses = getattr(m, name).numpy()[:1]
        setattr(m, name, wp.array(np.concatenate([masses, 1.5 * masses]), dtype=float))
    return m, d


def by_stages(m: Any, d: Any) -> dict[str, np.ndarray]:
    """Return what MuJoCo Warp's kernels find, by field."""
    forward = import_module("mujoco.mjx.third_party.mujoco_warp._src.forward")
    forward.smooth.kinematics(m, d)
    forward.smooth.com_pos(m, d)
    forward.smooth.crb(m, d)
    forward.smooth.transmission(m, d)
    forward.fwd_velocity(m, d)
    forward.fwd_actuation(m, d)
    forward.fwd_acceleration(m, d, factorize=True)
    return found_in(d)


def found_in(d: Any) -> dict[str, np.ndarray]:
    """Return what is found, by field; nothing of the world's body is."""
    found = {name: getattr(d, name).numpy().copy() for name in FOUND}
    bodies = ("subtree_com", "cvel", "xpos", "xquat", "xmat", "xipos", "ximat")
    return found | {name: found[name][:, 1:] for name in bodies}


def emptied(d: Any, static: np.ndarray) -> None:
    """Fill what is to be found with numbers that are wrong; poses of static geoms are known."""
    for name in FOUND:
        array = getattr(d, name)
        value = array.numpy().copy()
        kept = value[:, static].copy() if name.startswith("geom") else None
        value[:] = 9.0
        if kept is not None:
            value[:, static] = kept
        if value.size:
            array.assign(value)


def same(found: dict[str, np.ndarray], right: dict[str, np.ndarray]) -> None:
    """Assert that two findings are the same but for rounding."""
    for name, value in right.items():
        if value.size:
            most = ROUNDING * max(1.0, np.abs(value).max())
            np.testing.assert_allclose(found[name], value, rtol=0, atol=most, err_msg=name)


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[str, mujoco.MjModel]:
    """Return the name of a model, and the model."""
    return request.param, model_of(request.param)


@pytest.mark.oracle
@pytest.mark.parametrize("bodies", [128, 4])
def test_all_stages_find_what_those_of_mujoco_warp_find(case: tuple[str, mujoco.MjModel], bodies: int):
    """Numbers of each array are the same; chunks are the world, or parts of it."""
    name, model = case
    m, d = worlds_of(name, model)
    right = by_stages(m, d)
    assert smooth.why_not(model) is None
    emptied(d, ~smooth.make_tables(model, bodies).geom[:, 1].astype(bool))
    smooth.SmoothDynamics(model, bodies=bodies)(m, d)
    same(found_in(d), right)


@pytest.mark.oracle
def test_forces_and_mass_matrix_are_those_of_c_mujoco(case: tuple[str, mujoco.MjModel]):
    name, model = case
    mjw, states = import_module("mujoco.mjx.third_party.mujoco_warp"), states_of(name, model)
    m, d = mjw.put_model(model), mjw.make_data(model, nworld=len(states["qpos"]))
    for field, value in states.items():
        if value.size:
            getattr(d, field).assign(value.astype(np.float32))
    smooth.SmoothDynamics(model)(m, d)
    for world in range(d.nworld):
        data: Any = mujoco.MjData(model)
        for field, value in states.items():
            getattr(data, field)[:] = value[world]
        _MUJOCO.mj_fwdPosition(model, data)
        _MUJOCO.mj_fwdVelocity(model, data)
        _MUJOCO.mj_fwdActuation(model, data)
        _MUJOCO.mj_fwdAcceleration(model, data)
        for field in ("M", "qfrc_smooth", "qfrc_actuator", "qfrc_passive", "cvel", "geom_xpos", "act_dot"):
            right, found = getattr(data, field), getattr(d, field).numpy()[world]
            most = ERROR * max(1.0, np.abs(right).max(initial=0.0))
            np.testing.assert_allclose(found, right, rtol=0, atol=most, err_msg=field)


@pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")
@pytest.mark.parametrize(("case", "bodies", "threads"), [("joints", 128, 32), ("P2AT P2DX", 8, 64)])
def test_threads_of_a_gpu_find_what_one_alone_finds(case: str, bodies: int, threads: int):
    model = model_of(case)
    m, d = worlds_of(case, model)
    dynamics = smooth.SmoothDynamics(model, bodies=bodies)
    dynamics(m, d)
    right = found_in(d)
    emptied(d, ~smooth.make_tables(model, bodies).geom[:, 1].astype(bool))
    problem, fields = dynamics.problem(m, d), {}
    for name in smooth.problem_type().vars:
        value = getattr(problem, name)
        fields[name] = value.numpy().copy() if hasattr(value, "numpy") else int(value)
    chunks, numbers = fields["chunks"], smooth.numbers_of(smooth.make_tables(model, bodies), threads)
    code = smooth.smooth_code_of(numbers, threads)
    run_struct_as_on_a_gpu(code, fields, d.nworld * chunks * threads, threads)
    world_too = {name: fields[name] for name in FOUND}
    same({name: value[:, -right[name].shape[1] :] for name, value in world_too.items()}, right)


def moving(case: str, model: mujoco.MjModel, seed: int = 5) -> tuple[Any, Any, np.ndarray]:
    """Return model and data whose forces give random accelerations, and these; masses are C MuJoCo's."""
    mjw, states = import_module("mujoco.mjx.third_party.mujoco_warp"), states_of(case, model)
    m, d = mjw.put_model(model), mjw.make_data(model, nworld=len(states["qpos"]))
    rng, right = np.random.default_rng(seed), []
    for field, value in states.items():
        if value.size:
            getattr(d, field).assign(value.astype(np.float32))
    smooth.SmoothDynamics(model)(m, d)
    wanted = rng.normal(size=(d.nworld, model.nv))
    for world in range(d.nworld):
        data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
        data.qpos[:], data.qvel[:] = states["qpos"][world], states["qvel"][world]
        data.mocap_pos[:], data.mocap_quat[:] = states["mocap_pos"][world], states["mocap_quat"][world]
        _MUJOCO.mj_fwdPosition(model, data)
        _MUJOCO.mj_fullM(model, data, mass)
        speed, poly = np.abs(data.qvel), _any(model).dof_dampingpoly
        slope = _any(model).dof_damping + 2 * poly[:, 0] * speed + 3 * poly[:, 1] * speed**2
        damped = mass + model.opt.timestep * np.diag(slope)
        right.append(damped @ wanted[world])
    d.efc.Ma.assign(np.array(right, np.float32))
    d.qacc.assign(wanted.astype(np.float32))
    return m, d, wanted


def _any(model: mujoco.MjModel) -> Any:
    return model


STEPPED = ("qpos", "qvel", "act", "time", "qacc_warmstart")


@pytest.mark.oracle
@pytest.mark.parametrize("case", ["joints", "P2AT P2DX"])
def test_steps_end_as_those_of_mujoco_warp(case: str):
    """Velocities grow by the accelerations that the forces were made of."""
    forward, model = import_module("mujoco.mjx.third_party.mujoco_warp._src.forward"), model_of(case)
    m, d, wanted = moving(case, model)
    before = d.qvel.numpy().copy()
    forward.euler(m, d)
    right = {name: getattr(d, name).numpy().copy() for name in STEPPED}
    m, d, _ = moving(case, model)
    assert advance.fits(model)
    advance.Advance(model)(m, d)
    most = ERROR * max(1.0, np.abs(before).max())
    np.testing.assert_allclose(d.qvel.numpy(), before + model.opt.timestep * wanted, rtol=0, atol=most)
    for name, value in right.items():
        if value.size:
            most = ERROR * max(1.0, np.abs(value).max())
            np.testing.assert_allclose(getattr(d, name).numpy(), value, rtol=0, atol=most, err_msg=name)
    assert np.abs(d.qpos.numpy() - states_of(case, model)["qpos"]).max() > 1e-3


@pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")
def test_threads_of_a_gpu_end_steps_as_one_alone_does():
    model = model_of("joints")
    (m, d, _), (_, other, _) = (moving("joints", model) for _ in range(2))
    end = advance.Advance(model)
    problems = [end.problem(m, other, size) for size in end._tables]
    end(m, d)
    for size, problem in zip(end._tables, problems, strict=True):
        fields = {}
        for name in advance.problem_type().vars:
            value = getattr(problem, name)
            fields[name] = value.numpy().copy() if hasattr(value, "numpy") else int(value)
        dim = d.nworld * len(fields["starts"])
        run_struct_as_on_a_gpu(advance.code_of(size), fields, dim, 32)
        for name in ("qpos", "qvel", "act"):
            getattr(other, name).assign(fields[name])
    same(
        {name: getattr(other, name).numpy() for name in STEPPED[:3]},
        {name: getattr(d, name).numpy() for name in STEPPED[:3]},
    )


def test_large_trees_and_explicit_damping_are_left_to_mujoco_warp():
    assert not advance.fits(model_of("Kenaf Talon"))
    model = model_of("joints")
    model.opt.disableflags |= int(_MUJOCO.mjtDisableBit.mjDSBL_EULERDAMP)
    assert not advance.fits(model)
    assert smooth.SmoothDynamics(model).advance is None


def test_what_is_not_covered_is_named():
    """Each change of the model is one that MuJoCo Warp's kernels take."""
    model = model_of("joints")
    changes = {
        "gravity compensation": ("body_gravcomp", 1.0),
        "springs of free or ball joints": ("jnt_stiffness", 1.0),
        "actuators of other kinds": ("actuator_gaintype", int(_MUJOCO.mjtGain.mjGAIN_MUSCLE)),
        "actuators of free or ball joints": ("actuator_trnid", 1),
    }
    for name, (field, value) in changes.items():
        changed = copy.copy(model)
        getattr(changed, field)[:] = value
        assert smooth.why_not(changed) == name
    changed = copy.copy(model)
    changed.opt.density = 1.0
    assert smooth.why_not(changed) == "a fluid"


@pytest.mark.parametrize("gravcomp", [0.0, 1.0])
def test_engines_use_it_where_it_covers_the_scene(gravcomp: float, monkeypatch: pytest.MonkeyPatch):
    chosen: list[Any] = []
    monkeypatch.setattr(mjx_warp, "_step_by_blocks", lambda *args: chosen.append(args[2]))
    engine: Any = Batch(build_scene("yellow", ["P2AT"], Physics(solver="block")), 1, engine="warp").engine
    engine.model.body_gravcomp[1] = gravcomp
    engine._step_and_count()
    assert [type(smooth_dynamics) for smooth_dynamics in chosen] == [
        type(None) if gravcomp else smooth.SmoothDynamics
    ]
