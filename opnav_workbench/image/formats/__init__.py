"""Picture files of any format, told by their content and read into one form.

Flow    bytes -> which format -> size and length checked -> `StoredPicture`: arrays as stored, header values, remarks

Enter by `read_stored`. Every failure is one `ImageError` line with the file's name; no reader makes more of a file than its
bytes can hold, and what compiled code must decompress is tried in a supervised process first.

``stored``
    `StoredPicture`, and rasters of samples in bytes.
``fits_picture``
    FITS: image, error and quality planes.
``plain_fits``
    Plain FITS files without astropy.
``vicar``
    VICAR, with labels at begin and end.
``pds3``
    PDS3: attached and detached labels, rasters, records of variable length.
``huffman``
    The compressed pictures of Voyager's volumes.
``isis_cube``
    ISIS cubes: tiles and bands, special pixels.
``pds4``
    PDS4: arrays that an XML label describes.
``display_picture``
    PNG, TIFF and JPEG.
``sidecar``
    Files beside a picture that has no header of its own: JSON, YAML or CSV; the layout of raw files.
``reading``
    From a file to a `StoredPicture`: which format, and what lies beside it.
"""

from opnav_workbench.image.formats.reading import read_stored
from opnav_workbench.image.formats.stored import StoredPicture

__all__ = ["StoredPicture", "read_stored"]
