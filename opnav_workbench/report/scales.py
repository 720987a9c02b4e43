"""Round scales and the shape of a picture, for figures and for the page: numbers, without what draws."""

import numpy as np

__all__ = ["STRIP_ASPECT", "round_scale", "vector_scale"]

# A picture wider than this many times its height is shown as strips, one under the other.
STRIP_ASPECT = 4.0
# Share of the picture's shorter side that the longest vector takes; of a strip, at least this share of its longer side.
VECTOR_SHARE, LEAST_SIDE = 0.12, 0.05


def round_scale(scale: float) -> float:
    """Return the largest of 1, 2, 5 x 10^k that is not above `scale`.

    Examples
    --------
    >>> round_scale(734.0), round_scale(0.3)
    (500.0, 0.2)
    """
    power = 10.0 ** np.floor(np.log10(scale))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= scale * (1.0 + 1e-9)))


def vector_scale(longest_px: float, n_pixel: int, n_line: int) -> float:
    """Return the round factor that residual vectors are enlarged by over a picture.

    Examples
    --------
    >>> vector_scale(0.2, 1024, 1024)
    500.0
    """
    side = max(min(n_pixel, n_line), LEAST_SIDE * n_pixel)
    return round_scale(VECTOR_SHARE * side / max(longest_px, 1e-6))
