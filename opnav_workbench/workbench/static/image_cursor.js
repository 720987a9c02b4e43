// What follows the cursor: the readout and the magnifier.

const NEAR_PX = 10; // screen px: a star so near is meant
const MAGNIFIED_PX = 15; // pixels across the magnifier

class ImageCursor extends ImageActions {
  // Pixel and line under the pointer; null outside the frame, unless `clip` is given.
  place(event, clip = false, figure = this.figure) {
    const { frame, canvas_view } = figure;
    const box = canvas_view.el.getBoundingClientRect();
    const [sx, sy] = [event.clientX - box.left, event.clientY - box.top];
    if (!clip && !frame.bbox.contains(sx, sy)) return null;
    return [frame.x_scale.invert(sx), frame.y_scale.invert(sy)];
  }

  hover(event, figure = this.figure) {
    const at = this.place(event, false, figure);
    if (!at) return this.leave();
    this.lookAtPlace(at);
  }

  lookAtPlace(at) {
    this.cursor = at;
    this.tell(...at);
    this.magnify();
    this.cross();
  }

  // Lines through the cursor, in both pictures where two are shown.
  cross() {
    const places = this.second.isBeside ? [[this.layout.cross, this.figure], [this.layout.secondCross, this.second.figure]] : [[this.layout.cross, this.figure]];
    for (const [node, figure] of places) {
      node.hidden = !this.cursor || !figure || !(this.crossing || this.byKeys || (this.second.isBeside && figure));
      if (node.hidden) continue;
      const { frame } = figure;
      const [x, y] = [frame.x_scale.compute(this.cursor[0]), frame.y_scale.compute(this.cursor[1])];
      const { left, right, top, bottom } = frame.bbox;
      node.hidden = x < left || x > right || y < top || y > bottom;
      Object.assign(node.style, { left: `${left}px`, top: `${top}px`, width: `${right - left}px`, height: `${bottom - top}px` });
      node.style.setProperty("--x", `${x - left}px`);
      node.style.setProperty("--y", `${y - top}px`);
    }
  }

  leave() {
    this.cursor = undefined;
    this.cross();
    this.layout.lines.slice(0, 7).forEach((line) => { line.textContent = ""; });
    this.layout.lines[0].textContent = "Move the cursor over the picture.";
    this.tellScale();
  }

  tell(pixel, line) {
    const [place, value, ra, dec, degrees, body] = this.layout.lines;
    const [n_pixel, n_line] = this.setup.size;
    const [i, j] = [Math.round(pixel), Math.round(line)];
    const on = i >= 0 && j >= 0 && i < n_pixel && j < n_line;
    place.textContent = `pixel ${pixel.toFixed(2)}  line ${line.toFixed(2)}`;
    const values = this.pixels();
    const dn = on ? values?.[j * n_pixel + i] : undefined;
    const kind = on ? ["bad", "saturated"].filter((mask) => this.masked(mask, i, j)).join(", ") : "";
    value.textContent = !on ? "off the detector" : dn === undefined ? "the pixels are on their way" : `${dnText(dn)} DN${kind && `  (${kind})`}${this.second.valueText(i, j)}`;
    const sky = this.camera && skyAt(this.camera, pixel, line);
    const [right, north] = sky ? skyText(sky) : ["", ""];
    ra.textContent = sky ? `RA ${right}` : "";
    dec.textContent = sky ? `Dec ${north}` : "";
    degrees.textContent = sky ? `${sky[0].toFixed(6)}° ${sky[1] < 0 ? "−" : "+"}${Math.abs(sky[1]).toFixed(6)}°` : "";
    const target = this.bodies?.find(({ name }) => name === this.state.body);
    const r = target && Math.hypot(pixel - target.pixel, line - target.line);
    const radii = target?.radius_px ? ` = ${(r / target.radius_px).toFixed(2)} R` : "";
    body.textContent = target ? `${target.name}: ${r.toFixed(2)} px${radii}` : "";
    this.layout.lines[6].textContent = this.near(pixel, line);
    this.tellScale();
  }

  // What is known of the star under the cursor.
  near(pixel, line) {
    const facts = this.model("opnav-facts")?.data;
    const { x_range, frame_width } = this.model("opnav-picture");
    let best = (NEAR_PX * Math.abs(x_range.end - x_range.start)) / frame_width;
    let found = -1;
    for (let i = 0; i < (facts?.pixel.length ?? 0); i++) {
      const distance = Math.hypot(facts.pixel[i] - pixel, facts.line[i] - line);
      if (distance < best) [best, found] = [distance, i];
    }
    if (found < 0) return "";
    const [mag, snr, across, down] = ["mag", "snr", "d_pixel", "d_line"].map((name) => facts[name][found]);
    const seen = Number.isFinite(across) ? `\nSNR ${snr.toFixed(0)}  O−C ${signed(across)} ${signed(down)}` : "";
    return `${facts.id[found]}  ${mag.toFixed(1)} mag${seen}`;
  }

  tellScale() {
    const { x_range, frame_width } = this.model("opnav-picture");
    const scale = frame_width / Math.abs(x_range.end - x_range.start);
    const { contrast, bias } = this.shading();
    const shaded = contrast !== 1 || bias !== 0.5 ? `contrast ${contrast.toFixed(2)}, bias ${bias.toFixed(2)}` : "";
    this.layout.lines[7].textContent = `zoom ×${scale.toPrecision(2)}`;
    this.layout.lines[8].textContent = shaded;
  }

  masked(kind, i, j) {
    const source = this.model(`opnav-${kind}`);
    const { left, right, top, bottom } = source?.data ?? {};
    for (let run = 0; run < (left?.length ?? 0); run++)
      if (j > top[run] && j < bottom[run] && i > left[run] && i < right[run]) return true;
    return false;
  }

  magnify() {
    const values = this.pixels();
    if (!values || !this.table) return;
    const [n_pixel, n_line] = this.setup.size;
    const [x, y] = this.cursor ?? [n_pixel / 2 - 0.5, n_line / 2 - 0.5];
    const half = MAGNIFIED_PX / 2;
    const [i0, j0] = [Math.floor(x - half), Math.floor(y - half)];
    const n = MAGNIFIED_PX + 2;
    const part = Float32Array.from({ length: n * n }, (_, k) => {
      const [i, j] = [i0 + (k % n), j0 + Math.floor(k / n)];
      return i >= 0 && j >= 0 && i < n_pixel && j < n_line ? values[j * n_pixel + i] : NaN;
    });
    const [low, high] = this.limits();
    this.fill("opnav-magnified", { values: part, width: n, height: n }, low, high, 1, [i0 - 0.5, j0 - 0.5]);
    this.model("opnav-cursor").setv({ data: { pixel: [Math.round(x)], line: [Math.round(y)] } }, { sync: false });
    const { x_range, y_range } = this.model("opnav-magnifier");
    quiet(x_range, { start: x - half, end: x + half });
    quiet(y_range, { start: y + half, end: y - half });
  }

  nextBody() {
    const names = this.bodies.map(({ name }) => name);
    if (names.length) this.state.body = names[(names.indexOf(this.state.body) + 1) % names.length];
  }
}

const dnText = (dn) => (Number.isInteger(dn) ? String(dn) : Number.isNaN(dn) ? "no value" : dn.toFixed(Math.abs(dn) < 1000 ? 3 : 1));
