"""Conventional and motion-free ICP iteration by iteration, on pairs of scans whose truth is known."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mfslam import se2
from mfslam.config import DeskewConfig
from mfslam.deskew import deskew
from mfslam.icp import CELL_M, reference_table
from mfslam.kernels import align
from mfslam.types import DeskewedScan, FloatArray, Scan
from paper.rig import Drive, settings_of, wheel_twists

ITERATIONS = 15
RADIUS_M = 0.5  # partners are sought this far, at every iteration
STANDING_M = 0.01  # pairs closer than this have nothing to find


@dataclass(frozen=True)
class Method:
    """A registration of the paper: how scans are compensated, and who is whose partner."""

    name: str
    deskew: DeskewConfig
    mutual: bool


CONVENTIONAL = Method("conventional ICP (1-6)", DeskewConfig(mode="none"), mutual=False)
MOTION_FREE = Method("motion-free ICP (14-18, 25-39)", DeskewConfig(mode="pose"), mutual=True)
METHODS = (CONVENTIONAL, MOTION_FREE)
GUESSES = ("no motion known", "wheel odometry")


@dataclass(frozen=True, eq=False)
class Convergence:
    """RMS over all pairs and points before the first and after every iteration, (16,) each. ``x_m``, ``y_m``:
    registered points against where they truly are, along and across the driving. ``residual_m``: distance to
    the nearest point of the other scan, all that the ICP itself sees."""

    x_m: FloatArray
    y_m: FloatArray
    residual_m: FloatArray
    pairs: int


@dataclass(frozen=True, eq=False)
class Pair:
    """Successive scans ``n - 1`` and ``n`` of a log, and the wheels' twist through each scan."""

    drive: Drive
    scans: list[Scan]
    twists: FloatArray
    n: int

    def clouds(self, method: Method) -> tuple[DeskewedScan, DeskewedScan]:
        """Reference and source, each in its own body frame: all 682 beams."""
        a, b = (deskew(self.scans[k], self.twists[k], method.deskew) for k in (self.n - 1, self.n))
        return a, b

    def guess(self, kind: str) -> FloatArray:
        """ref_T_src (3,) to start from: no motion at all, or the wheels' through the scan before."""
        if kind == GUESSES[0]:
            return np.zeros(3)
        step_s = float(self.drive.instants_s[self.n] - self.drive.instants_s[self.n - 1])
        return se2.exp(0.5 * (self.twists[self.n - 1] + self.twists[self.n]) * step_s)

    def true_points(self, beams: np.ndarray) -> FloatArray:
        """(M, 2) where the source's points truly are, in the reference's body frame."""
        reference_T_world = se2.inverse(self.drive.world_T_body[self.n - 1])
        return se2.transform(reference_T_world, self.drive.hits_m[self.n, beams])


def pairs_of(drive: Drive, seed: int, every: int) -> list[Pair]:
    """Every so many pairs of successive scans of a log of the drive, those while it stands left out."""
    log = drive.log(seed)
    twists = wheel_twists(log.messages, settings_of())
    moved = np.hypot(*np.diff(drive.world_T_body[:, :2], axis=0).T) > STANDING_M
    scans = log.scans
    return [Pair(drive, scans, twists, int(n) + 1) for n in np.flatnonzero(moved)[::every]]


def iterate(pair: Pair, method: Method, guess: FloatArray, iterations: int = ITERATIONS) -> list[FloatArray]:
    """ref_T_src (3,) before the first and after each iteration."""
    reference, source = pair.clouds(method)
    tables = [reference_table(np.hstack([c.points_m, c.normals])) for c in (reference, source)]
    poses = [guess]
    for _ in range(iterations):
        pose, _, _ = align.point_to_point(
            tables[0], tables[1], CELL_M, poses[-1], RADIUS_M, RADIUS_M, 1, method.mutual
        )
        poses.append(pose)
    return poses


def converge(pairs: list[Pair], method: Method, guess_kind: str) -> Convergence:
    squares = np.zeros((3, ITERATIONS + 1))
    counts = np.zeros((2, ITERATIONS + 1))
    for pair in pairs:
        reference, source = pair.clouds(method)
        true = pair.true_points(source.beams)
        tree = cKDTree(reference.points_m)
        known = np.isfinite(true[:, 0])  # noise may bring a hit beyond the range back into it
        for k, pose in enumerate(iterate(pair, method, pair.guess(guess_kind))):
            placed = se2.transform(pose, source.points_m)
            off = (placed - true)[known]
            near = np.asarray(tree.query(placed, distance_upper_bound=RADIUS_M)[0])
            near = near[np.isfinite(near)]
            squares[:, k] += np.sum(off[:, 0] ** 2), np.sum(off[:, 1] ** 2), np.sum(near**2)
            counts[:, k] += len(off), len(near)
    x, y, residual = np.sqrt(squares / counts[[0, 0, 1]])
    return Convergence(x, y, residual, len(pairs))


def time_methods(pairs: list[Pair], rounds: int) -> dict[str, float]:
    """Mean CPU ms of compensation, search structures and 15 iterations on one pair, on one core; the methods
    take turns, so that a busy machine slows both."""
    spent = {method.name: 0.0 for method in METHODS}
    for method in METHODS:  # compiled before the clock starts
        iterate(pairs[0], method, np.zeros(3))
    for _ in range(rounds):
        for pair in pairs:
            for method in METHODS:
                start_s = time.process_time()
                iterate(pair, method, np.zeros(3))
                spent[method.name] += time.process_time() - start_s
    return {name: 1e3 * s / (rounds * len(pairs)) for name, s in spent.items()}
