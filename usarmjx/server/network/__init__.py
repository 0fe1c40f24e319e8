"""Ports and connections: who may connect, and on which ports the servers listen."""
