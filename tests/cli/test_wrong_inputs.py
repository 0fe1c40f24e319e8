"""Wrong inputs over all commands: status 2, no standard output, and the cure in the message."""

import pytest
from typer.testing import CliRunner

from usarmjx.cli.app import app

ONE_LINE = {
    "serve --arena yelow": "did you mean 'yellow'?",
    "serve --roster P2AT:x": "not of the form CLASS:COUNT, as P2AT:4",
    "serve --roster P3DZ:1 --engine jax": "P2AT",
    "serve --engine cuda": "known: auto, c, jax, planar, warp",
    "serve --allow 10.0.0.0/99 --host 0.0.0.0": "as 10.0.0.0/8",
    "serve --dialect ros": "known: manual, udk",
    "serve --instances 5 --worlds 2": "worlds 0 to 1",
    "serve --ini nowhere.ini": "nowhere.ini: cannot be read",
    "train": "usarmjx train explore",
    "train drive-to-gaol": "did you mean 'drive-to-goal'?",
    "train drive-to-goal --set lr=1": "learning_rate",
    "train drive-to-goal --set radius=-1": "expected a number above 0 [m]",
    "train drive-to-goal --set radius": "name=value",
    "train drive-to-goal --engine cuda": "known: auto, c, jax, planar, warp",
    "train drive-to-goal --resume --out nowhere": "nothing to resume in nowhere",
    "train drive-to-goal --from nowhere": "name the folder of a run",
    "train drive-to-goal --config nowhere.yaml": "nowhere.yaml: cannot be read",
    "train nowhere.py:Task": "there is no file",
    "train drive-to-goal --seeds 2 --processes 2": "leave out --processes, or --seeds",
    "train drive-to-goal --seeds 2 --clips 5": "--clips shows a single seed",
    "train drive-to-goal --print-config --set nosuch=1": "no setting 'nosuch'",
    "eval": "a run, file or packaged policy, or a --baseline",
    "eval nowhere": "drive-to-goal, explore-v1",
    "eval drive-to-gaol": "drive-to-goal, explore-v1",
    "eval drive-to-goal --engine cuda": "known: auto, c, jax, planar, warp",
    "eval drive-to-goal --set radius=x": "expected a number above 0 [m]",
    "eval --baseline nobody": "known: assignment, chain, convoy",
    "eval explore --split tset": "did you mean 'test'?",
    "play nowhere": "drive-to-goal, explore-v1",
    "play drive-to-goal --engine cuda": "known: auto, c, jax, planar, warp",
    "play drive-to-goal --out x.txt": "end in .png, .gif",
    "play --baseline nobody": "known: assignment, chain, convoy",
    "teams drive-to-goal": "no task for a team",
    "teams drive-to-goal --ablate": "its score has no parts",
    "teams explor": "did you mean 'explore'?",
    "teams explore-v1 nobody": "drive-to-goal, explore-v1",
    "sweep nowhere.yaml": "robustness, teams, thousand",
    "sweep thousand --set episodes=x": "expected a whole number from 1",
    "sweep thousand --set nosuch=1 --plan": "episode_steps",
    "sweep show nowhere": "it has no sweep.json",
    "export drive-to-goal --out goal.pt": "as .npz or .onnx",
    "export drive-to-gaol --out goal.npz": "did you mean 'drive-to-goal'?",
    "export drive-to-goal": "--out PATH",
    "curves nowhere": "neither a file of benchmark records nor the folder of a run",
    "portraits Dalek --out x.png": "P2AT",
    "arena draw yelow --png x.png": "did you mean 'yellow'?",
    "arena check nowhere.yaml": "there is no such file",
    "arena generate --kind castle --yaml x.yaml": "known: building, collapsed, maze",
    "arena generate --kind maze --size 12 --yaml x.yaml": "12x8",
    "list robotss": "known: everything, robots",
    "view nowhere.mcap": "cannot be read",
    "plot nowhere.mcap": "--png FILE, --pdf FILE",
    "replay nowhere.mcap": "cannot be read",
    "bench step --engine cuda": "known: auto, c, jax, planar, warp",
    "bench step --physics slow": "known: coarse, fast, reference, sleeping",
    "calibrate Dalek": "P2AT",
    "record mission.mcap": "--record FILE.mcap of serve",
    "suite run baseline --suite nosuch": "drive-v1, teams-v1",
    "suite run baseline --split tset": "did you mean 'test'?",
    "suite run nothing-there": "drive-to-goal, explore-v1",
    "suite run mine baseline:nobody": "known: assignment, chain, convoy",
    "suite run mine mine:random": "drive-to-goal, explore-v1",
    "suite run mine nowhere.py:act": "nowhere.py: there is no such file",
    "suite run baseline --engine cuda": "known: auto, c, jax, planar, warp",
    "suite show nowhere": "nowhere: cannot be read",
    "suite replay nowhere.json": "nowhere.json: cannot be read",
    "suite leaderboard nowhere": "nowhere: cannot be read",
    "sweep report nowhere": "it has no sweep.json",
    "sweep compare nowhere elsewhere": "it has no sweep.json",
    "sweep teams --figure x.bmp --plan": ".png",
    "film nowhere.mcap --out x.mp4": "nowhere.mcap: cannot be read",
    "film nowhere.mcap --out x.txt": "films end in .mp4, .gif, .png, .jpg",
    "film nowhere.mcap --out x.mp4 --size 12": "as 1920x1080",
    "robot check nowhere.urdf": "there is no such file",
    "robot check P2AT": "P2AT: there is no such file",
    "robot export P2TA --out x.urdf": "did you mean 'P2AT'?",
    "robot export P2AT --out x.obj": "known: mjcf, urdf, sdf",
    "robot export P2AT --out x.urdf --format usd": "known: mjcf, urdf, sdf",
    "arena export yelow --out x.xml": "did you mean 'yellow'?",
    "arena export yellow --out x.txt": "an arena is exported as .xml, .urdf, .sdf, .world",
    "arena generate --yaml x.txt": "an arena is written as .yaml",
    "arena lane stair": "did you mean 'stairs'?",
    "arena lane stairs --speed 2": "above 0 and up to 1",
    "arena obstacles --robot P2TA": "did you mean 'P2AT'?",
    "export nowhere.mcap --out x.gif": "nowhere.mcap: cannot be read",
    "export explore-v1 --out x.csv": "as .npz or .onnx",
    "radio-map yellow --from 0 --out x.png": "x,y or x,y,z [m]",
    "radio-map yellow --from 0,0": "--out PATH",
    "console": "--script FILE",
    "console nowhere": "HOST:PORT, as 127.0.0.1:3000",
    "demo --seconds 3": "--headless",
    "bench train": "--task TASK",
    "bench peers --engine cuda": "known: auto, c, jax, planar, warp",
    "calibrate --tasks --drives": "name one of them",
    "chaos --self --attack jnuk": "did you mean 'junk'?",
    "chaos localhost": "as 127.0.0.1:3000",
    "chaos 127.0.0.1:1": "start usarmjx serve first",
    "chaos 127.0.0.1:1 --self": "HOST:PORT of",
    "chaos": "HOST:PORT of a server that runs, or --self",
}
"""Our own messages: a line each."""
USAGE = {
    "serv": "serve",
    "serve --port 70000": "--port",
    "serve --port x": "--port",
    "serve --worlds 0": "--worlds",
    "serve --realtime-factor -1": "--realtime-factor",
    "serve --bogus": "--bogus",
    "train drive-to-goal explore-v1": "unexpected extra argument",
    "train drive-to-goal --steps 0": "--steps",
    "train drive-to-goal --worlds 0": "--worlds",
    "train drive-to-goal --processes 0": "--processes",
    "train drive-to-goal --seeds 0": "--seeds",
    "robot nosuch": "nosuch",
    "suite run": "method",
    "suite run baseline --episodes 0": "--episodes",
    "film mission.mcap --out x.mp4 --rate 0": "--rate",
    "bench nosuch": "nosuch",
    "bench step --worlds 0": "--worlds",
    "chaos --self --seconds 0": "--seconds",
    "eval drive-to-goal --episodes 0": "--episodes",
    "film mission.mcap": "--out",
    "arena export yellow": "--out",
    "doctor --nosuch": "--nosuch",
    "radio-map --arena atlantis --out x.png": "--arena",
}
"""Those of the parser of command lines, in its frame."""


def refused(words, tmp_path, monkeypatch):
    """Return the lines of a command's error stream, without those that announce work."""
    monkeypatch.chdir(tmp_path)
    plain = {"COLUMNS": "200", "TERM": "dumb", "NO_COLOR": "1"}
    result = CliRunner().invoke(app, words.split(), env=plain)
    assert (result.exit_code, result.stdout) == (2, ""), result.output
    assert not list(tmp_path.iterdir()), "nothing is written"
    return [line for line in result.stderr.splitlines() if not line.endswith(" ...")]


@pytest.mark.parametrize("words", ONE_LINE)
def test_a_wrong_input_is_answered_in_one_line_with_its_cure(words, tmp_path, monkeypatch):
    (line,) = refused(words, tmp_path, monkeypatch)
    assert line.startswith("usarmjx: ")
    assert ONE_LINE[words] in line


@pytest.mark.parametrize("words", USAGE)
def test_a_wrong_word_is_named(words, tmp_path, monkeypatch):
    assert USAGE[words] in "".join(refused(words, tmp_path, monkeypatch))


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("two\nlines.yaml", r"usarmjx: two\nlines.yaml:1: is no YAML"),
        ("\x1b[31mred.yaml", r"usarmjx: \x1b[31mred.yaml:1: is no YAML"),
        ("r\u00e4ume 1.yaml", "usarmjx: r\u00e4ume 1.yaml:1: is no YAML"),
    ],
)
def test_a_name_of_a_file_cannot_break_the_line(name, shown, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("x: [1")
    result = CliRunner().invoke(app, ["arena", "check", name])
    (line,) = [line for line in result.stderr.splitlines() if not line.endswith(" ...")]
    assert result.exit_code == 2
    assert line.startswith(shown)
    assert result.stderr.isprintable() or result.stderr.replace("\n", "").isprintable()


@pytest.mark.parametrize("command", ["arena check", "serve --arena", "sweep run", "view", "robot check"])
def test_a_name_that_no_file_can_have_is_one_line(command, tmp_path, monkeypatch):
    """Python's own look-up of it ends in an error of the system."""
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, [*command.split(), "n" * 5000 + ".yaml"])
    (line,) = [line for line in result.stderr.splitlines() if not line.endswith(" ...")]
    assert (result.exit_code, result.stdout) == (2, "")
    assert line.startswith("usarmjx: n")
