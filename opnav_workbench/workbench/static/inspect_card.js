// The card that tells what a tool measures: distribution with limits to drag, line cut, aperture, distance.

const CARD_PX = 310; // wide, where it lies over the picture
const CARD_TITLES = { histogram: "Histogram", cut: "Line cut", aperture: "Aperture", measure: "Distance" };
const CARD_HINTS = {
  histogram: "Drag the limits; the wheel zooms.",
  cut: "Drag in the picture; Shift keeps it straight.",
  aperture: "Click a star, or drag a circle.",
  measure: "Drag in the picture, or drag an end.",
};

class InspectCard {
  constructor(view, tools) {
    Object.assign(this, { view, tools });
    this.node = make("div", "opnav-card", view.layout.box);
    this.head = make("div", "opnav-card-head", this.node);
    this.title = make("b", "", this.head);
    this.hint = make("span", "opnav-card-hint", this.head);
    button(this.head, "×", "Put it away. Key: Esc", () => tools.putAway()).classList.add("opnav-card-close");
    this.plot = new SmallPlot(this.node, "opnav-card-plot");
    this.rows = make("table", "opnav-card-rows", this.node);
    this.node.hidden = true;
    this.listen();
  }

  listen() {
    const { signal } = this.view;
    const on = (node, name, heard) => node.addEventListener(name, (event) => this.view.page.guard(() => heard.call(this, event)), { signal });
    on(this.head, "pointerdown", this.grabCard);
    const { svg } = this.plot;
    on(svg, "pointerdown", this.grabLimit);
    on(svg, "pointermove", this.over);
    on(svg, "pointerleave", () => this.view.leave());
    on(svg, "wheel", this.zoom);
    on(svg, "dblclick", this.wholeRange);
  }

  show() {
    const { name } = this.tools;
    this.node.hidden = !name;
    if (!name) return;
    this.title.textContent = CARD_TITLES[name];
    this.hint.textContent = CARD_HINTS[name];
    this.node.dataset.tool = name;
    this.dock();
    if (this.view.pixels()) this[name]();
    else this.tell([["pixels", "on their way"]]);
    if (!this.docked && !this.moved) this.corner();
  }

  // -- where it stands: beside the picture where there is room, else in a corner that hides nothing drawn

  dock() {
    const { layout } = this.view;
    const docked = (this.docked = layout.box.classList.contains("opnav-wide"));
    const home = docked ? layout.side : layout.box;
    if (this.node.parentNode !== home) home.append(this.node);
    this.node.classList.toggle("opnav-card-docked", docked);
    this.width = docked ? layout.side.clientWidth - 12 : CARD_PX;
    if (docked) Object.assign(this.node.style, { left: "", top: "" });
  }

  corner() {
    const { layout, figure, tools } = this.view;
    if (!figure) return;
    const [box, stage] = [layout.box.getBoundingClientRect(), layout.picture.getBoundingClientRect()];
    const { frame } = figure;
    const { height } = this.node.getBoundingClientRect();
    const sides = { x: [frame.bbox.left, frame.bbox.right - CARD_PX], y: [frame.bbox.bottom - Math.max(height, 60), frame.bbox.top] };
    const drawn = tools.takesPointer ? tools.ends[tools.name] ?? (tools.circle ? [tools.circle.at] : []) : [];
    const places = drawn.map(([x, y]) => [frame.x_scale.compute(x), frame.y_scale.compute(y)]);
    const hides = (x, y) => places.some(([px, py]) => px > x - 20 && px < x + CARD_PX + 20 && py > y - 20 && py < y + height + 20);
    if (this.view.setup.strip) sides.y = [frame.bbox.bottom + 30]; // below it: it would hide all of it
    const corners = sides.y.flatMap((y) => sides.x.map((x) => [x, y]));
    const [x, y] = this.at && !hides(...this.at) && this.of === String([sides.x, sides.y]) ? this.at : corners.find((corner) => !hides(...corner)) ?? corners[0];
    [this.at, this.of] = [[x, y], String([sides.x, sides.y])];
    Object.assign(this.node.style, { left: `${stage.left - box.left + x}px`, top: `${stage.top - box.top + y}px` });
  }

  grabCard(event) {
    if (event.target.closest("button") || this.docked) return;
    const start = [this.node.offsetLeft - event.clientX, this.node.offsetTop - event.clientY];
    this.follow(this.head, event, (next) => {
      this.moved = true;
      const most = [this.view.layout.box.clientWidth - 60, this.view.layout.box.clientHeight - 24];
      const [left, top] = [start[0] + next.clientX, start[1] + next.clientY].map((at, i) => Math.min(Math.max(at, i ? 0 : -200), most[i]));
      Object.assign(this.node.style, { left: `${left}px`, top: `${top}px` });
    });
  }

  follow(node, event, moved, ended = () => {}) {
    node.setPointerCapture(event.pointerId);
    const move = (next) => this.view.page.guard(() => moved(next));
    const end = () => {
      node.removeEventListener("pointermove", move);
      this.view.page.guard(ended);
    };
    node.addEventListener("pointermove", move);
    node.addEventListener("pointerup", end, { once: true });
    node.addEventListener("pointercancel", end, { once: true });
  }

  tell(rows) {
    this.rows.replaceChildren(...rows.map(([name, value]) => {
      const row = make("tr", "", null);
      make("td", "", row, name);
      make("td", "", row, value);
      return row;
    }));
  }

  // -- the distribution of the picture's values

  sample() {
    const values = this.view.pixels();
    if (this.sampledOf !== values) {
      [this.sampledOf, this.sorted] = [values, sortedSample(values, this.view.setup.size[0])];
      this.range = undefined;
    }
    return this.sorted;
  }

  histogram() {
    this.plot.svg.style.display = "";
    const sorted = this.sample();
    const [low, high] = this.view.limits();
    this.range ??= this.usualRange(sorted, low, high);
    const { edges, counts } = binCounts(sorted, ...this.range);
    const heights = counts.map((count) => Math.log10(1 + count));
    const top = Math.max(...heights, 1) * 1.05;
    const outline = [edges.flatMap((edge) => [edge, edge]), [0, ...heights.flatMap((h) => [h, h]), 0]];
    this.plot.draw(this.width, { x: this.range, y: [0, top], xLabel: "DN", yLabel: "log pixels", curves: [["bars", ...outline], this.shadeCurve(low, high, top)], bare: true });
    this.limitLines(low, high);
    const told = (dn) => dnShort(dn, (high - low) / 10); // no digits that cannot be seen between black and white
    const share = (count) => `${((100 * count) / Math.max(sorted.length, 1)).toPrecision(2)} % of pixels`;
    this.tell([
      ["black", `${told(low)} DN, ${share(countBelow(sorted, low))} below`],
      ["white", `${told(high)} DN, ${share(sorted.length - countBelow(sorted, high))} above`],
      ["median", `${told(quantile(sorted, 0.5))} DN, of ${told(sorted[0])} to ${told(sorted.at(-1))}`],
    ]);
  }

  usualRange(sorted, low, high) {
    const ends = [Math.min(low, quantile(sorted, 0.0005)), Math.max(high, quantile(sorted, 0.9995))];
    const margin = 0.08 * (ends[1] - ends[0]) || 1;
    return [ends[0] - margin, ends[1] + margin];
  }

  // How bright each value is shown.
  shadeCurve(low, high, top) {
    const curve = STRETCHES[this.view.state.stretch] ?? STRETCHES.linear;
    const shares = Array.from({ length: 41 }, (_, i) => i / 40);
    return ["shade", shares.map((t) => low + t * (high - low)), shares.map((t) => 0.95 * top * curve(t))];
  }

  limitLines(low, high) {
    const [x0, y0, x1, y1] = this.plot.frame;
    for (const [name, value] of [["low", low], ["high", high]]) {
      const x = Math.min(Math.max(this.plot.toX(value), x0), x1);
      const line = svgNode("g", { class: `limit ${name}` }, this.plot.svg);
      svgNode("path", { d: `M${x} ${y0}V${y1}` }, line);
      svgNode("path", { class: "grip", d: `M${x - 5} ${y0 - 5}h10l-5 8z` }, line);
    }
  }

  grabLimit(event) {
    if (this.tools.name !== "histogram") return;
    const { view, plot } = this;
    const at = plot.fromX(event);
    const [low, high] = view.limits();
    const upper = Math.abs(at - high) < Math.abs(at - low);
    const least = (plot.x[1] - plot.x[0]) / 1000;
    event.preventDefault();
    this.follow(plot.svg, event, (next) => {
      const value = plot.fromX(next);
      view.localLimits = upper ? [low, Math.max(value, low + least)] : [Math.min(value, high - least), high];
      view.soon("update");
    }, () => {
      const limits = view.localLimits;
      view.localLimits = undefined;
      if (limits) view.setLimits("manual", { low: limits[0], high: limits[1] });
    });
  }

  zoom(event) {
    if (this.tools.name !== "histogram") return;
    event.preventDefault();
    const at = this.plot.fromX(event);
    const factor = event.deltaY > 0 ? 1.25 : 0.8;
    this.range = this.range.map((end) => at + (end - at) * factor);
    this.histogram();
  }

  wholeRange() {
    if (this.tools.name !== "histogram") return;
    const sorted = this.sample();
    const margin = 0.02 * (sorted.at(-1) - sorted[0]) || 1;
    this.range = [sorted[0] - margin, sorted.at(-1) + margin];
    this.histogram();
  }

  // -- values along a line

  cut() {
    const ends = this.tools.ends.cut;
    this.plot.svg.style.display = "";
    const { view } = this;
    const here = lineCut(view.pixels(), view.setup.size, ends);
    const curves = [["data", here.distance, here.values]];
    const other = view.partner();
    if (other !== view.shownKey() && view.images[other]?.ready) {
      const there = lineCut(view.pixels(other), view.setup.size, ends);
      curves.push(["model", there.distance, there.values]);
    }
    const length = here.distance.at(-1) || 1;
    this.plot.draw(this.width, { x: [0, length], y: rangeOf(curves.map(([, , ys]) => ys)), xLabel: "px along the line", yLabel: "DN", curves });
    this.marker = svgNode("path", { class: "marker", d: "" }, this.plot.inner);
    const [[x0, y0], [x1, y1]] = ends;
    const shown = [`━ ${view.images[view.shownKey()].label}`, ...(curves.length > 1 ? [`╍ ${view.images[other].label}`] : [])];
    this.tell([["from", placeText([x0, y0])], ["to", `${placeText([x1, y1])}, ${length.toFixed(2)} px`], ["", shown.join("   ")]]);
  }

  // The place under the pointer along a cut is looked at in the picture, too.
  over(event) {
    if (this.tools.name !== "cut" || event.buttons) return;
    const [[x0, y0], [x1, y1]] = this.tools.ends.cut;
    const share = Math.min(Math.max(this.plot.fromX(event) / this.plot.x[1], 0), 1);
    const [, top, , bottom] = this.plot.frame;
    this.marker?.setAttribute("d", `M${this.plot.toX(share * this.plot.x[1])} ${top}V${bottom}`);
    this.view.lookAtPlace([x0 + share * (x1 - x0), y0 + share * (y1 - y0)]);
  }

  // -- an aperture, as Python measured it

  aperture() {
    const found = this.tools.aperture;
    const shown = found?.profile;
    this.plot.svg.style.display = shown ? "" : "none";
    if (!shown) return this.tell([["", found?.message ?? "measuring ..."]]);
    const [radii, values] = found.profile;
    const half = found.fwhm_px === null ? [] : [["half", [found.fwhm_px / 2, found.fwhm_px / 2], [-1e30, 1e30]]];
    const y = rangeOf([values, [0]]);
    this.plot.draw(this.width, { x: [0, 1.5 * found.radius_px], y, xLabel: "px from the center", yLabel: "DN above the sky", dots: [["data", radii, values]], curves: [["edge", [found.radius_px, found.radius_px], y], ["zero", [0, 1.5 * found.radius_px], [0, 0]], ...half.map(([name, xs]) => [name, xs, y])] });
    const arcsec = this.view.degreesPerPixel([found.pixel, found.line]) * 3600;
    const wide = found.fwhm_px === null ? "not told" : `${found.fwhm_px.toFixed(2)} px${arcsec ? ` = ${(found.fwhm_px * arcsec).toPrecision(3)}″` : ""}`;
    const near = (dn) => dnShort(dn, found.noise_dn);
    this.tell([
      ["center", found.found ? placeText([found.pixel, found.line], 3) : `${placeText([found.pixel, found.line])}; no star in it`],
      ["sum", `${dnShort(found.sum_dn, found.sigma_dn)} ± ${dnShort(found.sigma_dn, found.sigma_dn)} DN (sky noise), r ${found.radius_px.toFixed(1)} px`],
      ["FWHM", wide],
      ["peak, sky", `${near(found.peak_dn)}, ${near(found.sky_dn)} ± ${near(found.noise_dn)} DN`],
      ...(found.n_missing ? [["without", `${found.n_missing} pixels that are bad, saturated or off`]] : []),
    ]);
  }

  // -- a distance

  measure() {
    this.plot.svg.style.display = "none";
    const [[x0, y0], [x1, y1]] = this.tools.ends.measure;
    const [dx, dy] = [x1 - x0, y1 - y0];
    const sky = this.view.camera && [[x0, y0], [x1, y1]].map((at) => skyAt(this.view.camera, ...at));
    const rows = [
      ["from", placeText([x0, y0])],
      ["to", placeText([x1, y1])],
      ["length", `${Math.hypot(dx, dy).toFixed(2)} px (${signed(dx)} px, ${signed(dy)} lines)`],
    ];
    if (sky?.every(Boolean)) {
      const { separation, angle } = skyStep(...sky);
      rows.push(["on the sky", angleText(separation)], ["position angle", `${angle.toFixed(2)}° east of north`]);
    } else rows.push(["on the sky", "an end is off the detector"]);
    this.tell(rows);
  }
}

const placeText = ([pixel, line], digits = 2) => `pixel ${pixel.toFixed(digits)}, line ${line.toFixed(digits)}`;
const signed = (value) => (value < 0 ? "−" : "+") + Math.abs(value).toFixed(2);
// Of what has noise no more than a hundredth of it is told.
const dnShort = (dn, noise) => {
  if (dn === null || dn === undefined) return "–";
  const rounded = noise > 0 ? dn.toFixed(Math.min(Math.max(2 - Math.floor(Math.log10(noise)), 0), 20)) : dn.toPrecision(Math.abs(dn) >= 1e5 ? 7 : 5);
  return String(Number(rounded));
};
