"""Tasks for BenchMARL: what its experiments ask of one, and algorithms that choose and that do not."""

import pickle

import pytest

from tests.train.toys import LineToy
from usarmjx.base.errors import UnknownNameError

pytest.importorskip("benchmarl", reason="needs BenchMARL, which docs/stacks.md tells the version of")
from benchmarl.algorithms import IppoConfig, MappoConfig, QmixConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig

from usarmjx.train.adapters import benchmarl as adapter

FRAMES = 48


def test_benchmarl_gets_what_a_task_is(monkeypatch):
    toy = LineToy(worlds=4)
    monkeypatch.setattr(adapter, "make", lambda name, worlds, engine, **fields: toy)
    task = adapter.BenchmarlTask("convoy", {"engine": "c", "episode_steps": 9, "bins": 5})
    assert pickle.loads(pickle.dumps(task)) == task
    env = task.get_env_fun(4, continuous_actions=False, seed=1, device="cpu")()
    assert env.batch_size == (4,)
    assert task.group_map(env) == {"A": ["A0", "A1"], "B": ["B0"]}
    assert task.max_steps(env) == toy.episode_steps
    seen, acts = task.observation_spec(env), task.action_spec(env)
    assert {key: tuple(seen[key].shape) for key in seen.keys(True, True)} == {
        ("A", "observation"): (2, 2),
        ("B", "observation"): (1, 2),
    }
    assert (acts["A", "action"].n, acts["B", "action"].n) == (25, 5)
    state = task.state_spec(env)
    assert {key: tuple(state[key].shape) for key in state.keys(True, True)} == {"state": (3 * 2 + 1,)}
    with pytest.raises(UnknownNameError, match="speling"):
        adapter.BenchmarlTask("convoy", {"speling": 1})


@pytest.mark.parametrize("algorithm", [MappoConfig, IppoConfig, QmixConfig])
def test_an_experiment_of_benchmarl_collects_learns_and_evaluates(algorithm, monkeypatch, tmp_path):
    monkeypatch.setattr(
        adapter, "make", lambda name, worlds, engine, **fields: LineToy(worlds=worlds, mixed=False)
    )
    config = ExperimentConfig.get_from_yaml()
    config.loggers, config.create_json, config.render, config.save_folder = [], True, False, str(tmp_path)
    config.on_policy_n_envs_per_worker = config.off_policy_n_envs_per_worker = 4
    config.on_policy_collected_frames_per_batch = config.off_policy_collected_frames_per_batch = FRAMES
    config.on_policy_minibatch_size = config.off_policy_train_batch_size = FRAMES // 2
    config.on_policy_n_minibatch_iters = config.off_policy_n_optimizer_steps = 1
    config.evaluation_interval, config.evaluation_episodes, config.max_n_frames = FRAMES, 2, 2 * FRAMES
    experiment = Experiment(
        task=adapter.BenchmarlTask("convoy"),
        algorithm_config=algorithm.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
    )
    assert experiment.continuous_actions == (algorithm is not QmixConfig)
    experiment.run()
    assert experiment.total_frames == 2 * FRAMES
    # Robots at rest collect 6 x (5/16 + 1/2); actions change that by 2.1 at most, later starts by 6 x 3/16.
    assert 4.87 - 2.1 <= experiment.mean_return <= 4.88 + 2.1 + 18 / 16
    assert list(tmp_path.rglob("*.json"))
