"""Cards of the packaged policies."""

import json

import pytest
from typer.testing import CliRunner

from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.cards import CARDS, card_text, file_hash, read_cards


def test_each_packaged_policy_has_a_card_with_its_hash():
    """After a new policy: `sha256sum usarmjx/train/policies/NAME.npz`, into `cards.json` with its records."""
    found = {name: file_hash(file) for name, file in POLICIES}
    assert {name: card.sha256 for name, card in read_cards().items()} == found


def test_a_card_says_what_is_known():
    for name, row in json.loads(CARDS.read_text(encoding="utf-8")).items():
        assert row.pop("score"), name
        assert all(isinstance(value, str) and value for value in row.values()), name
        assert "differs" not in card_text(name)
    with pytest.raises(UsageError, match=r"packaged policy 'explor-v3'.*explore-v3"):
        card_text("explor-v3")


def test_the_command_prints_a_card():
    shown = CliRunner().invoke(app, ["list", "policies", "--card", "explore-v3"])
    assert shown.exit_code == 0
    assert "| network | set, 3 hidden layers, " in shown.output
    refused = CliRunner().invoke(app, ["list", "robots", "--card", "explore-v3"])
    assert refused.exit_code == 2
    assert "--card is for policies, not for robots" in refused.output
