"""A small file of each kind that usarmjx keeps, and of runs and sweeps that people write, with its reader."""

import dataclasses
import io
import json
import warnings
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from tests.train.handmade import policy_file
from usarmjx.base.checked_cache import read_sealed, seal
from usarmjx.base.settings.json_file import kept_text, read_json_lines
from usarmjx.cli import known_names
from usarmjx.engines.planar import responses
from usarmjx.models.robots import ROBOTS
from usarmjx.recording.file import ChannelName, RecordingFile
from usarmjx.recording.inputs import StepState
from usarmjx.recording.reader import Recording
from usarmjx.sim.calibration import _measured
from usarmjx.sim.trials import _measured_before, success_text
from usarmjx.sweeps.spec import load_spec
from usarmjx.sweeps.store import CellRecord, read_cell, read_sweep, write_cell, write_sweep
from usarmjx.sweeps.suite import RunResult, read_result
from usarmjx.train.envs.env import AgentGroup
from usarmjx.train.learning.checkpoint import FORMAT, Checkpoints, read_part, write_part
from usarmjx.train.learning.config import SET_FILE, Config, RunRecord, load_record, load_seeds, save_seeds
from usarmjx.train.learning.metrics import read_lines
from usarmjx.train.policies.policy_file import read_arrays
from usarmjx.train.policies.sources import load_exported

ROBOT = dataclasses.replace(ROBOTS.get("P2AT"), name="MyBot")
TREE = {"weights": np.arange(3, dtype=np.float32)}
LINE = {"iteration": 1, "agent_steps": 1024, "steps_per_s": 86.4, "score": 0.5}
SWEEP = b"about: mine\ncommon: {task: explore-v1, episodes: 2}\nproduct: {seed: [0, 1]}\n"


def _plain(arrays):
    return {name: array.tolist() for name, array in arrays.items()}


def _program(path):
    """Removes a broken entry with a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return read_sealed(path, "key")


def _response(path):
    responses._overrides.pop(ROBOT, None)
    cache_folder = path.parent / "cache"
    file = responses.response_file(ROBOT, cache_folder)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(path.read_bytes())
    try:
        return responses.find_response(ROBOT, cache_folder)
    finally:
        responses._overrides.pop(ROBOT, None)


def _cell(path):
    (path.parent / "cells").mkdir(exist_ok=True)
    (path.parent / "cells" / "1f.json").write_bytes(path.read_bytes())
    return read_cell(path.parent, "1f")


def _cells(path):
    (path.parent / "sweep.json").write_bytes(path.read_bytes())
    return read_sweep(path.parent)


def _seeds(path):
    (path.parent / SET_FILE).write_bytes(path.read_bytes())
    return load_seeds(path.parent)


def _names(path):
    """Names for shells; without an entry that is whole they are asked for again, here in vain."""
    folder = path.parent / "usarmjx"
    folder.mkdir(exist_ok=True)
    (folder / f"names-{known_names._fingerprint()}.json").write_bytes(path.read_bytes())
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(path.parent))
        patch.setattr(known_names, "_asked", lambda: {"arenas": []})
        return known_names.names_of("arenas") or None


def _run(path):
    (path.parent / "config.json").write_bytes(path.read_bytes())
    return load_record(path.parent)


def _meta(path):
    folder = path.parent / "checkpoints" / "00000003"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "meta.json").write_bytes(path.read_bytes())
    found = Checkpoints(path.parent).meta(folder)
    return {name: found.get(name) for name in ("format", "iteration", "agent_steps", "score")}


def _arrays(path):
    (path.parent / "learner_0.npz").write_bytes(path.read_bytes())
    return _plain(read_part(path.parent, "learner", TREE))


def _policy(path):
    load_exported(path)  # refuses a policy that lacks an array
    about, arrays = read_arrays(path)
    return about, _plain(arrays)


def _recording(path):
    """Messages that are left, by time; a damaged part is left out, and counted."""
    recording = Recording(path)
    try:
        found = {message.time: message.value for message in recording.messages(["states", "events"])}
    finally:
        recording.close()
    return {time: str(value) for time, value in found.items()}


@cache
def _written():
    """Return files that the package writes, as bytes by name."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        rows = {"scores": (0.25,), "steps": (10,), "bad": (False,)}
        settings = {"task": "explore-v1", "policy": "random"}
        cell = CellRecord(key="1f", settings=settings, engine="c", **rows)
        write_cell(folder, cell)
        result = RunResult(
            suite="mine-v1", suite_digest="0f", split="test", method="m", run="random", cells=(cell,)
        )
        result.write(folder / "m.result.json")
        save_seeds(folder, (3, 4))
        write_sweep(folder, "mine", "", ("seed",), ("1f",))
        group = AgentGroup("P2AT", ("p0",), 3, 2)
        about = {"groups": (group,), "privileged_size": 0, "episode_steps": 100, "period": 0.2}
        RunRecord(task="wander", **about, processes=1, config=Config()).save(folder)
        write_part(folder, "learner", TREE)
        file = RecordingFile(folder / "drive.mcap")
        for step in range(3):
            at, ones = 0.02 * step, np.ones(2)
            state = StepState(step=step, time=at, qpos=ones, qvel=ones, act=np.ones(0))
            file.put(lambda file, at=at, state=state: file.write(ChannelName(0, "states"), at, state))
            said = {"kind": "join", "robot": "R", "slot": 0, "text": f"step {step}"}
            file.put(lambda file, at=at, said=said: file.write(ChannelName(0, "events"), at + 0.01, said))
        file.close()
        names = ("cells/1f.json", "sweep.json", "config.json", "learner_0.npz", "drive.mcap")
        names += ("m.result.json", SET_FILE)
        return [(folder / one).read_bytes() for one in names]


def kept_files():
    """Return the kinds that are kept: content and reader by name; None or UsageError is a refusal."""
    cell, cells, run, arrays, recording, result, seeds = _written()
    names = json.dumps({"arenas": ["yellow", "field"]})
    response = dataclasses.asdict(responses.Response(**responses.packaged_responses()["P2AT"]["response"]))
    about = {"key": responses.description_key(ROBOT), "response": response}
    meta = {"format": FORMAT, "iteration": 3, "agent_steps": 1000, "score": 0.5}
    return {
        "program": (seal(b"machine code", "key"), _program),
        "response.json": (kept_text(about).encode(), _response),
        "cell.json": (cell, _cell),
        "cells.json": (cells, _cells),
        "run.json": (run, _run),
        "meta.json": (kept_text(meta).encode(), _meta),
        "arrays.npz": (arrays, _arrays),
        "kept-policy.npz": (policy_file(io.BytesIO()).getvalue(), _policy),
        "recording.mcap": (recording, _recording),
        "kept.result.json": (result, read_result),
        "seeds.json": (seeds, _seeds),
        "names.json": (f"{known_names._checksum(names)}\n{names}".encode(), _names),
    }


def written_files():
    """Return the kinds that people write or change: content and reader by name."""
    entry = responses.packaged_responses()["P2AT"]
    measured = {"P2AT": {"key": "1", "response": entry["response"], "errors": {}}}
    curves = success_text({"P2AT": {"ramp": ((0.3, 1.0), (0.5, 0.25))}}, 8)
    benchmark = {"benchmark": "train", "task": "wander", "curve": [LINE]}
    return {
        "sweep.yaml": (SWEEP, load_spec),
        "metrics.jsonl": ((json.dumps(LINE) + "\n").encode() * 2, read_lines),
        "records.jsonl": ((json.dumps(benchmark) + "\n").encode(), read_json_lines),
        "measured.json": (json.dumps(measured).encode(), _measured),
        "crossings.json": (curves.encode(), _measured_before),
    }
