"""A second hostile suite, written from the documents of the protocols alone: `python -m benchmarks.hostile`.

It shares no code with `usarmjx chaos`. It starts a server of its own and attacks 127.0.0.1 only.
"""
