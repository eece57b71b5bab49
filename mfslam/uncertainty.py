"""Quantiles of what is uncertain."""

from __future__ import annotations


def chi2_quantile(probability: float) -> float:
    """Quantile of chi2 with three degrees of freedom."""
    from scipy.special import chdtri

    return float(chdtri(3, 1.0 - probability))
