"""How fast a step is: bare physics and the whole step of the same model, in one run.

Bare is the engine alone under constant inputs (MJX's step mapped over the worlds, or `mj_step`); the
whole step adds random commands, control, bookkeeping, all sensors, and resets of some worlds. Rates
count robots times physics steps.
"""

import json
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.batch import Batch, State
from usarmjx.control import wheel_speeds
from usarmjx.engines import Inputs, choose_engine
from usarmjx.engines.c import c_model
from usarmjx.models.compose import Physics
from usarmjx.scene import Scene, build_scene

RESET_SHARE = 0.01
"""Share of worlds that start again at each control step of the whole step."""
BASELINE_STEPS = 400


@dataclass(frozen=True, kw_only=True)
class Case:
    """What to measure; `steps` control steps of `substeps` physics steps, `repeats` times."""

    worlds: int
    robots: int
    robot: str = "P2AT"
    arena: str = "yellow"
    engine: str = "auto"
    substeps: int = 10
    steps: int = 20
    repeats: int = 5
    seed: int = 0


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in ("jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "usarmjx"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _commit() -> str:
    here = Path(__file__).parent
    try:
        asked = ["git", "-C", str(here), "rev-parse", "--short", "HEAD"]
        return subprocess.run(asked, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def _timed(run: Callable[[Any], Any], state: Any, repeats: int) -> tuple[float, list[float], Any]:  # noqa: ANN401
    """Return the first call's time (with compilation), the later ones', and the last state [s]."""
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        state = jax.block_until_ready(run(state))
        times.append(time.perf_counter() - began)
    return times[0], times[1:], state


def _loop(batch: Batch, body: Callable[[jax.Array, Any], Any], steps: int) -> Callable[[Any], Any]:
    """Repeat `body`, inside one compiled function where the engine allows."""
    if batch.engine.traceable:
        return jax.jit(lambda state: jax.lax.fori_loop(0, steps, body, state))

    def run(state: Any) -> Any:  # noqa: ANN401
        for i in range(steps):
            state = body(jnp.int32(i), state)
        return state

    return run


def _bare_inputs(batch: Batch, speeds: jax.Array) -> Inputs:
    scene, worlds = batch.scene, batch.worlds
    model = scene.model
    return Inputs(
        ctrl=speeds,
        act=jnp.zeros((worlds, model.na)),
        xfrc_applied=jnp.zeros((worlds, model.nbody, 6)),
        pinned=jnp.zeros((worlds, model.nq), bool),
        pinned_dof=jnp.zeros((worlds, model.nv), bool),
        qpos=jnp.zeros((worlds, model.nq)),
    )


def _random_speeds(batch: Batch, key: jax.Array) -> tuple[jax.Array, jax.Array]:
    team = batch.scene.teams[0]
    top = team.robot.drive.max_speed
    shape = (2, batch.worlds, len(team.slots))
    left, right = jax.random.uniform(key, shape, minval=-top, maxval=top)
    return left, right


def _bare(batch: Batch, key: jax.Array) -> Callable[[jax.Array, Any], Any]:
    """The engine alone: new random wheel speeds each control step, servo targets kept near the wheels."""
    team = batch.scene.teams[0]
    wheels = len(team.robot.wheels)

    def body(i: jax.Array, physics: Any) -> Any:  # noqa: ANN401
        left, right = _random_speeds(batch, jax.random.fold_in(key, i))
        ctrl = (
            jnp.zeros((batch.worlds, batch.scene.model.nu))
            .at[:, team.actuator[:, :wheels]]
            .set(wheel_speeds(team.robot, left, right))
        )
        now = batch.engine.state(physics)
        act = now.act.at[:, team.actuator].set(now.qpos[:, team.qpos])
        return batch.engine.advance(physics, _bare_inputs(batch, ctrl).replace(act=act))

    return body


def _whole(batch: Batch, key: jax.Array) -> Callable[[jax.Array, State], State]:
    def body(i: jax.Array, state: State) -> State:
        now = jax.random.fold_in(key, i)
        state = batch.drive(state, 0, *_random_speeds(batch, now))
        state = batch.step(state)
        state, _ = batch.observe(state)
        again = jax.random.uniform(jax.random.fold_in(now, 1), (batch.worlds,)) < RESET_SHARE
        return batch.reset_where(state, again)

    return body


def _baseline(scene: Scene, speeds: np.ndarray) -> float:
    """Robot-steps per second of plain `mj_step` on one CPU core, one world."""
    model = c_model(scene.model)
    data = mujoco.MjData(model)
    for slot, start in enumerate(scene.arena.starts[: scene.robots]):
        address = scene.teams[0].root_qpos[slot]
        data.qpos[address[:3]] = (*start.at[:2], scene.arena.floor + scene.teams[0].plan.clearance)
    data.ctrl[: speeds.size] = speeds
    mujoco.mj_step(model, data, nstep=BASELINE_STEPS // 4)
    began = time.perf_counter()
    mujoco.mj_step(model, data, nstep=BASELINE_STEPS)
    return BASELINE_STEPS * scene.robots / (time.perf_counter() - began)


def measure(case: Case, file: Path | None = None) -> str:
    """Run a case, append its record to `file` as a JSON line, and return a summary for people.

    Raises:
        EngineError: A contact buffer overflowed, so the figures would be wrong.
    """
    engine = choose_engine(case.engine, "train")
    scene = build_scene(case.arena, [case.robot] * case.robots, Physics(substeps=case.substeps))
    batch = Batch(scene, case.worlds, engine=engine, seed=case.seed, shuffle=True)
    key = jax.random.key(case.seed + 1)
    state = batch.reset()
    run = partial(_timed, repeats=case.repeats)
    bare_first, bare, _ = run(_loop(batch, _bare(batch, key), case.steps), state.physics)
    whole_first, whole, state = run(_loop(batch, _whole(batch, key), case.steps), state)
    batch.check(state)
    work = case.worlds * case.robots * case.substeps * case.steps
    status = jax.tree.map(lambda count: int(count.sum()), vars(state.worlds.status))
    rays = sum(case.robots * sum(team.suite.ray_counts) for team in scene.teams)
    bare_rate, whole_rate = work / statistics.median(bare), work / statistics.median(whole)
    device = jax.devices()[0].device_kind if engine != "c" else platform.processor() or platform.machine()
    record = {
        "benchmark": "step",
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "device": device,
        "commit": _commit(),
        "versions": _versions(),
        "case": {**asdict(case), "engine": engine},
        "timestep": scene.physics.timestep,
        "in_the_step": "contacts, random wheel speeds, control, all sensors of the class every control step, "
        f"resets of {RESET_SHARE:.0%} of worlds every control step; no radio, no rendering",
        "rays_per_control_step": rays * case.worlds,
        "bare_robot_steps_per_s": bare_rate,
        "robot_steps_per_s": whole_rate,
        "whole_to_bare": whole_rate / bare_rate,
        "bare_times_s": bare,
        "whole_times_s": whole,
        "compile_s": {"bare": bare_first - bare[0], "whole": whole_first - whole[0]},
        "cpu_mujoco_robot_steps_per_s": _baseline(scene, np.full(scene.model.nu, 1.0)),
        "faults": status,
    }
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("a") as lines:
            lines.write(json.dumps(record) + "\n")
    return _summary(record)


def _summary(record: dict[str, Any]) -> str:
    case = record["case"]
    return "\n".join(
        [
            f"{case['worlds']} worlds x {case['robots']} {case['robot']}, "
            f"engine {case['engine']} on {record['device']}",
            f"bare physics  {record['bare_robot_steps_per_s']:12,.0f} robot-steps/s",
            f"whole step    {record['robot_steps_per_s']:12,.0f} robot-steps/s  ({record['in_the_step']})",
            f"ratio         {record['whole_to_bare']:12.2f}",
            f"mj_step       {record['cpu_mujoco_robot_steps_per_s']:12,.0f} robot-steps/s, bare, one core",
            f"compile [s]   bare {record['compile_s']['bare']:.1f}, whole {record['compile_s']['whole']:.1f}",
            f"faults        {record['faults']}",
        ]
    )
