"""Round enlargement factors, for residual vectors that a person reads off."""

import numpy as np

__all__ = ["round_scale"]


def round_scale(scale: float) -> float:
    """Return the largest of 1, 2, 5 x 10^k that is not above `scale`.

    Examples
    --------
    >>> round_scale(734.0), round_scale(0.3)
    (500.0, 0.2)
    """
    power = 10.0 ** np.floor(np.log10(scale))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= scale * (1.0 + 1e-9)))
