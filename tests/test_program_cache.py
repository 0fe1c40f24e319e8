"""Which processes of the tests share compiled programs."""

import os
from pathlib import Path

import jax

from tests.program_cache import KEPT, folder_of_programs

OWN = Path("/own")


def test_a_run_begins_with_an_empty_folder_unless_one_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    users = {"JAX_COMPILATION_CACHE_DIR": "/programs/of/the/user"}
    assert folder_of_programs(users, OWN) == Path("/own/compiled")
    assert folder_of_programs({**users, KEPT: ""}, OWN) == Path("/own/compiled")
    assert folder_of_programs({**users, KEPT: "kept"}, OWN) == tmp_path.resolve() / "kept"


def test_workers_have_that_of_their_run():
    run = {"JAX_COMPILATION_CACHE_DIR": "/run", "PYTEST_XDIST_WORKER": "gw0", KEPT: "/kept"}
    assert folder_of_programs(run, OWN) == Path("/run")


def test_this_process_and_those_that_it_starts_use_it(monkeypatch):
    folder = jax.config.jax_compilation_cache_dir
    monkeypatch.setenv("PYTEST_XDIST_WORKER", "gw0")
    assert str(folder_of_programs(os.environ, OWN)) == folder
