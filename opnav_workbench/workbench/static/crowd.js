// Marks of stars where many are in sight: stamped into one picture, which BokehJS then draws at once. Stroke by stroke two
// thousand of them, each with its dark edge, cost a tenth of a second at every paint.

const CROWD = 500; // marks of a kind in sight: fewer are strokes, in some milliseconds
const INK_SHARE = 0.25; // of the picture that marks of a kind and their edges may cover: of more, each is smaller
const LEAST_MARK = 0.5; // of its size: below, shapes cannot be told apart
const AROUND_MARK = 3.2; // length of a mark's lines over its size, of a circle
const [HEAD_PX, HEAD_SHARE, HEAD_TURN] = [5, 0.6, 2.6]; // sides of an arrow's head, at most so much of it; their turn, rad
const AT_A_TIME = 64; // arrows in a path: the time of a path grows with the square of what it holds

// The shapes of bokeh's markers that themes have for stars, about the middle, in half sizes.
const MARKER_PATHS = {
  circle: (path, r) => path.arc(0, 0, r, 0, 2 * Math.PI),
  x: (path, r) => { path.moveTo(-r, -r); path.lineTo(r, r); path.moveTo(-r, r); path.lineTo(r, -r); },
  square_x: (path, r) => { path.rect(-r, -r, 2 * r, 2 * r); MARKER_PATHS.x(path, r); },
  inverted_triangle: (path, r) => {
    const high = r * Math.sqrt(3);
    path.moveTo(-r, -high / 3);
    path.lineTo(r, -high / 3);
    path.lineTo(0, (2 * high) / 3);
    path.closePath();
  },
};

const valueOf = (spec) => (spec !== null && typeof spec === "object" && "value" in spec ? spec.value : spec);
const lookOf = (glyph) => ({ color: valueOf(glyph.line_color), alpha: valueOf(glyph.line_alpha) ?? 1, width: valueOf(glyph.line_width) });

class CrowdMarks {
  constructor(view) {
    const tagged = [...view.doc.all_models].filter((model) => model.tags?.includes?.("stars"));
    const ours = view.model("opnav-picture").renderers;
    Object.assign(this, { view, tagged, marks: ours.filter((one) => tagged.includes(one)), arrow: tagged.find((one) => one.end) });
    this.canvas = document.createElement("canvas");
    this.brush = this.canvas.getContext("2d", { willReadFrequently: true }); // read back at every paint
  }

  groupShown(model) {
    return this.view.state.groups.includes(model.name.slice("overlay:".length));
  }

  // Shows the marks one way or the other; does nothing where nothing has changed.
  paint() {
    const { view } = this;
    const { x_range, y_range, frame_width, frame_height } = view.model("opnav-picture");
    const scale = (view.scale() || 1) * globalThis.devicePixelRatio;
    const [x0, y0] = [Math.min(x_range.start, x_range.end), Math.min(y_range.start, y_range.end)];
    const [width, height] = [frame_width, frame_height].map((px) => Math.max(1, Math.round(px * globalThis.devicePixelRatio)));
    const shown = [...this.marks, this.arrow].filter((model) => this.groupShown(model));
    const looks = shown.map((model) => JSON.stringify(lookOf(model.glyph ?? model)));
    const of = [x0, y0, scale, width, height, ...looks, ...shown.map((model) => this.dataOf(model))];
    if (this.of?.length === of.length && of.every((one, i) => one === this.of[i])) return;
    this.of = of;
    const sight = { x0, y0, scale, width, height };
    const places = new Map(shown.map((model) => [model, this.placesOf(model, sight)]));
    const most = Math.max(0, ...shown.map((model) => places.get(model).length));
    const crowded = most > CROWD;
    for (const model of this.tagged) quiet(model, { visible: this.groupShown(model) && !crowded });
    if (!crowded) return view.empty("opnav-marks");
    const words = new Uint32Array(width * height);
    // A mark and its dark edge, which are of one source, are one stamp.
    const stamps = Map.groupBy(this.marks.filter((model) => places.has(model)), (model) => model.data_source);
    for (const models of stamps.values()) this.stamp(words, models, places.get(models[0]), sight);
    if (places.get(this.arrow)?.length) this.draw(words, places.get(this.arrow), lookOf(this.arrow), sight);
    const image = view.ndarray(words.buffer, { dtype: "uint32", shape: [height, width] });
    const [dw, dh] = [width / scale, height / scale];
    view.model("opnav-marks").setv({ data: { image: [image], x: [x0], y: [y0], dw: [dw], dh: [dh] } }, { sync: false });
  }

  dataOf(model) {
    return (model.data_source ?? model.source).data;
  }

  // Where marks in sight are, px of the canvas; of arrows where they end, too.
  placesOf(model, { x0, y0, scale, width, height }) {
    const { pixel = [], line = [], end_pixel, end_line } = this.dataOf(model);
    const seen = [];
    for (let i = 0; i < pixel.length; i++) {
      const [x, y] = [(pixel[i] - x0) * scale, (line[i] - y0) * scale];
      if (x > -width && x < 2 * width && y > -height && y < 2 * height && (end_pixel || (x >= 0 && x <= width && y >= 0 && y <= height)))
        seen.push(end_pixel ? [x, y, (end_pixel[i] - x0) * scale, (end_line[i] - y0) * scale] : [x, y]);
    }
    return seen;
  }

  // Drawn once, and its few pixels that are not clear laid at each place: a thousandth of a millisecond a mark.
  stamp(words, models, places, { width, height }) {
    const ratio = globalThis.devicePixelRatio;
    const glyphs = models.map(({ glyph }) => glyph);
    const size = valueOf(glyphs[0].size) * ratio;
    const line = Math.max(...glyphs.map((glyph) => lookOf(glyph).width)) * ratio;
    const ink = places.length * AROUND_MARK * size * line;
    const share = Math.min(1, Math.max(LEAST_MARK, (INK_SHARE * width * height) / ink));
    const side = Math.ceil(size * share + line) + 2;
    const brush = this.blank(side, side);
    brush.translate(side / 2, side / 2);
    for (const glyph of glyphs) {
      const { color, alpha, width: px } = lookOf(glyph);
      Object.assign(brush, { strokeStyle: color, globalAlpha: alpha, lineWidth: px * ratio });
      brush.beginPath();
      (MARKER_PATHS[valueOf(glyph.marker)] ?? MARKER_PATHS.circle)(brush, (size * share) / 2);
      brush.stroke();
    }
    const drawn = inkOf(brush, side, side);
    for (const [x, y] of places) lay(words, width, height, drawn, Math.round(x - side / 2), Math.round(y - side / 2));
  }

  draw(words, arrows, { color, width: line }, { width, height }) {
    const ratio = globalThis.devicePixelRatio;
    const brush = this.blank(width, height);
    Object.assign(brush, { strokeStyle: color, lineWidth: line * ratio });
    for (let first = 0; first < arrows.length; first += AT_A_TIME) {
      brush.beginPath();
      for (const [x0, y0, x1, y1] of arrows.slice(first, first + AT_A_TIME)) {
        brush.moveTo(x0, y0);
        brush.lineTo(x1, y1);
        const turn = Math.atan2(y1 - y0, x1 - x0);
        const head = Math.min(HEAD_PX * ratio, HEAD_SHARE * Math.hypot(x1 - x0, y1 - y0));
        for (const side of [HEAD_TURN, -HEAD_TURN]) {
          brush.moveTo(x1, y1);
          brush.lineTo(x1 + head * Math.cos(turn + side), y1 + head * Math.sin(turn + side));
        }
      }
      brush.stroke();
    }
    lay(words, width, height, inkOf(brush, width, height), 0, 0);
  }

  // The canvas, cleared, with so many pixels; it is read back, and so is kept where it can be.
  blank(width, height) {
    Object.assign(this.canvas, { width, height });
    return this.brush;
  }
}

// The pixels of a drawing that are not clear: their columns, rows and words.
function inkOf(brush, width, height) {
  const all = new Uint32Array(brush.getImageData(0, 0, width, height).data.buffer);
  let count = 0; // loops, and no lists of places: of a whole picture those cost more than all else here
  for (let i = 0; i < all.length; i++) if (all[i] >>> 24) count++;
  const [columns, rows, words] = [0, 0, 0].map(() => new Uint32Array(count));
  for (let i = 0, n = 0; n < count; i++) {
    if (!(all[i] >>> 24)) continue;
    columns[n] = i % width;
    rows[n] = i / width;
    words[n++] = all[i];
  }
  return { columns, rows, words };
}

// Lay ink over a picture of RGBA words (not premultiplied), with its corner at so many px.
function lay(picture, width, height, { columns, rows, words }, left, top) {
  for (let i = 0; i < words.length; i++) {
    const x = left + columns[i];
    const y = top + rows[i];
    if (x < 0 || y < 0 || x >= width || y >= height) continue;
    const at = y * width + x;
    const below = picture[at];
    picture[at] = below === 0 || words[i] >>> 24 === 255 ? words[i] : over(words[i], below);
  }
}

// One word over another.
function over(word, below) {
  const alpha = word >>> 24;
  const left = ((below >>> 24) * (255 - alpha)) / 255;
  const all = alpha + left;
  const red = ((word & 255) * alpha + (below & 255) * left) / all;
  const green = (((word >>> 8) & 255) * alpha + ((below >>> 8) & 255) * left) / all;
  const blue = (((word >>> 16) & 255) * alpha + ((below >>> 16) & 255) * left) / all;
  return ((red + 0.5) | ((green + 0.5) << 8) | ((blue + 0.5) << 16) | ((all + 0.5) << 24)) >>> 0;
}
