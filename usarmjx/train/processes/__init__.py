"""Several processes that train together, one for each device.

`launch` starts them and reads from environment variables which is which, without JAX; `group` joins them and
moves arrays between what one process has (local) and what all have together (global). Only gradients and sums
cross between them. Begin with `group.ProcessGroup`; `learning/ppo.py` is where they meet.
"""
