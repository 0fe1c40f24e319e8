"""A world of `LineToy` for Gymnasium, written by hand: what our adapters are compared with."""

import gymnasium
import numpy as np

from tests.train.toys import END


class Line(gymnasium.Env):
    """A world of `LineToy` with one robot, by hand."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def __init__(self, number):
        self.number, self.episode = number, -1

    def reset(self, *, seed=None, options=None):
        self.episode, self.length, self.score = self.episode + 1, 0, 0.0
        self.x = (self.number + 1) / 8 + self.episode / 16
        return np.array([self.x, 0.0], np.float32), {}

    def step(self, action):
        self.x, self.length = self.x + 0.1 * float(action[0]), self.length + 1
        self.score += self.x
        ended = self.x > END
        info = {"way": self.x, "score": self.score}
        return (
            np.array([self.x, self.length], np.float32),
            self.x,
            ended,
            not ended and self.length >= 6,
            info,
        )
