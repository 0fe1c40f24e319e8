"""What `usarmjx arena check` looks at: whether robots can start, what they reach, what lies in what.

`arena` has the checks, each a generator of sentences; `probe` is the arena on C MuJoCo with one robot in
it. Begin with `arena.check_arena`. A check says where, and how far from right; it never raises for what it
finds.
"""
