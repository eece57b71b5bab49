"""Sensors that are not there: they speak their protocols byte by byte on pseudo-terminals, at true bit rates.

`urg` (a Hokuyo over SCIP), `board` (encoders): what a device says, no I/O. `wire`: the cable, and what goes
wrong on it. `stage`: the world that they sense. `pty_port`, `serve`: as a process of its own.
"""
