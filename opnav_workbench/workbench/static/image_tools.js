// What the analyst measures in the picture: a line cut, an aperture, a distance. Drawn over it, told in a card.

const GRAB_PX = 9; // screen px: so near, a drawn end is meant
const FIRST_REACH_PX = 12; // of a cut through what is under decision
const FIRST_RADIUS_PX = 5;
const DRAWING = ["cut", "aperture", "measure"]; // tools that take the pointer

class ImageTools {
  constructor(view) {
    this.view = view;
    this.name = "";
    this.ends = {}; // of cut and measure: two places
    this.circle = undefined; // of the aperture: place and radius
    this.card = new InspectCard(view, this);
  }

  get takesPointer() {
    return DRAWING.includes(this.name);
  }

  take(name) {
    this.name = this.name === name ? "" : name;
    if (this.name) this.begin();
    this.view.soon("update");
    this.show();
  }

  putAway() {
    if (!this.name) return false;
    this.take(this.name);
    return true;
  }

  // Without a shape yet, or with one out of sight: about what is under decision.
  begin() {
    const at = this.middle();
    if (this.name === "aperture" && !(this.circle && this.inSight(this.circle.at))) this.measureAperture(at, this.circle?.radius ?? FIRST_RADIUS_PX);
    else if (this.name in { cut: 1, measure: 1 } && !this.ends[this.name]?.some((end) => this.inSight(end)))
      this.ends[this.name] = [[at[0] - FIRST_REACH_PX, at[1]], [at[0] + FIRST_REACH_PX, at[1]]];
  }

  middle() {
    const { pixel, line } = this.view.model("opnav-focus").data;
    if (pixel.length) return [pixel[0], line[0]];
    const { x_range, y_range } = this.view.model("opnav-picture");
    return [(x_range.start + x_range.end) / 2, (y_range.start + y_range.end) / 2];
  }

  inSight([pixel, line]) {
    const { x_range, y_range } = this.view.model("opnav-picture");
    const within = (at, { start, end }) => at >= Math.min(start, end) && at <= Math.max(start, end);
    return within(pixel, x_range) && within(line, y_range);
  }

  // Screen px from one place to another.
  apart([x0, y0], [x1, y1]) {
    return Math.hypot(x1 - x0, y1 - y0) * this.view.scale();
  }

  // -- the pointer

  down(at) {
    if (this.name === "aperture") {
      this.held = { at, begun: at };
      return;
    }
    const ends = this.ends[this.name];
    const near = ends?.findIndex((end) => this.apart(end, at) < GRAB_PX) ?? -1;
    if (near >= 0) this.held = { end: near };
    else if (ends && this.fromLine(ends, at) < GRAB_PX) this.held = { whole: ends, at };
    else {
      this.ends[this.name] = [at, at];
      this.held = { end: 1, fresh: ends };
    }
  }

  // Screen px from a place to a line between two others.
  fromLine([a, b], at) {
    const along = [b[0] - a[0], b[1] - a[1]];
    const share = ((at[0] - a[0]) * along[0] + (at[1] - a[1]) * along[1]) / (along[0] ** 2 + along[1] ** 2 || 1);
    const near = Math.min(Math.max(share, 0), 1);
    return this.apart([a[0] + near * along[0], a[1] + near * along[1]], at);
  }

  // `straight`: along pixels or lines.
  move(at, straight) {
    const { held } = this;
    if (!held) return;
    if (this.name === "aperture") {
      this.circle = { at: held.begun, radius: Math.max(Math.hypot(at[0] - held.begun[0], at[1] - held.begun[1]), 1) };
      held.drawn = this.apart(held.begun, at) > CLICK_PX;
    } else if (held.whole) this.ends[this.name] = held.whole.map(([x, y]) => [x + at[0] - held.at[0], y + at[1] - held.at[1]]);
    else this.ends[this.name][held.end] = straight ? this.straight(this.ends[this.name][1 - held.end], at) : at;
    this.show();
  }

  straight([x, y], at) {
    return Math.abs(at[0] - x) > Math.abs(at[1] - y) ? [at[0], y] : [x, at[1]];
  }

  up() {
    const { held } = this;
    this.held = undefined;
    if (!held) return;
    if (this.name === "aperture") this.measureAperture(held.begun, held.drawn ? this.circle.radius : this.asked?.radius ?? FIRST_RADIUS_PX);
    else if (held.fresh && this.apart(...this.ends[this.name]) < CLICK_PX) this.ends[this.name] = held.fresh; // only a click
    this.show();
  }

  // -- the aperture is measured by Python

  measureAperture(at, radius) {
    this.asked = { at, radius, key: this.view.shownKey() };
    this.circle = { at, radius };
    this.view.page.event("aperture", [this.asked.key, ...at, radius]);
  }

  // Python has measured.
  changed() {
    const found = (this.aperture = JSON.parse(this.view.state.aperture));
    if (found?.pixel !== undefined && this.circle && !this.held) this.circle = { at: [found.pixel, found.line], radius: found.radius_px };
    this.show();
  }

  // Another picture: what was drawn stays, and is read off that one.
  otherPicture() {
    if (this.name === "aperture" && this.asked && this.asked.key !== this.view.shownKey()) this.measureAperture(this.asked.at, this.asked.radius);
    else this.show();
  }

  // -- what is seen

  show() {
    const segments = { x0: [], y0: [], x1: [], y1: [] };
    const ends = this.takesPointer ? this.ends[this.name] ?? [] : [];
    if (ends.length) {
      const [[x0, y0], [x1, y1]] = ends;
      Object.assign(segments, { x0: [x0], y0: [y0], x1: [x1], y1: [y1] });
    }
    const circle = this.name === "aperture" && this.circle;
    const ring = circle ? { pixel: [circle.at[0]], line: [circle.at[1]], radius: [circle.radius] } : { pixel: [], line: [], radius: [] };
    const drawn = JSON.stringify([segments, ring]);
    if (drawn !== this.drawn) {
      this.drawn = drawn;
      this.view.model("opnav-inspect").setv({ data: segments }, { sync: false });
      this.view.model("opnav-inspect-ends").setv({ data: { pixel: ends.map((e) => e[0]), line: ends.map((e) => e[1]) } }, { sync: false });
      this.view.model("opnav-inspect-ring").setv({ data: ring }, { sync: false });
    }
    this.card.show();
  }
}
