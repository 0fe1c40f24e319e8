"""Kept files with flipped bits: their content is as it was, or refused; damage is never believed.

A run of the tests flips some bits of each kind, `dev.py fuzz` all.
"""

import contextlib
import logging

import numpy as np
import pytest
from hypothesis import settings

from tests.kept_files import kept_files
from usarmjx.base.errors import UsageError

KEPT = kept_files()
BITS = 150
"""Most bits of a kind in a run of the tests."""
MANY = settings.default.max_examples if settings.default else 0
pytestmark = pytest.mark.hypothesis


def bits_of(whole):
    count = 8 * len(whole)
    few = np.random.default_rng(0).choice(count, min(BITS, count), replace=False)
    return range(count) if MANY > 100 else sorted(few.tolist())


@pytest.mark.parametrize("name", KEPT)
def test_a_flipped_bit_is_refused_or_changes_nothing(name, tmp_path, caplog):
    whole, reader = KEPT[name]
    caplog.set_level(logging.CRITICAL)
    path = tmp_path / name
    path.write_bytes(whole)
    expected = reader(path)
    assert expected
    for bit in bits_of(whole):
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        found = None
        with contextlib.suppress(UsageError):
            found = reader(path)
        if name == "recording.mcap" and found is not None:  # a damaged part is left out
            found = expected if found.items() <= expected.items() else found
        assert found is None or found == expected, bit
