"""The loop that serves worlds: its clock, logs and metrics, and how it ends.

`loop` steps worlds in time and runs all services, `background` runs it in a thread for a Python program,
`signals` ends it, `logs` and `metrics` report on it. Begin with `loop.ServerLoop`.
"""
