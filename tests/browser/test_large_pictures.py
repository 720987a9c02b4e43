"""Two large pictures in the workbench: the second is in the page before it is asked for. Counted, not timed."""

import re
from importlib import resources

import numpy as np
import pytest
import spiceypy
from astropy.io import fits

from opnav_workbench import workbench
from opnav_workbench.camera import Camera
from opnav_workbench.cli.lab import LabParameters, put_notebook
from opnav_workbench.geometry import radec_from_unit
from opnav_workbench.processing import Processing
from opnav_workbench.resources import kernels_meta_dir

pytestmark = pytest.mark.slow

SIZE = 2560  # as 4096 in all that is seen here, at less than half the time
# Pieces of 2 MiB of both pictures' 16 bit pixels, the last one smaller, each with its coarse form before.
PIECES = 2 * (1 + -(-2 * SIZE * SIZE // (1 << 21)))
# Presses PgDn; resolves to all that was seen between the key and the second picture's own pixels.
PRESS = """() => new Promise(done => {
  const text = (s) => document.querySelector(s)?.textContent ?? '', seen = new Set();
  const root = document.querySelector('.opnav-bridge');
  const pixels = () => Bokeh.documents.at(-1)?.get_model_by_name('opnav-shown')?.data.image[0];
  const before = pixels();
  const look = () => {
    seen.add(root.dataset.painted.split(' ')[0] + text('.opnav-message'));
    const there = text('.ow-header b') === 'large_1.fit' && pixels() && pixels() !== before;
    there ? done([...seen]) : requestAnimationFrame(look);
  };
  const key = new KeyboardEvent('keydown', { key: 'PageDown', bubbles: true });
  document.querySelector('.opnav-workbench').dispatchEvent(key);
  look();
})"""


# Blocks of parts against those parts of the blocks of the whole, of a picture whose sides no block divides.
PARTS = """() => {
  const [n_pixel, n_line] = [53, 37];
  const values = Float32Array.from({ length: n_pixel * n_line }, (_, i) => (i % 17 === 0 ? NaN : Math.sin(i) * 100));
  const differ = [];
  for (const k of [2, 3, 5, 9]) {
    const whole = binned(values, n_pixel, n_line, k);
    const [w, h] = [whole.width, whole.height];
    for (const part of [[0, 0, w, h], [1, 0, w, h], [0, 1, w, h - 1], [2, 2, w - 1, h], [w - 1, h - 1, w, h]]) {
      const [a, b] = [cutOut(whole, part), binned(values, n_pixel, n_line, k, part)];
      if (String([a.width, a.height, ...a.values]) !== String([b.width, b.height, ...b.values])) differ.push([k, part]);
    }
  }
  return differ;
}"""


def test_a_part_in_blocks_is_that_part_of_the_whole(chromium):
    page = chromium.new_page()
    page.add_script_tag(
        content=(resources.files(workbench) / "static/stretch.js").read_text(encoding="utf-8")
    )
    assert page.evaluate(PARTS) == []
    page.close()


def large_pictures(folder):
    """Write two pictures, their mission and catalog; return their paths and how they are processed."""
    generic, mission = kernels_meta_dir() / "generic", folder / "mission"
    (mission / "cameras").mkdir(parents=True)
    middle = f"[{SIZE / 2 - 0.5}, {SIZE / 2 - 0.5}]"
    camera = (generic / "cameras/pinhole.yaml").read_text().replace("[511.5, 511.5]", middle)
    (mission / "cameras/pinhole.yaml").write_text(camera.replace("1024", str(SIZE)))
    cubesat = "  - file: cameras/cubesat.yaml\n    match: {INSTRUME: CUBESAT}\n"
    (mission / "mission.yaml").write_text((generic / "mission.yaml").read_text().replace(cubesat, ""))
    rng = np.random.default_rng(5)
    places = rng.uniform(5.0, SIZE - 6.0, (40, 2))
    ra, dec = radec_from_unit(Camera.from_yaml(mission / "cameras/pinhole.yaml").unproject(places))
    mag, names = np.linspace(7.0, 10.0, 40), [f"ST {n}" for n in range(40)]
    np.savez(folder / "stars.npz", ra_deg=np.degrees(ra), dec_deg=np.degrees(dec), mag=mag, id=names)
    facts = {"DATE-AVG": "2030-01-01T00:00:00", "EXPTIME": 1.0, "INSTRUME": "PINHOLE"}
    facts |= {f"QUAT{i}": float(value) for i, value in enumerate(spiceypy.m2q(np.eye(3)))}
    facts |= {
        "SUNPOSX": 1.4e8,
        "SUNPOSY": 3e7,
        "SUNPOSZ": 1e6,
        "SUNVELX": 5.0,
        "SUNVELY": 29.0,
        "SUNVELZ": 1.0,
    }
    paths = []
    for number in range(2):
        image = rng.normal(600.0, 3.0, (SIZE, SIZE)).astype(np.uint16)
        paths.append(folder / f"large_{number}.fit")
        fits.writeto(paths[-1], image, fits.Header(facts))
    how = Processing(mission=str(mission / "mission.yaml"), catalog=f"npz:{folder / 'stars.npz'}")
    return tuple(map(str, paths)), how


def test_the_next_large_picture_is_in_the_page_before_its_key(lab, chromium, wait_ms):
    folder = lab.root / "large"
    folder.mkdir()
    put_notebook(folder, LabParameters(*large_pictures(folder)))
    page = chromium.new_context(viewport={"width": 1280, "height": 800}).new_page()
    page.set_default_timeout(wait_ms)
    asked, come = [], []

    def count(frame, kind, counted):
        text = frame if isinstance(frame, str) else frame[:2000].decode("latin1")  # pixels follow
        counted.extend(re.findall(rf'"kind": ?"{kind}"', text))

    def listen(socket):
        socket.on("framesent", lambda frame: count(frame, "pull", asked))
        socket.on("framereceived", lambda frame: count(frame, "piece", come))

    page.on("websocket", listen)
    page.goto(f"{lab.address}/lab/tree/large/workbench.ipynb?token={lab.token}")
    page.locator(".ow-window .opnav-bridge[data-ready]").wait_for()
    for _ in range(900):  # a loaded machine
        page.wait_for_timeout(100)
        if len(come) >= PIECES:
            break
    page.wait_for_timeout(500)  # what has come is put in its place
    before = len(asked)
    assert len(come) >= PIECES
    seen = page.evaluate(PRESS)
    assert seen == ["data"]  # all its pixels at once: no message, no coarse picture, no blank one
    page.wait_for_timeout(300)
    # late ones of the busy page at most: not the picture, which came before
    assert len(asked) - before < PIECES // 4
    page.evaluate("() => jupyterapp.shell.currentWidget?.sessionContext?.shutdown()")
    page.context.close()
