"""Robots driven through arenas: whether they pass, and how often in the lanes of the NIST test methods.

`driver` drives one robot along points on C MuJoCo, `postures` says what its flippers do meanwhile, `lanes`
counts repetitions, `ways` drives all that a robot is said to reach. Drivers know the truth and no obstacle:
what they do not get over, a better driver may.
"""
