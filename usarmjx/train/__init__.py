"""Policies: tasks, environments over batches of worlds, hand-written baselines, training, evaluation.

`envs` has the contract (`Task`, `Env`, `Policy`), `tasks` what robots are asked to do, `scenes` and `mapping`
what tasks are made of, `baselines` policies by hand; `learning` is PPO over one or more `processes`,
`policies` what comes out, `evaluation` how good it is, `adapters` other libraries' interfaces. A new task or
baseline goes beside the others and touches nothing else. Names of fields of tasks, `Config` and metrics are
keys of files: keep them. Begin with `envs/task.py`, then `tasks/drive_to_goal.py`.
"""
