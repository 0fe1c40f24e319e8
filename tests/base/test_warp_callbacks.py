"""No garbage is collected in Warp's callbacks from XLA: a collection there may unload compiled programs."""

import gc
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base.warp_functions import without_collection

wp = pytest.importorskip("warp")


@pytest.fixture
def collections():
    """Collections that begin, each with whether a callback was at work; the collector is at its keenest."""
    seen, inside = [], threading.Event()

    def note(phase, info):
        if phase == "start":
            seen.append(inside.is_set())

    thresholds = gc.get_threshold()
    gc.callbacks.append(note)
    gc.set_threshold(1)
    yield seen, inside
    gc.set_threshold(*thresholds)
    gc.callbacks.remove(note)


def garbage():
    for _ in range(100):
        ring = []
        ring.append(ring)


def test_the_collector_rests_in_a_callback_and_works_before_and_after(collections):
    seen, inside = collections

    def callback(number):
        inside.set()
        garbage()
        inside.clear()
        return number + 1

    garbage()
    before = len(seen)
    assert without_collection(callback)(1) == 2
    assert gc.isenabled()
    garbage()
    assert 0 < before < len(seen)
    assert not any(seen)


def test_without_it_the_collector_does_run_there(collections):
    seen, inside = collections
    inside.set()
    garbage()
    inside.clear()
    assert any(seen)


def test_a_collector_that_is_off_stays_off_and_errors_leave_it_as_it_was():
    gc.disable()
    try:
        without_collection(garbage)()
        assert not gc.isenabled()
    finally:
        gc.enable()
    with pytest.raises(ZeroDivisionError):
        without_collection(lambda: 1 / 0)()
    assert gc.isenabled()


def test_callbacks_in_two_threads_end_in_either_order():
    first, second = threading.Event(), threading.Event()
    states = []

    def short():
        second.set()
        assert first.wait(60)

    def long():
        assert second.wait(60)
        other.join(60)
        states.append(gc.isenabled())

    other = threading.Thread(target=without_collection(short))
    one = threading.Thread(target=without_collection(long))
    one.start()
    other.start()
    assert second.wait(60)
    first.set()
    one.join(60)
    assert states == [False]
    assert gc.isenabled()


def test_kernels_of_the_product_are_called_back_without_it(monkeypatch):
    """The launch of a real kernel, seen from Warp's own callback."""
    from usarmjx.base import warp_functions
    from usarmjx.base.warp_functions import pause_collection_in_callbacks

    pause_collection_in_callbacks()
    states, entered = [], warp_functions._Pause.__enter__

    def watched(pause):
        entered(pause)
        states.append(gc.isenabled())

    monkeypatch.setattr(warp_functions._Pause, "__enter__", watched)

    @wp.kernel
    def twice(x: wp.array(dtype=float), y: wp.array(dtype=float)):
        i = wp.tid()
        y[i] = 2.0 * x[i]

    run = jax.jit(lambda x: wp.jax_kernel(twice)(x)[0])
    np.testing.assert_array_equal(run(jnp.arange(4.0)), 2 * np.arange(4.0))
    assert states
    assert not any(states)
    assert gc.isenabled()
