"""Ports and connections: which ports the servers get, and who may connect to them.

`ports` finds and binds ports, `access` holds the rules (networks, token, number of connections), `gate`
applies them to a connection, and `web_gate` to a browser's request. `loop_meter` bounds what connections cost
the loop in a control step. Nothing here knows worlds. Begin with `gate.Gate`.
"""
