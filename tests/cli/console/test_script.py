"""The console without panes: scripts, pipes, transcripts, and one line for what is wrong."""

import io
import os
import re
import subprocess
import sys
import threading
from datetime import UTC, datetime

import pytest
from typer.testing import CliRunner

from tests.server.peers import PATIENCE, serving
from tests.server.still_world import CLASS, StillWorld, init
from usarmjx.base.errors import UsageError, WriteError
from usarmjx.cli.app import app
from usarmjx.cli.console.client import LONGEST_SLEEP, NOTE, RECEIVED, SENT, Transcript, parse_place
from usarmjx.server.network.access import AccessRules

GREETING = "NFO {Gametype BotDeathMatch} {Level flat} {TimeLimit 0}"
STAMP = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z ([<>#]) (.*)")


@pytest.fixture(scope="module")
def port():
    with serving(StillWorld(), realtime_factor=1.0) as (port, _):
        yield port


def run(port, script, *options, tmp_path=None):
    """What a script prints, and how it ends."""
    if tmp_path is not None:
        (tmp_path / "script.txt").write_text(script)
        return CliRunner().invoke(
            app, ["console", str(port), "--script", str(tmp_path / "script.txt"), *options]
        )
    return CliRunner().invoke(app, ["console", str(port), "--script", "-", *options], input=script)


def test_a_script_sends_its_lines_and_prints_the_messages(port, tmp_path):
    begin, ask = f"# begin\n\n@until {GREETING}\n{init()}\n@until STA\n", "GETCONF {Type Robot}\n@until CONF"
    script = f"{begin}@sleep 0.05\n{ask}"
    done = run(port, script, "--linger", "0", tmp_path=tmp_path)
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    assert lines[0] == GREETING
    assert lines[1].startswith("STA {Type GroundVehicle} {Time ")
    assert lines[-1].startswith(f"CONF {{Type GroundVehicle}} {{Name {CLASS}}}")


def test_messages_are_printed_as_long_as_asked_for_after_the_last_line(port):
    done = run(port, init("R2"), "--linger", "1")
    assert [line.split(" ")[0] for line in done.stdout.splitlines()][:3] == ["NFO", "STA", "STA"]


def test_a_pipe_is_taken_line_by_line_and_may_end_early(port):
    """What comes out answers what went in while the pipe is still open."""
    command = [sys.executable, "-m", "usarmjx", "console", f"127.0.0.1:{port}", "--script", "-"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    guard = threading.Timer(PATIENCE, process.kill)
    guard.start()
    try:
        assert process.stdout.readline().decode().rstrip() == GREETING
        process.stdin.write(b"GETSTARTPOSES\n")
        process.stdin.flush()
        assert process.stdout.readline().startswith(b"NFO {StartPoses 6}")
        process.stdout.close()  # as `| head` does
        process.stdin.write(b"GETSTARTPOSES\n@sleep 0.2\nGETSTARTPOSES\n@sleep 0.2\n")
        process.stdin.close()
        assert process.wait(PATIENCE) == 0
        assert b"Traceback" not in process.stderr.read()
    finally:
        guard.cancel()
        process.kill()


def test_the_transcript_has_every_message_with_direction_and_time(port, tmp_path):
    path = tmp_path / "talk.txt"
    before = datetime.now(UTC)
    for _ in range(2):
        done = run(port, "GETSTARTPOSES\n@until NFO {StartPoses", "--linger", "0", "--transcript", str(path))
        assert done.exit_code == 0
    lines = path.read_text().splitlines()
    matches = [STAMP.fullmatch(line) for line in lines]
    talk = [match.groups() for match in matches]
    assert [direction for direction, _ in talk].count(SENT) == 2
    first = talk[: len(talk) // 2]
    assert (NOTE, f"connected to 127.0.0.1:{port}") == first[0]
    assert (SENT, "GETSTARTPOSES") in first
    assert {(RECEIVED, GREETING)} < set(first)
    assert [text for direction, text in first if direction == RECEIVED] == done.stdout.splitlines()
    assert datetime.fromisoformat(lines[0].split(" ")[0]) >= before.replace(microsecond=0)


def test_a_token_is_said_first_and_written_nowhere(tmp_path):
    token = tmp_path / "token"
    token.write_text("open-sesame\n")
    path = tmp_path / "talk.txt"
    with serving(StillWorld(), realtime_factor=1.0, access=AccessRules(token="open-sesame")) as (port, _):
        options = ["--linger", "0", "--transcript", str(path), "--token-file", str(token)]
        done = run(port, "GETSTARTPOSES\n@until NFO {StartPoses\nAUTH {Token open-sesame}", *options)
        refused = run(port, "@until NFO", "--token", "wrong")
    assert done.exit_code == 0
    assert "AUTH ..." in path.read_text()
    assert "sesame" not in path.read_text() + done.output
    assert refused.exit_code == 2
    assert "@until NFO: the server has hung up" in refused.output


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ("@until XYZ", "@until XYZ: nothing like that came within 0.2 s"),
        ("@wait 3", "@wait is none of @sleep SECONDS, @until BEGINNING"),
        ("@sleep long", f"@sleep long: expected a number of seconds from 0 to {LONGEST_SLEEP:g}"),
        ("@sleep -1", "expected a number of seconds"),
        ("@sleep nan", "expected a number of seconds"),
    ],
)
def test_a_line_that_cannot_be_is_one_line_and_status_2(port, script, told):
    done = run(port, script, "--patience", "0.2")
    assert done.exit_code == 2
    assert told in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["1", "--script", "-"], "no connection to 127.0.0.1:1: Connection refused"),
        (
            ["localhost", "--script", "-"],
            "'localhost' is no place; expected HOST:PORT, as 127.0.0.1:3000 or 3000",
        ),
        (["1", "--script", "/nowhere/x"], "no connection to"),
        (["3000"], "the panes need a terminal; with --script FILE (or -) lines are sent without"),
        (["3000", "--save-pictures", "x"], "--save-pictures needs --video"),
        (["3000", "--script", "-", "--video", "5003"], "--video with --script needs --save-pictures"),
        (["3000", "--video", "image"], "'127.0.0.1:image' is no place; expected [HOST:]PORT"),
        (["3000", "--transcript", "/nowhere/x"], "--transcript: cannot write /nowhere/x: No such file"),
        (["3000", "--joystick", "/dev/nothing"], "--joystick: no '/dev/nothing'; expected auto, off"),
    ],
)
def test_what_is_wrong_with_the_options_is_one_line(words, told, monkeypatch):
    done = CliRunner().invoke(app, ["console", *words])
    assert done.exit_code == 2
    assert told in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_script_that_is_not_there_is_one_line(port):
    done = CliRunner().invoke(app, ["console", str(port), "--script", "/nowhere/script"])
    assert done.exit_code == 2
    assert "--script: cannot read /nowhere/script" in done.stderr


def test_without_its_library_the_panes_say_what_to_install(monkeypatch):
    absent = "nothing_like_textual"
    monkeypatch.setattr("usarmjx.cli.console.command.LIBRARY", absent)
    done = CliRunner().invoke(app, ["console", "3000"])
    assert done.stderr == (f"usarmjx: the panes need {absent}: pip install {absent}; --script does without\n")


def test_the_console_starts_without_jax_and_with_few_modules():
    code = "import sys, usarmjx.cli.console.app, usarmjx.cli.console.command\n"
    code += "print(len(sys.modules), *(name in sys.modules for name in ('jax', 'mujoco', 'numpy')))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=PATIENCE
    )
    count, *loaded = done.stdout.split()
    assert loaded == ["False", "False", "False"]
    assert int(count) < 700  # 522 today; a library like jax or numpy brings hundreds


@pytest.mark.parametrize(
    ("text", "place"),
    [("3000", ("127.0.0.1", 3000)), ("sim.example:1", ("sim.example", 1)), ("[::1]:3000", ("::1", 3000))],
)
def test_places(text, place):
    assert parse_place(text) == place


@pytest.mark.parametrize("text", ["", "x", "x:", "x:0", "x:65536", "x:²", "x:99999999999", "3000:"])
def test_what_is_no_place(text):
    with pytest.raises(UsageError, match="is no place; expected HOST:PORT"):
        parse_place(text)


def test_a_disk_that_is_full_is_one_line(tmp_path):
    class Full(io.StringIO):
        def write(self, text):
            raise OSError(28, os.strerror(28))

    transcript = Transcript(tmp_path / "talk.txt")
    transcript._file.close()
    transcript._file = Full()
    with pytest.raises(WriteError, match=r"--transcript: cannot write .*talk\.txt: No space left"):
        transcript.write(SENT, "DRIVE")
    transcript.write(SENT, "DRIVE")  # the talk goes on
