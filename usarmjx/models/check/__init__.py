"""Checks of `usarmjx arena check`: start poses, reachability, and overlapping solids.

`arena` has the checks, each a generator of sentences; its `ArenaProbe` is the arena on C MuJoCo with one
robot. Begin with `arena.check_arena`. A check reports position and error distance; it never raises for a
finding.
"""
