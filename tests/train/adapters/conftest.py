"""Fixtures of the tests of adapters."""

import pytest

from tests.train.toys import LineToy


@pytest.fixture
def made(monkeypatch):
    """Arguments of the environments that `jaxmarl.make` makes, which are toys."""
    jaxmarl = pytest.importorskip("jaxmarl", reason="needs the extra rl")
    calls = []

    def remember(name, **keywords):
        calls.append((name, keywords))
        return LineToy()

    monkeypatch.setattr("usarmjx.train.adapters.jaxmarl.make_task_env", remember)
    monkeypatch.setattr(jaxmarl, "make", jaxmarl.make)
    monkeypatch.setattr(jaxmarl, "registered_envs", list(jaxmarl.registered_envs))
    return calls
