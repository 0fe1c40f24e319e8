"""MuJoCo's `rollout` of our own scene on all cores: what the host does without us."""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import mujoco
import numpy as np
from clock import measure, read_options
from mujoco import rollout

FULL = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
PERIOD = 0.05
"""Of a step, which holds its random speeds [s]."""
SPEED = 2.0
"""Most of a wheel [rad/s]."""


def main():
    """Measure it."""
    options = read_options()
    model = mujoco.MjModel.from_binary_path(options.model)
    data = mujoco.MjData(model)
    substeps = max(1, round(PERIOD / model.opt.timestep))
    first = np.zeros(mujoco.mj_stateSize(model, FULL))
    mujoco.mj_getState(model, data, first, FULL)
    draw = np.random.default_rng(options.seed)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    datas = [mujoco.MjData(model) for _ in range(cores)]

    with rollout.Rollout(nthread=cores) as pool:

        def run(state):
            for _ in range(options.steps):
                ctrl = draw.uniform(-SPEED, SPEED, (options.worlds, 1, model.nu))
                state = pool.rollout(model, datas, state, np.repeat(ctrl, substeps, 1))[0][:, -1]
            return state

        start = np.tile(first, (options.worlds, 1))
        measure(run, start, options, PERIOD, ("mujoco",), "host", cores=cores, substeps=substeps)


if __name__ == "__main__":
    main()
