"""Speed of solver `block` by the size classes of its islands, and of the kernels of a physics step, on a GPU.

python -m benchmarks.islands.speed physics --worlds 4096 --robots 16 --out block.jsonl
python -m benchmarks.islands.speed whole --worlds 4096 --robots 16 --solvers registers,CG --out block.jsonl

`physics` launches Warp's kernels without JAX, with each of `solver.VARIANTS` in turn: from the same state,
under the same random controls; a variant `+mixed` has pairs of the convex collider among all others, one
`+tiles` MuJoCo Warp's solution of the mass matrix, one `+gravcomp` its kernel of gravity compensation, one
`+stages` its kernels of smooth dynamics, one `+chunks-32-64` chunks of 32 bodies by 64 threads, and one
`+beside` launches on several streams, as far as they do not need each other. `whole` takes the whole step
with all sensors, as `bench step` does; its solvers may be `+beside`, too. Several of these compile beside
each other, and measure one after another, if they are given the same `--lock`.
"""

import argparse
import fcntl
import json
import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from usarmjx.engines.block import branches, broad_phase, islands, solver, trees
from usarmjx.engines.block.smooth import SmoothDynamics
from usarmjx.engines.mjx_warp import _step_by_blocks

MUJOCO_WARP = "mujoco.mjx.third_party.mujoco_warp"
"""Private; the version of MJX is pinned."""
CONTROL_STEPS = 10
"""Physics steps of a control step of 50 ms."""


def tell(out: Path | None, **figures: object) -> None:
    """Print a line, and append it to a file."""
    line = json.dumps(figures)
    print(line, flush=True)
    if out is not None:
        with out.open("a", encoding="utf-8") as file:
            file.write(line + "\n")


@contextmanager
def alone(lock: Path | None) -> Iterator[None]:
    """Hold a lock, so that nothing else is measured meanwhile."""
    if lock is None:
        yield
        return
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


class PhysicsWorlds:
    """Worlds of P2AT in `yellow` on Warp alone, whose steps have solver `block`.

    Args:
        worlds: Number.
        robots: Of each world.
        device: Warp's.
    """

    def __init__(self, worlds: int, robots: int, device: Any) -> None:  # noqa: ANN401 - Warp's
        from benchmarks.scenes import start_qpos
        from usarmjx.engines.block.broad_phase import BroadPhase, make_table
        from usarmjx.engines.mjx_warp import convex_contact_budget
        from usarmjx.models.compile.physics import Physics
        from usarmjx.sim.scene import build_scene

        physics = Physics(solver="block")
        scene = build_scene("yellow", ["P2AT"] * robots, physics)
        model: Any = scene.model  # more of MuJoCo than its stubs have
        warp = import_module(MUJOCO_WARP)
        model.opt.solver = 1  # as the engine has it: MuJoCo Warp then lists no rows for Newton's method
        self.m, contacts = warp.put_model(model), int(model.numeric("max_contact_points").data[0])
        self.m.opt.warn_overflow = False
        pairs, own = self.m.nxn_geom_pair_filtered.numpy(), self.m.nxn_pairid_filtered.numpy()
        self.d = warp.make_data(
            model,
            nworld=worlds,
            naconmax=worlds * contacts,
            naccdmax=worlds * convex_contact_budget(model, pairs, contacts),
            njmax=3 * physics.rows_per_contact * contacts,
        )
        self.d.qpos.assign(np.tile(start_qpos(scene).astype(np.float32), (worlds, 1)))
        rng, nu = np.random.default_rng(0), model.nu
        top = np.where(model.actuator_biastype == 0, 3.0, 0.0)
        self.controls = [
            wp.array((rng.uniform(-1.0, 1.0, (worlds, nu)) * top).astype(np.float32), device=device)
            for _ in range(8)
        ]
        table, self._model = make_table(model, pairs, (own >= 0).any(1)), model
        self._broad_phases = {}
        for apart in (False, True):  # the last is the usual one
            broad_phase.CONVEX_APART = apart
            self._broad_phases[apart] = BroadPhase(table, device)
        self._most_size = trees.MOST_SIZE
        self.device, self.worlds, self.robots = device, worlds, robots
        names = ("qpos", "qvel", "qacc_warmstart", "time", "act")
        self._state = {name: value for name in names if (value := getattr(self.d, name)).size}
        self._kept: dict[str, Any] = {}
        self.choose("objects")

    def choose(self, variant: str) -> None:
        """Choose the variant of the steps from now on."""
        name, *other = variant.split("+")
        solver.CLASSES = solver.VARIANTS[name]
        trees.MOST_SIZE = 0 if "tiles" in other else self._most_size
        sizes = [map(int, one.split("-")[1:]) for one in other if one.startswith("chunks-")]
        gravcomp, smooth_dynamics = "gravcomp" in other, None
        if not gravcomp and "stages" not in other:
            smooth_dynamics = SmoothDynamics(self._model, self.device, *(sizes[0] if sizes else ()))
        near = self._broad_phases["mixed" not in other]
        self._step = _step_by_blocks(near, gravcomp, smooth_dynamics)
        branches.BESIDE = "beside" in other

    def step(self) -> None:
        """Launch the kernels of a physics step."""
        self._step(self.m, self.d)

    def control(self, k: int) -> None:
        """Set the controls of a control step."""
        wp.copy(self.d.ctrl, self.controls[k % len(self.controls)])

    def keep(self) -> None:
        """Keep the state."""
        self._kept = {name: wp.clone(value) for name, value in self._state.items()}

    def restore(self) -> None:
        """Go back to the state that was kept."""
        for name, value in self._kept.items():
            wp.copy(self._state[name], value)

    def time(self, steps: int) -> float:
        """Return the time of a physics step, as a CUDA graph if there is a GPU [s]."""
        graph = None
        if self.device.is_cuda:
            with wp.ScopedCapture(device=self.device, force_module_load=False) as capture:
                self.step()
            graph = capture.graph
        times = []
        for _ in range(3 if self.device.is_cuda else 1):
            self.restore()
            wp.synchronize_device(self.device)
            began = time.perf_counter()
            for k in range(steps):
                if k % CONTROL_STEPS == 0:
                    self.control(k // CONTROL_STEPS)
                if graph is None:
                    self.step()
                else:
                    wp.capture_launch(graph)
            wp.synchronize_device(self.device)
            times.append((time.perf_counter() - began) / steps)
        return min(times)  # others may compile, and run what they compiled, meanwhile

    def kernels(self, count: int = 3) -> list[dict[str, Any]]:
        """Return the times of the kernels of a step in their order, mean of some steps; none on a CPU."""
        if not self.device.is_cuda:
            return []
        self.restore()
        wp.timing_begin(cuda_filter=wp.TIMING_ALL)
        for _ in range(count):
            self.step()
        found = wp.timing_end()
        each = len(found) // count
        rows = [
            {
                "name": found[k].name[:70],
                "ms": statistics.mean(found[k + i * each].elapsed for i in range(count)),
            }
            for k in range(each)
        ]
        return sorted(rows, key=lambda row: -row["ms"])


def compile_classes(names: Sequence[str], device: Any) -> None:  # noqa: ANN401 - Warp's
    """Compile the solver's kernels beside each other."""
    by_block: dict[int, list[Any]] = {}
    for classes in {solver.VARIANTS[name.partition("+")[0]] for name in names}:
        by_block.setdefault(islands.THREADS, []).append(solver.islands_kernel(classes).module)
        for which, one in enumerate(classes):
            by_block.setdefault(one.block, []).append(solver.newton_kernel(one, which).module)
    for block, modules in by_block.items():
        wp.force_load(device, modules, block_dim=block, max_workers=8)


def measure_physics(args: argparse.Namespace) -> None:
    """Measure the step and its kernels with each variant."""
    wp.init()
    device = wp.get_preferred_device()
    compile_classes(args.variants, device)
    with wp.ScopedDevice(device):
        if args.first_worlds:
            PhysicsWorlds(args.first_worlds, args.robots, device).step()
        with alone(args.lock):
            worlds = PhysicsWorlds(args.worlds, args.robots, device)
            case = {"worlds": args.worlds, "robots": args.robots}
            for k in range(args.steps):
                if k % CONTROL_STEPS == 0:
                    worlds.control(k // CONTROL_STEPS)
                worlds.step()
            worlds.keep()
            first = None
            for name in args.variants:
                worlds.choose(name)
                worlds.restore()
                worlds.step()
                now = worlds.d.qacc.numpy().copy()  # on a CPU, NumPy sees the array itself
                first = now if first is None else first
                off = np.abs(now - first).max() / np.abs(first).max()
                took = worlds.time(args.steps)
                rate = args.worlds * args.robots / took
                iterations = worlds.d.solver_niter.numpy()
                rows = float(worlds.d.nefc.numpy().mean())
                figures = {"ms": 1e3 * took, "robot_steps_per_s": rate, "rows": rows, "off": float(off)}
                niter = {"most": int(iterations.max()), "mean_of_worlds": float(iterations.mean())}
                tell(args.out, what="physics", variant=name, **case, **figures, iterations=niter)
            for name in args.profiled or args.variants[-1:]:
                worlds.choose(name)
                kernels = worlds.kernels()
                total = sum(row["ms"] for row in kernels)
                tell(args.out, what="kernels", variant=name, **case, ms=total, top=kernels[:40])


def measure_whole(args: argparse.Namespace) -> None:
    """Measure the whole step with all sensors with variants of solver `block`, or other solvers."""
    import jax

    from benchmarks.cases import StepCase
    from benchmarks.scenes import batch_of, repeat_loop, scene_of, whole_step

    for variant in args.solvers:
        name, *other = variant.split("+")
        branches.BESIDE = "beside" in other
        if name in solver.VARIANTS:
            solver.CLASSES = solver.VARIANTS[name]
        case = StepCase(
            roster=f"P2AT:{args.robots}",
            worlds=args.worlds,
            engine="warp",
            solver="block" if name in solver.VARIANTS else name,
        )
        scene = scene_of(case)
        batch, control_steps = batch_of(case, scene), max(1, args.steps // CONTROL_STEPS)
        loop = repeat_loop(batch, whole_step(batch, jax.random.key(1)), control_steps)
        began = time.perf_counter()
        state = jax.block_until_ready(loop(batch.reset()))
        first, times = time.perf_counter() - began, []
        with alone(args.lock):
            for _ in range(args.repeats):
                began = time.perf_counter()
                state = jax.block_until_ready(loop(state))
                times.append(time.perf_counter() - began)
        took = statistics.median(times) / (control_steps * scene.physics.substeps)
        robots = args.worlds * args.robots * scene.physics.timestep / took
        solved = batch.engine.solved(state.physics)
        contacts = None if solved is None else float(np.asarray(solved.contacts).mean()) / args.robots
        figures = {"ms": 1e3 * took, "robots_in_real_time": robots, "contacts_of_a_robot": contacts}
        case_of = {"worlds": args.worlds, "robots": args.robots}
        tell(args.out, what="whole", solver=variant, **case_of, **figures, times_s=times, first_s=first)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)

    def names(text: str) -> list[str]:
        return [name for name in text.split(",") if name]

    parser.add_argument("what", choices=["physics", "whole"])
    parser.add_argument("--worlds", type=int, default=4096)
    parser.add_argument("--robots", type=int, default=16)
    parser.add_argument(
        "--steps", type=int, default=200, help="physics steps, before and in each measurement"
    )
    parser.add_argument("--repeats", type=int, default=3, help="of the steps of `whole`")
    parser.add_argument("--variants", type=names, default=list(solver.VARIANTS))
    parser.add_argument("--profiled", type=names, default=[], help="variants whose kernels are timed")
    parser.add_argument("--solvers", type=names, default=["registers", "CG"], help="variants, or solvers")
    parser.add_argument("--first-worlds", type=int, default=0, help="worlds of a step that compiles kernels")
    parser.add_argument("--lock", type=Path, help="file")
    parser.add_argument("--out", type=Path, help="file to which lines are appended")
    args = parser.parse_args(arguments)
    (measure_physics if args.what == "physics" else measure_whole)(args)


if __name__ == "__main__":
    main()
