"""The contract of training: what a task is (`task`), and a task in a batch of worlds (`env`).

`Task` is data and pure functions of one world; `Env` maps them over worlds with the functions of `episode`
and hands out an `EnvState` (`state`). `recipe` says what a task's scene is made from, `policy` what acts.
`observe` must not see the truth: only sensors' readings, links and mail. Whoever adds a field to `TaskState`
or to a task's memory raises `learning.checkpoint.FORMAT`. Begin with `task.py`, then `Env._step` in `env.py`.
"""
