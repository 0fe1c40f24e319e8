"""Served worlds on the live page, which itself is `view`'s.

`viewer_service` begins it when a browser first asks, `front` lets in only who may look.
`served_source` says what there is to see of the worlds, `controls` what may be done to them.
`inset` shows pictures of robots' cameras.
"""
