"""Worlds that go bad in a training: their last seconds are recorded, and replay repeats them."""

from dataclasses import dataclass, replace
from typing import ClassVar

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from usarmjx.recording import episodes
from usarmjx.recording.episodes import BlackBox
from usarmjx.recording.reader import Recording
from usarmjx.recording.replay import check_recording
from usarmjx.recording.source import RecordingSource
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import StepResult, Task
from usarmjx.train.learning.trajectory import RolloutInputs

REPEAT, STEPS, BAD_AT = 5, 4, 2
"""Control steps per action, actions per rollout, and action of the second one in which world 1 goes bad."""


@dataclass(frozen=True, kw_only=True)
class Faulty(Task):
    """A robot drives; the reward of world 1 is no number in one step."""

    about: ClassVar[str] = "A robot drives until its task fails."
    sensors: tuple = ("GroundTruth",)
    repeat: int = REPEAT

    @property
    def robots(self):
        return ("P2DX",)

    def start(self, view, key):
        return jnp.zeros((), jnp.int32)

    def observe(self, view, memory):
        return (view.robots(0).pos,)

    def evaluate(self, view, memory):
        wrong = (view.world.number == 1) & (memory == STEPS + BAD_AT)
        reward = jnp.where(wrong, jnp.nan, 1.0)[None]
        return StepResult(memory + 1, (reward,), jnp.zeros((), bool), jnp.zeros(()), {})


@pytest.fixture(scope="module")
def env():
    return Env(Faulty(), 3, engine="c")


def rollouts(env, state, count=2):
    """Rollouts of a policy that turns more and more."""
    for iteration in range(1, count + 1):
        begun, rows = state, []
        for step in range(STEPS):
            actions = (jnp.full((env.worlds, 1, 2), 0.5).at[..., 0].add(0.1 * step),)
            state = env.step(state, actions)
            rows.append((actions[0], state.reward[0].mean(-1), state.done, state.bad))
        actions, reward, done, bad = (jnp.stack(column) for column in zip(*rows, strict=True))
        yield RolloutInputs(
            iteration=iteration, env_state=begun, actions=(actions,), reward=reward, done=done, bad=bad
        )


def recorded(env, folder, state, most=4):
    lines = []
    box = BlackBox(env, folder, most, lines.append)
    for inputs in rollouts(env, state):
        box.inspect(inputs)
    box.close()
    return sorted(folder.glob("*.mcap")), lines


def test_the_last_seconds_of_a_bad_world_are_kept_and_replayed_to_the_bit(env, tmp_path, monkeypatch):
    """Five actions of 0.1 s across two rollouts, the last of which is the one that failed."""
    monkeypatch.setattr(episodes, "SECONDS", 0.5)
    files, lines = recorded(env, tmp_path, env.reset(0))
    assert [file.name for file in files] == ["iteration-000002-world-000001.mcap"]
    assert "a number of the task is not finite" in lines[0]
    recording = Recording(files[0])
    result = check_recording(recording, 0)
    assert (result.steps, result.difference) == (5 * REPEAT, "")
    source = RecordingSource(recording)
    assert source.start == pytest.approx((STEPS + BAD_AT + 1 - 5) * env.period)
    assert source.end - source.start == pytest.approx(0.5)
    truth = env.reset(0)
    for inputs in rollouts(env, truth):
        for step in range(STEPS if inputs.iteration == 1 else BAD_AT):
            truth = env.step(truth, inputs.action(step))
    expected = np.asarray(env.batch.physics(truth.batch).qpos)[1]
    states = [m.value for m in recording.messages(("states",), 0) if m.value.step == 4 * REPEAT]
    np.testing.assert_array_equal(states[0].qpos, expected, err_msg="it is what happened in the training")


@pytest.mark.thorough
def test_worlds_of_warp_share_a_list_of_contacts_and_are_recorded_alone(tmp_path):
    env = Env(Faulty(), 3, engine="warp")
    files, lines = recorded(env, tmp_path, env.reset(0))
    assert [file.name for file in files] == ["iteration-000002-world-000001.mcap"], lines
    result = check_recording(Recording(files[0]), 0)
    assert (result.steps, result.difference) == ((STEPS + BAD_AT + 1) * REPEAT, "")


def test_a_fault_of_the_physics_comes_again_and_recordings_are_bounded(env, tmp_path):
    state = env.reset(0)
    numbers = state.batch.physics.integration.copy()
    speed = env.batch.engine._parts[mujoco.mjtState.mjSTATE_QVEL].start
    numbers[[0, 2], speed] = np.nan
    state = state.replace(
        batch=state.batch.replace(physics=state.batch.physics._replace(integration=numbers))
    )
    files, lines = recorded(env, tmp_path, state, most=1)
    assert [file.name for file in files] == ["iteration-000001-world-000000.mcap"]
    assert "a number of the physics is not finite" in lines[0]
    assert len(lines) == 1
    result = check_recording(Recording(files[0]), 0)
    assert (result.steps, result.difference) == (REPEAT, "")


def test_a_recording_begins_after_the_last_episode_did(env, tmp_path):
    """Commands do not repeat a reset: of 8 actions the first one ends an episode of world 1."""
    state = env.reset(0)
    files, lines = recorded(
        env, tmp_path, state.replace(length=state.length.at[1].set(env.episode_steps - 1))
    )
    assert "a number of the task is not finite" in lines[0]
    recording = Recording(files[0])
    result = check_recording(recording, 0)
    assert (result.steps, result.difference) == (7 * REPEAT, "")
    assert RecordingSource(recording).start == 0.0


def test_a_recording_of_another_scene_is_refused(env, tmp_path, monkeypatch):
    monkeypatch.setattr(episodes, "SECONDS", 0.1)
    files, _ = recorded(env, tmp_path, env.reset(0))
    recording = Recording(files[0])
    setup = recording.setup(0)
    monkeypatch.setattr(recording, "setup", lambda number: replace(setup, roster=setup.roster * 2))
    with pytest.raises(Exception, match=r"another version or scene|both named"):
        check_recording(recording, 0)
