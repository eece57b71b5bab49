"""The report's map: the grid as a picture, trajectory and edges over it as SVG, one unit a metre."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mfslam.output import maps
from mfslam.output.summary import travelled_m
from mfslam.types import BoolArray, Edge, FloatArray, IntArray, OccupancyGrid, OpenStretch, RunResult

ELLIPSE_SIGMAS = 2.448  # 95 % of a normal distribution in the plane
_SCALES = (1, 2, 5, 10, 20, 50, 100)
_ELLIPSES = 300  # at most
_BAR_M = 2.0
_MARGIN_M = 1.0
_PATH_POINTS = 6000


@dataclass(frozen=True)
class Layer:
    """One thing that the reader can show or hide: an SVG group with a name."""

    key: str
    name: str
    svg: str
    shown: bool = True


def map_layers(result: RunResult, jumps: IntArray) -> tuple[list[Layer], FloatArray]:
    """The layers of the map, lowest first, and the box (left, top, width, height) that holds them all.

    ``jumps``: indices of the scans where the wheel odometry was not believed.
    """
    poses = result.world_T_body
    keyframes = poses[result.keyframes]
    loops = [edge for edge in result.edges if edge.kind == "loop" and edge.weight >= 0.5]
    rejected = [edge for edge in result.edges if edge.weight < 0.5 and edge.i != edge.j]
    stretches = result.open_stretches
    picture, box = _picture(result.grid, poses)
    extent_m = float(box[2:].max())
    scale = ellipse_scale(result.covariances, extent_m)
    layers = [
        Layer("map", "map", f'<g class="l-map">{picture}</g>'),
        _layer("weak", f"open direction ({len(stretches)})", _stretches(poses, stretches)),
        _layer(
            "ellipses",
            f"uncertainty (95 %, {scale} times as large)" if scale > 1 else "uncertainty (95 %)",
            _ellipses(poses, result.covariances, scale, extent_m),
        ),
        _layer("loops", f"loop closures ({len(loops)})", _segments(keyframes, loops)),
        _layer("rejected", f"rejected edges ({len(rejected)})", _segments(keyframes, rejected)),
        Layer("path", "trajectory", f'<path class="l-path" d="{_polyline(poses)}"/>{_ends(poses)}'),
        _layer("keyframes", f"keyframes ({len(keyframes)})", _dots(keyframes), shown=False),
        _layer("jumps", f"odometry jumps ({len(jumps)})", _dots(poses[jumps])),
    ]
    return [layer for layer in layers if layer.svg], box


def _layer(key: str, name: str, d: str, shown: bool = True) -> Layer:
    return Layer(key, name, f'<path class="l-{key}" d="{d}"/>' if d else "", shown)


def _stretches(world_T_body: FloatArray, stretches: Iterable[OpenStretch]) -> str:
    """The stretches of the path, and across the middle of each a bar along its open direction."""
    out = ""
    for stretch in stretches:
        poses = world_T_body[stretch.first_scan : stretch.last_scan + 1]
        x, y = poses[len(poses) // 2, :2]
        half = 0.5 * _BAR_M * np.array([np.cos(stretch.direction_rad), np.sin(stretch.direction_rad)])
        out += _polyline(poses) + f"M{x - half[0]:.2f} {half[1] - y:.2f}L{x + half[0]:.2f} {-y - half[1]:.2f}"
    return out


def ellipse_scale(covariances: FloatArray, extent_m: float) -> int:
    """How many times larger than life the ellipses are drawn, so that they are seen on a map of this extent."""
    if len(covariances) == 0:
        return 1
    largest_m = ELLIPSE_SIGMAS * float(
        np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, 1].max().clip(0.0))
    )
    fitting = [scale for scale in _SCALES if scale * largest_m <= 0.03 * extent_m]
    return max(fitting, default=1)


def _ellipses(world_T_body: FloatArray, covariances: FloatArray, scale: int, extent_m: float) -> str:
    """95 % ellipses of the position, evenly along the path, as closed polygons."""
    if len(world_T_body) == 0:
        return ""
    travel = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(world_T_body[:, :2], axis=0).T))])
    apart_m = max(0.03 * extent_m, travel[-1] / _ELLIPSES)
    chosen = np.unique(np.searchsorted(travel, np.arange(0.0, travel[-1] + 1e-9, apart_m)))
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    circle = scale * ELLIPSE_SIGMAS * np.stack([np.cos(angles), np.sin(angles)])
    values, vectors = np.linalg.eigh(covariances[chosen, :2, :2])
    axes = vectors * np.sqrt(values.clip(min=0.0))[:, None, :]
    outlines = world_T_body[chosen, :2, None] + axes @ circle
    return "".join("M" + "L".join(f"{x:.3f} {-y:.3f}" for x, y in o.T.tolist()) + "Z" for o in outlines)


def _picture(grid: OccupancyGrid, world_T_body: FloatArray) -> tuple[str, FloatArray]:
    """The known part of the grid as an image element, and the box around it and the path, y downwards."""
    known: BoolArray = grid.occupancy >= 0
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    del known  # grids are large
    corners = [world_T_body[:, :2]] if len(world_T_body) else [np.zeros((1, 2))]
    image = ""
    if len(rows) and len(cols):
        low = grid.origin_m + grid.resolution_m * np.array([cols[0], rows[0]])
        high = grid.origin_m + grid.resolution_m * np.array([cols[-1] + 1, rows[-1] + 1])
        corners += [low[None], high[None]]
        known_part = grid.occupancy[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        part = OccupancyGrid(low, grid.resolution_m, known_part)
        png = base64.b64encode(maps.png_bytes(maps.grid_image(part), clear_unknown=True)).decode("ascii")
        width, height = high - low
        image = (
            f'<image x="{low[0]:.3f}" y="{-high[1]:.3f}" width="{width:.3f}" height="{height:.3f}" '
            f'preserveAspectRatio="none" href="data:image/png;base64,{png}"/>'
        )
    points = np.concatenate(corners) * [1.0, -1.0]
    size = np.ptp(points, axis=0) + 2.0 * _MARGIN_M
    return image, np.concatenate([points.min(axis=0) - _MARGIN_M, size])


def _polyline(world_T_body: FloatArray) -> str:
    """The path, thinned evenly along its length: a standing robot adds nothing."""
    if len(world_T_body) == 0:
        return ""
    steps = np.hypot(*np.diff(world_T_body[:, :2], axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    cell = np.floor(along / max(travelled_m(world_T_body) / _PATH_POINTS, 0.02))
    keep = np.concatenate([[True], np.diff(cell) > 0])
    keep[-1] = True
    return "M" + "L".join(f"{x:.2f} {-y:.2f}" for x, y in world_T_body[keep, :2].tolist())


def _segments(keyframes: FloatArray, edges: Iterable[Edge]) -> str:
    xy = keyframes[:, :2].tolist()
    return "".join(f"M{xy[e.i][0]:.2f} {-xy[e.i][1]:.2f}L{xy[e.j][0]:.2f} {-xy[e.j][1]:.2f}" for e in edges)


def _dots(keyframes: FloatArray) -> str:
    # a zero-length stroke with round caps is a dot of constant size at every zoom
    return "".join(f"M{x:.2f} {-y:.2f}h0" for x, y in keyframes[:, :2].tolist())


def _ends(world_T_body: FloatArray) -> str:
    if len(world_T_body) == 0:
        return ""
    (x0, y0), (x1, y1) = world_T_body[0, :2].tolist(), world_T_body[-1, :2].tolist()
    return (
        f'<path class="l-path start" d="M{x0:.2f} {-y0:.2f}h0"><title>start</title></path>'
        f'<path class="l-path end" d="M{x1:.2f} {-y1:.2f}h0"><title>end</title></path>'
    )
