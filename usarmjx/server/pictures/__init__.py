"""Pictures of a served world: the image server for robots' cameras, and what the live page shows of them.

`views` composes a client's picture of cameras, renders and encodes it beside the loop, and draws traces and
findings of sensors. `image_server` serves USARSim's image protocol. Begin with
`views.client_view`.
"""
