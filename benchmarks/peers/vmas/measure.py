"""VMAS's `navigation`: discs that drive to their goals, with beams to each other or without."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import torch
import vmas
from clock import measure, read_options

BEAMS = "navigation"


def main():
    """Measure it."""
    options = read_options()
    device = "cuda" if options.device == "gpu" else "cpu"
    env = vmas.make_env(
        "navigation",
        num_envs=options.worlds,
        device=device,
        continuous_actions=True,
        seed=options.seed,
        n_agents=options.robots,
        collisions=options.variant == BEAMS,  # what VMAS calls so is contacts and beams at once
    )
    env.reset()

    def run(_):
        for _ in range(options.steps):
            env.step(env.get_random_actions())
        if device == "cuda":
            torch.cuda.synchronize()

    name = torch.cuda.get_device_name() if device == "cuda" else "cpu"
    measure(run, None, options, env.world.dt, ("vmas", "torch"), name)


if __name__ == "__main__":
    main()
