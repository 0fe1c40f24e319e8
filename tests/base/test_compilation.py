"""Where compilations are kept: what the environment says, how large it grows, and what is broken in it."""

import os
import warnings
from importlib import metadata

import pytest

from usarmjx.base.compilation import (
    CACHE_VARIABLE,
    JAX_FOLDER,
    MIN_COMPILE_TIME,
    NO_FUSION_EMITTERS,
    NO_OPTIMIZATION,
    PROGRAMS_FOLDER,
    WARP_FOLDER,
    enable_compilation_cache,
    fast_compilation_flags,
    processor,
    prune_cache,
    warn_once_of_broken_entries,
)


def test_both_are_told_where_and_that_small_programs_count(tmp_path):
    said = {"XDG_CACHE_HOME": str(tmp_path)}
    assert enable_compilation_cache(said) is None
    folder = tmp_path / "usarmjx"
    assert said[JAX_FOLDER] == str(folder / "jax" / processor())
    assert said[WARP_FOLDER] == str(folder / "warp")
    assert said[PROGRAMS_FOLDER] == str(folder / "programs" / processor())
    assert said[MIN_COMPILE_TIME[0]] == "0"


def test_without_a_variable_it_is_the_usual_folder_of_caches(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    said = {}
    enable_compilation_cache(said)
    assert said[WARP_FOLDER] == str(tmp_path / ".cache/usarmjx/warp")


def test_it_can_be_moved_and_turned_off(tmp_path):
    moved, off = (
        {CACHE_VARIABLE: str(tmp_path / "here")},
        {CACHE_VARIABLE: "Off", "XDG_CACHE_HOME": str(tmp_path)},
    )
    assert enable_compilation_cache(moved) is enable_compilation_cache(off) is None
    assert moved[WARP_FOLDER] == str(tmp_path / "here/warp")
    assert JAX_FOLDER not in off
    assert [path.name for path in tmp_path.iterdir()] == ["here"]


def test_what_users_tell_jax_and_warp_themselves_stays(tmp_path):
    own = {JAX_FOLDER: "/own/jax", WARP_FOLDER: "/own/warp", MIN_COMPILE_TIME[0]: "5"}
    said = {**own, "XDG_CACHE_HOME": str(tmp_path)}
    enable_compilation_cache(said)
    assert {name: said[name] for name in own} == own


def test_a_folder_that_cannot_be_written_is_a_line_and_no_failure(tmp_path):
    (tmp_path / "file").touch()
    said = {CACHE_VARIABLE: str(tmp_path / "file")}
    complaint = enable_compilation_cache(said)
    assert complaint is not None
    assert "not kept" in complaint
    assert str(tmp_path / "file") in complaint
    assert "\n" not in complaint
    assert JAX_FOLDER not in said


def test_what_was_not_used_for_longest_goes_first(tmp_path):
    """JAX's programs and ours are files, Warp's modules are folders; a use is a reading, too."""
    programs, module = tmp_path / "jax" / "x86", tmp_path / "warp" / "1.0" / "wp_module"
    ours = tmp_path / "programs" / "x86"
    for folder in (programs, module, ours):
        folder.mkdir(parents=True)
    files = [ours / "old", module / "code", programs / "read", programs / "new"]
    for place, path in enumerate(files):
        path.write_bytes(bytes(100))
        os.utime(path, (1000.0 + place, 1000.0 + place))
    os.utime(files[2], (5000.0, 1.0))  # read lately, written long ago
    prune_cache(tmp_path, 400)
    assert all(path.exists() for path in files)
    prune_cache(tmp_path, 250)
    assert [path.exists() for path in files] == [False, False, True, True]
    assert not module.exists()
    prune_cache(tmp_path, 100)
    assert [path.exists() for path in files] == [False, False, True, False]


@pytest.fixture
def complaints(tmp_path, monkeypatch):
    monkeypatch.setattr(warnings, "showwarning", lambda *rest: said.append(str(rest[0])))
    said = []
    warn_once_of_broken_entries(said.append, tmp_path)
    return said


def test_of_broken_entries_one_line_is_said_and_they_go(complaints, tmp_path):
    broken, good = tmp_path / "jit_step-1-cache", tmp_path / "jit_other-2-cache"
    broken.touch()
    good.touch()
    for name in ("jit_step", "jit_stop"):
        warnings.showwarning(
            UserWarning(f"Error reading persistent compilation cache entry for '{name}': OSError: x"), None
        )
    assert len(complaints) == 1
    assert "jit_step" in complaints[0]
    assert not broken.exists()
    assert good.exists()
    warnings.showwarning("something else", None)
    assert complaints[1:] == ["something else"]


def test_of_kept_programs_that_are_broken_one_line_is_said(complaints):
    for name in ("Env.step", "Env.act"):
        warnings.showwarning(UserWarning(f"Error reading the kept program {name}-1: it is not whole"), None)
    (line,) = complaints
    assert "Env.step" in line


def test_quick_compilation_asks_only_for_flags_that_jaxlib_knows():
    """XLA ends the process over another one: of 0.11.2 with the older emitters `play` did not start."""
    assert fast_compilation_flags("0.10.2") == [NO_OPTIMIZATION, NO_FUSION_EMITTERS]
    assert [fast_compilation_flags(version) for version in ("0.11.0", "0.11.2", "0.12.0.1", "1.0")] == [
        [NO_OPTIMIZATION]
    ] * 4
    assert fast_compilation_flags() == fast_compilation_flags(metadata.version("jaxlib"))
