"""Pictures of a served world: the image server for robots' cameras, and a page in a browser for people.

`views` composes a client's picture of cameras, `render_thread` renders and encodes beside the loop, `overlay`
draws traces and findings of sensors. `image_server` serves USARSim's image protocol, `spectator_server` the
page `spectator.html`, whose keys are in `spectator`. Begin with `views.client_view`.
"""
