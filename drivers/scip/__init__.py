"""Hokuyo lasers over SCIP 2.0 (source: Hokuyo, C-42-03320B).

`codec` (characters), `status` (codes in words), `requests`, `replies` (bytes into replies): no I/O.
`session`: the talk over a line. `sensor`: scans on the host's clock.
"""
