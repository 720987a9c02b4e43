"""Pictures: files read into a `Frame` with masks, time and header pointing; the sky's level and noise.

reading       `read_image`: FITS, VICAR or PDS3 by content, every failure one line
keywords      `KeywordMap`: which header keywords hold what
masks         what quality bits mean, as data
expansion     values squeezed on board, by table
smear         columns that a frame-transfer CCD smears
background    level and noise of the sky, robust against stars and a resolved body
extended      where the light of resolved bodies covers the picture
heliocentric  from the Sun to the barycenter without kernels
"""

from opnav_workbench.image.background import Background, estimate_background
from opnav_workbench.image.extended import extended_light, sky_and_bodies
from opnav_workbench.image.frame import Frame, Header, HeaderGeometry, HeaderValue
from opnav_workbench.image.heliocentric import barycentric_from_heliocentric
from opnav_workbench.image.keywords import KeywordMap
from opnav_workbench.image.masks import QUALITY_TABLES, QualityBit, QualityTable, read_quality
from opnav_workbench.image.noise import pixel_noise
from opnav_workbench.image.reading import read_image
from opnav_workbench.image.smear import column_level

__all__ = [
    "QUALITY_TABLES",
    "Background",
    "Frame",
    "Header",
    "HeaderGeometry",
    "HeaderValue",
    "KeywordMap",
    "QualityBit",
    "QualityTable",
    "barycentric_from_heliocentric",
    "column_level",
    "estimate_background",
    "extended_light",
    "pixel_noise",
    "read_image",
    "read_quality",
    "sky_and_bodies",
]
