"""Programs that are kept: read instead of traced, only where nothing that they depend on has changed."""

import os
import platform
import time
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base import program_cache
from usarmjx.base.compilation import PROGRAMS_FOLDER
from usarmjx.base.program_cache import (
    PrecompiledProgram,
    ProgramCache,
    SourcesChangedError,
    build_conditions,
    compile_program,
    digest_of_sources,
    open_program_cache,
)

TREE = {"a": np.arange(3.0, dtype=np.float32), "b": (np.int32(2), None)}


@pytest.fixture
def traced():
    return []


@pytest.fixture
def start(tmp_path, traced):
    """What a start of the program makes of a function, with a digest of what it closes over."""

    def started(digest="x", owner="test"):
        def tripled(tree, key):
            traced.append(jax.tree.leaves(tree)[0].dtype)
            return {**tree, "drawn": 3 * tree["a"] + jax.random.normal(key, (3,))}

        return compile_program(tripled, ProgramCache(tmp_path, digest), owner)

    return started


def test_a_kept_program_computes_the_same_and_is_not_traced(start, traced):
    key = jax.random.key(1)
    first, second = start()(TREE, key), start()(TREE, key)
    assert len(traced) == 1
    assert jax.tree.structure(first) == jax.tree.structure(second)
    jax.tree.map(np.testing.assert_array_equal, first, second)
    np.testing.assert_array_equal(first["drawn"], 3 * TREE["a"] + jax.random.normal(key, (3,)))


@pytest.mark.every_run("dtype", "tree", "more")
@pytest.mark.parametrize(
    "other",
    [
        {**TREE, "a": np.arange(3, dtype=np.int32)},
        {**TREE, "a": np.ones((3, 1), np.float32)},
        {**TREE, "b": [np.int32(2), None]},
        {**TREE, "b": (2, None)},
        {**TREE, "c": np.int32(2)},
    ],
    ids=["dtype", "shape", "tree", "weak type", "more"],
)
def test_of_other_arguments_it_is_another_program(start, traced, other):
    key = jax.random.key(0)
    for tree in (TREE, other, other):
        start()(tree, key)
    assert len(traced) == 2
    program = start()  # also of one that is there already
    for tree in (TREE, other, TREE):
        assert jax.tree.structure(program(tree, key)["b"]) == jax.tree.structure(tree["b"])
    assert len(traced) == 2


def test_with_another_digest_or_name_it_is_another_program(start, traced):
    for told in ({}, {"digest": "y"}, {"owner": "other"}):
        start(**told)(TREE, jax.random.key(0))
    assert len(traced) == 3


@pytest.mark.parametrize(
    "spoil", [lambda data: data[:-7], lambda data: data[:40] + b"?" + data[41:], lambda _: b""]
)
def test_a_broken_file_is_warned_of_and_the_program_is_kept_anew(start, traced, tmp_path, spoil):
    key = jax.random.key(0)
    good = start()(TREE, key)
    (file,) = tmp_path.iterdir()
    file.write_bytes(spoil(file.read_bytes()))
    with pytest.warns(UserWarning, match=f"Error reading the kept program {file.name}"):
        again = start()(TREE, key)
    jax.tree.map(np.testing.assert_array_equal, good, again)
    start()(TREE, key)
    assert len(traced) == 2


def test_where_nothing_can_be_written_it_is_warned_of_and_computed(traced, tmp_path):
    (tmp_path / "file").touch()
    program = compile_program(jnp.sin, ProgramCache(tmp_path / "file", "x"), "test")
    with pytest.warns(UserWarning, match="Error writing the kept program"):
        assert program(0.0) == 0.0


def test_what_calls_this_process_back_is_not_kept(tmp_path):
    def called(x):
        return jax.pure_callback(np.sin, jax.ShapeDtypeStruct((), np.float32), x)

    assert compile_program(called, ProgramCache(tmp_path, "x"), "test")(0.0) == 0.0
    assert not list(tmp_path.iterdir())


def test_two_functions_of_a_name_are_not_mixed_up(tmp_path):
    program_cache = ProgramCache(tmp_path, "x")
    programs = [
        compile_program(function, program_cache, "test") for function in (lambda x: x + 1, lambda x: x + 2)
    ]
    assert [program(1.0) for program in programs] == [2.0, 3.0]


def test_within_a_function_that_is_traced_it_is_part_of_that(start):
    key = jax.random.key(0)
    program = start()
    jax.tree.map(np.testing.assert_array_equal, jax.jit(program)(TREE, key), program(TREE, key))


def test_values_are_made_once(tmp_path):
    made = []

    def make():
        made.append(1)
        return (jax.ShapeDtypeStruct((2,), jnp.float32), ("a",))

    first, second = (ProgramCache(tmp_path, "x").value("shapes", make) for _ in range(2))
    assert first == second
    assert len(made) == 1


# What the digest covers.


def digest(*ingredients):
    return open_program_cache(*ingredients).path("name", "signature").name


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setenv(PROGRAMS_FOLDER, str(tmp_path))
    monkeypatch.setattr(program_cache, "_sources", lambda: "as they are")


CHANGES = {
    "sources": lambda patch: patch.setattr(program_cache, "_sources", lambda: "others"),
    "flags of XLA": lambda patch: patch.setenv("XLA_FLAGS", "--xla_other"),
    "threads": lambda patch: patch.setenv("NPROC", "11"),
    "Python": lambda patch: patch.setattr(platform, "python_version", lambda: "3.99"),
    "versions": lambda patch: patch.setattr(program_cache.metadata, "version", lambda name: "99"),
    "processor": lambda patch: patch.setattr(program_cache, "processor", lambda: "other"),
    "cores": lambda patch: patch.setattr(program_cache, "cores", lambda: 99),
}


@pytest.mark.parametrize("what", CHANGES)
def test_whatever_may_change_a_program_changes_its_digest(kept, monkeypatch, what):
    before = digest(1)
    assert digest(1) == before
    CHANGES[what](monkeypatch)
    assert digest(1) != before


def test_settings_of_jax_change_the_digest_but_not_where_it_keeps_things(kept):
    before = digest(1)
    with jax.default_matmul_precision("bfloat16"):
        assert digest(1) != before
    folder = jax.config.jax_compilation_cache_dir
    try:
        jax.config.update("jax_compilation_cache_dir", "/elsewhere")
        assert digest(1) == before
    finally:
        jax.config.update("jax_compilation_cache_dir", folder)


def test_each_version_that_matters_is_looked_at(monkeypatch):
    monkeypatch.setattr(program_cache.metadata, "version", lambda name: f"of {name}")
    assert {"jax", "jaxlib", "mujoco", "numpy"} <= build_conditions()["versions"].keys()
    assert build_conditions()["versions"]["jaxlib"] == "of jaxlib"


def test_what_a_program_closes_over_changes_its_digest(kept):
    assert len({digest(), digest(1), digest(2), digest(1, 2)}) == 4
    assert open_program_cache(lambda: 0) is None


def test_nothing_is_kept_unless_it_was_asked_for(kept, monkeypatch):
    monkeypatch.delenv(PROGRAMS_FOLDER)
    assert open_program_cache() is None


@pytest.fixture
def package(tmp_path):
    for name, text in {"a.py": "1", "inner/b.py": "2", "inner/data.yaml": "3"}.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_each_file_of_the_package_counts(package):
    later = time.time() + 1e3
    before = digest_of_sources(package, later)
    (package / "__pycache__").mkdir()
    (package / "__pycache__/a.pyc").touch()
    assert digest_of_sources(package, later) == before
    for change in (
        lambda: (package / "inner/data.yaml").write_text("4"),
        lambda: (package / "a.py").rename(package / "c.py"),
        lambda: (package / "new.py").touch(),
        lambda: (package / "c.py").unlink(),
    ):
        known, _ = before, change()
        before = digest_of_sources(package, later)
        assert before != known


def test_sources_that_changed_while_the_process_ran_are_not_trusted(package, kept, monkeypatch):
    os.utime(package / "a.py", (2e9, 2e9))
    with pytest.raises(SourcesChangedError, match=r"a\.py"):
        digest_of_sources(package, 2e9 - 1)
    monkeypatch.setattr(program_cache, "_sources", lambda: digest_of_sources(package, 2e9 - 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert open_program_cache() is None


def test_a_program_that_was_compiled_ahead_is_called_and_others_are_compiled(traced):
    def doubled(one):
        traced.append(one.shape)
        return {"twice": 2 * one}

    told, program = [], PrecompiledProgram(compile_program(doubled, None, "test"))
    program.compile(jax.ShapeDtypeStruct((3,), np.float32), tell=told.append)
    assert told[0]["twice"].shape == (3,)
    np.testing.assert_array_equal(program(jnp.arange(3.0))["twice"], [0, 2, 4])
    assert traced == [(3,)]
    np.testing.assert_array_equal(program(jnp.arange(4.0))["twice"], [0, 2, 4, 6])
    assert traced == [(3,), (4,)]


def test_a_kept_program_is_lowered_for_shapes_alone(start, traced):
    key = jax.random.key(1)
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), (TREE, key))
    lowered = [start().lower(*shapes) for _ in range(2)]
    assert len(traced) == 1
    assert lowered[1].out_info["drawn"].shape == (3,)
    np.testing.assert_array_equal(lowered[1].compile()(TREE, key)["drawn"], start()(TREE, key)["drawn"])


def test_a_keeper_of_more_has_another_digest_and_none_for_what_has_no_digest(kept):
    program_cache = open_program_cache(1)
    assert program_cache.of(2).path("a", "b") == open_program_cache(1).of(2).path("a", "b")
    paths = [one.path("a", "b") for one in (program_cache, program_cache.of(2), program_cache.of(3))]
    assert len(set(paths)) == 3
    assert program_cache.of(lambda: 0) is None
