"""What other libraries hand over and expect: keywords, pictures, faults, critics' state, processes."""

import os
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.toys import DriveToy, LineToy
from usarmjx.base.errors import UnknownNameError, UsageError

pytest.importorskip("gymnasium", reason="needs the extra rl")
import gymnasium

from usarmjx.sensors.cameras.paint import ROBOT_LABEL
from usarmjx.train.adapters.agents import overhead_viewpoint
from usarmjx.train.adapters.gymnasium import TeamWorld, VectorWorlds

ID = "usarmjx.train.adapters.gymnasium:usarmjx/drive-to-goal-v1"
TINY = {"engine": "c", "ranges": (), "pose": "GroundTruth", "arena": "field"}
FLAT = {name: value for name, value in TINY.items() if name != "arena"}
"""In the arena of 8 m x 8 m that the task has otherwise."""


def rotten(worlds):
    """A toy whose worlds go bad when its robots drive to the right."""
    return DriveToy(worlds, rotten=True)


def run_until_bad(step, limit=12):
    for _ in range(limit):
        found = step()
        if found is not None:
            return found
    raise AssertionError("no fault came")


def right(worlds):
    return np.tile(np.float32([1, 0, 1, 0, 0, 0]), (worlds, 1))


def test_a_fault_is_truncated_not_terminated_in_gymnasium():
    worlds = VectorWorlds(rotten(4))
    worlds.reset(seed=0)

    def step():
        _, _, terminated, truncated, infos = worlds.step(right(4))
        return (terminated, truncated, infos) if infos["bad"].any() else None

    terminated, truncated, infos = run_until_bad(step)
    bad = infos["bad"]
    assert not terminated[bad].any()
    assert truncated[bad].all()
    np.testing.assert_array_equal(infos["fault"], bad)
    np.testing.assert_array_equal(infos["_fault"], bad)


def test_physics_that_is_not_finite_is_truncated_in_its_own_world_only():
    import mujoco

    import usarmjx

    env = usarmjx.make("drive-to-goal", worlds=4, episode_steps=12, **TINY)
    worlds, ahead = VectorWorlds(env), np.full((4, 2), 0.4, np.float32)
    worlds.reset(seed=0)
    worlds.step(ahead)
    state = worlds._state
    numbers = state.batch.physics.integration.copy()
    numbers[1, env.batch.engine._parts[mujoco.mjtState.mjSTATE_QVEL].start] = np.nan
    broken = state.batch.replace(physics=state.batch.physics._replace(integration=numbers))
    worlds._state = state.replace(batch=broken)
    _, reward, terminated, truncated, infos = worlds.step(ahead)
    only = [False, True, False, False]
    assert infos["bad"].tolist() == infos["fault"].tolist() == truncated.tolist() == only
    assert not terminated.any()
    assert reward[1] == 0
    assert (reward[[0, 2, 3]] != 0).all()


def test_a_fault_is_truncated_in_a_single_world_and_in_pettingzoo():
    from usarmjx.train.adapters.pettingzoo import ParallelWorld

    world = TeamWorld(rotten(1))
    world.reset(seed=0)

    def step():
        _, _, terminated, truncated, info = world.step(right(1)[0])
        return (terminated, truncated, info) if info["bad"] else None

    terminated, truncated, info = run_until_bad(step)
    assert (terminated, truncated, bool(info["fault"])) == (False, True, True)
    zoo = ParallelWorld(rotten(1))
    zoo.reset(seed=0)
    actions = {"A0": np.float32([1, 0]), "A1": np.float32([1, 0]), "B0": np.zeros(2, np.float32)}

    def turn():
        _, _, terminated, truncated, infos = zoo.step(actions)
        return (terminated, truncated, infos) if infos["A0"]["bad"] else None

    terminated, truncated, infos = run_until_bad(turn)
    assert not any(terminated.values())
    assert all(truncated.values())
    assert infos["B0"]["fault"]


def test_a_fault_is_a_truncation_in_brax():
    pytest.importorskip("brax")
    from usarmjx.train.adapters.brax import BatchedRobots

    toy = LineToy()
    toy.groups = toy.groups[:1]
    robots = BatchedRobots(toy)
    state = toy.reset(0)
    state = state.replace(bad=jnp.ones(toy.worlds, bool), obs=state.obs[:1], final_obs=state.final_obs[:1])
    assert np.asarray(robots._state(state).info["truncation"]).all()
    seen = BatchedRobots(toy, privileged=True)._state(state).obs
    assert {name: value.shape[-1] for name, value in seen.items()} == {
        "state": toy.groups[0].obs_size,
        "privileged_state": toy.privileged_size,
    }


def test_critics_get_their_state():
    from usarmjx.train.adapters.pettingzoo import ParallelWorld

    zoo = ParallelWorld(LineToy(worlds=1))
    zoo.reset(seed=0)
    assert zoo.state_space.contains(zoo.state())
    worlds = VectorWorlds(LineToy(worlds=3))
    worlds.reset(seed=0)
    assert worlds.state().shape == (3, *worlds.state_space.shape)


def test_options_of_a_reset_are_refused_by_name():
    for world in (TeamWorld(LineToy(worlds=1)), VectorWorlds(LineToy())):
        with pytest.raises(UsageError, match="unknown options of reset: gravity"):
            world.reset(options={"gravity": 3})


@pytest.mark.thorough
def test_gymnasium_own_keywords_are_known_and_others_refused():
    world = gymnasium.make(ID, episode_steps=5, render_mode="rgb_array", **FLAT)
    assert world.render_mode == "rgb_array"
    world.reset(seed=0)
    picture = world.render()
    assert picture.dtype == np.uint8
    assert picture.shape == (240, 320, 3)
    env, state = world.unwrapped.worlds.env, world.unwrapped.worlds._state.batch
    above = overhead_viewpoint(env.batch.arena_of(state, 0))
    shown = env.batch.render_view(state, 0, above)
    np.testing.assert_array_equal(picture, shown.rgb)
    rows, columns = np.nonzero(np.asarray(shown.segmentation) == ROBOT_LABEL)
    x, y, z = env.batch.physics(state).qpos[0, :3]
    scale = 160 / np.tan(above.fov / 2) / (above.pos[2] - z)  # of a pinhole [pixels/m]
    middle = 159.5 + scale * (x - above.pos[0]), 119.5 - scale * (y - above.pos[1])
    np.testing.assert_allclose((columns.mean(), rows.mean()), middle, atol=2.5)  # it is 20 pixels long
    assert 100 < len(rows) < 600
    worlds = gymnasium.make_vec(ID, num_envs=2, max_episode_steps=3, **TINY)
    worlds.reset(seed=0)
    still = np.zeros(worlds.action_space.shape, np.float32)
    for _ in range(3):
        _, _, terminated, truncated, _ = worlds.step(still)
    assert truncated.all()
    assert not terminated.any()
    with pytest.raises(UnknownNameError, match="speling"):
        gymnasium.make_vec(ID, num_envs=2, speling=1, **TINY)
    with pytest.raises(UsageError, match="render_mode 'human'"):
        VectorWorlds(LineToy(), render_mode="human")


def test_a_single_world_stays_at_its_end_until_a_reset():
    world = TeamWorld(LineToy())
    world.reset(seed=0)
    for _ in range(6):
        world.step(np.float32([1.0, 0.0] * 2 + [0.0]))
    assert world.state() == pytest.approx([1 / 8 + 6 * 0.1])
    world.reset()
    assert world.state() == pytest.approx([1 / 8 + 1 / 16])


def test_the_last_picture_of_an_episode_shows_its_end():
    """A world whose episode goes on is the oracle."""
    short, long = (
        gymnasium.make(ID, episode_steps=steps, render_mode="rgb_array", **FLAT) for steps in (4, 8)
    )
    for world in (short, long):
        world.reset(seed=0)
    for step in range(4):
        *_, ended, late, _ = short.step(np.float32([1.0, 0.0]))
        long.step(np.float32([1.0, 0.0]))
        assert (ended or late) == (step == 3)
    end = short.render()
    np.testing.assert_array_equal(end, long.render())
    short.reset()
    assert (short.render() != end).any()


def test_a_single_world_shows_a_picture_after_a_fault_and_goes_on():
    import mujoco

    world = gymnasium.make(ID, episode_steps=12, render_mode="rgb_array", **FLAT).unwrapped
    world.reset(seed=0)
    worlds, ahead = world.worlds, np.float32([0.4, 0.4])
    physics = worlds._state.batch.physics
    numbers = physics.integration.copy()
    numbers[0, worlds.env.batch.engine._parts[mujoco.mjtState.mjSTATE_QVEL].start] = np.nan
    broken = worlds._state.batch.replace(physics=physics._replace(integration=numbers))
    worlds._state = worlds._state.replace(batch=broken)
    _, reward, ended, late, info = world.step(ahead)
    assert (reward, ended, late, bool(info["fault"])) == (0.0, False, True, True)
    assert world.render().shape == (240, 320, 3)
    assert np.isfinite(world.reset()[0]).all()
    _, _, ended, late, info = world.step(ahead)
    assert (ended, late, bool(info["bad"])) == (False, False, False)


def test_record_video_of_gymnasium_writes_the_frames_of_an_episode(tmp_path):
    """MoviePy 2 asks for Pillow 11, `dev` takes a later one: the workflow's job `adapters` installs it."""
    pytest.importorskip("moviepy", reason="needs MoviePy, which gymnasium[other] brings")
    reader = pytest.importorskip("imageio_ffmpeg")
    world = gymnasium.make(ID, episode_steps=5, render_mode="rgb_array", **FLAT)
    recorded = gymnasium.wrappers.RecordVideo(world, str(tmp_path / "videos"), name_prefix="goal")
    recorded.reset(seed=0)
    seen, over = [world.render()], False
    while not over:
        _, _, ended, late, _ = recorded.step(np.float32([1.0, 0.0]))
        seen.append(world.render())
        over = ended or late
    recorded.close()
    (file,) = (tmp_path / "videos").iterdir()
    assert file.name == "goal-episode-0.mp4"
    frames = reader.read_frames(str(file))
    about = next(frames)
    assert (about["size"], about["fps"]) == ((320, 240), world.metadata["render_fps"])
    shown = [np.frombuffer(frame, np.uint8).reshape(240, 320, 3) for frame in frames]
    assert len(shown) == len(seen) == 6
    far = np.array([[np.square(np.float32(a) - b).mean() for b in seen] for a in shown])
    assert far.argmin(1).tolist() == list(range(6)), "each frame shows its own step, whatever the codec loses"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::DeprecationWarning")
def test_a_fork_of_a_process_with_jax_is_refused_instead_of_hanging():
    import usarmjx

    jnp.zeros(1).block_until_ready()  # JAX has started
    pid = os.fork()
    if not pid:
        try:
            usarmjx.make("drive-to-goal", **TINY)
        except UsageError as error:
            os._exit(0 if "'spawn'" in str(error) else 2)
        except BaseException:
            os._exit(3)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


FORKED = f"""
import gymnasium

def make():
    return gymnasium.make({ID!r}, episode_steps=5, **{TINY!r})

gymnasium.vector.AsyncVectorEnv([make, make], context="fork")
"""


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_an_async_vector_of_forks_ends_with_the_way_out_instead_of_hanging():
    """The library makes a world in the parent to learn the spaces, which starts JAX, and forks then."""
    run = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=300)
    assert run.returncode != 0
    assert "UsageError" in run.stderr
    assert "AsyncVectorEnv(..., context='spawn')" in run.stderr
