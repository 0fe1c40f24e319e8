"""Served worlds on the live page.

`served_source` says what there is to see of them; the page itself is `view`'s.
"""
