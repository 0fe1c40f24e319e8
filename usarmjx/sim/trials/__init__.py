"""Robots driven through arenas: repetitions in the lanes of the NIST test methods, and coverage of an arena.

`driver` drives one robot along points on C MuJoCo, sets its flippers and counts repetitions in a lane;
`routes` drives to all points that an arena declares reachable; `obstacles` measures crossings. Drivers know
the true state and avoid nothing, so a better driver may pass where these fail.
"""
