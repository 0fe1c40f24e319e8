"""A run that was stopped at any moment goes on as if nothing had been; what does not fit is refused."""

import json
import shutil
import signal
import sys
import time
import zipfile
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.train.runs import CONFIG, PATIENCE, PROGRAM, checksums, lines, run, started
from tests.train.toys import DriveToy
from usarmjx.base.errors import UsageError
from usarmjx.base.settings.json_file import kept_text
from usarmjx.train.learning.checkpoint import Checkpoints, read_part, read_policy, write_part
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.metrics import MetricsLog
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.trainer import StopRequest, train
from usarmjx.train.make import make
from usarmjx.view.training_page import BatchSource


def wait_for_lines(folder, count, process):
    """Wait until so many iterations have been written down."""
    until = time.monotonic() + PATIENCE
    while not (folder / "metrics.jsonl").exists() or len(lines(folder)) < count:
        assert time.monotonic() < until, "nothing was written"
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)


class Stop(Exception):
    pass


def leave_halves(folder):
    """Leave half a line and half a checkpoint, as a kill at an unlucky moment does."""
    with (folder / "metrics.jsonl").open("a") as file:
        file.write('{"iteration": 99, "sco')
    (folder / "checkpoints" / "00000009.partial" / "worlds").mkdir(parents=True)


def test_a_run_that_broke_off_ends_as_one_that_did_not(reference, tmp_path):
    """Bit for bit: all that was learned, all worlds, all that was written down."""
    folder = tmp_path / "run"

    def stop(line):
        if line["iteration"] == 4:
            raise Stop

    with pytest.raises(Stop):
        run(folder, watch=stop)
    assert len(lines(folder)) == 4
    leave_halves(folder)
    run(folder, resume=True)
    assert lines(folder) == lines(reference)
    assert checksums(folder) == checksums(reference)


@pytest.mark.thorough
def test_a_run_that_was_killed_ends_as_one_that_was_not(reference, cache, tmp_path):
    """Bit for bit: all that was learned, all worlds, all that was written down."""
    folder = tmp_path / "run"
    with started([sys.executable, *PROGRAM, str(folder)], cache) as process:
        wait_for_lines(folder, 1, process)
        for resume in (True, False):
            with pytest.raises(UsageError, match=f"^process {process.pid} on .* trains in "):
                run(folder, resume=resume)
        wait_for_lines(folder, 4, process)
        process.send_signal(signal.SIGKILL)
        assert process.wait(10) == -signal.SIGKILL
    assert 4 <= len(lines(folder)) < 10
    leave_halves(folder)
    with started([sys.executable, *PROGRAM, str(folder), "--resume"], cache) as process:
        output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, output
    assert lines(folder) == lines(reference)
    assert checksums(folder) == checksums(reference)


@pytest.fixture
def copy(reference, tmp_path):
    """The run, to be damaged."""
    folder = tmp_path / "copy"
    shutil.copytree(reference, folder)
    return folder


def test_the_latest_checkpoints_and_the_best_are_kept(reference):
    there = [path.name for path in Checkpoints(reference).all()]
    assert there[-2:] == ["00000009", "00000010"]
    assert len(there) <= 3
    best = Checkpoints(reference).find("best")
    scores = {record["iteration"]: record["score"] for record in lines(reference)}
    assert scores[int(best.name)] == max(scores.values())


def test_a_signal_ends_a_run_with_a_checkpoint_and_it_goes_on_as_if_nothing_had_happened(reference, tmp_path):
    """The run's checkpoints are far apart: the one that is left is of the signal."""
    config, said = replace(CONFIG, checkpoint_interval=100), list[str]()
    usual = signal.getsignal(signal.SIGTERM)

    def interrupt(line):
        if line["iteration"] == 3:
            signal.raise_signal(signal.SIGTERM)

    with StopRequest(said.append) as stop:
        ended = run(tmp_path / "run", config, watch=interrupt, stop=stop)
    assert signal.getsignal(signal.SIGTERM) is usual
    assert stop.number == signal.SIGTERM
    assert said == ["SIGTERM: ending with a checkpoint after this iteration; a second one ends at once"]
    assert ended.stopped
    assert 3 <= ended.iterations <= 5
    assert [path.name for path in Checkpoints(tmp_path / "run").all()] == [f"{ended.iterations:08}"]
    assert lines(tmp_path / "run") == lines(reference)[: ended.iterations]
    finished = run(tmp_path / "run", config, resume=True)
    assert (finished.iterations, finished.stopped) == (10, False)
    whole = lines(tmp_path / "run")
    assert [line["score"] for line in whole] == [line["score"] for line in lines(reference)]
    checkpoints = Checkpoints(tmp_path / "run")
    noted = checkpoints.meta(checkpoints.find("last"))["score"]
    assert noted == pytest.approx(mean_score(whole), rel=1e-12)  # of the iterations before the stop, too


def mean_score(records):
    """The mean over all episodes of some iterations."""
    ended = [record for record in records if record["score"] is not None]
    count = sum(record["episodes"] for record in ended)
    return sum(record["episodes"] * record["score"] for record in ended) / count


def test_a_run_without_a_checkpoint_begins_anew_and_keeps_its_lines(copy, capsys):
    shutil.rmtree(copy / "checkpoints")
    before = (copy / "metrics.jsonl").read_text()
    with MetricsLog(copy, 10):
        pass
    assert (copy / "metrics-1.jsonl").read_text() == before
    assert (copy / "metrics.jsonl").read_text() == ""
    assert "training begins anew; metrics-1.jsonl keeps the lines of before" in capsys.readouterr().err


def test_a_run_that_is_over_is_over(copy):
    """Resuming it changes nothing."""
    before = lines(copy)
    assert run(copy, resume=True).last_metrics["iteration"] == 10
    assert lines(copy) == before


def test_a_run_is_not_resumed_to_fewer_steps_than_it_has_done(copy):
    """It says so, and changes nothing, not even what is written down of its settings."""
    before = lines(copy), (copy / "config.json").read_text()
    with pytest.raises(UsageError, match="has 24,000 agent steps behind it, more than the requested 12,000"):
        run(copy, replace(CONFIG, total_steps=12_000), resume=True)
    assert (lines(copy), (copy / "config.json").read_text()) == before


def spoil_data(path):
    """Turn over some bits in the largest file."""
    file = max((file for file in path.rglob("*") if file.is_file()), key=lambda file: file.stat().st_size)
    data = bytearray(file.read_bytes())
    for place in range(len(data) // 4, len(data) // 2):
        data[place] ^= 0xFF
    file.write_bytes(bytes(data))


def lose_meta(path):
    (path / "meta.json").unlink()


def cut_file(path):
    file = path / "learner_0.npz"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def turn_one_bit(path):
    """The last bit of the first array's numbers."""
    file = path / "worlds_0.npz"
    with zipfile.ZipFile(file) as arrays:
        second = arrays.infolist()[1].header_offset
    data = bytearray(file.read_bytes())
    data[second - 1] ^= 1
    file.write_bytes(bytes(data))


@pytest.mark.parametrize("damage", [spoil_data, lose_meta, cut_file, turn_one_bit])
def test_a_broken_checkpoint_is_refused(copy, damage):
    damage(Checkpoints(copy).find("last"))
    with pytest.raises(UsageError, match="00000010 is broken"):
        run(copy, resume=True)


def test_a_run_of_another_version_is_refused_in_one_line(copy):
    """As those of orbax are, and those whose leaves had other names."""
    for path in Checkpoints(copy).all():
        meta = json.loads((path / "meta.json").read_text())
        meta.pop("checksum")
        (path / "meta.json").write_text(kept_text({**meta, "format": 2}))
    for use in (lambda: run(copy, resume=True), lambda: read_policy(copy), lambda: read_policy(copy, "last")):
        with pytest.raises(UsageError, match="another version of usarmjx") as error:
            use()
        assert "\n" not in str(error.value)


def test_a_checkpoint_of_something_else_is_refused(copy, reference):
    """Of other networks, or of another toy: it says what it found and what it expected."""
    path = Checkpoints(reference).find("last")
    for worlds, config in (
        (32, replace(CONFIG, hidden_sizes=(16, 32))),
        (16, replace(CONFIG, num_worlds=16)),
    ):
        part = "learner" if worlds == 32 else "worlds"
        train_state, rollout_state = Trainer(DriveToy(worlds), config, ProcessGroup()).start()
        with pytest.raises(UsageError, match=r"of another run: it holds .* expected"):
            read_part(path, part, train_state if part == "learner" else rollout_state)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gamma": 0.95}, r"started with other settings: gamma: 0.9 -> 0.95"),
        ({"hidden_sizes": (16,)}, r"hidden_sizes: \(32, 32\) -> \(16,\)"),
    ],
)
def test_a_run_is_not_resumed_with_other_settings(copy, change, words):
    with pytest.raises(UsageError, match=words):
        run(copy, replace(CONFIG, **change), resume=True)


class WiderToy(DriveToy):
    """`DriveToy` whose critics see one number more."""

    privileged_size = 7

    def see(self, x, time):
        obs, privileged = super().see(x, time)
        return obs, jnp.append(privileged, 1.0)


def test_a_run_whose_critics_saw_other_numbers_is_not_resumed(copy):
    with pytest.raises(UsageError, match=r"other settings: numbers that only critics see: 6 -> 7$"):
        train(lambda worlds, first: WiderToy(worlds, first), CONFIG, copy, True, progress=False)


def test_a_folder_with_a_run_is_not_overwritten(reference, tmp_path):
    with pytest.raises(UsageError, match="has a run already"):
        run(reference)
    with pytest.raises(UsageError, match="nothing to resume"):
        run(tmp_path / "none", resume=True)
    with pytest.raises(UsageError, match="is no run"):
        read_policy(tmp_path)
    with pytest.raises(UsageError, match=r"known: .*10, besides last and best"):
        read_policy(reference, "11")


def place(env, state):
    """At which step a world is, and where its robot is on the live page."""
    frame = BatchSource(env.batch, state.batch, [0]).frame(0)
    return int(np.asarray(state.batch.worlds.step)[0]), tuple(frame.robots[0].pos)


@pytest.mark.parametrize("engine", ["c", pytest.param("jax", marks=pytest.mark.slow)])
def test_a_robot_goes_on_where_it_was(engine, tmp_path):
    """A real environment: physics, sensors' memories and random keys come back bit for bit."""
    config = Config(
        total_steps=4 * 4 * 4, num_worlds=4, rollout_length=4, num_minibatches=2,
        num_epochs=1, hidden_sizes=(8,), critic_hidden_sizes=(8,),
        checkpoint_interval=2,
    )  # fmt: skip
    env = make("drive-to-goal", worlds=4, engine=engine, episode_steps=6, ranges=())

    def stop(line):
        if line["iteration"] == 3:
            raise Stop

    seen = []
    train(env, config, tmp_path / "whole", progress=False, look=lambda state: seen.append(place(env, state)))
    assert seen[0][0] == 0, "who looks sees the worlds before anything is compiled"
    assert len(seen) == 1 + config.iterations(1) * (1 if env.traceable else config.rollout_length)
    assert len({pose for _, pose in seen}) == len(seen), "and each time the robot is somewhere else"
    with pytest.raises(Stop):
        train(env, config, tmp_path / "part", progress=False, watch=stop)
    assert Checkpoints(tmp_path / "part").find().name == "00000002"
    train(env, config, tmp_path / "part", resume=True, progress=False)
    assert lines(tmp_path / "part") == lines(tmp_path / "whole")
    assert checksums(tmp_path / "part") == checksums(tmp_path / "whole")
    assert lines(tmp_path / "whole")[-1]["episodes"] > 0


def test_numbers_of_64_bits_and_random_keys_come_back(tmp_path):
    """As C MuJoCo's states have them; JAX here has no such numbers."""
    tree = {
        "double": np.array([[1 / 3, np.pi], [np.nan, np.inf]]),
        "scalar": np.float64(2 / 3) * np.ones(()),
        "long": np.array([2**62 + 1]),
        "key": jax.random.key(7),
        "flag": np.array([True, False]),
        "nothing": np.zeros((3, 0)),
        "turned": np.arange(6.0).reshape(2, 3).T,
        "number": jax.numpy.float32(1 / 3),
    }
    write_part(tmp_path, "part", tree)
    found = read_part(tmp_path, "part", tree)
    for name, value in tree.items():
        assert isinstance(found[name], jax.Array) == isinstance(value, jax.Array)
        one, other = (
            jax.random.key_data(v) if name == "key" else np.asarray(v) for v in (value, found[name])
        )
        assert one.dtype == other.dtype
        assert_array_equal(one, other)
