"""What a GPU keeps: the same numbers and slopes, in arrays that XLA leaves as they are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base.compilation import materialize, unroll_on_gpu


@pytest.mark.parametrize("where", ["cpu", "gpu"])
def test_what_is_kept_has_the_same_numbers_and_slopes(where, monkeypatch):
    """Also in many worlds at once; there is a barrier on a GPU and none on a CPU."""
    monkeypatch.setattr("jax.default_backend", lambda: where)

    def total(x):  # here, as JAX keeps what a function has been traced to
        kept = materialize({"sine": jnp.sin(x), "above": x > 0.5})
        return (kept["sine"] * jnp.where(kept["above"], 2.0, 1.0)).sum()

    x = jnp.linspace(0.0, 1.0, 12).reshape(4, 3)
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(total)))(x)
    factor = np.where(np.asarray(x) > 0.5, 2.0, 1.0)
    np.testing.assert_allclose(value, (np.sin(x) * factor).sum(-1), rtol=1e-6)
    np.testing.assert_allclose(slope, np.cos(x) * factor, rtol=1e-6)
    text = jax.jit(total).lower(x).as_text()
    assert ("optimization_barrier" in text) == (where == "gpu")


@pytest.mark.parametrize("where", ["cpu", "gpu"])
def test_a_small_loop_is_unrolled_on_a_gpu(where, monkeypatch):
    """The sum is the same; a GPU has no loop left."""
    monkeypatch.setattr("jax.default_backend", lambda: where)

    def total(x):
        return jax.lax.scan(lambda so_far, one: (so_far + one, None), 0.0, x, unroll=unroll_on_gpu(12))[0]

    x = jnp.arange(12.0)
    assert total(x) == 66.0
    assert ("while" in jax.jit(total).lower(x).as_text()) == (where == "cpu")
