"""opnav_workbench: optical navigation from spacecraft images.

Background stars give the camera's pointing, the pointing gives the direction of a target body, and that direction
goes to orbit determination with its covariance and partials.

    import opnav_workbench as opnav

    with opnav.KernelSet("approach.tm"):
        session = opnav.ImageSession.open("frame.fit", mission="new_horizons")
        session.predict()
        session.find_stars()
        session.repoint()
        session.find_body("PLUTO")
        table = session.observables()

Enter by `ImageSession` for one picture, step by step, or by `process` for pictures at which nobody looks. Every package's
docstring is its map: what it is, by which door to come in, one line for every module. Data flows from the bottom of
this list to its top; a package imports what stands below it.

``cli``
    The ``opnav`` program; ``python -m opnav_workbench`` is it, too (``__main__``).
``contracts``
    What files hold: their JSON Schemas, and a check of any file.
``workbench``
    The workbench in JupyterLab: pictures, marks, plots, keys. Every button calls one method of `ImageSession`.
``headless``
    What runs without a person: nights of pictures, rehearsals.
``processing``
    What shall be done with a picture, said once for program, notebooks, nights and queues; and the automatic steps.
``report``
    Figures and pages that a navigator shows.
``commissioning``
    A new mission from an instrument kernel or a few numbers, and a picture.
``campaign``
    Many pictures: their archive, their trends and their stack.
``session``
    One picture, step by step, with its journal, its files and its undo.
``planning``
    What pictures will show, and which are worth taking.
``rehearsal``
    Simulated pictures whose truth is sealed, and the truth held beside the solution.
``simulation``
    What a flight camera would have sent.
``estimation``
    What many observables say of target and spacecraft; the B-plane; triangulation from stars.
``observables``
    O, C, O-C, covariances and partials of bodies' centers; their files.
``calibration``
    Optics, mounting and PSF of a camera from its own star pictures.
``landmarks``
    Small patches of a body's surface found in pictures, and the camera's pose from them.
``bodies``
    Centers of target bodies in a picture.
``stars``
    Star centers, their identification, and the camera's attitude from them.
``render``
    Bodies as the camera sees them: light spread over pixels.
``scene``
    What the camera should see: predicted stars and bodies.
``mission``
    A mission's spacecraft, cameras and header keywords.
``image``
    Pictures read from files, with masks, time and header pointing; the sky's level and noise.
``camera``
    From directions to (pixel, line) and back, and what the camera makes of light.
``catalog``
    Star catalogs.
``targets``
    Targets as values: where a body is, how large, how turned, how lit.
``kernels``
    SPICE: kernels opened as a set, made, checked, fetched; states, attitudes and times from them.
``photometry``
    From spectra and band passes to electrons and magnitudes.
``psf``
    Point spread functions.
``geometry``
    Directions, attitudes, aberration, space motion and conics; no state, no kernels.
``robust``
    Scatter beyond what is stated, and how improbable an error is.
``downloads``
    Files fetched over http and https, whole or not there.
``yaml_file``
    YAML files into validated models, with errors that name line and field.
``fits_layout``
    FITS headers looked at before a library believes them.
``format_versions``
    What a file's `format_version` promises; files of older versions read.
``npz_file``
    Npz files of others: whole, of arrays alone, of bounded size.
``parts``
    Parts of the installation that not everybody needs, and the command that brings one.
``yaml_nodes``
    YAML text into nodes and plain values, bounded in depth, count, aliases, numbers and tags.
``templating``
    HTML templates: one environment for each folder of them, everything escaped.
``files``
    Files written whole or not at all.
``mapped_file``
    Arrays mapped into memory: the header of their files.
``processes``
    Many items on several processes, each of which opens what it needs once.
``threads``
    One thread for matrices while a picture is worked on.
``supervised``
    Work that may end its process, in a process of its own: kept warm, watched, with limits.
``resources``
    Where the package's own files and the user's cache stand.
``arrays``
    Read-only arrays inside frozen results.
``constants``
    Constants of nature, of the sky and of statistics, with their sources.
``lazy_names``
    Names of a package whose modules are loaded at their first use.
``paths``
    Paths that others name, asked about without surprise.
``errors``
    One root error, one leaf per thing that can be wrong.
``version``
    The package's version.

Where to change what
--------------------
how a limb scan is chosen
    ``bodies.limb_scan.selection``; by hand in ``session.body_steps`` and ``workbench.limb_scan_choice``
how landmarks are drawn, matched and judged
    ``landmarks.drawing``, ``landmarks.matching``, ``landmarks.finder``; the pose: ``landmarks.pose``
how a body's size, pole and spin follow from a sequence
    ``estimation.body``; from files: ``processing.body_sequence``
how a body's center is found
    a module of ``bodies`` beside ``bodies.cross_correlation``; which one "auto" means: ``bodies.method``
a star catalog
    a module of ``catalog`` beside ``catalog.tycho2`` that answers as ``catalog.interface`` says; its spec: ``catalog.specs``
a column of the observables
    ``observables.columns``, filled by ``observables.observing``; all files take it from there
a field of a result
    ``session.result``
a step of a session
    its method in ``session.session``, its function and line in ``session.history``'s table of steps
a kind of file, its schema and its check
    ``contracts.kinds``; layouts of JSON files: ``contracts.layouts``
an option of processing
    its field in ``processing.model``: program, notebooks, nights and queues follow
a camera or a mission
    no code: ``camera.camera_file`` and ``mission`` say what their YAML files hold
a picture format
    ``image.formats``
an effect of the detector in simulated pictures
    ``simulation.effects`` and ``simulation.detector``

Glossary
--------
a priori
    What was believed before the picture was measured: attitude from kernels or header, with its sigma.
apparent direction
    Where a light source is seen from a moving spacecraft: light time and stellar aberration included.
boresight
    The camera's optical axis, a direction in the camera's frame.
center
    Where a star's light, or a body's center of figure, falls on the detector, with its covariance.
decision
    What an analyst said of a star, scan, circle or picture; outranks what the program found, and can be replayed.
frame
    A reference frame of SPICE (J2000, NH_LORRI). What a camera took is a picture.
full disk, limb scan
    The paper's ways to a center: all pixels of the body compared, or brightness along lines across its limb.
journal
    All steps and decisions of a session, in order, with time and outcome.
kernel
    A file of SPICE; a kernel set is what one metakernel loads.
landmark, maplet
    A point of a body's surface that pictures are searched for; the patch of heights and albedo about it.
limb, terminator
    The edge of a body against the sky; the edge of its lit part.
night
    Many pictures processed without a person, each once, to be continued at will.
observable
    A measured direction with what orbit determination needs: O, C, O-C, covariance, partials.
outcome
    What became of a picture, a step or a download: done or why not, in one line.
partials
    How an observable moves with the spacecraft's position, the attitude or the target's position.
phase angle
    Sun - body - spacecraft: 0 is full.
picture
    What the spacecraft's camera took (or the simulation drew): pixels, masks, time, header. In names that are a promise
    it is also "image" (`ImageSession`).
pointing
    The camera's attitude at the time of the picture, camera from J2000, as solved from stars.
predicted, observed
    Where something should be with the best attitude at hand; where it was measured. Residual = observed - predicted.
rehearsal (ORT)
    An operational readiness test: pictures whose truth is sealed until the team has delivered.
scene
    What the camera should see at an epoch: observer, stars, bodies.
session
    One picture with everything that was done to it: a frozen state, its history, its folder.
sigma
    One standard deviation, verified against truth. An estimate never travels without it.
status
    What is to be thought of a star or a body, in one word of a fixed list; flags and messages say why.
target
    A body or star whose direction is wanted.
truth
    What a simulated picture really shows; read only by what scores or tests.
twist
    Position angle of increasing line at the boresight, east of J2000 north.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand
from opnav_workbench.version import __version__

if TYPE_CHECKING:
    from opnav_workbench.camera import Camera
    from opnav_workbench.catalog import StarTable, open_catalog
    from opnav_workbench.errors import (
        CameraError,
        CatalogError,
        CenterfindingError,
        EstimationError,
        ImageError,
        KernelError,
        MissionError,
        OpNavError,
        PointingError,
        SelectionPending,
        SessionError,
    )
    from opnav_workbench.kernels import KernelSet
    from opnav_workbench.mission import Mission, load_mission
    from opnav_workbench.processing import process
    from opnav_workbench.session import ImageSession, Settings

# Loaded on first use, so that a layer below may import the package's version without importing the layers above it.
_HOMES = {
    "Camera": "camera",
    "StarTable": "catalog",
    "open_catalog": "catalog",
    "Mission": "mission",
    "load_mission": "mission",
    "process": "processing",
    "ImageSession": "session",
    "Settings": "session",
    "KernelSet": "kernels",
    "OpNavError": "errors",
    "KernelError": "errors",
    "CameraError": "errors",
    "CatalogError": "errors",
    "ImageError": "errors",
    "MissionError": "errors",
    "CenterfindingError": "errors",
    "EstimationError": "errors",
    "PointingError": "errors",
    "SelectionPending": "errors",
    "SessionError": "errors",
}

__all__ = [
    "Camera",
    "CameraError",
    "CatalogError",
    "CenterfindingError",
    "EstimationError",
    "ImageError",
    "ImageSession",
    "KernelError",
    "KernelSet",
    "Mission",
    "MissionError",
    "OpNavError",
    "PointingError",
    "SelectionPending",
    "SessionError",
    "Settings",
    "StarTable",
    "__version__",
    "load_mission",
    "open_catalog",
    "process",
]

__getattr__ = names_on_demand(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
