"""The map: every beam of every scan re-projected from the body's pose at the beam's own instant.

Hits are moved, within their noise, onto the surface that all scans agree on. A cell is judged by its hits against the
beams that passed through it: what stood there only for a while is cleared by the beams that passed before
and after; what is seen through from aslant and met squarely is glass and stays. Walls are brought to one cell.
"""

from mfslam.mapping.render import render_map

__all__ = ["render_map"]
