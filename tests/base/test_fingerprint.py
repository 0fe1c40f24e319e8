"""Digests differ wherever values do, and are the same in another process."""

import math
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dev import ROOT
from usarmjx.base.program_cache import FingerprintError, fingerprint
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.suite import suite_of

BOX = Shape(kind="box", size=(1.0, 2.0, 3.0), at=(0.0, 0.0, 0.0))
XML = "<mujoco><worldbody><geom name='g' size='{}'/></worldbody></mujoco>"


def model(size):
    return mujoco.MjModel.from_xml_string(XML.format(size))


APART = {
    "numbers": [0, 0.0, -0.0, False, None, "0", b"0", math.inf, 1, True, 1.0, 1 + 0j],
    "arrays": [
        np.zeros(2, np.float32),
        np.zeros(2, np.float64),
        np.zeros((2, 1), np.float32),
        np.array([0.0, 1e-45], np.float32),
        np.float32(0.0),
        jnp.zeros(2),
        jax.random.key(0),
        jax.random.key(1),
    ],
    "collections": [(1, 2), [1, 2], (2, 1), ((1,), 2), (1, (2,)), {1: 2}, {2: 1}, {1, 2}, frozenset({1, 2})],
    "descriptions": [
        BOX,
        replace(BOX, size=(1.0, 2.0, 3.1)),
        (BOX, BOX),
        ROBOTS.get("P2AT"),
        ROBOTS.get("P2DX"),
    ],
    "sensors": [suite_of(ROBOTS.get("P2AT")), suite_of(ROBOTS.get("P2DX")), suite_of(ROBOTS.get("kenaf"))],
    "functions": [math.sin, math.cos, replace, fingerprint, partial(fingerprint, 1), partial(fingerprint, 2)],
    "models": [model(1), model(1.0000001), XML],
}


@pytest.mark.parametrize("kind", APART)
def test_other_values_have_other_digests(kind):
    digests = [fingerprint(value) for value in APART[kind]]
    assert len(set(digests)) == len(digests)


def test_equal_values_have_equal_digests_however_they_were_made():
    assert fingerprint(model(1)) == fingerprint(model(1))
    assert fingerprint({"b", "a", "c"}) == fingerprint({"c", "b", "a"})
    assert fingerprint((BOX, BOX)) == fingerprint((BOX, replace(BOX)))
    assert fingerprint(np.arange(6).reshape(2, 3).T) == fingerprint(np.arange(6).reshape(2, 3).T.copy())


SAID = """
from usarmjx.base.program_cache import fingerprint
from usarmjx.models.robots import ROBOTS
print(fingerprint(ROBOTS.get("P2AT"), {"a", "b", "c"}, {"x": fingerprint}))
"""


def test_another_process_has_the_same_digest():
    settings = {**os.environ, "PYTHONHASHSEED": "7"}
    said = subprocess.run(
        [sys.executable, "-c", SAID], env=settings, capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert said.stdout.strip() == fingerprint(ROBOTS.get("P2AT"), {"c", "b", "a"}, {"x": fingerprint})


@dataclass(frozen=True)
class Foreign:
    """Nobody knows from which sources."""


@pytest.mark.parametrize(
    "value",
    [
        Foreign(),
        Foreign,
        lambda: 0,
        np.array([object()]),
        np.random.default_rng(0),
        mujoco.MjSpec(),
        object(),
    ],
    ids=["dataclass", "class", "lambda", "objects", "generator", "spec", "object"],
)
def test_what_cannot_be_told_apart_has_no_digest(value):
    with pytest.raises(FingerprintError):
        fingerprint([value])
