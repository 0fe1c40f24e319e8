"""Robots and arenas as data, and their composition into one MuJoCo model. Nothing here knows worlds or time.

`spec` says what a robot and an arena are; `robots`, `drives`, `effecters` and `arenas` are the manual's;
`generate` makes arenas by seed. `files`, `ini` and `roads` read them from outside and write them, `build`
makes an MjSpec of them and indices of names, `check` says what is wrong with an arena. Begin with a robot
of `robots`, then `build.compose`. Values are frozen: what changes is a copy by `dataclasses.replace`.
"""
