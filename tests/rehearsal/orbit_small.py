"""The rehearsal in orbit with a camera of 256 pixels, each of four of MapCam's: as wide a field, a 16th of the cost."""

import yaml

from opnav_workbench.rehearsal import load_ort_scenario
from opnav_workbench.resources import kernels_meta_dir

BINS = 4


def small_mission(folder):
    meta = kernels_meta_dir() / "osiris_rex"
    camera = yaml.safe_load((meta / "cameras/mapcam.yaml").read_text())
    scale = camera["optics"]["pixel_from_mm"]
    camera["optics"]["pixel_from_mm"] = [[value / BINS for value in row] for row in scale]
    # The light of 16 pixels: an exposure so much shorter, read out so much faster.
    camera["detector"] |= {
        "n_pixel": 256,
        "n_line": 256,
        "center_pixel_line": [127.5, 127.5],
        "frame_transfer_s": 1e-5,
    }
    mission = yaml.safe_load((meta / "mission.yaml").read_text())
    mission["cameras"] = [one for one in mission["cameras"] if "mapcam" in one["file"]]
    (folder / "cameras").mkdir(parents=True)
    (folder / "cameras/mapcam.yaml").write_text(yaml.safe_dump(camera))
    (folder / "mission.yaml").write_text(yaml.safe_dump(mission))
    return folder / "mission.yaml"


def small_scenario(folder, pairs=1):
    """The content of the scenario, its mission file in a folder."""
    content = load_ort_scenario("osiris_rex/bennu_orbit").model_dump(mode="json")
    content["mission"] = str(small_mission(folder))
    content["orbit"] |= {
        "spacing_km": 0.035,
        "sample_km": 0.0024,
        "detail_km": 0.004,
        "place_sigma_km": 0.0012,
    }
    content["bodies"][0]["terrain"] |= {"step_km": 0.009}
    content["perturbations"]["attitude"]["shift_px"] = {"normal": 1.5}
    content["perturbations"]["lost_images"] = None
    for entry in content["pictures"]:
        entry["count"] = 1 if entry["name"] == "full" else pairs
        entry["pointing"]["offset_px"] = [x / BINS for x in entry["pointing"]["offset_px"]]
        entry["exposure_s"] /= 1 if entry["name"] == "stars" else BINS**2
    return content
