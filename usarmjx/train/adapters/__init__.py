"""The interfaces of other libraries over `train.envs.env.Env`; each needs its extra: `rl`, `train` or `sb3`.

None of them computes anything: they hand the same numbers over under other names. `agents` has what they
share. Each is held to its library's own checkers by `tests/train/adapters`. Begin with `pettingzoo.py`, the
simplest.
"""
