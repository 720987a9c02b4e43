"""Exam of undersampled stars against the bound: run by hand, not by pytest.

    python tests/stars/psf_exam.py [shapes] [sigmas] [stars] [place_sigma] [frames of a night]

For example ``psf_exam.py coma,disk 0.25,0.35 12,40 0.05``. Truths are those of ``test_effective_psf.py``, summed from fine
samples; each row gives, for stars of SNR 8 to 20, 20 to 60 and 60 to 400, the root mean square of error over bound (of a PSF
known exactly) and of error over stated sigma; then the processor time of a frame. A place sigma gives the fit the catalog's
places with that error (px). With frames of a night these are other pictures of the same camera, of 40 stars each, from which
its effective PSF was learned before. Ten seconds a row, and half a second for each frame of a night.
"""

import sys
import time

import numpy as np
import test_effective_psf as truth

SHAPES = {
    "gaussian": (truth.gaussian, 0.0),
    "wings": (truth.wings, 0.0),
    "coma": (truth.coma, 0.0),
    "disk": (truth.disk, 0.0),
    "obstructed": (truth.obstructed, 0.0),
    "edges": (truth.gaussian, 0.25),
}
CLASSES = ((8, 20), (20, 60), (60, 400))
STARS_A_CLASS = 120


def words(argument, default):
    return (sys.argv[argument] if len(sys.argv) > argument else default).split(",")


def night(shares, sigma, frames, place_sigma):
    """The effective PSF as other pictures teach it; their stars' places are those of a catalog of 0.02 px without."""
    from opnav_workbench.calibration import learn_effective_psf
    from opnav_workbench.stars import ShapePrior

    pictures = [truth.teaching_picture(shares, seed, place_sigma or 0.02) for seed in range(frames)]
    return learn_effective_psf(pictures, ShapePrior.round_psf(1.1 * sigma))


def row(name, sigma, n, place_sigma, night_frames):
    density, edge_loss = SHAPES[name]
    shares = truth.pixel_shares(density, sigma, edge_loss)
    frames = max(2, 3 * STARS_A_CLASS // n)
    kept = night(shares, sigma, night_frames, place_sigma) if night_frames else None
    start = time.process_time()
    error, own, bound, snr = truth.errors(
        shares, sigma, n, frames, (CLASSES[0][0], CLASSES[-1][1]), place_sigma, kept=kept
    )
    seconds = (time.process_time() - start) / frames
    told = []
    for low, high in CLASSES:
        chosen = (snr[:, 0] >= low) & (snr[:, 0] < high)
        ratios = (truth.rms((error / other)[chosen]) for other in (bound, own))
        told.append(" | ".join(f"{ratio:5.2f}" for ratio in ratios))
    return f"{name:10s} {sigma:4.2f} px {n:4d} stars   " + "    ".join(told) + f"   {seconds:.2f} s"


def main():
    place_sigma = (float(sys.argv[4]) if len(sys.argv) > 4 else 0.0) or None
    night_frames = int(sys.argv[5]) if len(sys.argv) > 5 else 0
    sys.stdout.write("error over bound | over sigma, for SNR 8-20, 20-60, 60-400\n")
    for name in words(1, ",".join(SHAPES)):
        for sigma in words(2, "0.25,0.35,0.5"):
            for n in words(3, "40"):
                sys.stdout.write(row(name, float(sigma), int(n), place_sigma, night_frames) + "\n")
                sys.stdout.flush()
    return 0


if __name__ == "__main__":
    np.seterr(all="ignore")
    sys.exit(main())
