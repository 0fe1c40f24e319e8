"""Received power against the manual's formula, written out in plain floats, and USARComServer.ini."""

import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usarmjx.base.errors import SpecError
from usarmjx.comms.attenuation import (
    INI_KEYS,
    MIN_ANTENNA_DISTANCE,
    RadioSettings,
    link_range,
    radio_settings,
    received_power,
)
from usarmjx.models.ini.parse import parse_ini

DBM_ATOL = 1e-3  # dBm, as the radio promises; single precision errs by 1e-5
MANUAL = RadioSettings()
FILE = """
[USARBotAPI.ComServer]
ListenPort=6000

[USARBotAPI.ComConnection]
bDebug=True
ePdo=-40.5
eDo=1.0
eN=1
eCutoff=-70
eMaxObs=3
eAttenFac=6.325

[USARBotAPI.ComLink]
bDebug=False

[USARBot.P2AT]
eWhatever=7
"""


def manual_power(d, walls, pdo=-49.67, do=2.0, n=1.09, most=5, waf=6.625):
    """Manual 3.2.4: P(d) = P(d0) - 10 n log(d/d0) - nW WAF where nW < C, else - C WAF."""
    obstacles = walls * waf if walls < most else most * waf
    return pdo - 10 * n * math.log10(d / do) - obstacles


def power(distance, walls, constants=MANUAL):
    return np.asarray(received_power(constants, jnp.asarray(distance), jnp.asarray(walls)))


@pytest.mark.oracle
def test_power_is_the_manuals_formula():
    rng = np.random.default_rng(0)
    distances, walls = 10 ** rng.uniform(-2, 5, 10_000), rng.integers(0, 12, 10_000)
    expected = [manual_power(d, w) for d, w in zip(distances, walls, strict=True)]
    np.testing.assert_allclose(power(distances, walls), expected, atol=DBM_ATOL)


@pytest.mark.oracle
def test_every_constant_counts():
    rng = np.random.default_rng(1)
    for _ in range(20):
        pdo, do, n, waf = rng.uniform(-80, 0), rng.uniform(0.5, 9), rng.uniform(0, 4), rng.uniform(0, 20)
        most, d, w = int(rng.integers(0, 9)), rng.uniform(0.1, 100), int(rng.integers(0, 9))
        constants = RadioSettings(pdo=pdo, do=do, n=n, max_obs=most, atten_fac=waf)
        expected = manual_power(d, w, pdo, do, n, most, waf)
        assert power(d, w, constants) == pytest.approx(expected, abs=DBM_ATOL)


def test_known_powers():
    """By hand: P(d0) at d0; ten times as far takes 10.9 dB, each wall 6.625, five and more 33.125."""
    np.testing.assert_allclose(
        power([2.0, 20.0, 0.2, 2.0, 2.0, 2.0], [0, 0, 0, 1, 5, 6]),
        [-49.67, -60.57, -38.77, -56.295, -82.795, -82.795],
        atol=DBM_ATOL,
    )


def test_any_shape_is_taken_and_broadcast():
    assert power(np.ones((4, 1, 3)), np.zeros((5, 1), int)).shape == (4, 5, 3)
    assert power(1.0, 0).shape == ()
    assert power(np.float64(1.0), 0).dtype == np.float32


SHORTEST = float(np.nextafter(np.float32(MIN_ANTENNA_DISTANCE), np.float32(1)))
distances = st.floats(SHORTEST, 1e5, width=32)


@settings(deadline=None)
@given(distances, distances, st.integers(0, 9))
def test_power_falls_with_distance(a, b, walls):
    near, far = power(min(a, b), walls), power(max(a, b), walls)
    assert near >= far
    if max(a, b) > 1.001 * min(a, b):  # 0.005 dB, which single precision resolves at 100 dBm
        assert near > far


@settings(deadline=None)
@given(distances, st.integers(0, 100), st.integers(0, 8), st.floats(0, 20, width=32))
def test_walls_beyond_the_cap_take_nothing(distance, walls, most, each):
    constants = RadioSettings(max_obs=most, atten_fac=each)
    taken = power(distance, 0, constants) - power(distance, walls, constants)
    assert taken == pytest.approx(min(walls, most) * each, abs=DBM_ATOL)


@settings(deadline=None)
@given(st.floats(SHORTEST, 1.875, width=32), st.integers(0, 9))
def test_below_the_reference_distance_the_formula_goes_on(distance, walls):
    assert power(distance, walls) == pytest.approx(manual_power(distance, walls), abs=DBM_ATOL)
    assert power(distance, walls) > power(2.0, walls)


def test_distance_zero_has_the_power_of_a_millimetre():
    assert (
        power(0.0, 2) == power(MIN_ANTENNA_DISTANCE, 2) == pytest.approx(manual_power(0.001, 2), abs=DBM_ATOL)
    )


def test_slope_is_that_of_the_logarithm():
    slope = jax.vmap(jax.grad(lambda d: received_power(MANUAL, d, 3)))
    d = jnp.array([0.1, 1.0, 2.0, 30.0])
    np.testing.assert_allclose(slope(d), -10 * 1.09 / math.log(10) / np.asarray(d), rtol=1e-5)
    np.testing.assert_array_equal(slope(jnp.array([0.0, MIN_ANTENNA_DISTANCE / 2])), 0.0)


def test_reach_is_where_the_power_is_the_cutoff():
    for walls in range(8):
        assert manual_power(link_range(MANUAL, walls), walls) == pytest.approx(-93.0)
    # The issue of the example's ini (eCutoff=-70) and of the manual's constants, worked out beforehand.
    for cutoff, expected in ((-93.0, (18891, 4661, 1150, 284, 70.0, 17.3)), (-70.0, (146, 36, 8.9, 2.2))):
        there = [link_range(RadioSettings(cutoff=cutoff), walls) for walls in range(len(expected))]
        assert there == pytest.approx(expected, rel=0.01)
    assert link_range(RadioSettings(n=0.0), 0) == math.inf
    assert link_range(RadioSettings(n=0.0, cutoff=-40.0), 0) == 0.0


def test_ini_is_read():
    assert radio_settings(parse_ini(FILE)) == RadioSettings(
        listen_port=6000, pdo=-40.5, do=1.0, n=1.0, cutoff=-70.0, max_obs=3, atten_fac=6.325, debug=True
    )


def test_ini_that_says_nothing_leaves_the_manuals_constants(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    file = tmp_path / "USARComServer.ini"
    file.write_text("[usarbotapi.COMCONNECTION]\necutoff=-80.0\nEMAXOBS=4.0\n", encoding="utf-16")
    assert radio_settings(file) == RadioSettings(cutoff=-80.0, max_obs=4)
    assert radio_settings(parse_ini("[Elsewhere]\nePdo=1\n", "server.ini")) == MANUAL
    assert "server.ini:2: [Elsewhere] is not of the radio; read are USARBotAPI.ComServer" in caplog.text
    assert (MANUAL.pdo, MANUAL.do, MANUAL.n, MANUAL.max_obs) == (-49.67, 2.0, 1.09, 5)
    assert (MANUAL.atten_fac, MANUAL.cutoff, MANUAL.listen_port) == (6.625, -93.0, 5874)


@pytest.mark.parametrize("section", ["ComServer", "ComConnection", "ComLink"])
def test_any_of_the_sections_turns_debug_on(section: str):
    rest = "".join(f"[{name}]\nbDebug=False\n" for name in INI_KEYS)
    assert not radio_settings(parse_ini(rest)).debug
    assert radio_settings(parse_ini(f"{rest}[USARBotAPI.{section}]\nbDebug=True\n")).debug


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("eDo=0", ("server.ini", "do is 0", "above 0")),
        ("eN=-1", ("n is -1", "from 0")),
        ("eMaxObs=2.5", ("server.ini:2", "eMaxObs is 2.5", "whole number")),
        ("eMaxObs=-1", ("max_obs is -1", "from 0")),
        ("eAttenFac=none", ("server.ini:2", "eAttenFac", "a number")),
        ("bDebug=maybe", ("server.ini:2", "bDebug", "True or False")),
        ("eCutof=-93", ("server.ini:2", "eCutof", "eCutoff")),
        ("ListenPort=5874", ("server.ini:2", "ListenPort", "ePdo")),  # it belongs to ComServer
    ],
)
def test_mistakes_are_named(line: str, words: tuple):
    with pytest.raises(SpecError) as caught:
        radio_settings(parse_ini(f"[USARBotAPI.ComConnection]\n{line}\n", "server.ini"))
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("field", "value", "allowed"),
    [
        ("listen_port", 65536, "0 to 65535"),
        ("listen_port", -1, "0 to 65535"),
        ("pdo", math.nan, "pdo is nan, expected a number"),
        ("cutoff", -math.inf, "cutoff is -inf, expected a number"),
        ("do", -2.0, "above 0"),
        ("shadowing", -0.1, "from 0"),
        ("loss_band", -1.0, "from 0"),
        ("period", -0.02, "from 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(field: str, value: float, allowed: str):
    with pytest.raises(SpecError, match=allowed) as caught:
        RadioSettings(**{field: value})
    assert field in str(caught.value)
