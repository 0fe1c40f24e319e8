"""Locks with hashes: made from pip's report, of the pinned versions, without the address of an index."""

import json
import os
import re
import shutil
import subprocess
from importlib import metadata

import pytest

import dev
from tools import dependencies, lock

LOCKS = sorted((dev.ROOT / "locks").glob("*.txt"))
DOCKERFILE = (dev.ROOT / "Dockerfile").read_text(encoding="utf-8")


def package(name, version="1.0", licence="MIT", **hashes):
    found = {"archive_info": {"hashes": hashes}} if hashes else {}
    about = {"name": name, "version": version, "license": licence}
    return {"metadata": about, "download_info": {"url": "x", **found}}


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
    licences = tmp_path / "locks" / "cpu-3.12-linux-x86_64.licences.tsv"
    assert licences.read_text() == "flax\t1.0\tMIT\nnumpy\t2.4.6\tMIT\n"
    report["install"][-1]["requested_extras"] = ["cuda", "train"]
    assert lock.lock_file(report) == tmp_path / "locks" / "cuda-3.12-linux-x86_64.txt"
    with pytest.raises(ValueError, match="other states no licence"):
        lock.licences_text({"install": [package("other", licence="")]})
    with pytest.raises(ValueError, match="other has no sha256"):
        lock.lock_text({"install": [package("other")]})
    assert lock.main([]) == 2


def python_of(file):
    return file.stem.split("-")[1]


def locked(file):
    """Versions by name in a lock, each line of which has a hash."""
    lines = [line for line in file.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return dict(
        re.fullmatch(r"([a-z0-9-]+)==(\S+) --hash=sha256:[0-9a-f]{64}", line).groups() for line in lines
    )


@pytest.mark.parametrize("file", LOCKS, ids=lambda file: file.stem)
def test_lock_pins_bill_and_licences_name_the_same_versions(file):
    """The bill is of all pins, the lock of those that the image has; the licences are the lock's."""
    versions = locked(file)
    assert len(versions) > 30
    pinned = dependencies.pins(dependencies.CONSTRAINTS.read_text(encoding="utf-8"), python_of(file))
    bill = {one["name"]: one["version"] for one in dependencies.sbom(pinned)["components"]}
    assert bill == pinned
    assert versions == {name: bill[name] for name in versions}
    rows = [line.split("\t") for line in lock.licences_file(file).read_text(encoding="utf-8").splitlines()]
    assert {name: version for name, version, _ in rows} == versions
    assert all(licence.strip() for _, _, licence in rows)


@pytest.mark.parametrize("file", LOCKS, ids=lambda file: file.stem)
def test_licences_beside_a_lock_are_those_that_packages_state(file):
    """Of what is installed here in the same version."""
    rows = [line.split("\t") for line in lock.licences_file(file).read_text(encoding="utf-8").splitlines()]
    here = {one.name.lower().replace("_", "-"): one.version for one in metadata.distributions()}
    same = [(name, licence) for name, version, licence in rows if here.get(name) == version]
    assert len(same) > 30
    for name, licence in same:
        assert (name, dependencies.licence_names(dependencies.licences(name))) == (name, licence)


def test_both_images_compare_hashes():
    (python,) = re.findall(r"^ARG PYTHON=(\S+)", DOCKERFILE, re.M)
    for image in ("cpu", "cuda"):
        assert dev.ROOT / "locks" / f"{image}-{python}-linux-x86_64.txt" in LOCKS
        _, _, stage = DOCKERFILE.partition(f"FROM base AS {image}\n")
        installs = re.findall(r"^RUN (.*)", stage.partition("\nFROM ")[0], re.M)
        assert installs[0] == f"sh /usarmjx/locks/install.sh {image}"
        assert installs[1].startswith("pip install")


@pytest.mark.parametrize(("image", "said"), [("cpu", "--require-hashes --no-deps -r "), ("gpu", "no hashes")])
def test_a_lock_is_installed_where_there_is_one_of_this_python_and_machine(tmp_path, image, said):
    folder = tmp_path / "locks"
    folder.mkdir()
    for name, text in (
        ("pip", "#!/bin/sh\necho pip $*\n"),
        ("python", "#!/bin/sh\necho 3.12-linux-x86_64\n"),
    ):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    shutil.copy(dev.ROOT / "locks" / "install.sh", folder)
    (folder / "cpu-3.12-linux-x86_64.txt").touch()
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    words = ["sh", str(folder / "install.sh"), image]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    assert said in done.stdout
    assert f"{image}-3.12-linux-x86_64.txt" in done.stdout


@pytest.mark.parametrize(
    ("release", "base", "builds"),
    [
        ("", "python:3.12-slim", True),
        ("yes", "python:3.12-slim", False),
        ("yes", "python@sha256:" + "0a" * 32, True),
        ("yes", "python@sha256:" + "0a" * 31, False),
    ],
)
def test_the_base_of_a_release_is_named_by_digest(release, base, builds):
    assert set(re.findall(r"^FROM (\S+)", DOCKERFILE, re.M)) == {"${BASE}", "base"}
    (check,) = re.findall(r"^RUN (if \[ -n (?:.*\\\n)*.*)$", DOCKERFILE, re.M)
    words = ["sh", "-c", check.replace("\\\n", "")]
    environment = os.environ | {"RELEASE": release, "BASE": base}
    assert (subprocess.run(words, env=environment, capture_output=True).returncode == 0) is builds
