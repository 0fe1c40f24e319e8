"""What `dev.py audit` and `dev.py sbom` do: known faults of the pinned packages, and a list of them.

Both look at `constraints.txt`. The list is in CycloneDX's format, made from what is installed here; it has no
date and no random number, so that the same packages give the same file.
"""

import argparse
import hashlib
import importlib.util
import json
import shutil
import subprocess
import sys
import uuid
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
CONSTRAINTS = ROOT / "constraints.txt"
LOCKS = ROOT / "locks"
PRODUCT = "usarmjx"
CYCLONEDX = "1.6"
COULD_NOT_RUN = 2
"""Exit status where nothing is known, good or bad."""
LONGEST_LICENCE = 100  # characters; some put the whole text into the field for its name
PHRASES = {
    "Permission is hereby granted, free of charge": "MIT License",
    "Redistribution and use in source and binary forms": "BSD License",
}
"""Licences by words of their texts."""


def pins(text: str, python: str | None = None) -> dict[str, str]:
    """Return the versions by name that the lines of a constraints file pin.

    Args:
        text: The file.
        python: For which Python, as "3.12"; None: for this one.
    """
    lines = [line.split("#")[0].strip() for line in text.splitlines()]
    wanted = [Requirement(line) for line in lines if line]
    where = None if python is None else {"python_version": python, "python_full_version": f"{python}.0"}
    return {
        canonicalize_name(one.name): next(iter(one.specifier)).version
        for one in wanted
        if one.marker is None or one.marker.evaluate(where)
    }


def needs(name: str, extras: Iterable[str]) -> list[Requirement]:
    """Return what an installed package needs with some of its extras; nothing if it is not installed."""
    try:
        lines = metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return []
    chosen = ("", *extras)
    found = [Requirement(line) for line in lines]
    return [one for one in found if not one.marker or any(one.marker.evaluate({"extra": e}) for e in chosen)]


def graph(roots: Iterable[Requirement]) -> dict[str, set[str]]:
    """Return which packages each package needs, from some that are needed, by name."""
    queue, found, seen = list(roots), dict[str, set[str]](), set[tuple[str, frozenset[str]]]()
    while queue:
        wanted = queue.pop()
        name = canonicalize_name(wanted.name)
        visit = (name, frozenset(wanted.extras))
        if visit in seen:
            continue
        seen.add(visit)
        next_ones = needs(name, wanted.extras)
        found.setdefault(name, set()).update(canonicalize_name(one.name) for one in next_ones)
        queue += next_ones
    return found


def licences(name: str) -> list[dict[str, Any]]:
    """Return the licences that an installed package states, as CycloneDX writes them."""
    try:
        return stated_licences(metadata.metadata(name).json)
    except metadata.PackageNotFoundError:
        return []


def kept_licences() -> dict[tuple[str, str], str]:
    """Return licences by name and version of the packages that images install, kept by `tools/lock.py`."""
    files = sorted(LOCKS.glob("*.licences.tsv"))
    rows = [line.split("\t") for file in files for line in file.read_text(encoding="utf-8").splitlines()]
    return {(name, version): licence for name, version, licence in rows}


def stated_licences(about: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the licences in the metadata of a package, as CycloneDX writes them.

    Args:
        about: Metadata in the form of JSON, as pip's reports have it.
    """
    if expression := about.get("license_expression"):
        return [{"expression": expression}]
    parts = [line.split(" :: ") for line in about.get("classifier", ())]
    names = [words[-1] for words in parts if words[0] == "License" and words[-1] != "OSI Approved"]
    stated = (about.get("license") or "").strip()
    if not names and stated and "\n" not in stated and len(stated) <= LONGEST_LICENCE:
        names = [stated]
    if not names:
        text = " ".join(stated.split())
        names = [licence for phrase, licence in PHRASES.items() if phrase in text][:1]
    return [{"license": {"name": one}} for one in names]


def licence_names(stated: Iterable[Mapping[str, Any]]) -> str:
    """Return licences as a line of text has them; nothing if there are none."""
    return ", ".join(one.get("expression") or one["license"]["name"] for one in stated)


def _kept(kept: Mapping[tuple[str, str], str], name: str, version: str) -> list[dict[str, Any]]:
    """Return a kept licence of a package that is not installed here, as CycloneDX writes it."""
    licence = kept.get((name, version))
    return [] if licence is None else [{"license": {"name": licence}}]


def purl(name: str, version: str) -> str:
    """Return the package URL by which the world knows a version of a package."""
    return f"pkg:pypi/{name}@{version}"


def sbom(versions: dict[str, str]) -> dict[str, Any]:
    """Return the software bill of materials of usarmjx with pinned packages, as CycloneDX JSON has it."""
    product = f"pkg:generic/{PRODUCT}@{metadata.version(PRODUCT)}"
    refs = {name: purl(name, version) for name, version in versions.items()}
    bare, kept = graph([Requirement(PRODUCT)]), kept_licences()
    edges = graph([Requirement(PRODUCT), *map(Requirement, versions)])
    components = [
        {
            "type": "library",
            "bom-ref": refs[name],
            "name": name,
            "version": version,
            "scope": "required" if name in bare else "optional",
            "purl": refs[name],
        }
        | ({"licenses": found} if (found := licences(name) or _kept(kept, name, version)) else {})
        for name, version in sorted(versions.items())
    ]
    dependencies = [
        {"ref": ref, "dependsOn": sorted(refs[one] for one in edges.get(name, ()) if one in refs)}
        for name, ref in [(PRODUCT, product), *sorted(refs.items())]
    ]
    content = hashlib.sha256(json.dumps([components, dependencies]).encode()).hexdigest()
    about = {"type": "application", "bom-ref": product, "name": PRODUCT, "purl": product}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": CYCLONEDX,
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_OID, content)}",
        "version": 1,
        "metadata": {"component": {**about, "version": metadata.version(PRODUCT)}},
        "components": components,
        "dependencies": dependencies,
    }


def write_sbom(args: Sequence[str]) -> int:
    """Write the list to a file, or to standard output; name those that state no licence on the error stream.

    Args:
        args: The file, if any; `--python 3.12`: of the pins of that Python.
    """
    parser = argparse.ArgumentParser(prog="dev.py sbom")
    parser.add_argument("out", nargs="?", type=Path, help="file; else standard output")
    parser.add_argument("--python", metavar="X.Y", help="of the pins of this Python, such as the image's")
    options = parser.parse_args(args)
    bill = sbom(pins(CONSTRAINTS.read_text(encoding="utf-8"), options.python))
    if unknown := [one["name"] for one in bill["components"] if "licenses" not in one]:
        sys.stderr.write(
            f"sbom: no licence is known of {', '.join(unknown)}: not installed, or states none\n"
        )
    text = json.dumps(bill, indent=1) + "\n"
    if options.out is None:
        sys.stdout.write(text)
        return 0
    fresh = Path(f"{options.out}.unfinished")
    try:
        fresh.write_text(text, encoding="utf-8")
        fresh.replace(options.out)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        sys.stderr.write(f"sbom: cannot write {options.out}: {error.strerror}\n")
        return COULD_NOT_RUN
    return 0


def auditor() -> list[str]:
    """Return the command line of pip-audit, of this environment or of the machine; [] where there is none."""
    if importlib.util.find_spec("pip_audit"):
        return [sys.executable, "-m", "pip_audit"]
    found = shutil.which("pip-audit")
    return [found] if found else []


def verdict(output: str, complaint: str) -> tuple[int, str]:
    """Return the exit status of an audit and what to say, from what pip-audit wrote.

    Its own status is 0 also where it could look up nothing, and 1 both for a find and for a failure.
    """
    try:
        packages = json.loads(output)["dependencies"]
    except (ValueError, KeyError, TypeError):
        last = complaint.strip().splitlines()[-1:] or ["it said nothing"]
        return COULD_NOT_RUN, f"audit: could not run: pip-audit failed: {last[0]}"
    looked_up = [one for one in packages if "skip_reason" not in one]
    if not looked_up:
        return COULD_NOT_RUN, f"audit: could not run: none of {len(packages)} packages could be looked up"
    lines = [
        f"{one['name']} {one['version']}: {fault['id']}, mended in {', '.join(fault['fix_versions']) or '-'}"
        for one in looked_up
        for fault in one["vulns"]
    ]
    skipped = [one["name"] for one in packages if "skip_reason" in one]
    rest = f"; not looked up: {', '.join(skipped)}" if skipped else ""
    summary = f"audit: {len(lines)} known vulnerabilities in {len(looked_up)} packages{rest}"
    return int(bool(lines)), "\n".join([*lines, summary])


def audit(args: Sequence[str]) -> int:
    """Let pip-audit look for known vulnerabilities of the pinned packages.

    Returns:
        0: none is known, 1: some are, 2: it could not run.
    """
    command = auditor()
    if not command:
        print("audit: could not run: pip-audit is not there; install it, here or on this machine")
        return COULD_NOT_RUN
    command += ["--requirement", str(CONSTRAINTS), "--no-deps", "--disable-pip", "--format", "json"]
    done = subprocess.run([*command, "--progress-spinner", "off", *args], capture_output=True, text=True)
    status, text = verdict(done.stdout, done.stderr)
    print(text)
    return status


if __name__ == "__main__":
    sys.exit({"audit": audit, "sbom": write_sbom}[sys.argv[1]](sys.argv[2:]))
