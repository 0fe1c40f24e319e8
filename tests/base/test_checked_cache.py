"""Damaged entries of the cache are compiled again; entries of another writer or of a crash are not loaded."""

import os
import subprocess
import sys
import warnings
from types import SimpleNamespace

import pytest

from usarmjx.base import checked_cache
from usarmjx.base.checked_cache import (
    LOADING_FOLDER,
    LoadingEntries,
    check_warp_folder,
    guard_jax,
    read_sealed,
    remove_entries_of_crashes,
    seal,
    seal_warp_folder,
    unseal,
    write_sealed,
)
from usarmjx.base.compilation import (
    CACHE_VARIABLE,
    JAX_FOLDER,
    PROGRAMS_FOLDER,
    enable_compilation_cache,
    own_cache_folder,
)


def flips(content):
    """Yield a content with each of its bits flipped."""
    for bit in range(8 * len(content)):
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        yield bytes(changed)


def test_no_flipped_bit_of_a_sealed_file_is_believed():
    content = seal(b"a program", "key")
    assert unseal(content, "key") == b"a program"
    for changed in flips(content):
        with pytest.raises(ValueError, match="it is not whole"):
            unseal(changed, "key")
    for length in range(len(content)):
        with pytest.raises(ValueError, match="it is not whole"):
            unseal(content[:length], "key")


def test_an_entry_under_another_key_is_removed_with_a_warning(tmp_path):
    write_sealed(tmp_path / "a", b"a program", "a")
    (tmp_path / "b").write_bytes((tmp_path / "a").read_bytes())
    assert read_sealed(tmp_path / "a", "a") == b"a program"
    with pytest.warns(UserWarning, match="Error reading the kept program b: it is not whole"):
        assert read_sealed(tmp_path / "b", "b") is None
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


# JAX's cache.


@pytest.fixture
def guarded(tmp_path):
    """JAX's module of compilations with a cache of its own, guarded."""
    from jax._src import compilation_cache
    from jax._src.lru_cache import LRUCache

    loads = []
    module = SimpleNamespace(
        LRUCache=LRUCache,
        config=SimpleNamespace(
            config=SimpleNamespace(jax_compilation_cache_dir=str(tmp_path / "jax" / "cpu"))
        ),
        get_executable_and_time=lambda key, *_: loads.append(list((tmp_path / LOADING_FOLDER).iterdir())),
        loads=loads,
    )
    assert {"LRUCache", "get_executable_and_time", "config"} <= vars(compilation_cache).keys()
    guard_jax(module, LoadingEntries(tmp_path), tmp_path / "jax")
    return module


def test_each_flipped_bit_of_an_entry_of_jax_is_a_miss_that_is_written_again(guarded, tmp_path):
    kept = guarded.LRUCache(str(tmp_path / "jax" / "cpu"), max_size=-1)
    kept.put("jit_f-1", b"machine code")
    (file,) = (tmp_path / "jax" / "cpu").iterdir()
    assert kept.get("jit_f-1") == b"machine code"
    assert kept.get("jit_f-2") is None
    whole = file.read_bytes()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for changed in flips(whole):
            file.write_bytes(changed)
            assert kept.get("jit_f-1") is None
            assert not file.exists()
    assert len(caught) == 8 * len(whole)
    kept.put("jit_f-1", b"machine code")
    assert file.read_bytes() == whole


def test_a_folder_that_the_user_has_named_stays_as_jax_writes_it(guarded, tmp_path):
    """Programs without usarmjx read it, and what they have written is neither refused nor removed."""
    theirs = tmp_path / "theirs"
    kept = guarded.LRUCache(str(theirs), max_size=-1)
    kept.put("jit_f-1", b"machine code")
    (file,) = theirs.glob("*-cache")
    assert file.read_bytes() == kept.get("jit_f-1") == b"machine code"
    file.write_bytes(b"other code")
    assert kept.get("jit_f-1") == b"other code"


def test_a_program_that_is_being_loaded_is_noted(guarded, tmp_path):
    guarded.get_executable_and_time("jit_f-1")
    ((note,),) = guarded.loads
    assert note.read_text() == ""  # afterwards
    assert note.name.endswith(f"-{os.getpid()}")


def test_another_jax_without_such_a_cache_keeps_nothing(tmp_path):
    updates = {}
    config = SimpleNamespace(config=SimpleNamespace(update=updates.__setitem__))
    with pytest.warns(UserWarning, match="keeps no compilations"):
        guard_jax(SimpleNamespace(config=config), LoadingEntries(tmp_path), tmp_path)
    assert updates == {"jax_compilation_cache_dir": None}


def test_a_program_that_has_imported_such_a_jax_keeps_nothing_either(tmp_path):
    """The cache was turned off for lack of checksums, and then on again."""
    code = """if True:
        import jax, jax._src.compilation_cache as module

        del module.LRUCache
        from usarmjx.base.compilation import enable_cache_after_import

        enable_cache_after_import()
        print(jax.config.jax_compilation_cache_dir)
    """
    rest = {name: text for name, text in os.environ.items() if name not in (JAX_FOLDER, PROGRAMS_FOLDER)}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=rest | {CACHE_VARIABLE: str(tmp_path / "kept")},
        check=True,
        capture_output=True,
        text=True,
    )
    assert done.stdout.split() == ["None"]
    assert "keeps no compilations" in done.stderr


def test_an_entry_that_ended_the_process_that_loaded_it_is_removed(tmp_path):
    """The process is gone before the context ends, as by SIGSEGV."""
    entry, other = tmp_path / "cache" / "jit_f-1-cache", tmp_path / "cache" / "other"
    for file in (entry, other, tmp_path / "outside"):
        file.parent.mkdir(exist_ok=True)
        file.touch()
    code = (
        "import os, sys; from pathlib import Path; from usarmjx.base.checked_cache import LoadingEntries\n"
        "notes = LoadingEntries(Path(sys.argv[1]))\n"
        "with notes.loading(Path(sys.argv[3])): pass\n"
        "with notes.loading(Path(sys.argv[4])), notes.loading(Path(sys.argv[2])): os.abort()"
    )
    paths = [str(path) for path in (tmp_path, entry, other, tmp_path / "outside")]
    crashed = subprocess.run([sys.executable, "-c", code, *paths], check=False, capture_output=True)
    assert crashed.returncode == -6
    assert remove_entries_of_crashes(tmp_path, tmp_path / "cache") == ["jit_f-1-cache"]
    assert not entry.exists()
    assert other.exists()
    assert (tmp_path / "outside").exists()
    assert not list((tmp_path / LOADING_FOLDER).iterdir())
    with LoadingEntries(tmp_path).loading(other):
        assert remove_entries_of_crashes(tmp_path, tmp_path / "cache") == []  # this process is alive


def test_the_checks_are_installed_when_jax_is_imported(tmp_path):
    """In the process that enables the cache and in those that it starts."""
    code = "import jax._src.compilation_cache as c; print(c.LRUCache.__name__)"
    enable = "from usarmjx.base.compilation import enable_compilation_cache as e; e()\n"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', 'import usarmjx; {code}'])"
    environment = {**os.environ, CACHE_VARIABLE: str(tmp_path / "cache")}
    environment.pop(JAX_FOLDER, None)
    done = subprocess.run(
        [sys.executable, "-c", f"{enable}{code}; {child}"],
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    )
    assert done.stdout.split() == ["CheckedCache"] * 2


# Warp's cache.


def test_each_flipped_bit_of_a_module_of_warp_removes_it(tmp_path):
    module = tmp_path / "1.0" / "wp_rays_12ab"
    module.mkdir(parents=True)
    (module / "rays.cubin").write_bytes(b"code")
    assert check_warp_folder(tmp_path) == []  # not yet listed
    seal_warp_folder(tmp_path)
    assert check_warp_folder(tmp_path) == []
    sealed = {path.name: path.read_bytes() for path in module.iterdir()}
    for name in ("rays.cubin", checked_cache.SUMS_FILE):
        for changed in [*flips(sealed[name]), b""]:
            (module / name).write_bytes(changed)
            with pytest.warns(UserWarning, match="wp_rays_12ab: it is not whole"):
                assert check_warp_folder(tmp_path) == [module.name]
            assert not module.exists()
            # As it was: each sealing would wait for the disk.
            module.mkdir()
            for file, content in sealed.items():
                (module / file).write_bytes(content)
    (module / "rays.sm90.cubin").write_bytes(b"more")  # of another GPU
    seal_warp_folder(tmp_path)
    (module / "rays.sm90.cubin").write_bytes(b"less")
    with pytest.warns(UserWarning, match="it is not whole"):
        assert check_warp_folder(tmp_path) == [module.name]


# Who may write.


def test_a_cache_that_others_may_write_to_is_not_used(tmp_path):
    said = {CACHE_VARIABLE: str(tmp_path / "cache")}
    assert enable_compilation_cache(dict(said)) is None
    assert own_cache_folder(said) == tmp_path / "cache"
    assert (tmp_path / "cache").stat().st_mode & 0o077 == 0
    for place in (tmp_path / "cache", tmp_path / "cache" / "jax"):
        place.chmod(0o770)
        asked = dict(said)
        complaint = enable_compilation_cache(asked)
        assert complaint is not None
        assert complaint.endswith(f"others may write to {place}: chmod -R go-w {place}")
        assert JAX_FOLDER not in asked
        assert own_cache_folder(said) is None
        place.chmod(0o700)
    tmp_path.chmod(0o777)
    assert f"anybody may rename the files in {tmp_path}" in str(enable_compilation_cache(dict(said)))
    tmp_path.chmod(0o1777)
    assert enable_compilation_cache(dict(said)) is None


def test_a_cache_of_another_user_is_not_used(tmp_path, monkeypatch):
    said = {CACHE_VARIABLE: str(tmp_path)}
    assert own_cache_folder(said) is not None
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    if tmp_path.stat().st_uid == 0:
        assert own_cache_folder(said) is not None  # root may do everything anyway
    else:
        assert own_cache_folder(said) is None
        assert "belongs to another user" in str(enable_compilation_cache(dict(said)))


def test_scripts_keep_what_they_compile_unless_told_not_to(tmp_path):
    """From the first batch on, though they have imported JAX already; importing usarmjx sets nothing."""
    code = """if True:
        import os, sys, jax, usarmjx
        from usarmjx.base import compilation

        print(jax.config.jax_compilation_cache_dir)
        scene = usarmjx.build_scene("yellow", ["P2AT"])
        for folder in ("off", sys.argv[1]):
            os.environ["USARMJX_CACHE"], compilation._asked = folder, False
            usarmjx.Batch(scene, worlds=1, engine="c")
            print(jax.config.jax_compilation_cache_dir)
    """
    rest = {name: text for name, text in os.environ.items() if name not in (JAX_FOLDER, PROGRAMS_FOLDER)}
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "kept")],
        env=rest,
        check=True,
        capture_output=True,
        text=True,
    )
    imported, off, on = done.stdout.split()
    assert (imported, off) == ("None", "None")
    assert on.startswith(str(tmp_path / "kept" / "jax"))
