"""Ports and connections: ports of the servers, and access rules for the peers that connect."""
