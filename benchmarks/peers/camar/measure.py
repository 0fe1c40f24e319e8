"""CAMAR's random grid of round obstacles, steps mapped over the worlds in one compiled loop."""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from clock import measure, read_options

options = read_options()
if options.device == "cpu":
    os.environ["JAX_PLATFORMS"] = "cpu"

import jax
from camar import camar_v0


def main():
    """Measure it."""
    env = camar_v0(options.variant, map_kwargs={"num_agents": options.robots})
    keys = jax.random.split(jax.random.PRNGKey(options.seed), options.worlds)
    _, state = jax.jit(jax.vmap(env.reset))(keys)
    shape = (options.worlds, options.robots, env.action_size)

    def step(carry, _):
        state, key = carry
        key, of_actions, of_step = jax.random.split(key, 3)
        actions = jax.random.uniform(of_actions, shape, minval=-1.0, maxval=1.0)
        keys = jax.random.split(of_step, options.worlds)
        observations, state, rewards, *_ = jax.vmap(env.step)(keys, state, actions)
        # Sums, so that nothing of a step can be left out by the compiler.
        return (state, key), observations.sum() + rewards.sum()

    @jax.jit
    def run(carry):
        return jax.lax.scan(step, carry, None, options.steps)

    carry = (state, jax.random.PRNGKey(options.seed + 1))
    device = jax.devices()[0].device_kind
    measure(lambda c: jax.block_until_ready(run(c))[0], carry, options, env.step_dt, ("camar", "jax"), device)


if __name__ == "__main__":
    main()
