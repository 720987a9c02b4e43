"""Pictures: files read into a `Picture` with masks, time and header pointing; the sky's level and noise.

Enter by `read_image` for a file, by `sky_and_bodies` or `estimate_background` for the sky in it.

``picture``
    `Picture` and `read_image`: from a file to pixels, masks, mid-exposure time and header pointing.
``file_bytes``
    The bytes of a picture file, bounded.
``formats``
    FITS, VICAR, PDS3, PDS4, ISIS cubes, PNG, TIFF, JPEG and raw files, told by content; every failure one line.
``picture_trial``
    Compressed images tried out in a supervised process.
``pds_label``
    Labels of PDS3 files and ISIS cubes read in one pass: their values, and where the picture is.
``header``
    `Header` and `KeywordMap`: which keywords hold what; pointing and trajectory from them, to the barycenter.
``planes``
    Picture, error and masks of one shape from the stored arrays; squeezed values expanded.
``contradictions``
    What a header says against itself, or against what any spacecraft can do.
``masks``
    What the bits of quality planes mean, as data.
``background``
    Level and noise of the sky, robust against stars and a resolved body; columns that a frame-transfer CCD smears.
``readout_smear``
    What bodies leave along their columns while a frame-transfer CCD is read out.
``extended``
    Where the light of resolved bodies covers the picture.
``picture_files``
    What paths, folders and patterns stand for, and how each picture's folder of results is named.
"""

from opnav_workbench.image.background import (
    Background,
    column_level,
    contained_bias_dn,
    darkest_sky,
    estimate_background,
    pixel_noise,
)
from opnav_workbench.image.contradictions import unknown_velocity_sigma_km_s
from opnav_workbench.image.extended import extended_light, sky_and_bodies
from opnav_workbench.image.header import (
    Header,
    HeaderGeometry,
    HeaderValue,
    KeywordMap,
    barycentric_from_heliocentric,
)
from opnav_workbench.image.masks import QUALITY_TABLES, QualityBit, QualityTable, read_quality
from opnav_workbench.image.picture import Picture, read_image

__all__ = [
    "QUALITY_TABLES",
    "Background",
    "Header",
    "HeaderGeometry",
    "HeaderValue",
    "KeywordMap",
    "Picture",
    "QualityBit",
    "QualityTable",
    "barycentric_from_heliocentric",
    "column_level",
    "contained_bias_dn",
    "darkest_sky",
    "estimate_background",
    "extended_light",
    "pixel_noise",
    "read_image",
    "read_quality",
    "sky_and_bodies",
    "unknown_velocity_sigma_km_s",
]
