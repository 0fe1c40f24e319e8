"""Served worlds on the live page.

`served_source` says what there is to see of them, `controls` what may be done to them; the page itself is `view`'s.
`viewer_service` begins it when a browser first asks, `front` lets in only who may look, `inset` has cameras' pictures.
"""
