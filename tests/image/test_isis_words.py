"""Cubes of missions, with the words that ISIS has for them, against ALE's image support data of the same pictures."""

import json
import re

import numpy as np
import pytest
from picture_bytes import isis_bytes

from opnav_workbench.image import KeywordMap, read_image
from opnav_workbench.image.contradictions import check_frame_exposure, time_tolerance_s
from opnav_workbench.image.formats.isis_cube import in_words_of, isis_label
from opnav_workbench.image.picture import stated_span
from opnav_workbench.mission import load_mission

# Label, support data, mission, camera, and how far both times may be apart: where the archive's UTC has whole seconds only,
# ALE and ISIS take the clock's (Hayabusa2's and OSIRIS-REx's clock kernels and UTC differ by hundredths).
LABELS = {
    "c1637937": ("instruments/voyager1_iss/c1637937_isis3.lbl", "c1637937_isd", "voyager1", "iss_na", 2e-3),
    "c1638610": ("instruments/voyager1_iss/c1638610_isis3.lbl", "c1638610_isd", "voyager1", "iss_wa", 2e-3),
    "c2065022": ("instruments/voyager2_iss/c2065022_isis3.lbl", "c2065022_isd", "voyager2", "iss_na", 2e-3),
    "c2065801": ("instruments/voyager2_iss/c2065801_isis3.lbl", "c2065801_isd", "voyager2", "iss_wa", 2e-3),
    "f735a00": ("instruments/viking1_vis/f735a00_isis3.lbl", "f735a00_isd", "viking1", "vis_b", 1.0),
    "f004b65": ("instruments/viking2_vis/f004b65_isis3.lbl", "f004b65_isd", "viking2", "vis_a", 1.0),
    "E6I0032": ("instruments/galileo_ssi/E6I0032_isis3.lbl", "galileossi_isd", "galileo", "ssi", 2e-3),
    "st_2458542208": (
        "instruments/hayabusa_amica/st_2458542208_v_isis.lbl", "hayabusaamica_isd", "hayabusa", "amica", 1.0
    ),
    "EN1072174528M": (
        "instruments/messenger_mdis/EN1072174528M_isis3.lbl", "messmdis_isis_isd", "messenger", "mdis_nac", 2e-3
    ),
    "JNCR_2016240": (
        "instruments/juno_junocam/JNCR_2016240_01M06152_V01_isis3.lbl", "juno_isd", "juno", "junocam_methane", 2e-3
    ),
    "LUA3107H": ("instruments/clementine_uvvis/LUA3107H.161_isis3.lbl", "clem_uvvis_isd", "clementine", "uvvis_a", 2e-3),
    "CaSSIS": (
        "instruments/tgo_cassis/CAS-MCO-2016-11-26T22.32.14.582-RED-01000-B1_isis.lbl",
        "cassis_isd", "tgo", "cassis", 2e-3,
    ),
    "FC21A0038582": (
        "slices/FC21A0038582_15170161546F6F/FC21A0038582_15170161546F6G_isis3.lbl", "dawnfc_isis_isd", "dawn", "fc2", 2e-3
    ),
    "N1702360370": ("slices/N1702360370_1/N1702360370_1_isis3.lbl", "cassiniiss_isis_isd", "cassini", "iss_nac", 2e-3),
    "hyb2_onc": (
        "slices/hyb2_onc_20151203_084458_w2f_l2a/hyb2_onc_20151203_084458_w2f_l2a_isis3.lbl",
        "hayabusa2_isd", "hayabusa2", "onc_w2", 0.02,
    ),
}  # fmt: skip


INSTRUMENT = re.compile(r"Group = Instrument.*?End_Group", re.DOTALL)


def _cube(text: str) -> bytes:
    """A small cube whose label says of instrument, filter and frame what another one does."""
    more = re.findall(r"^\s*(?:FilterName|NaifFrameCode) *= *[^(\n]+$", text, re.MULTILINE)
    said = "\n".join([INSTRUMENT.search(text)[0], *more])
    data = isis_bytes(np.arange(12.0, dtype="<f4").reshape(1, 3, 4), "Real")
    label = INSTRUMENT.sub(lambda _: said, data[:2048].rstrip(b"\0").decode()).replace("2049", "8193")
    return label.encode().ljust(8192, b"\0") + data[2048:]


@pytest.mark.realdata
@pytest.mark.parametrize("name", LABELS)
def test_a_mission_knows_its_cubes(data_dir, tmp_path, name):
    """By the labels of ISIS: whose picture it is, which camera took it and when."""
    label, isd, mission_name, stem, apart_s = LABELS[name]
    text = (data_dir / "spice" / label).read_text(errors="replace")
    path = tmp_path / f"{name}.cub"
    path.write_bytes(_cube(text))
    mission = load_mission(mission_name)
    picture = read_image(path, KeywordMap(**mission.keywords))
    center = json.loads((data_dir / f"spice/instruments/isds/{isd}.json").read_text())[
        "center_ephemeris_time"
    ]
    assert picture.et == pytest.approx(center, abs=apart_s)
    assert mission.camera_for(picture.header).name == mission.camera_named(stem).name
    span = stated_span(picture.header, picture.keywords or KeywordMap(**mission.keywords))
    if span is not None and mission.span_of(picture.header) == "exposure":
        said = check_frame_exposure("E", picture.exposure_s, span.seconds, time_tolerance_s(*span.stated))
        assert said == []


def test_own_words_of_a_cube_come_first_and_what_is_none_is_told_later():
    words = KeywordMap(
        exposure_s="EXPOSURE_DURATION", exposure_scale=1e-3, utc="IMAGE_MID_TIME", target="TARGET"
    )
    text = (
        "Object = IsisCube\n  Group = Instrument\n    TargetName = IO\n    StartTime = 2011-346T05:02:19.773\n"
        "    StopTime = 2011-346T05:02:24.373\n    ExposureDuration = 4600.0 <Milliseconds>\n    INSTRUMENT_ID = OWN\n"
        "    InstrumentId = ISSNA\n  End_Group\nEnd_Object\nEnd\n"
    )
    said = in_words_of(isis_label(text.encode()), words)
    assert (said["INSTRUMENT_ID"], said["INSTRUMENT_NAME"], said["TARGET"]) == ("OWN", "ISSNA", "IO")
    assert said["EXPOSURE_DURATION"] == pytest.approx(4600.0)
    assert said["IMAGE_MID_TIME"].startswith("2011-12-12T05:02:22.073")
    spoiled = text.replace("4600.0 <Milliseconds>", "N/A").replace("2011-346T05:02:24.373", "UNK")
    said = in_words_of(isis_label(spoiled.encode()), words)
    assert "EXPOSURE_DURATION" not in said
    assert said["IMAGE_MID_TIME"] == "2011-346T05:02:19.773"
