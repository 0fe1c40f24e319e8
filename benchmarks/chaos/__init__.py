"""Attacks of `usarmjx chaos`: bounded attacks on a server of one's own, and a neighbour that notices.

`attacks` says what each attack is, `attackers` carries it out, `neighbour` is the robot beside it that
behaves well, `processor` finds the server's process and its processor time, `target` starts a server, `play`
makes the table. `soak` drives robots for a long time instead and tells whether the server grows. Begin with
`attacks`.
"""
