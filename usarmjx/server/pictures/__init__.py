"""Pictures of a served world: the image server for robots' cameras, and a page in a browser for people.

`views` says which cameras share a client's picture, `render_thread` renders and encodes so that the loop
steps on, `dots` draws traces and what sensors find. `image_server` serves USARSim's image protocol,
`spectator_server` the page `spectator.html`; what its keys do is `spectator`. Begin with
`views.client_view`.
"""
