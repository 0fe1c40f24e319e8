"""PPO: the robots act (`rollout`), an update follows (`ppo`), and `trainer` does both until the run is over.

Data are in `trajectory` (what a rollout brings) and `train_state` (what an update changes), networks in
`networks`; `config` has all settings, `metrics` and `checkpoint` what a run writes. Runs are
resumed bit by bit, so random keys are folded by number, never split in sequence, and the order of sums does
not depend on the number of processes. Begin with `Trainer.iterate` in `learner.py`, then `ppo.update`.
"""
