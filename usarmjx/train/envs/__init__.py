"""The contract of training: `task` has the base class of tasks, `env` runs a task in a batch of worlds.

`Task` is data and pure functions of one world; `Env` maps them over worlds with the functions of `episode`
and returns an `EnvState` (`state`). `recipe` has the parts of a task's scene, `policy` the type of policies.
`observe` must not see the truth: only sensors' readings, links and mail. A new field of `TaskState` or of a
task's memory needs another `learning.checkpoint.FORMAT`. Begin with `task.py`, then `Env._step` in `env.py`.
"""
