"""Recordings with damaged parts: each costs its own time, and every command says so."""

import logging
import threading

import pytest
from typer.testing import CliRunner

from tests.recording.missions import HEIGHT, SCOUT, mission_world
from usarmjx.cli.app import app
from usarmjx.recording import file as recording_file
from usarmjx.recording.reader import Recording
from usarmjx.recording.tables import export_tables
from usarmjx.sim.control import CommandUpdate

STEPS, PART = 30, 5
"""Control steps in all and in a part."""


def end_part(file):
    """Let the file's thread end the present part, and wait until it is written."""
    done = threading.Event()
    file.put(lambda file: (file._flush(), done.set()))
    assert done.wait(10)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A recorded drive as bytes, broken off and complete, by name; its parts have five steps each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording_file, "FLUSH", 1000.0)  # no part ends by the clock
        # Shapes are written when nothing else waits, and their size would end a part.
        patch.setattr(recording_file.RecordingFile, "write_in_pieces", lambda *_: None)
        world, file = mission_world(tmp_path_factory.mktemp("drive") / "drive.mcap")
        robot = world.spawn_at(SCOUT, "One", [((0.0, 0.0, HEIGHT), (0.0, 0.0, 0.0))])
        world.update_command(robot, CommandUpdate(drive={"Left": 3.0, "Right": 4.0}))
        for step in range(STEPS):
            world.step()
            if step % PART == PART - 1:
                end_part(file)
        cut = file.path.read_bytes()
        file.close()
    return {"cut": cut, "complete": file.path.read_bytes()}


@pytest.fixture(params=["cut", "complete"])
def damage(request, drive, tmp_path):
    """A function that damages parts with control steps, chosen by their numbers; the file."""
    path = tmp_path / "damaged.mcap"
    path.write_bytes(drive[request.param])
    whole = Recording(path)
    assert whole.is_complete == (request.param == "complete")
    states = whole._wanted(["states"], 0)
    parts = [part for part in whole._parts if not states.isdisjoint(part.channels)]
    assert len(parts) == STEPS // PART
    whole.close()

    def spoil(*numbers, every=False):
        data = bytearray(drive[request.param])
        for part in whole._parts if every else [parts[number] for number in numbers]:
            data[part.offset + 9 + 60] ^= 4  # in the chunk's content
        path.write_bytes(data)
        return path

    return spoil


def steps_of(recording):
    return [message.value.step for message in recording.messages(["states"])]


@pytest.mark.parametrize("number", range(STEPS // PART))
def test_a_damaged_part_costs_its_own_steps_and_tables_have_the_rest(damage, number, tmp_path, caplog):
    recording = Recording(damage(number))
    lost = range(number * PART + 1, (number + 1) * PART + 1)
    assert steps_of(recording) == [step for step in range(1, STEPS + 1) if step not in lost]
    assert recording.damaged == 1
    assert steps_of(recording), "again"
    assert [record.levelno for record in caplog.records] == [logging.WARNING], "once for each part"
    written = {path.name for path in export_tables(recording, tmp_path / "out.csv")}
    assert "out-poses.csv" in written or number == 0  # without the drawing that names the robots


def test_replay_check_fails_where_a_part_cannot_be_compared(damage):
    path = str(damage(-1))
    done = CliRunner().invoke(app, ["replay", "--check", path])
    assert done.exit_code == 1
    assert "1 damaged parts cannot be compared" in done.output
    assert CliRunner().invoke(app, ["replay", "--no-check", path]).exit_code == 0


def test_an_export_that_writes_nothing_is_an_error(damage, tmp_path):
    path = damage(every=True)
    done = CliRunner().invoke(app, ["export", str(path), "--out", str(tmp_path / "out.csv")])
    assert done.exit_code == 2
    assert "nothing is left of it" in done.stderr
    assert [*tmp_path.iterdir()] == [path]
