"""A quadratic form that is nowhere above chi2 of a pose graph, and touches it (but for terms of fourth order) at a solution.

In unit complex headings z and complex positions t, as in `chordal`. Of one edge: e = (u, theta) its error, p the
translation of which u = log's is p e^(-i theta/2) (theta/2) / sin(theta/2); those of the solution have a 0; w, q: turn and
translation that were measured. Let D = diag(tau, tau, kappa) <= Omega, R = Omega - D and c = R e0 = (m, c_theta). Then

    e^T Omega e >= e^T D e + 2 c . e - c . e0                     (R has no negative eigenvalue; equal at e0)
    tau |u|^2   >= tau |p|^2                                      (equal at theta = 0)
    theta^2     >= theta0^2 + 2 gamma (cos theta0 - cos theta),   gamma = theta0 / sin theta0
    2 c_theta (theta - theta0) >= 2 c_theta sin d - 2 |c_theta| h (2 - 2 cos d),   d = theta - theta0,
        h the largest (|d| - sin |d|) / (2 - 2 cos d) there is, at |d| = pi + |theta0|
    2 m . u = gamma m . (p + p e^(-i theta)) + 2 f m . p e^(-i theta/2)

where p and p e^(-i theta) are forms conj(z_i) (t_j - t_i) and conj(z_j) (t_j - t_i) but for a constant turn, and, of the rest,

    |f| <= pi/2 (gamma - 1) + pi/4 (1 - cos theta),   f^2 <= (pi/2 0.4362 pi/2 gamma)^2 (2 - 2 cos d).

With p = p0 + delta, a share `_SHARE` of tau |delta|^2 pays for 2 f m . delta at a price in (2 - 2 cos d), which kappa pays;
edges of the same two poses, whose |delta| is one, pay together. Where that is more than kappa has, R is made smaller.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfslam import se2
from mfslam.graph.chordal import Couplings, QuadraticForm, quadratic_form
from mfslam.pose_graphs.data import Problem
from mfslam.types import BoolArray, FloatArray

_SHARE = 0.4
_STEEP = (0.5 * np.pi * 0.4362 * 0.5 * np.pi) ** 2  # 0.4362: the steepest sin(x) / x becomes
_MOST = 0.5  # of kappa that may be spent


@dataclass(frozen=True, eq=False)
class Minorant:
    """chi2 of any poses >= ``form`` there + ``constant``. ``is_plain``: no edge weighs its errors by direction."""

    form: QuadraticForm
    constant: float
    is_plain: bool


def minorant(problem: Problem, world_T_pose: FloatArray) -> Minorant | None:
    """The form that touches at poses (N, 3); none where an edge is half a turn off."""
    poses = np.vstack([world_T_pose, np.zeros(3)])
    error = se2.between(problem.i_T_j, se2.between(poses[problem.i], poses[problem.j]))
    e0 = se2.log(error)
    theta = e0[:, 2]
    sine = np.where(theta == 0, 1.0, np.sinc(theta / np.pi))
    if (sine <= 1e-6).any():
        return None
    gamma = 1.0 / sine
    tau, kappa, plain = isotropic_part(problem.information)
    p0 = error[:, 0] + 1j * error[:, 1]
    q = problem.i_T_j[:, 0] + 1j * problem.i_T_j[:, 1]
    w = np.exp(1j * problem.i_T_j[:, 2])
    rest = problem.information.copy()
    rest[:, (0, 1, 2), (0, 1, 2)] -= np.stack([tau, tau, kappa], axis=-1)
    rest[plain] = 0.0
    c, price, share = _paid(problem, rest, e0, tau, kappa, gamma)
    m, turn = c[:, 0] + 1j * c[:, 1], c[:, 2]
    # translations
    left = (1.0 - share) * tau
    a = np.conj((2.0 * share * tau * p0 + gamma * m) * w)
    b = np.conj(gamma * m)
    constant = -share * tau * np.abs(p0) ** 2 - (a * q).real - np.sum(c * e0, axis=1)
    # headings: cosine cos(theta) + sine sin(theta)
    bent = 2.0 * np.abs(turn) * (np.pi + np.abs(theta) + np.sin(np.abs(theta))) / (2.0 + 2.0 * np.cos(theta))
    price = price + bent
    slack = np.abs(m) * np.abs(p0)
    cosine = (
        -2.0 * kappa * gamma + 2.0 * price * np.cos(theta) - 2.0 * turn * np.sin(theta) + 0.5 * np.pi * slack
    )
    sines = 2.0 * price * np.sin(theta) + 2.0 * turn * np.cos(theta)
    constant += kappa * theta**2 + 2.0 * kappa * gamma * np.cos(theta) + 2.0 * turn * theta
    constant -= 2.0 * price + 0.5 * np.pi * slack + np.pi * slack * (gamma - 1.0)
    # what is left of the cosine as a square, which rounds better
    square = np.maximum(-0.5 * cosine, 0.0)
    constant -= 2.0 * square
    rest_cosine = cosine + 2.0 * square
    turns = (rest_cosine - 1j * sines) * np.conj(w) - np.conj(b * q)
    return Minorant(
        quadratic_form(problem, left, square, Couplings(a, b, turns)),
        float(constant.sum()),
        bool(plain.all()),
    )


def _paid(
    problem: Problem, rest: FloatArray, e0: FloatArray, tau: FloatArray, kappa: FloatArray, gamma: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """c (E, 3), what it costs of 2 - 2 cos d (E,), and the share of tau (E,) that is spent."""
    pair = problem.i * (problem.size + 1) + problem.j
    _, group = np.unique(pair, return_inverse=True)
    c = np.einsum("eab,eb->ea", rest, e0)
    pull = np.hypot(c[:, 0], c[:, 1])

    def of_group(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(group, weights=values)[group])

    funds = _SHARE * of_group(tau)
    cost = _STEEP * gamma**2 * pull * of_group(pull)
    needed = np.where(cost > 0, cost / np.maximum(_MOST * kappa * funds, 1e-300), 0.0)
    smaller = np.zeros_like(needed)
    np.maximum.at(smaller, group, needed)
    scale = 1.0 / np.sqrt(np.maximum(smaller[group], 1.0))
    scale[~np.isfinite(scale) | (cost / np.maximum(funds, 1e-300) == np.inf)] = 0.0
    c *= scale[:, None]
    price = np.where(cost > 0, scale**2 * cost / np.maximum(funds, 1e-300), 0.0)
    return c, price, np.where(of_group(pull * scale) > 0, _SHARE, 0.0)


def isotropic_part(information: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """tau, kappa (E,): diag(tau, tau, kappa) is below the information matrix (E, 3, 3) in every direction; and where it
    is equal to it (E,).

    kappa is most of what is known of the heading when the translation is not, tau what remains in every direction.
    """
    off = np.abs(information[:, (0, 0, 1), (1, 2, 2)]).max(axis=1)
    plain = (off == 0) & (information[:, 0, 0] == information[:, 1, 1])
    translation, cross, heading = information[:, :2, :2], information[:, :2, 2], information[:, 2, 2]
    values, vectors = np.linalg.eigh(translation)
    along = np.einsum("eba,eb->ea", vectors, cross)
    floor = 1e-12 * np.maximum(values[:, 1], 0.0)[:, None] + 1e-300
    told = np.sum(along**2 / np.maximum(values, floor), axis=1)  # of the heading, by the translation
    own = np.maximum(heading - told, 0.0)
    kappa = np.where(own > 0, own / (1.0 + np.sqrt(told / np.where(own > 0, own, 1.0))), 0.0)
    spare = heading - kappa
    cut = np.where(spare[:, None, None] > 0, cross[:, :, None] * cross[:, None, :], 0.0)
    cut = cut / np.where(spare > 0, spare, 1.0)[:, None, None]
    tau = np.maximum(np.linalg.eigvalsh(translation - cut)[:, 0], 0.0)
    # where doubles do not show that it is below, nothing is claimed
    tau, kappa = (1.0 - 1e-9) * tau, (1.0 - 1e-9) * kappa
    below = information.copy()
    below[:, (0, 1, 2), (0, 1, 2)] -= np.stack([tau, tau, kappa], axis=-1)
    scale = np.sqrt(np.maximum(np.einsum("eaa->ea", information), 1e-300))
    negative = np.linalg.eigvalsh(below / (scale[:, :, None] * scale[:, None, :]))[:, 0] < -1e-9
    tau, kappa = np.where(negative, 0.0, tau), np.where(negative, 0.0, kappa)
    return np.where(plain, information[:, 0, 0], tau), np.where(plain, heading, kappa), plain
