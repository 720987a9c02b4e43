"""What a stranger must know of a file of observables, said in the file: conventions, program, cameras, kernels.

Every format writes the same words: ECSV as metadata of the table, CSV and the TDM as comments, JSON as an object.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from opnav_workbench.errors import SessionError
from opnav_workbench.format_versions import FORMAT_KEY, PRESENT_VERSION, stamped
from opnav_workbench.version import __version__

__all__ = [
    "ASTROMETRIC",
    "CONVENTIONS",
    "Origin",
    "explanation",
    "explanation_lines",
    "origin_lines",
    "origins_of_table",
    "together",
]

# Said of the computed position and of the observed right ascension and declination: they are directions of one kind.
ASTROMETRIC = (
    "astrometric: from the spacecraft at the time tag to where the body was one light time before; "
    "no stellar aberration"
)
CONVENTIONS: Mapping[str, str] = {
    "time_tag": "the middle of the exposure, at the spacecraft: et in TDB seconds past J2000, utc the same in UTC",
    "place": "pixel is horizontal, line vertical; both 0-based, an integer is a pixel's center; center of figure",
    "ra, dec": f"observed, {ASTROMETRIC}",
    "position": f"computed, {ASTROMETRIC}: what ra and dec are compared with",
    "apparent_ra, apparent_dec": "observed, apparent: the same with stellar aberration, as the camera saw it",
    "light_time": "one-way light time lies in every place and direction: the body stands where the light left it "
    "(SPICE: corrected for light time, CN), not where it is at the time tag. The column light_time says only whether "
    "partials hold it fixed or solve it anew",
    "aberration": "stellar aberration as SPICE's STELAB, spacecraft relative to the solar-system barycenter: contained "
    "in pixel, line, apparent_ra and apparent_dec, removed from ra and dec, not in position",
    "frame": "vectors and directions: J2000 as in SPICE (ICRF axes)",
    "residual": "observed minus computed; computed with the solved pointing",
    "partials": "of the computed place: d(computed pixel, line)/d(parameter); observed minus computed changes by the "
    "negative. Bodies are held fixed among each other, so those of any body are of its own place",
}


@dataclass(frozen=True, slots=True)
class Origin:
    """How observables came about.

    Attributes
    ----------
    mission, camera
        Names.
    version
        Of the program that made them.
    catalog
        Spec of the star catalog.
    kernels : tuple of (str, str)
        File and SHA-256 of every kernel that was loaded.
    images
        Pictures; empty: all in the file.
    """

    mission: str = ""
    camera: str = ""
    version: str = ""
    catalog: str = ""
    kernels: tuple[tuple[str, str], ...] = ()
    images: tuple[str, ...] = ()

    @classmethod
    def of_result(cls, result: Mapping[str, Any]) -> "Origin":
        """Return what a ``result.json`` says of its origin.

        Raises
        ------
        SessionError
            Its provenance is damaged.

        Examples
        --------
        >>> Origin.of_result({"image": "a.fit", "camera": "lorri"}).camera
        'lorri'
        """
        known = result.get("provenance") or {}
        where = {name: result.get(name) for name in ("mission", "camera")}
        image = result.get("image")
        try:
            return cls.of_values({**known, **where}, [] if image is None else [image])
        except (AttributeError, KeyError, TypeError) as error:
            raise SessionError(
                f"the provenance in the result of {image} is damaged ({error!r}); process the picture again."
            ) from error

    @classmethod
    def of_values(cls, values: Mapping[str, Any], images: Iterable[str] = ()) -> "Origin":
        """Return the origin of plain values, as `to_dict` made them; of these `images` where they tell none."""
        texts = {name: str(values.get(name) or "") for name in ("mission", "camera", "version", "catalog")}
        kernels = tuple((str(k["file"]), str(k["sha256"])) for k in values.get("kernels") or ())
        return cls(**texts, kernels=kernels, images=tuple(map(str, values.get("images") or images)))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, as they stand in a file."""
        return {
            "mission": self.mission,
            "camera": self.camera,
            "version": self.version,
            "catalog": self.catalog,
            "kernels": [{"file": name, "sha256": digest} for name, digest in self.kernels],
        } | ({"images": list(self.images)} if self.images else {})


def together(origins: Iterable[Origin]) -> tuple[Origin, ...]:
    """Return origins with the pictures of equal ones put together; a single one is of all pictures.

    Examples
    --------
    >>> lorri = [Origin(camera="lorri", images=(name,)) for name in ("a.fit", "b.fit")]
    >>> [origin.images for origin in together([*lorri, Origin(camera="mvic", images=("c.fit",))])]
    [('a.fit', 'b.fit'), ('c.fit',)]
    >>> together(lorri)
    (Origin(mission='', camera='lorri', version='', catalog='', kernels=(), images=()),)
    """
    images: dict[Origin, dict[str, None]] = {}
    for origin in origins:
        images.setdefault(replace(origin, images=()), {}).update(dict.fromkeys(origin.images))
    if len(images) == 1:
        return tuple(images)
    return tuple(replace(origin, images=tuple(names)) for origin, names in images.items())


def explanation(origins: Sequence[Origin] = ()) -> dict[str, Any]:
    """Return what a file of observables says of itself, as plain values.

    Examples
    --------
    >>> explanation()["conventions"]["residual"]
    'observed minus computed; computed with the solved pointing'
    """
    said = {
        "written_by": f"opnav_workbench {__version__}",
        "conventions": dict(CONVENTIONS),
        "origins": [origin.to_dict() for origin in together(origins)],
    }
    return stamped("observables", said)


def explanation_lines(origins: Sequence[Origin] = ()) -> Iterator[str]:
    """Yield the same as lines of text, for comments."""
    yield f"{FORMAT_KEY}: {PRESENT_VERSION['observables']}"
    yield f"written_by: opnav_workbench {__version__}"
    yield from (f"{name}: {words}" for name, words in CONVENTIONS.items())
    yield from origin_lines(origins)


def origin_lines(origins: Sequence[Origin]) -> Iterator[str]:
    """Yield how observables came about as lines of text; an origin's begin with its number where there are several."""
    found = together(origins)
    for number, origin in enumerate(found, start=1):
        which = "origin" if len(found) == 1 else f"origin {number}"
        names = {"mission": origin.mission, "camera": origin.camera, "catalog": origin.catalog}
        yield f"{which}: " + ", ".join(f"{key} {value or 'unknown'}" for key, value in names.items())
        yield f"{which}, made by: opnav_workbench {origin.version or 'of an unknown version'}"
        if not origin.kernels:
            yield f"{which}, kernels: none was loaded"
        yield from (f"{which}, kernel: {name} sha256 {digest}" for name, digest in origin.kernels)
        yield from (f"{which}, picture: {image}" for image in origin.images)


def origins_of_table(meta: Mapping[str, Any], images: Iterable[str] = ()) -> tuple[Origin, ...]:
    """Return the origins that a table's metadata, or a file's content, tells; what is damaged tells nothing.

    Parameters
    ----------
    meta
        As `explanation` made it.
    images
        The table's pictures, for an origin that is of all of them.
    """
    pictures = tuple(images)
    try:
        return tuple(Origin.of_values(values, pictures) for values in meta.get("origins") or ())
    except (AttributeError, KeyError, TypeError):
        return ()
