"""Clips of trainings: which worlds they show, and that they are moving pictures of the rollout."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
from PIL import Image
from tensorboardX.proto.event_pb2 import Event

import usarmjx
from usarmjx.plots.play import Clips, ranked_worlds
from usarmjx.train.learning.tensorboard import TensorBoardLog
from usarmjx.train.learning.trajectory import RolloutInputs

STEPS = 3


def test_worlds_are_ranked_by_their_rewards_and_bad_ones_left_out():
    reward = np.array([[1.0, 5.0, 2.0, 9.0, 3.0], [1.0, 0.0, 2.0, 9.0, 3.0]])
    bad = np.zeros((2, 5), bool)
    bad[1, 3] = True
    assert ranked_worlds(reward, bad) == {"best": 4, "median": 1, "worst": 0}
    assert ranked_worlds(reward[:, :1], bad[:, :1]) == {"best": 0, "median": 0, "worst": 0}
    assert ranked_worlds(reward, np.ones((2, 5), bad.dtype))["best"] == 3


def test_clips_are_of_every_nth_iteration_and_move(tmp_path):
    env = usarmjx.make("drive-to-goal", worlds=2, engine="c", ranges=(), pose="GroundTruth")
    actions = (jnp.zeros((STEPS, 2, 1, 2)).at[:, 1].set(1.0),)
    none = jnp.zeros((STEPS, 2), bool)
    seen = []
    clips = Clips(env, tmp_path, 2, (lambda *clip: seen.append(clip),))
    for iteration in (1, 2):
        clips.inspect(
            RolloutInputs(
                iteration=iteration,
                env_state=env.reset(0),
                actions=actions,
                reward=jnp.zeros((STEPS, 2)).at[:, 1].set(1.0),
                done=none,
                bad=none,
            )
        )
    assert [(rank, path.name, iteration) for rank, path, iteration in seen] == [
        (rank, f"iteration-000002-{rank}.gif", 2) for rank in ("best", "median", "worst")
    ]
    with Image.open(seen[0][1]) as film:
        assert film.n_frames == STEPS + 1


def test_tensorboard_gets_them_as_moving_pictures(tmp_path):
    gif = tmp_path / "clip.gif"
    frames = [Image.new("P", (12, 7), color) for color in (0, 1)]
    frames[0].save(gif, save_all=True, append_images=frames[1:])
    board = TensorBoardLog(tmp_path / "board", 0)
    board.show_picture(640, "clips/best", gif.read_bytes())
    board.close()
    (file,) = (tmp_path / "board").iterdir()
    data, events = file.read_bytes(), []
    while data:
        size = int.from_bytes(data[:8], "little")
        events.append(Event.FromString(data[12 : 12 + size]))
        data = data[16 + size :]
    value = events[-1].summary.value[0]
    assert (events[-1].step, value.tag) == (640, "clips/best")
    assert (value.image.width, value.image.height) == (12, 7)
    assert value.image.encoded_image_string == gif.read_bytes()


def test_weights_and_biases_gets_them_as_videos(monkeypatch):
    from usarmjx.cli import train

    logged = []

    def log(*values, **options):
        logged.append((values, options))

    module = SimpleNamespace(log=log, Video=lambda path, format: (path, format))
    monkeypatch.setattr("usarmjx.train.learning.metrics.find_wandb", lambda: module)
    train._to_wandb("best", train.Path("x.gif"), 2)
    assert logged == [(({"clips/best": ("x.gif", "gif")},), {"commit": False})]
