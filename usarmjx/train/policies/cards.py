"""Cards of the packaged policies: how each was made, its scores, and the hash of its file.

Facts of the file come from the file. Those of its training are in `cards.json`, from the records, or "not
recorded". A test compares hashes.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.base.registry import unknown_name
from usarmjx.train.policies import FOLDER, POLICIES
from usarmjx.train.policies.policy_file import NumpyPolicy, read_arrays
from usarmjx.train.task_names import newest_name

CARDS = FOLDER / "cards.json"


@dataclass(frozen=True, kw_only=True)
class PolicyCard:
    """Card of a packaged policy.

    Attributes:
        sha256: Hash of its file.
        trained: Engine, machine, time and commit of its training.
        seeds: Its seed, and how many there were.
        chosen: Rule of its choice among runs and checkpoints.
        settings: Settings of the training.
        curve: Scores in training over its length.
        score: Scores with 95 % intervals, and those of the baseline.
        ablation: Scores with something taken away.
    """

    sha256: str
    trained: str
    seeds: str
    chosen: str
    settings: str
    curve: str
    score: tuple[str, ...]
    ablation: str


def read_cards(file: Path = CARDS) -> dict[str, PolicyCard]:
    """Return the cards by the names of the policies."""
    rows: dict[str, dict[str, Any]] = json.loads(file.read_text(encoding="utf-8"))
    # Arguments are evaluated in their order: `score`, a list in JSON, is out before `row` is unpacked.
    return {name: PolicyCard(score=tuple(row.pop("score")), **row) for name, row in rows.items()}


def file_hash(file: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def card_text(name: str) -> str:
    """Return the card of a packaged policy as Markdown.

    Raises:
        UsageError: No policy of that name is packaged, or it has no card.
    """
    name, cards = newest_name(name), read_cards()
    if name not in POLICIES or name not in cards:
        raise UsageError(unknown_name("packaged policy", name, POLICIES.names()))
    card, file = cards[name], POLICIES.get(name)
    policy, (_, arrays) = NumpyPolicy(file), read_arrays(file)
    # Means and deviations of observations are no weights.
    count = sum(array.size for key, array in arrays.items() if key.startswith("weights/"))
    memory = f", memory of {policy.memory} units" if policy.memory else ""
    robots = [
        f"{group['name']} ({group['obs_size']} numbers in observation, {group['action_size']} in action)"
        for group in policy.groups
    ]
    fields = ", ".join(f"{key}={value}" for key, value in policy.overrides.items()) or "defaults"
    rows = {
        "task": policy.task,
        "robots": "; ".join(robots),
        "network": f"{policy.network}, {policy.layers} hidden layers{memory}, {count:,} weights",
        "action each": f"{policy.period:g} s",
        "fields of the task": fields,
        # Another file under this name must not get scores that it never had.
        "sha256": card.sha256 if card.sha256 == file_hash(file) else f"{card.sha256}, but the file differs",
        "trained": card.trained,
        "seeds": card.seeds,
        "chosen": card.chosen,
        "settings": card.settings,
        "curve": card.curve,
        # Numbered: rows are a dictionary, where one score would replace the other.
        **{f"score {i}" if len(card.score) > 1 else "score": one for i, one in enumerate(card.score, 1)},
        "ablation": card.ablation,
    }
    table = [f"| {key} | {value} |" for key, value in rows.items()]
    return "\n".join([f"# {name}", "", "| | |", "|---|---|", *table])
