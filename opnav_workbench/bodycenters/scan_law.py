"""A scattering law made to fit: the body's own, darkened toward the limb by more or less.

Lommel-Seeliger's law is Lambert's times 2 / (mu0 + mu), mu0 and mu the cosines of incidence and emission; most laws lie
between the two. A power of that factor times any law, ``law (2 / (mu0 + mu))^share``, follows what scans show of the
darkening near the limb: share 1 turns Lambert into Lommel-Seeliger, share -1 the other way.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.render import BodyModel, ScatteringLaw

__all__ = ["FitLaw", "law_share", "with_law_share"]

LARGEST_SHARE = 1.2  # a little beyond from one law to the other
DARKEST = 0.02  # mu0 + mu that the factor is bounded at, near the cusps


@dataclass(frozen=True, slots=True)
class FitLaw(ScatteringLaw):
    """A law times ``(2 / (mu0 + mu))^share``.

    Examples
    --------
    >>> from opnav_workbench.render import Lambert, LommelSeeliger
    >>> law = FitLaw(Lambert(), 1.0)
    >>> law.reflectance(0.5, 0.3, 0.2) == LommelSeeliger().reflectance(0.5, 0.3, 0.2)
    np.True_
    """

    law: ScatteringLaw
    share: float
    uses_phase: ClassVar[bool] = True

    def _lit(self, mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:
        factor = 2.0 / np.maximum(mu0 + mu, DARKEST)
        return np.asarray(self.law.reflectance(mu0, mu, phase_rad) * factor**self.share)


def law_share(picture: BodyPicture, name: str) -> float:
    """Return the share that is in a body's law already."""
    law = picture.model(name).law
    return law.share if isinstance(law, FitLaw) else 0.0


def with_law_share(picture: BodyPicture, name: str, share: float) -> BodyPicture:
    """Return the picture with another share in the law of one body's model, kept within bounds."""
    bounded = float(np.clip(share, -LARGEST_SHARE, LARGEST_SHARE))
    models = (_shared(m, bounded) if m.target.name == name else m for m in picture.models)
    return replace(picture, models=tuple(models))


def _shared(model: BodyModel, share: float) -> BodyModel:
    own = model.law.law if isinstance(model.law, FitLaw) else model.law
    return replace(model, law=FitLaw(own, share))
