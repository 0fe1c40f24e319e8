"""Worlds as they look: what recordings keep, and what the page in a browser shows.

`drawing` has the values, `capture` makes them of a world as it is, whatever the engine.
`page` is where to begin with the live page: `stage` and `mesh` draw bodies, `layers` what is
drawn over them, `viewpoint` follows robots.
"""
