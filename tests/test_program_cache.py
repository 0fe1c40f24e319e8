"""Which processes of the tests share compiled programs."""

import os
from pathlib import Path

import jax

from tests.program_cache import KEPT, folder_of_programs, limit_kept
from usarmjx.base.compilation import processor

OWN = Path("/own")


def test_a_run_begins_with_an_empty_folder_unless_one_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    users = {"JAX_COMPILATION_CACHE_DIR": "/programs/of/the/user", "NPROC": "8"}
    for none in ({}, {KEPT: ""}, {KEPT: "off"}):
        assert folder_of_programs({**users, **none}, OWN) == Path("/own/compiled")
    kept = folder_of_programs({**users, KEPT: "kept"}, OWN)
    assert kept == tmp_path.resolve() / "kept/jax" / f"{processor()}-8"


def test_another_pool_of_threads_has_other_programs():
    """XLA divides loops by it, which JAX's keys do not know."""
    assert folder_of_programs({KEPT: "/kept", "NPROC": "2"}, OWN) != folder_of_programs({KEPT: "/kept"}, OWN)


def test_workers_have_that_of_their_run():
    run = {"JAX_COMPILATION_CACHE_DIR": "/run", "PYTEST_XDIST_WORKER": "gw0", KEPT: "/kept"}
    assert folder_of_programs(run, OWN) == Path("/run")


def test_a_run_begins_by_removing_what_was_not_used_for_longest(tmp_path):
    environ = {KEPT: str(tmp_path), "NPROC": "8"}
    folder = folder_of_programs(environ, OWN)
    folder.mkdir(parents=True)
    for age, name in enumerate(("new", "old")):
        (folder / name).write_bytes(bytes(100))
        os.utime(folder / name, (1e9 - age, 1e9 - age))
    limit_kept({**environ, "PYTEST_XDIST_WORKER": "gw0"}, 100)
    assert len(list(folder.iterdir())) == 2
    limit_kept(environ, 100)
    assert [one.name for one in folder.iterdir()] == ["new"]


def test_this_process_and_those_that_it_starts_use_it(monkeypatch):
    folder = jax.config.jax_compilation_cache_dir
    monkeypatch.setenv("PYTEST_XDIST_WORKER", "gw0")
    assert str(folder_of_programs(os.environ, OWN)) == folder
