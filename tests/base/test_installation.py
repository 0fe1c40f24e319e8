"""The command that installs extras: it works from a clone and from a wheel, and names no package index."""

import json
from importlib import metadata

import pytest

import usarmjx
from usarmjx.base import installation

WHEEL = f"usarmjx-{usarmjx.__version__}-py3-none-any.whl"
"""Name of the wheel, which pip refuses under any other."""


class Installed:
    """Metadata of an installation from an address."""

    def __init__(self, address: str) -> None:
        self._address = address

    def read_text(self, name: str) -> str | None:
        return json.dumps({"url": self._address}) if name == "direct_url.json" and self._address else None


def test_a_clone_is_installed_again_with_its_pins(monkeypatch, tmp_path):
    root = installation.PACKAGE.parent
    monkeypatch.chdir(root)
    assert installation.install_command("train") == 'pip install -c constraints.txt -e ".[train]"'
    assert installation.install_command("rl", "sb3").endswith('-e ".[rl,sb3]"')
    monkeypatch.chdir(tmp_path)
    assert installation.install_command("cuda") == (
        f'pip install -c "{root / "constraints.txt"}" -e "{root}[cuda]"'
    )


@pytest.mark.parametrize(
    ("address", "wheel"),
    [
        (
            "file:///tmp/my%20files/usarmjx-1.2.3-py3-none-any.whl",
            "/tmp/my files/usarmjx-1.2.3-py3-none-any.whl",
        ),
        ("", WHEEL),  # from somewhere that pip did not write down
    ],
)
def test_a_wheel_is_named_by_its_file(address, wheel, monkeypatch, tmp_path):
    monkeypatch.setattr(installation, "PACKAGE", tmp_path / "site-packages" / "usarmjx")
    monkeypatch.setattr(metadata, "distribution", lambda name: Installed(address))
    assert installation.install_command("train") == f'pip install "{wheel}[train]"'


def test_without_metadata_the_wheel_of_the_version_is_asked_for(monkeypatch, tmp_path):
    def missing(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(installation, "PACKAGE", tmp_path / "usarmjx")
    monkeypatch.setattr(metadata, "distribution", missing)
    assert installation.install_command() == f'pip install "{WHEEL}"'
