"""Served worlds on the live page, which itself is in `view`.

`viewer_service` starts the page when a browser first asks for it, `viser_gate` admits browsers.
`served_source` draws the worlds, `controls` carries out requests of users, `inset` shows pictures of robots'
cameras, and `console` has the console.
"""
