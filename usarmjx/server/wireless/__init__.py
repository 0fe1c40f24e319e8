"""The radio between robots as clients see it: two protocols that carry data only while the radio does.

Dialect A (`dialect_a`) is the manual's: both robots register, and the server connects to both
ends of a link. Dialect B (`dialect_b`) is that of the later stand-alone server: it forwards a
port per pair of robots. `positions` answers such a server elsewhere. `net` has the sockets of all three.
All ask a `channel.RadioAccess`; `radio_channel` is the one of a served world. Begin with
`net.WirelessService`.
"""
