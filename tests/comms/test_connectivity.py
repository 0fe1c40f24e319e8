"""Who reaches whom: against a search written out in Python, and networks with known answers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usarmjx.comms.links import bottleneck, connected_components, hops, reachable, transitive_closure

N = 7


def network(n, *pairs):
    table = np.zeros((n, n), bool)
    for i, j in pairs:
        table[i, j] = table[j, i] = True
    return table


def search(table, base):
    """Links to each robot by breadth first search; len(table) where no way leads."""
    count, queue = [len(table)] * len(table), [base]
    count[base] = 0
    for robot in queue:
        for other in np.flatnonzero(table[robot]):
            if count[other] == len(table):
                count[other] = count[robot] + 1
                queue.append(other)
    return count


edges = st.lists(st.tuples(st.integers(0, N - 1), st.integers(0, N - 1)), max_size=10)
networks = edges.map(lambda pairs: network(N, *[p for p in pairs if p[0] != p[1]]))


@settings(deadline=None)
@given(networks, st.integers(0, N - 1))
def test_reach_is_that_of_a_search(table: np.ndarray, base: int):
    expected = search(table, base)
    assert hops(table, base).tolist() == expected
    assert reachable(table, base).tolist() == [h < N for h in expected]
    for most in range(4):
        assert reachable(table, base, most).tolist() == [h <= most for h in expected]


@settings(deadline=None)
@given(networks)
def test_components_are_named_by_their_lowest_slot(table: np.ndarray):
    expected = [min(j for j in range(N) if search(table, i)[j] < N) for i in range(N)]
    assert connected_components(table).tolist() == expected
    np.testing.assert_array_equal(transitive_closure(table), np.equal.outer(expected, expected))


def test_the_longest_chain_is_followed():
    for n in (1, 2, 4, 17):
        chain = network(n, *[(i, i + 1) for i in range(n - 1)])
        assert hops(chain, 0).tolist() == list(range(n))
        assert np.asarray(reachable(chain, 0)).all()
        assert np.asarray(reachable(chain, n - 1, n - 1)).all()
        assert connected_components(chain).tolist() == [0] * n
        power = np.where(chain, -50.0 - np.arange(n)[:, None] - np.arange(n), -np.inf).astype(np.float32)
        if n > 1:
            # The links weaken along the chain: to each robot its last one is the weakest.
            expected = [-50.0 - (2 * i - 1) for i in range(1, n)]
            assert np.asarray(bottleneck(power))[0, 1:].tolist() == expected


POWERS = {"rng": np.random.default_rng(4)}


def random_powers(n, holes=0.3):
    rng = POWERS["rng"]
    power = np.triu(rng.uniform(-110, -40, (n, n)), 1).astype(np.float32)
    power[rng.random((n, n)) < holes] = -np.inf
    power = np.triu(power, 1)
    power = power + power.T
    np.fill_diagonal(power, -np.inf)
    return power


@pytest.mark.oracle
def test_bottlenecks_are_the_weakest_links_of_the_best_ways():
    """By trying every cutoff: the bottleneck is the highest at which two robots still reach each other."""
    for n in (2, 3, 6, 9):
        power = random_powers(n)
        best = np.asarray(bottleneck(power))
        np.testing.assert_array_equal(best, best.T)
        for i in range(n):
            for j in range(n):
                if i == j:
                    assert best[i, j] == np.inf
                    continue
                cutoffs = sorted(set(power[np.isfinite(power)].tolist()), reverse=True)
                expected = next((c for c in cutoffs if search(power >= c, i)[j] < n), -np.inf)
                assert best[i, j] == expected


def test_worlds_are_mapped_over_and_may_be_leading_axes():
    tables = np.stack([network(5, (0, 1), (1, 2)), network(5, (3, 4)), network(5)])
    np.testing.assert_array_equal(connected_components(tables), jax.vmap(connected_components)(tables))
    np.testing.assert_array_equal(hops(tables, 3), jax.vmap(lambda t: hops(t, 3))(tables))
    np.testing.assert_array_equal(reachable(tables, 0).sum(-1), [3, 1, 1])
    np.testing.assert_array_equal(reachable(tables, jnp.int32(0), 1).sum(-1), [2, 1, 1])
    powers = np.stack([random_powers(5) for _ in range(3)])
    np.testing.assert_array_equal(bottleneck(powers), jax.vmap(bottleneck)(powers))
