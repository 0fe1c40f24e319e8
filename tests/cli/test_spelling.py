"""One spelling for one thing: old spellings still work, are in no help, and each is told in a line."""

import pytest
from typer.testing import CliRunner

from benchmarks.cases import one_class
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import COUNTED, OTHER_ROBOT, RENAMED, app, respelt
from usarmjx.cli.common import chosen_out
from usarmjx.cli.listing import commands_of


def names_of(command):
    return {name for one in command.params for name in (*one.opts, *one.secondary_opts)}


COMMANDS = dict(commands_of(app))


@pytest.mark.parametrize(
    ("words", "now", "lines"),
    [
        ("serve --no-viewer --port 0", "serve --no-view --port 0", 1),
        ("radio-map yellow --ini=a.ini", "radio-map yellow --radio-ini=a.ini", 1),
        ("chaos --page-port 5 --self", "chaos --viewer-port 5 --self", 1),
        ("chaos --spectator-port 5 --self", "chaos --viewer-port 5 --self", 1),
        ("bench rays --robots 4 --worlds 2", "bench rays --worlds 2 --roster P2AT:4", 1),
        ("bench rays --robot Zerg", "bench rays --roster Zerg:16", 1),
        ("bench camera --robots=2 --robot=P2DX", "bench camera --roster P2DX:2", 1),
        ("bench viewer --robots 1 --robots 4", "bench viewer --roster P2AT:1 --roster P2AT:4", 1),
        ("bench radio --robots 4", "bench radio --roster P2AT:4", 1),
        (
            "bench serve --robots 4 --robot Zerg --robots 16",
            "bench serve --robot Zerg --roster P2AT:4 --roster P2AT:16",
            1,
        ),
        ("serve --ini a.ini", "serve --ini a.ini", 0),
        ("", "", 0),
    ],
)
def test_old_spellings_become_the_present_ones(words, now, lines):
    told = []
    assert respelt(words.split(), told.append) == now.split()
    assert len(told) == lines


def test_present_spellings_are_in_the_help_and_old_ones_are_not():
    for path, names in RENAMED.items():
        assert {*names.values()} <= names_of(COMMANDS[path])
        assert not {*names} & names_of(COMMANDS[path])
    for path in COUNTED:
        assert "--roster" in names_of(COMMANDS[path])
        old = {"--robots"} if path in OTHER_ROBOT else {"--robots", "--robot"}
        assert not old & names_of(COMMANDS[path])


def test_the_spectators_page_is_the_live_page_now():
    """In one line, whatever its port was."""
    for words in (["serve", "--spectator-port", "5005"], ["play", "wander", "--spectator-port=0"]):
        result = CliRunner().invoke(app, words)
        assert (result.exit_code, result.stdout) == (2, "")
        assert result.stderr.endswith("the live page replaces that page: --viewer-port sets its port\n")
        assert result.stderr.count("\n") == 1


def test_an_old_spelling_works_and_is_told_on_the_error_stream():
    result = CliRunner().invoke(app, ["serve", "--no-viewer", "--instance", "3"])
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.splitlines() == [
        "usarmjx: --no-viewer is called --no-view now",
        "usarmjx: instance 3 is not among worlds 0 to 0",
    ]


SAME = {"--seed", "--worlds", "--engine", "--arena", "--out", "--checkpoint", "--task", "--realtime-factor"}


def test_the_same_thing_has_one_name():
    """No command has another name for where to write to, for a roster, or for settings."""
    found = {path: names_of(command) for path, command in COMMANDS.items()}
    assert {*SAME} <= {name for names in found.values() for name in names}
    for path, names in found.items():
        assert not names & {"--output", "--robots-per-world", "--num-envs", "--num-worlds", "--random-seed"}
        if "--set" in names:
            assert "-c" in names, path
        shown = [one.name for one in COMMANDS[path].params if not getattr(one, "hidden", False)]
        out_of_place = [
            one.name
            for one in COMMANDS[path].params
            if one.param_type_name == "argument" and one.name == "out" and one.name in shown
        ]
        assert out_of_place == [], path


def test_where_to_write_to(capsys, tmp_path):
    assert chosen_out(tmp_path, None) == tmp_path
    assert capsys.readouterr().err == ""
    assert chosen_out(None, tmp_path) == tmp_path
    assert capsys.readouterr().err == f"usarmjx: the file to write is an option now: --out {tmp_path}\n"
    with pytest.raises(UsageError, match="--out PATH"):
        chosen_out(None, None)
    with pytest.raises(UsageError, match="too much"):
        chosen_out(tmp_path, tmp_path)


@pytest.mark.parametrize(
    "words",
    [
        ["portraits", "{folder}/robots.png", "Dalek"],
        ["portraits", "Dalek", "--out", "{folder}/robots.png"],
        ["radio-map", "yellow", "{folder}/a.png", "--from", "0"],
        ["export", "{folder}/nowhere", "{folder}/a.npz"],
    ],
)
def test_the_place_where_to_write_to_is_understood_in_both_forms(words, tmp_path):
    result = CliRunner().invoke(app, [word.format(folder=tmp_path) for word in words])
    assert result.exit_code == 2
    said = [line for line in result.stderr.splitlines() if not line.endswith(" ...")]
    assert len(said) == (1 if "--out" in words else 2), said
    assert any(bad in said[-1] for bad in ("Dalek", "x,y or x,y,z", "nowhere")), said


def test_a_roster_of_one_class():
    assert one_class("P2AT:3") == ("P2AT", 3)
    assert one_class("p2dx") == ("P2DX", 1)
    for bad in ("", "P2AT,P2DX", "P2AT:0"):
        with pytest.raises(UsageError, match="--roster"):
            one_class(bad)


@pytest.mark.parametrize("words", [["--out", "x"], ["explore-v1", "--task", "explore-v1", "--out", "x"]])
def test_a_training_has_one_task(words):
    result = CliRunner().invoke(app, ["train", *words])
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("usarmjx: name one task")
    assert result.stderr.count("\n") == 1
