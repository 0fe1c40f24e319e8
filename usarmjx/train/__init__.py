"""Policies: tasks, environments over batches of worlds, hand-written baselines, training, evaluation."""
