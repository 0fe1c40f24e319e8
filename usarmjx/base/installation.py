"""The pip command that adds extras to this installation.

The project owns no name on a package index: `pip install usarmjx[...]` fails, or installs a stranger's code.
"""

import json
import sys
from importlib import metadata
from pathlib import Path
from urllib.parse import unquote, urlsplit

PACKAGE = Path(__file__).resolve().parents[1]
"""Folder of the package."""


def install_command(*extras: str) -> str:
    """Return the command that installs extras beside what is there."""
    names = f"[{','.join(extras)}]" if extras else ""
    root = PACKAGE.parent
    if (root / "pyproject.toml").is_file() and (root / "constraints.txt").is_file():
        if Path.cwd() == root:
            return f'pip install -c constraints.txt -e ".{names}"'
        return f'pip install -c "{root / "constraints.txt"}" -e "{root}{names}"'
    return f'pip install "{_wheel()}{names}"'


def _wheel() -> str:
    """Return the path of the wheel that was installed, else the name of the wheel of this version."""
    try:
        record = json.loads(metadata.distribution("usarmjx").read_text("direct_url.json") or "{}")
        path = unquote(urlsplit(str(record.get("url", ""))).path)
    except (metadata.PackageNotFoundError, ValueError, AttributeError):
        path = ""
    # An import of the package above would make everything that needs errors depend on all of it.
    version = sys.modules["usarmjx"].__version__
    return path if path.endswith(".whl") else f"usarmjx-{version}-py3-none-any.whl"
