"""Evaluation: `evaluate` plays episodes, `yardsticks` compares teams, `radio_matters` radios.

Scores are means over episodes, each world with as many of them, with 95 % intervals; episodes whose physics
failed are left out and counted. A change of the choice of episodes changes all published figures. Begin
with `evaluate.run_episodes`.
"""
