"""Locks with hashes: made from pip's report, of the pinned versions, without the address of an index."""

import json
import re

import pytest

import dev
from tools import dependencies, lock

LOCKS = sorted((dev.ROOT / "locks").glob("*.txt"))
DOCKERFILE = (dev.ROOT / "Dockerfile").read_text(encoding="utf-8")


def package(name, version="1.0", **hashes):
    found = {"archive_info": {"hashes": hashes}} if hashes else {}
    return {"metadata": {"name": name, "version": version}, "download_info": {"url": "x", **found}}


def test_a_lock_has_a_hash_of_each_package_but_our_own(tmp_path, monkeypatch):
    report = {
        "environment": {"python_version": "3.12", "sys_platform": "linux", "platform_machine": "x86_64"},
        "install": [package("Numpy", "2.4.6", sha256="ab"), package("flax", sha256="cd"), package("usarmjx")],
    }
    monkeypatch.setattr(lock, "ROOT", tmp_path)
    (tmp_path / "report.json").write_text(json.dumps(report))
    assert lock.main([str(tmp_path / "report.json")]) == 0
    text = (tmp_path / "locks" / "cpu-3.12-linux-x86_64.txt").read_text()
    assert text == lock.HEAD + "flax==1.0 --hash=sha256:cd\nnumpy==2.4.6 --hash=sha256:ab\n"
    with pytest.raises(ValueError, match="other has no sha256"):
        lock.lock_text({"install": [package("other")]})
    assert lock.main([]) == 2


@pytest.mark.parametrize("file", LOCKS, ids=lambda file: file.stem)
def test_locks_are_of_the_pinned_versions(file, monkeypatch):
    python = file.stem.split("-")[1]
    lines = [line for line in file.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    assert len(lines) > 30
    text = dependencies.CONSTRAINTS.read_text(encoding="utf-8")
    where = {"python_version": python}
    wanted = [dependencies.Requirement(line) for line in re.findall(r"^[^#\n]+", text, re.MULTILINE)]
    pinned = {
        dependencies.canonicalize_name(one.name): next(iter(one.specifier)).version
        for one in wanted
        if one.marker is None or one.marker.evaluate(where)
    }
    for line in lines:
        name, version = re.fullmatch(r"([a-z0-9-]+)==(\S+) --hash=sha256:[0-9a-f]{64}", line).groups()
        assert pinned[name] == version


def test_the_image_compares_hashes_and_its_base_may_be_named_by_digest():
    (python,) = re.findall(r"^ARG PYTHON=(\S+)", DOCKERFILE, re.M)
    assert dev.ROOT / "locks" / f"cpu-{python}-linux-x86_64.txt" in LOCKS
    assert 'pip install --no-cache-dir --require-hashes --no-deps -r "$lock"' in DOCKERFILE
    assert set(re.findall(r"^FROM (\S+)", DOCKERFILE, re.M)) == {"${BASE}", "base"}
