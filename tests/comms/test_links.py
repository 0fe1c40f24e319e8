"""The table of links: whom it pairs, what it reports as changed, and what shadowing and losses do."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.comms.solids import Geom, box, random_boxes, slab_count, solids
from tests.comms.test_attenuation import DBM_ATOL, manual_power
from usarmjx.comms.attenuation import RadioSettings, link_range
from usarmjx.comms.links import (
    delivery_probability,
    drop_old_events,
    evaluate_links,
    is_due,
    no_links,
    pair_powers,
    pair_slots,
    shadowing,
)

KEY = jax.random.key(5)
OPEN = solids((Geom.mjGEOM_PLANE, (0, 0, 0), (0, 0, 1))).geoms()
MANUAL = RadioSettings()
EVALUATE = jax.jit(evaluate_links, static_argnums=0)


def links_of(antennas, in_use=None, before=None, constants=MANUAL, geoms=OPEN, step=0, key=KEY):
    antennas = jnp.asarray(antennas, jnp.float32)
    n = len(antennas)
    used = jnp.ones(n, bool) if in_use is None else jnp.asarray(in_use)
    return EVALUATE(constants, geoms, (antennas, used), before or no_links(n), key, jnp.int32(step))


@pytest.mark.oracle
def test_every_pair_has_the_manuals_power():
    rng = np.random.default_rng(2)
    walls = random_boxes(rng, 30, upright=True)
    at = rng.uniform((-10, -10, 0.1), (10, 10, 2), (12, 3)).astype(np.float32).astype(float)
    links = links_of(at, geoms=walls.geoms())
    for i in range(12):
        for j in range(12):
            if i == j:
                assert links.power[i, j] == -np.inf
                assert not links.paired[i, j]
                continue
            least, count, greatest = (slab_count(walls, at[[i]], at[[j]], g)[0] for g in (-1e-4, 0, 1e-4))
            assert least == greatest, "another seed: this one has a segment close to an edge"
            assert links.walls[i, j] == count
            expected = manual_power(np.linalg.norm(at[i] - at[j]), count)
            assert links.power[i, j] == pytest.approx(expected, abs=DBM_ATOL)
            assert links.in_range[i, j] == (expected >= -93.0)


places = st.lists(st.tuples(*[st.floats(-50, 50, width=32)] * 3), min_size=4, max_size=4)
AMONG_WALLS = partial(links_of, geoms=random_boxes(np.random.default_rng(3), 20, True).geoms())


@settings(deadline=None)
@given(places, st.lists(st.booleans(), min_size=4, max_size=4))
def test_tables_are_symmetric_and_without_oneself(antennas: list, in_use: list):
    links = AMONG_WALLS(np.array(antennas, np.float32), np.array(in_use))
    for name in ("power", "walls", "paired", "in_range", "delivery_probability"):
        table = np.asarray(getattr(links, name))
        np.testing.assert_array_equal(table, table.T)
    assert not np.diag(links.paired).any()
    assert not (links.in_range & ~links.paired).any()


@settings(deadline=None)
@given(places)
def test_who_numbers_the_robots_does_not_matter(antennas: list):
    """Bit for bit: the order of a pair's ends does not enter."""
    at, order = np.array(antennas, np.float32), [2, 0, 3, 1]
    one, other = AMONG_WALLS(at), AMONG_WALLS(at[order])
    np.testing.assert_array_equal(np.asarray(one.power)[np.ix_(order, order)], other.power)


def test_parked_robots_have_no_links():
    links = links_of([(0, 0, 1), (1, 0, 1), (2, 0, 1)], in_use=[True, False, True])
    expected = np.zeros((3, 3), bool)
    expected[0, 2] = expected[2, 0] = True
    for table in (links.paired, links.in_range, np.isfinite(links.power)):
        np.testing.assert_array_equal(table, expected)


@pytest.mark.parametrize("robots", [1, 2])
def test_small_worlds(robots: int):
    links = links_of([(0, 0, 1), (1, 0, 1)][:robots])
    assert links.power.shape == (robots, robots)
    assert links.in_range.sum() == robots * (robots - 1)


def test_robots_in_one_place_have_a_link():
    links = links_of([(0, 0, 1), (0, 0, 1)])
    assert links.in_range[0, 1]
    assert links.power[0, 1] == pytest.approx(manual_power(1e-3, 0), abs=DBM_ATOL)


def test_links_hold_up_to_the_cutoff():
    constants = RadioSettings(cutoff=-60.0)
    limit = link_range(constants, 0)
    for distance, holds in ((limit * 0.9999, True), (limit * 1.0001, False)):
        assert links_of([(0, 0, 1), (distance, 0, 1)], constants=constants).in_range[0, 1] == holds


def test_a_link_holds_at_the_cutoff_itself():
    """Manual 3.2.4: it fails below. With a log factor of 0 the power is ePdo at any distance, to the bit."""
    for cutoff, holds in ((-60.0, True), (float(np.nextafter(np.float32(-60), np.float32(0))), False)):
        constants = RadioSettings(pdo=-60.0, n=0.0, cutoff=cutoff)
        links = links_of([(0, 0, 1), (5, 0, 1)], constants=constants)
        assert links.power[0, 1] == -60.0
        assert links.in_range[0, 1] == holds
        assert links.delivery_probability[0, 1] == holds


def test_events_are_changes_since_the_last_evaluation():
    constants = RadioSettings(cutoff=-60.0)
    near, far = [(0, 0, 1), (1, 0, 1)], [(0, 0, 1), (100, 0, 1)]
    look = partial(links_of, constants=constants)
    first = look(near, step=3)
    assert first.evaluated
    assert first.step == 3
    assert not (first.came_up | first.went_down).any()  # of a new episode nothing is known before
    steps = [(near, 0, 0), (far, 0, 1), (far, 0, 0), (near, 1, 0), (near, 0, 0)]
    links = first
    for at, gained, lost in steps:
        links = look(at, before=links)
        np.testing.assert_array_equal(links.came_up, gained * ~np.eye(2, dtype=bool))
        np.testing.assert_array_equal(links.went_down, lost * ~np.eye(2, dtype=bool))
    gone = look(near, in_use=[True, False], before=links)
    assert gone.went_down[0, 1]
    assert look(near, before=gone).came_up[0, 1]


def test_a_table_that_is_looked_at_again_keeps_its_events_for_its_own_step():
    links = links_of([(0, 0, 1), (1, 0, 1)], before=no_links(2).replace(evaluated=jnp.bool_(True)), step=7)
    assert links.came_up[0, 1]
    assert drop_old_events(links, jnp.int32(7)).came_up[0, 1]
    later = drop_old_events(links, jnp.int32(8))
    assert not later.came_up.any()
    np.testing.assert_array_equal(later.power, links.power)


def test_evaluations_are_due_as_often_as_asked():
    links = no_links(2)
    assert is_due(links, jnp.int32(0), 5)  # nothing known yet
    links = links.replace(evaluated=jnp.bool_(True), step=jnp.int32(10))
    due = [bool(is_due(links, jnp.int32(step), 5)) for step in range(10, 17)]
    assert due == [False] * 5 + [True] * 2


def test_shadowing_is_normal_in_decibels_and_the_pairs_own():
    constants = RadioSettings(shadowing=4.0)
    shadow = partial(jax.jit(shadowing, static_argnums=(0, 2)), constants, KEY)
    many = np.asarray(shadow(100))  # of 4950: the mean errs by 0.06, the rest by 0.04
    assert many.mean() == pytest.approx(0.0, abs=0.25)
    assert many.std() == pytest.approx(4.0, abs=0.2)
    few, more = (
        {
            (int(i), int(j)): float(x)
            for i, j, x in zip(*pair_slots(n), shadowing(constants, KEY, n), strict=True)
        }
        for n in (5, 9)
    )
    assert all(more[pair] == x for pair, x in few.items())  # a robot more leaves the others alone
    assert len(set(more.values())) == len(more)


def test_shadowing_is_kept_for_an_episode_and_shifts_the_power():
    at = np.random.default_rng(0).uniform(0, 9, (6, 3))
    plain = links_of(at)
    one, again, other = (
        links_of(at, constants=RadioSettings(shadowing=4.0), key=key) for key in (KEY, KEY, jax.random.key(6))
    )
    np.testing.assert_array_equal(one.power, again.power)
    np.testing.assert_array_equal(one.power, one.power.T)
    pairs = pair_slots(6)
    shift = np.asarray(one.power - plain.power)[pairs]
    np.testing.assert_allclose(shift, shadowing(RadioSettings(shadowing=4.0), KEY, 6), atol=DBM_ATOL)
    assert np.abs(np.asarray(one.power - other.power)[pairs]).min() > 0


def test_chance_rises_over_the_band_above_the_cutoff():
    lossy = RadioSettings(cutoff=-90.0, loss_band=4.0)
    powers = jnp.array([-jnp.inf, -91.0, -90.0, -89.0, -88.0, -86.0, -50.0])
    np.testing.assert_allclose(delivery_probability(lossy, powers), [0, 0, 0, 0.25, 0.5, 1, 1], atol=1e-6)
    sure = RadioSettings(cutoff=-90.0)
    np.testing.assert_array_equal(delivery_probability(sure, powers), [0, 0, 1, 1, 1, 1, 1])


def test_powers_have_slopes_that_draw_robots_together():
    """d P / d x = -10 n / (ln 10 d): by the closed form; finite even where two are in one place."""
    at = jnp.array([(0.0, 0, 1), (3.0, 0, 1)])
    slope = jax.jit(jax.grad(lambda a: pair_powers(MANUAL, OPEN, a)[0].sum()))
    np.testing.assert_allclose(slope(at)[:, 0], [10.9 / np.log(10) / 3, -10.9 / np.log(10) / 3], rtol=1e-5)
    assert np.isfinite(slope(at.at[1].set(at[0]))).all()
    table = jax.grad(lambda a: links_of(a).power[0, 1])
    np.testing.assert_allclose(table(at), slope(at), rtol=1e-6)


def test_walls_between_robots_count_from_both_sides():
    wall = solids(box((1, 0, 1), (0.05, 3, 1)), box((1.2, 0, 1), (0.05, 3, 1)))
    links = links_of([(0, 0, 0.3), (2, 0, 0.3), (2, 9, 0.3)], geoms=wall.geoms())
    np.testing.assert_array_equal(links.walls, [[0, 2, 0], [2, 0, 0], [0, 0, 0]])
