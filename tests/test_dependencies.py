"""What `dev.py audit` and `dev.py sbom` say, and when they say that they cannot."""

import json
import re
import subprocess
import sys
from importlib import metadata

import pytest
from packaging.utils import canonicalize_name

import dev
from tools import dependencies

PINS = (
    "# a comment\nnumpy==2.4.6\njax==0.10.2; python_version < '3.0'\njax==0.11.2; python_version >= '3.0'\n"
)
PLACES = {"type", "bom-ref", "name", "version", "scope", "purl", "licenses"}
"""Fields of a component that we use, all of CycloneDX 1.6."""


@pytest.fixture(scope="module")
def bill():
    return dependencies.sbom(dependencies.pins(dependencies.CONSTRAINTS.read_text(encoding="utf-8")))


def test_pins_are_those_of_this_python():
    assert dependencies.pins(PINS) == {"numpy": "2.4.6", "jax": "0.11.2"}


def test_pins_of_another_python():
    assert dependencies.pins(PINS, "2.7") == {"numpy": "2.4.6", "jax": "0.10.2"}


@pytest.mark.parametrize(
    ("about", "found"),
    [
        ({"license_expression": "MIT OR X", "license": "old"}, "MIT OR X"),
        (
            {"classifier": ["License :: OSI Approved", "License :: OSI Approved :: ISC License"]},
            "ISC License",
        ),
        ({"license": "BSD-3-Clause"}, "BSD-3-Clause"),
        ({"license": "Mine\n\nPermission is hereby\ngranted, free of charge, to"}, "MIT License"),
        ({"license": "Copyright\nall rights reserved"}, ""),
        ({}, ""),
    ],
)
def test_a_licence_is_what_the_metadata_state(about, found):
    assert dependencies.licence_names(dependencies.stated_licences(about)) == found


def test_every_pin_that_is_installed_states_a_licence(bill):
    here = {canonicalize_name(one.name) for one in metadata.distributions()}
    unknown = {one["name"] for one in bill["components"] if "licenses" not in one}
    assert unknown & here == set()


def test_packages_of_the_images_have_a_licence_wherever_the_bill_is_made():
    """NVIDIA's are installed nowhere but there; `tools/lock.py` has kept what they state."""
    pinned = dependencies.pins(dependencies.CONSTRAINTS.read_text(encoding="utf-8"), "3.12")
    found = {one["name"]: one for one in dependencies.sbom(pinned)["components"]}
    kept = dependencies.kept_licences()
    assert ("nvidia-cublas", found["nvidia-cublas"]["version"]) in kept
    assert [name for name, _ in kept if not found[name].get("licenses")] == []


def test_the_bill_has_what_the_schema_requires(bill):
    """CycloneDX 1.6: fields that must be there, the forms that they have, and where references lead."""
    assert (bill["bomFormat"], bill["specVersion"], bill["version"]) == ("CycloneDX", "1.6", 1)
    uuid = "[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}"
    assert re.fullmatch(f"urn:uuid:{uuid}", bill["serialNumber"])
    assert bill["metadata"]["component"].keys() >= {"type", "name"}
    refs = [bill["metadata"]["component"]["bom-ref"]]
    for one in bill["components"]:
        assert {"type", "name"} <= one.keys() <= PLACES
        assert (one["type"], one["scope"] in ("required", "optional")) == ("library", True)
        refs.append(one["bom-ref"])
        stated = one.get("licenses", [])
        kinds = [next(iter(entry)) for entry in stated]
        assert kinds in (["expression"], ["license"] * len(kinds)), "one expression, or licences"
        assert all(entry.get("expression") or entry["license"]["name"] for entry in stated)
    assert len(set(refs)) == len(refs)
    assert sorted(entry["ref"] for entry in bill["dependencies"]) == sorted(refs)
    assert {to for entry in bill["dependencies"] for to in entry["dependsOn"]} <= set(refs)


def test_the_bill_has_every_pin_with_what_is_known_of_it(bill):
    found = {one["name"]: one for one in bill["components"]}
    pinned = dependencies.pins(dependencies.CONSTRAINTS.read_text(encoding="utf-8"))
    assert {name: one["version"] for name, one in found.items()} == pinned
    numpy, pytest_, cuda = found["numpy"], found["pytest"], found["nvidia-cublas"]
    assert numpy["purl"] == f"pkg:pypi/numpy@{pinned['numpy']}"
    assert "BSD-3-Clause" in numpy["licenses"][0]["expression"]
    assert (numpy["scope"], pytest_["scope"], cuda["scope"]) == ("required", "optional", "optional")
    needs = {entry["ref"]: entry["dependsOn"] for entry in bill["dependencies"]}
    assert numpy["purl"] in needs[found["scipy"]["purl"]]
    assert numpy["purl"] in needs[bill["metadata"]["component"]["bom-ref"]]
    assert "://" not in json.dumps(bill), "no host of a registry"


def test_the_same_packages_give_the_same_file(bill, tmp_path):
    out = tmp_path / "sbom.json"
    assert dependencies.write_sbom([str(out)]) == 0
    assert json.loads(out.read_text()) == bill
    other = dependencies.sbom({"numpy": "1.0"})
    assert other["serialNumber"] != bill["serialNumber"]
    assert dependencies.write_sbom([str(tmp_path / "none" / "x.json")]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["sbom.json"]
    assert dependencies.write_sbom([str(out), "--python", "3.12"]) == 0
    jax = next(one for one in json.loads(out.read_text())["components"] if one["name"] == "jax")
    assert jax["version"] == dependencies.pins(dependencies.CONSTRAINTS.read_text(), "3.12")["jax"]


def package(name, *faults, skipped=False):
    if skipped:
        return {"name": name, "skip_reason": "not found"}
    return {"name": name, "version": "1", "vulns": [{"id": f, "fix_versions": ["2"]} for f in faults]}


@pytest.mark.parametrize(
    ("packages", "status", "says"),
    [
        ([package("a"), package("b")], 0, "audit: 0 known vulnerabilities in 2 packages"),
        ([package("a"), package("b", skipped=True)], 0, "in 1 packages; not looked up: b"),
        ([package("a", "CVE-1")], 1, "a 1: CVE-1, mended in 2\naudit: 1 known"),
        ([package("a", skipped=True)], 2, "could not run: none of 1 packages could be looked up"),
    ],
)
def test_what_an_audit_found_is_its_status(packages, status, says):
    """As pip-audit 2.10 writes it, whose own status is 0 where a mirror knows nothing of faults."""
    found, text = dependencies.verdict(json.dumps({"dependencies": packages}), "")
    assert (found, says in text) == (status, True)


def test_an_audit_without_network_or_tool_says_so_in_a_line(monkeypatch, capsys):
    status, text = dependencies.verdict("", "Traceback\n  File\nConnectionError: no route to host\n")
    assert (status, text) == (2, "audit: could not run: pip-audit failed: ConnectionError: no route to host")
    monkeypatch.setattr(dependencies, "auditor", lambda: [])
    assert dependencies.audit([]) == 2
    assert capsys.readouterr().out.count("\n") == 1
    broken = [sys.executable, "-c", "import sys; sys.exit('no network')"]
    monkeypatch.setattr(dependencies, "auditor", lambda: broken)
    assert dependencies.audit([]) == 2
    assert capsys.readouterr().out == "audit: could not run: pip-audit failed: no network\n"


def test_the_verbs_of_a_contributor_lead_there():
    for name, rest in (("audit", ["--strict"]), ("sbom", ["x.json"])):
        assert dev.VERBS[name].steps(*rest) == [["-m", "tools.dependencies", name, *rest]]
    done = subprocess.run(
        [sys.executable, "-m", "tools.dependencies", "sbom"], cwd=dev.ROOT, capture_output=True, text=True
    )
    assert json.loads(done.stdout)["bomFormat"] == "CycloneDX"
