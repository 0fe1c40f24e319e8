"""The Gamebots server: clients' commands drive robots of a served world, and their reports go back.

`server` has the sockets of one world, `adapter` carries out the commands of a client, `reporter` and
`sensors` make its reports: `sensors` has the manual's sensors, `victims` those that find victims and RFID
tags. Any other sensor declares its quantities (`Sensor.quantities`) and needs nothing here. Readings come in
our axes and leave in the wire's. Begin with `server.BotServer.tick`, then `adapter.Client`.
"""
