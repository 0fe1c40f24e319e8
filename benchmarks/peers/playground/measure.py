"""A task of MuJoCo Playground's control suite; worlds have one robot each, so there are more of them."""

import os
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from clock import measure, read_options

options = read_options()
if options.device == "cpu":
    os.environ["JAX_PLATFORMS"] = "cpu"

import jax
from mujoco_playground import registry, wrapper

TRAINED = 2048
"""Worlds of its authors' training, which the registry's room for the contacts of all worlds is made for."""


def main():
    """Measure it."""
    count = options.worlds * options.robots
    defaults = registry.get_default_config(options.variant)
    # MuJoCo Warp leaves out contacts that have no room: the default is 1.5 for each of 65,536 worlds.
    room = math.ceil(defaults.naconmax * max(1, count / TRAINED))
    env = registry.load(options.variant, config_overrides={"naconmax": room})
    episode = defaults.episode_length
    wrapped = wrapper.wrap_for_brax_training(env, episode_length=episode, action_repeat=1)
    state = jax.jit(wrapped.reset)(jax.random.split(jax.random.PRNGKey(options.seed), count))

    def step(carry, _):
        state, key = carry
        key, now = jax.random.split(key)
        actions = jax.random.uniform(now, (count, env.action_size), minval=-1.0, maxval=1.0)
        return (wrapped.step(state, actions), key), None

    @jax.jit
    def run(carry):
        return jax.lax.scan(step, carry, None, options.steps)[0]

    carry = (state, jax.random.PRNGKey(options.seed + 1))
    device = jax.devices()[0].device_kind
    packages = ("playground", "mujoco-mjx", "jax")
    measure(lambda c: jax.block_until_ready(run(c)), carry, options, env.dt, packages, device)


if __name__ == "__main__":
    main()
