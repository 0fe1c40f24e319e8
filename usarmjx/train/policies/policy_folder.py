"""A policy as a folder with a card, its configuration and its weights, as model hubs keep them.

`README.md` is the card: YAML that hubs index, then text. `config.json` has the facts of `policy_file` for
other programs, `policy.npz` is the policy's file with the same facts, which alone is read back.
"""

import json
from pathlib import Path

import numpy as np

from usarmjx.base.errors import UsageError, WriteError
from usarmjx.base.files import atomic_write
from usarmjx.train.policies.policy_file import NumpyPolicy, read_arrays

SUFFIX = ".policy"
"""Suffix of a folder to write; one that is read may have any name."""
CARD, CONFIG, WEIGHTS = "README.md", "config.json", "policy.npz"


def weights_in(folder: Path) -> Path | None:
    """Return the file of the policy that a folder holds; None: it is no such folder."""
    file = folder / WEIGHTS
    return file if file.is_file() else None


def check_place(folder: Path) -> None:
    """Refuse a place for a policy's folder that is a file.

    Raises:
        UsageError: It is one.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file; a policy's folder goes elsewhere")


def write_folder(file: Path, folder: Path) -> None:
    """Write a policy's file as a folder.

    Args:
        file: The policy.
        folder: To write; files of these names in it are replaced.

    Raises:
        UsageError: The place is a file, or the policy is broken.
        WriteError: The folder or a file in it cannot be written.
    """
    check_place(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(f"cannot write {folder}: {error.strerror}") from error
    about, arrays = read_arrays(file)
    with atomic_write(folder / WEIGHTS) as fresh:
        fresh.write_bytes(file.read_bytes())
    _write(folder / CONFIG, json.dumps({"library": "usarmjx", **about}, indent=2) + "\n")
    _write(folder / CARD, card_of(NumpyPolicy(file), arrays))


def card_of(policy: NumpyPolicy, arrays: dict[str, np.ndarray]) -> str:
    """Return the card of a policy as Markdown with YAML in front."""
    count = sum(array.size for name, array in arrays.items() if name.startswith("weights/"))
    groups = [
        f"| {group['name']} | {group['obs_size']} | {group['action_size']} |" for group in policy.groups
    ]
    settings = [f"- `{name}={value}`" for name, value in policy.overrides.items()]
    lines = [
        "---",
        "library_name: usarmjx",
        "pipeline_tag: reinforcement-learning",
        f"tags: [reinforcement-learning, robotics, usarmjx, {json.dumps(policy.task)}]",
        "---",
        "",
        f"# Policy for {policy.task}",
        "",
        f"A policy of usarmjx for the task `{policy.task}`: {policy.layers} hidden layers, memory of"
        f" {policy.memory} units, {count:,} weights, an action each {policy.period:g} s.",
        "",
        "| robot | numbers in observation | in action |",
        "|---|---|---|",
        *groups,
        "",
        *(["Settings of the task in training:", "", *settings, ""] if settings else []),
        "```console",
        "$ usarmjx eval FOLDER",
        "$ usarmjx play FOLDER --out policy.gif",
        "```",
        "",
        f"`usarmjx.train.NumpyPolicy('{WEIGHTS}')` runs it with NumPy alone.",
    ]
    return "\n".join(lines) + "\n"


def _write(file: Path, text: str) -> None:
    with atomic_write(file) as fresh:
        fresh.write_text(text, encoding="utf-8")


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of the files in a folder."""
    return sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path]))
