"""A small policy of drive-to-goal with weights set by hand, in a file as `usarmjx export` writes them."""

import json

import numpy as np

AHEAD, TURN = 1.5, 2.5
"""How much the cosine and the sine of the goal's bearing count: tanh(AHEAD cos -+ TURN sin)."""


def policy_file(path, overrides=None, obs_size=4, task="drive-to-goal"):
    """Write the policy: left = tanh(AHEAD cos - TURN sin), right = tanh(AHEAD cos + TURN sin).

    The hidden units are cosine and sine + 2, which ELU leaves as they are.
    """
    hidden = np.zeros((obs_size, 2), np.float32)
    hidden[0, 0] = hidden[1, 1] = 1.0
    head = np.array([[AHEAD, AHEAD, 0, 0], [-TURN, TURN, 0, 0]], np.float32)
    about = {
        "format": 1,
        "task": task,
        "overrides": overrides or {},
        "period": 0.2,
        "groups": [{"name": "P2AT", "agents": ["P2AT0"], "obs_size": obs_size, "action_size": 2}],
        "layers": 1,
        "memory": 0,
    }
    np.savez(
        path,
        about=np.array(json.dumps(about)),
        **{
            "mean/0": np.zeros(obs_size, np.float32),
            "std/0": np.ones(obs_size, np.float32),
            "weights/0/layer_0/kernel": hidden,
            "weights/0/layer_0/bias": np.full(2, 2.0, np.float32),
            "weights/0/head/kernel": head,
            "weights/0/head/bias": (-2.0 * head.sum(0)).astype(np.float32),
        },
    )
    return path
