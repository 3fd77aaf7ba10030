"""When the method of multipliers is satisfied with a minimum, and how stiff its penalty becomes."""

from __future__ import annotations

from orbimpc_ros.mpc.kernels import compiled

ENOUGH = 1e-2  # a minimum is near enough at this share of what the multipliers gain by it
HALVINGS = 30
DESCENT = 1e-4  # share of a Newton step's promise that a step must keep
ROUNDING = 1e-13
GROWTH = 3.0
QUICK, SLOW, STUCK = 2, 6, 15  # Newton steps after which sigma grows fast, grows, stays, shrinks


@compiled
def stiffened(sigma, largest, near, taken):
    """Return the next sigma, after so many Newton steps that came near a minimum or did not."""
    if not near:
        return sigma / (GROWTH * GROWTH)
    if taken <= QUICK:
        return min(largest, sigma * GROWTH * GROWTH)
    return min(largest, sigma * GROWTH) if taken <= SLOW else sigma


@compiled
def descends(reached, merit, share, decrease):
    """Return whether a share of a Newton step brings the merit down far enough (Armijo)."""
    return reached <= merit - DESCENT * share * decrease + ROUNDING * (1.0 + abs(merit))
