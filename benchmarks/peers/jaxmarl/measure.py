"""JaxMARL's `jaxnav` and `MPE_simple_spread_v3`, steps mapped over the worlds in one compiled loop."""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from clock import measure, read_options

options = read_options()
if options.device == "cpu":
    os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import jaxmarl

PERIOD = 0.1
"""Of a step of either [s]."""


def make():
    """Return the environment."""
    if options.variant == "jaxnav":
        return jaxmarl.make("jaxnav", num_agents=options.robots)
    crowd = {"num_agents": options.robots, "num_landmarks": options.robots}
    return jaxmarl.make(options.variant, action_type="Continuous", **crowd)


def main():
    """Measure it."""
    env = make()
    keys = jax.random.split(jax.random.PRNGKey(options.seed), options.worlds)
    _, state = jax.jit(jax.vmap(env.reset))(keys)

    def act(key):
        keys = jax.random.split(key, len(env.agents))
        return {name: env.action_space(name).sample(k) for name, k in zip(env.agents, keys, strict=True)}

    def step(carry, _):
        state, key = carry
        key, of_actions, of_step = jax.random.split(key, 3)
        actions = jax.vmap(act)(jax.random.split(of_actions, options.worlds))
        observations, state, rewards, _, _ = jax.vmap(env.step)(
            jax.random.split(of_step, options.worlds), state, actions
        )
        # Sums, so that nothing of a step can be left out by the compiler.
        return (state, key), sum(x.sum() for x in jax.tree.leaves((observations, rewards)))

    @jax.jit
    def run(carry):
        return jax.lax.scan(step, carry, None, options.steps)

    carry = (state, jax.random.PRNGKey(options.seed + 1))
    device = jax.devices()[0].device_kind
    measure(lambda c: jax.block_until_ready(run(c))[0], carry, options, PERIOD, ("jaxmarl", "jax"), device)


if __name__ == "__main__":
    main()
