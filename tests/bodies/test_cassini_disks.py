"""Real disks of Dione and Rhea with an operator's limb; their Sun is rough by degrees, their light a display's."""

import json
from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.bodies import find_disk, judged_disk, measure_disk
from opnav_workbench.camera import read_out
from opnav_workbench.kernels import KernelSet
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.session import ImageSession
from opnav_workbench.session.body_models import body_picture

pytestmark = [pytest.mark.realdata, pytest.mark.slow]

# What the operator's limb is good to, px; and how far a center may lie from it.
LIMB_PX = 1.0
MEASURED = {
    "N1572105349": 1.0,  # measured: 0.4 px, and a sigma of 0.3
    "N1519300016": 1.0,  # 0.1
    "N1633925572": 1.5,  # 0.9: a crescent of 122 px, most of it saturated
    "W1637520502": 1.5,  # 0.5, and a sigma of 1.2: 864 px wide; its fit is led away, and stays where its limb is
    "N1484593951": 10.0,  # 3.4, and sigmas of 12 and 9: 1584 px wide, a quarter of its limb in the frame
}


def opened(data_dir, case):
    """The picture as the centerfinders take it, the body's name, and the operator's limb."""
    folder, spice = data_dir / "images" / "cassini_disks", data_dir / "spice"
    generic = [spice / "generic" / name for name in ("naif0012.tls", "pck00011.tpc", "gm_de440.tpc")]
    own = [folder / case / name for name in ("geometry.bsp", "body.tpc")]
    kernels = [*generic, spice / "derived" / "de440_excerpt_2006_2030.bsp", folder / "frames.tf", *own]
    limb = json.loads((folder / case / "case.json").read_text())
    name = limb["body"]
    with KernelSet(kernels):
        session = ImageSession.open(
            folder / case / f"{case}.fits", folder / "mission.yaml", attitude="header"
        )
        session.add_target(name)
        return body_picture(session.context, session.inputs, session.state, (name,), (name,)), name, limb


@pytest.mark.parametrize("case", MEASURED)
def test_a_real_disk_is_where_its_limb_is(data_dir, case):
    picture, name, limb = opened(data_dir, case)
    disk = measure_disk(picture, name, "disk", None, None)
    # Terrain, which a smooth body's light does not explain; of the crescent too little is not saturated to tell.
    assert disk.fit.prior.on_slopes or case == "N1633925572"
    center = judged_disk(disk)
    assert center.status == "ok", center.messages
    for place, covariance in (
        (center.pixel_line, center.covariance_px2),
        (disk.fit.center_px, disk.fit.covariance_px2),
    ):
        away = place - limb["limb_center_pixel_line"]
        assert away @ np.linalg.solve(covariance + LIMB_PX**2 * np.eye(2), away) < 9.0
    assert np.hypot(*(center.pixel_line - limb["limb_center_pixel_line"])) < MEASURED[case]


def binned(picture, n):
    """The picture as a detector with pixels n times as large would have taken it: its PSF is then sharper than they are."""
    camera = read_out(picture.camera, binning=(n, n))

    def blocks(plane):
        return plane[: n * camera.n_line, : n * camera.n_pixel].reshape(camera.n_line, n, camera.n_pixel, n)

    usable = blocks(np.isfinite(picture.signal_dn) & ~picture.bad)
    count = np.maximum(usable.sum(axis=(1, 3)), 1)
    signal = np.where(usable, blocks(picture.signal_dn), 0.0).sum(axis=(1, 3)) / count
    sigma, noise = float(np.max(picture.psf.sigma_px)) / n, picture.noise_model
    return replace(
        picture,
        signal_dn=signal,
        noise_dn=np.median(picture.noise_dn) / n,
        bad=usable.mean(axis=(1, 3)) < 0.5,
        saturated=blocks(picture.saturated).any(axis=(1, 3)),
        camera=camera,
        psf=GaussianPsf(sigma, sigma),
        noise_model=replace(
            noise,
            read_noise_dn=noise.read_noise_dn / n,
            gain_e_per_dn=noise.gain_e_per_dn * n**2,
        ),
    )


@pytest.mark.parametrize("case", MEASURED)
def test_a_real_disk_in_large_pixels_is_where_its_limb_is(data_dir, case):
    """8 by 8 of them in one, 15 to 200 px wide: none of its limb was "lit and in sight", as cells about it were empty."""
    picture, name, limb = opened(data_dir, case)
    center = find_disk(binned(picture, 8), name)
    assert center.status == "ok", center.messages
    away = center.pixel_line - ((np.array(limb["limb_center_pixel_line"]) + 0.5) / 8 - 0.5)
    assert np.hypot(*away) < 1.0
    assert away @ np.linalg.solve(center.covariance_px2 + (LIMB_PX / 8) ** 2 * np.eye(2), away) < 9.0
