"""Effect of settings of the physics on every robot class, beside the reference settings.

Each manoeuvre is driven in a world of C MuJoCo and gives one number; `scorecard` compares them. Begin with
`manoeuvres.py`; `track.py` has the ground that they need.
"""
