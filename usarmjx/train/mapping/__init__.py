"""Beliefs and targets of a team's robots: maps from scans, messages with maps, paths to frontiers.

`maps` are squares of one map, `wavefront` paths over it, `belief` what each robot holds true and sends to
others, `planning` where it goes next. All are pure functions of arrays; none sees the truth, and none may: a
policy that knew more than its sensors would be worth nothing on a robot. Begin with `maps.py`, then
`belief.Belief`.
"""
