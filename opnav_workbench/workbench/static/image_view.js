// The picture in the page: paints DN with the stretch, follows the cursor, and carries out the view's own actions.

const SIDE_PX = 132; // magnifier and panner
const SIDE_NARROW_PX = 104; // two of them fill the column beside the picture, too: they stay as they are where the room changes
const ZOOM_PX = 36; // the buttons beside the picture
const MOST_PX = 900; // of the picture's frame, in a notebook's cell
const COLUMN_PX = 236; // menus, switches, small pictures and readout beside the picture, where that leaves it larger
const NARROW_PX = 752; // of a view: below, the readout goes under the picture
const AROUND_PX = 270; // JupyterLab's bars, and the view's own
const STRIP_SHAPE = 3; // width over height of the frame for a strip
const STRIP_MARGIN = 1.15; // lines shown, over the strip's own
const AXES_PX = [52, 26]; // room for axis labels, left and below
const READOUT_PX = 60; // the readout in four rows, under the picture
const COMPASS_PX = { corner: 62, arrow: 34, name: 46 }; // its middle from the frame's edges, and its reach
const GAP_PX = 10; // between two pictures side by side
const MOST_WIDTHS = 3; // of the frame that are remembered: with the panel, without it, with more of it
const AT_ONCE = 1 << 18; // pixels that are put into blocks in one go while nobody works: about a millisecond
const AROUND_SHOWN = 0.25; // of what is in sight is painted beyond it, on each side: a small pan paints nothing

class ImagePage extends ImageCursor {
  constructor(page, doc, state, host) {
    super();
    Object.assign(this, { page, doc, state, signal: page.signal, blinking: false, mips: new WeakMap(), toMake: [] });
    const models = new Map(); // BokehJS looks through all of them each time
    this.model = (name) => models.get(name) ?? models.set(name, doc.get_model_by_name(name)).get(name);
    this.setup = JSON.parse((this.setupText = state.setup));
    this.images = JSON.parse(state.images);
    this.layout = new ImageLayout(this, host);
    this.ndarray = page.bokeh.require("core/util/ndarray").ndarray;
    this.tools = new ImageTools(this);
    this.second = new SecondPicture(this);
    this.crowd = new CrowdMarks(this);
    this.palettes = Object.fromEntries(Object.entries(this.setup.colormaps).map(([name, hex]) => [name, paletteWords(hex)]));
    this.fit();
    this.update();
  }

  hint(action) {
    return this.setup.actions[action][1];
  }

  // Before BokehJS draws: where each figure goes.
  slots(roots) {
    const places = { "opnav-picture": this.layout.picture, "opnav-magnifier": this.layout.magnifier, "opnav-panner": this.layout.panner, "opnav-second": this.layout.second };
    return roots.map((root) => places[root.name]);
  }

  // After it has drawn.
  attach() {
    this.figure = this.page.views.get_by_id(this.model("opnav-picture").id);
    this.pointer = new ImagePointer(this, this.layout.picture);
    this.second.attach();
    const { x_range, y_range } = this.model("opnav-picture");
    for (const range of [x_range, y_range]) range.change.connect(() => this.atOnce());
    this.state.change.connect(() => this.soon("update"));
    const bench = this.page.root.closest(".opnav-workbench");
    // In the frame in which the room changes; the observer tells of it when that one is painted.
    bench?.addEventListener("opnav-room", () => this.page.guard(() => this.fit()), { signal: this.signal });
    const observer = new ResizeObserver(() => this.fits() || this.soon("fit"));
    // The bars too: they change their height when a theme is loaded, and nothing else does then.
    for (const node of [this.page.root.parentElement, this.layout.bar, this.layout.switches]) observer.observe(node);
    this.signal.addEventListener("abort", () => observer.disconnect());
    this.leave();
  }

  // At most once a frame.
  soon(task) {
    this.due ??= new Set();
    if (this.due.size === 0)
      requestAnimationFrame(() => this.page.guard(() => {
        const tasks = this.due;
        this.due = new Set();
        if (this.signal.aborted || this.page.doc !== this.doc) return;
        if (tasks.has("fit")) this.fit();
        if (tasks.has("update")) this.update();
        else if (tasks.has("paint")) this.paint();
      }));
    this.due.add(task);
  }

  // Of a zoom or a pan: before BokehJS draws the next frame, so that it draws no other one after it.
  atOnce() {
    if (this.waits) return;
    this.waits = true;
    queueMicrotask(() => this.page.guard(() => {
      this.waits = false;
      if (!this.signal.aborted && this.page.doc === this.doc) this.paint();
    }));
  }

  // Python's patch may have brought another picture, or other overlays.
  patched() {
    this.soon("update");
  }

  update() {
    this.images = JSON.parse(this.state.images);
    this.ahead = JSON.parse(this.state.ahead);
    if (this.setupText !== this.state.setup) {
      this.setupText = this.state.setup; // of another picture
      this.setup = JSON.parse(this.setupText);
      this.fit();
    }
    this.camera = JSON.parse(this.state.camera);
    this.bodies = JSON.parse(this.state.bodies);
    this.arrows = JSON.parse(this.state.compass);
    this.layout.update();
    this.showGroups();
    this.stretchArrows();
    this.second.update();
    this.page.pixels.want(this.needed(), this.asSent(this.ahead));
    this.paint();
    if (this.cursor) this.tell(...this.cursor);
    this.updateTools();
  }

  updateTools() {
    const { state, tools } = this;
    const of = `${state.title} ${this.shownKey()} ${Boolean(this.pixels())}`;
    if (of !== this.toolsOf && this.figure) {
      this.toolsOf = of;
      tools.otherPicture();
    } else tools.show();
    if (state.aperture !== this.apertureText) {
      this.apertureText = state.aperture;
      tools.changed();
    }
  }

  // -- painting

  // All of a picture's pixels; undefined while they are on their way.
  pixels(key = this.shownKey()) {
    return this.page.pixels.values(this.images[key]?.pixels?.full);
  }

  // What is to be asked of Python, most urgent first: a large picture's coarse form, so that it is seen, then its pixels.
  needed() {
    const asked = [this.blinkKey, this.state.image, "data", this.state.partner, ...Object.keys(this.images)];
    const shown = [...new Set(asked)].map((key) => this.images[key]).filter((one) => one?.ready && one.pixels);
    return this.asSent(shown.map(({ pixels }) => pixels));
  }

  asSent(pictures) {
    const whole = (one) => this.page.pixels.values(one.full);
    return pictures.flatMap((one) => (one.coarse && !whole(one) ? [one.coarse, one.full] : [one.full]));
  }

  // An array has come: shown at once, or made ready to be while nobody waits.
  arrived(token, all) {
    if (!all) return this.tellArriving();
    const next = this.ahead.find(({ full }) => full.token === token);
    if (!next) return this.soon("update");
    const [n_line, n_pixel] = next.full.shape;
    const block = this.blockAt(this.model("opnav-picture").frame_width / n_pixel);
    this.makeAhead(this.page.pixels.values(next.full), [block, this.overviewBlock([n_pixel])], [n_pixel, n_line]);
  }

  tellArriving() {
    const full = this.images.data?.pixels?.full;
    this.layout.arriving(this.pixels() || this.state.message ? undefined : this.page.pixels.share(full));
  }

  // The picture shown; the frame itself while another one is being made.
  shownKey() {
    const wanted = this.blinkKey ?? this.state.image;
    return this.images[wanted]?.ready && this.pixels(wanted) ? wanted : "data";
  }

  limits() {
    const key = this.shownKey();
    return this.localLimits ?? this.limitsOf(key);
  }

  limitsOf(key) {
    const { limits, low, high } = this.state;
    return limits === "manual" ? [low, high] : this.images[key]?.limits?.[limits] ?? [0, 1];
  }

  // Screen px of a pixel.
  scale() {
    const { x_range, frame_width } = this.model("opnav-picture");
    return frame_width / Math.abs(x_range.end - x_range.start);
  }

  degreesPerPixel([pixel, line]) {
    const sky = this.camera && [0, 1].map((step) => skyAt(this.camera, pixel - step, line));
    return sky?.every(Boolean) ? skyStep(...sky).separation : 0;
  }

  shading() {
    const { contrast, bias } = this.local ?? this.state;
    return { contrast, bias };
  }

  paint() {
    const values = this.pixels();
    const [low, high] = this.limits();
    const { stretch, colormap, inverted } = this.state;
    const look = JSON.stringify([stretch, colormap, inverted, this.shading(), low, high]);
    if (look !== this.look) {
      this.look = look;
      this.table = colorTable({ stretch, inverted, ...this.shading() }, this.palettes[colormap] ?? this.palettes.gray);
    }
    this.tellArriving();
    this.crowd.paint();
    if (!values) return this.paintCoarse([low, high]);
    if (this.fillSight("opnav-shown", values, [low, high])) this.page.root.dataset.painted = `${this.shownKey()} ${look}`;
    const { frame_width } = this.model("opnav-picture");
    const factors = [1 / ZOOM, 1, ZOOM, ...this.widths.map((width) => width / frame_width)]; // a zoom, or the room as it was
    const around = [...new Set(factors.map((factor) => this.blockAt(factor * this.scale())))];
    this.makeAhead(values, around, this.setup.size); // what the next zoom shows
    this.second.paint();
    this.paintOverview(values, [low, high]);
    this.magnify();
    this.drawCompass();
    this.tellScale();
  }

  // What is known of the picture before its pixels are here; never the picture before.
  paintCoarse([low, high]) {
    const coarse = this.images.data?.pixels?.coarse;
    const values = this.page.pixels.values(coarse);
    for (const name of ["opnav-shown", "opnav-overview"])
      if (values) this.fill(name, { values, width: coarse.shape[1], height: coarse.shape[0] }, low, high, coarse.block);
      else this.empty(name);
    this.empty("opnav-magnified");
    this.painted = this.overviewOf = undefined;
    this.page.root.dataset.painted = values ? "coarse" : "";
    this.drawCompass();
    this.tellScale();
  }

  paintOverview(values, [low, high]) {
    if (this.overviewOf === values && this.overviewLook === this.look) return;
    const small = this.overviewBlock(this.setup.size);
    [this.overviewOf, this.overviewLook] = [values, this.look];
    this.fill("opnav-overview", this.mip(values, small), low, high, small);
  }

  overviewBlock([n_pixel]) {
    return Math.max(1, Math.ceil(n_pixel / (this.model("opnav-panner").frame_width || SIDE_PX)));
  }

  // What is in sight and a little more: [first pixel, first line, past pixel, past line], whole blocks.
  sight(block) {
    const { x_range, y_range } = this.model("opnav-picture");
    const ends = (range, n) => {
      const [low, high] = [Math.min(range.start, range.end), Math.max(range.start, range.end)];
      const beyond = AROUND_SHOWN * (high - low);
      const blocks = Math.ceil(n / block);
      const whole = (from, to) => {
        const first = Math.min(Math.max(Math.floor((from + 0.5) / block), 0), blocks - 1);
        return [first * block, Math.min(Math.max(Math.ceil((to + 0.5) / block), first + 1), blocks) * block];
      };
      return { least: whole(low, high), wanted: whole(low - beyond, high + beyond) };
    };
    const [x, y] = [ends(x_range, this.setup.size[0]), ends(y_range, this.setup.size[1])];
    const box = (kind) => [x[kind][0], y[kind][0], x[kind][1], y[kind][1]];
    return { least: box("least"), wanted: box("wanted") };
  }

  // Paint what is in sight, unless that was painted so already; true where it was done.
  fillSight(name, values, [low, high]) {
    const block = this.blockAt(this.scale());
    const { least, wanted } = this.sight(block);
    const before = this.painted?.[name];
    const same = before?.values === values && before.block === block && before.look === `${this.look} ${low} ${high}`;
    if (same && least.every((end, i) => (i < 2 ? end >= before.box[i] : end <= before.box[i]))) return false;
    this.painted = { ...this.painted, [name]: { values, block, box: wanted, look: `${this.look} ${low} ${high}` } };
    const part = wanted.map((end) => end / block);
    const whole = this.made(values).get(block) ?? (block === 1 && { values, width: this.setup.size[0], height: this.setup.size[1] });
    const blocks = whole ? cutOut(whole, part) : binned(values, ...this.setup.size, block, part);
    this.fill(name, blocks, low, high, block, [wanted[0] - 0.5, wanted[1] - 0.5]);
    return true;
  }

  // Pixels along a block, so that one is at least one of the screen.
  blockAt(scale) {
    return Math.max(1, Math.ceil(0.99 / scale));
  }

  // A picture in blocks, by their size, as far as they are made.
  made(values) {
    if (!this.mips.has(values)) this.mips.set(values, new Map());
    return this.mips.get(values);
  }

  // The whole picture in blocks, made once for each size of them.
  mip(values, block, [n_pixel, n_line] = this.setup.size) {
    if (!values) return;
    if (block === 1) return { values, width: n_pixel, height: n_line };
    const made = this.made(values);
    if (!made.has(block)) made.set(block, binned(values, n_pixel, n_line, block));
    return made.get(block);
  }

  // The same a few lines at a time, while nobody works: no key waits for it. The last asked for comes first.
  makeAhead(values, blocks, size) {
    const asked = blocks.filter((block) => block > 1 && !this.made(values).has(block)).map((block) => ({ values, block, size }));
    const others = this.toMake.filter((one) => !asked.some((two) => two.values === one.values && two.block === one.block));
    this.toMake = [...asked, ...others];
    if (!this.making) this.makeNext();
  }

  makeNext() {
    const next = this.toMake.shift();
    this.making = next !== undefined;
    if (!this.making) return;
    const { values, block, size: [n_pixel, n_line] } = next;
    const [width, height] = [Math.ceil(n_pixel / block), Math.ceil(n_line / block)];
    const whole = { values: new Float32Array(width * height), width, height };
    const rows = Math.max(1, Math.floor(AT_ONCE / (n_pixel * block)));
    const go = (row) => {
      if (this.signal.aborted || this.made(values).has(block)) return this.makeNext();
      const past = Math.min(row + rows, height);
      whole.values.set(binned(values, n_pixel, n_line, block, [0, row, width, past]).values, row * width);
      if (past < height) return whenIdle(() => go(past));
      this.made(values).set(block, whole);
      this.makeNext();
    };
    whenIdle(() => go(0));
  }

  fill(name, { values, width, height }, low, high, block, [x, y] = [-0.5, -0.5]) {
    const words = colored(values, low, high, this.table);
    const image = this.ndarray(words.buffer, { dtype: "uint32", shape: [height, width] });
    const data = { image: [image], x: [x], y: [y], dw: [width * block], dh: [height * block] };
    this.model(name).setv({ data }, { sync: false });
  }

  empty(name) {
    this.model(name).setv({ data: { image: [], x: [], y: [], dw: [], dh: [] } }, { sync: false });
  }

  // Residual vectors as long as the analyst wants them.
  stretchArrows() {
    const { data } = this.model("opnav-vectors");
    const scale = this.state.vector_scale;
    if (data === this.arrowsOf && scale === this.arrowScale) return;
    [this.arrowsOf, this.arrowScale] = [data, scale];
    const { pixel = [], line = [], d_pixel = [], d_line = [] } = data;
    const ends = (from, offset) => Float64Array.from(from, (at, i) => at + scale * offset[i]);
    this.model("opnav-arrows").setv({ data: { pixel, line, end_pixel: ends(pixel, d_pixel), end_line: ends(line, d_line) } }, { sync: false });
  }

  // North, east and the Sun in the picture's corner.
  drawCompass() {
    const { x_range, y_range, frame_width, frame_height } = this.model("opnav-picture");
    const shown = this.state.groups.includes("compass") && frame_height > 3 * COMPASS_PX.corner ? this.arrows : [];
    const px = 1 / this.scale();
    const middle = [x_range.end - COMPASS_PX.corner * px, Math.max(y_range.start, y_range.end) - COMPASS_PX.corner * px];
    const drawn = JSON.stringify([shown, middle, px, frame_width]);
    if (drawn === this.compassDrawn) return;
    this.compassDrawn = drawn;
    const ends = (reach) => shown.map(([, x, y]) => [middle[0] + reach * px * x, middle[1] + reach * px * y]);
    const column = (list, i) => list.map((at) => at[i]);
    const [tips, places] = [ends(COMPASS_PX.arrow), ends(COMPASS_PX.name)];
    const data = { pixel: shown.map(() => middle[0]), line: shown.map(() => middle[1]), end_pixel: column(tips, 0), end_line: column(tips, 1) };
    this.model("opnav-compass").setv({ data }, { sync: false });
    this.model("opnav-compass-names").setv({ data: { pixel: column(places, 0), line: column(places, 1), text: shown.map(([name]) => name) } }, { sync: false });
  }

  // -- sizes and ranges

  // The frame's size follows the room there is; ranges are Python's, so both sides keep the frame's shape.
  fit() {
    const outer = this.page.root.parentElement;
    const width = outer.clientWidth || this.width || 640; // none while it is out of the page
    this.width = width;
    const [axis_x, axis_y] = AXES_PX;
    const classes = this.layout.box.classList;
    const height = outer.clientHeight;
    const bench = this.page.root.closest(".opnav-workbench") && height > 0;
    // What the bars leave, as they are with little room across, and with much.
    const roomBelow = (narrow) => (bench ? height - this.barsHeight(width, narrow) - 8 : Infinity);
    const wide = width < NARROW_PX ? 0 : Math.min(width - axis_x - ZOOM_PX - SIDE_PX - 86, roomBelow(false) - axis_y);
    const room = roomBelow(true);
    // Where there is little room, everything stands under the picture, or the small pictures beside it: what shows more.
    const tall = Math.min(width - axis_x - ZOOM_PX - 10, room - axis_y - SIDE_NARROW_PX - 8);
    const slim = Math.min(width - axis_x - SIDE_NARROW_PX - 14, room - axis_y - READOUT_PX);
    const narrow = width < NARROW_PX || (bench && Math.max(tall, slim) > wide);
    let square = narrow ? SIDE_NARROW_PX : SIDE_PX;
    const most = bench ? Infinity : Math.min(MOST_PX, Math.max(window.innerHeight - AROUND_PX, 360));
    const size = (name, frame_width, frame_height) => this.resize(name, { frame_width, frame_height });
    classes.toggle("opnav-narrow", narrow);
    if (this.setup.strip) {
      classes.remove("opnav-slim", "opnav-wide");
      const frame = Math.round(Math.min(width - axis_x - ZOOM_PX - 10, 1200));
      const height = Math.round(Math.min(frame / STRIP_SHAPE, room - square - 60));
      size("opnav-picture", Math.max(frame, 200), Math.max(height, 120));
      const thin = Math.max(Math.round((frame * this.setup.size[1]) / this.setup.size[0]), 12);
      size("opnav-panner", Math.max(frame, 200), thin);
    } else {
      const usual = narrow ? Math.max(slim, tall) : wide;
      const beside = bench ? Math.min(width - axis_x - ZOOM_PX - COLUMN_PX, height - axis_y - 6) : 0;
      classes.toggle("opnav-wide", beside > usual);
      classes.toggle("opnav-slim", narrow && slim > tall && beside <= usual);
      const frame = Math.round(Math.max(Math.min(Math.max(usual, beside), most), 180));
      const across = beside > usual ? width - axis_x - ZOOM_PX - COLUMN_PX : width - axis_x - ZOOM_PX - (narrow ? 10 + (classes.contains("opnav-slim") ? SIDE_NARROW_PX - ZOOM_PX : 0) : SIDE_PX + 86);
      const each = this.second.isBeside ? Math.max(Math.floor((Math.max(across, frame) - GAP_PX) / 2), 120) : frame;
      size("opnav-picture", each, frame);
      if (beside > usual) square = SIDE_NARROW_PX;
      size("opnav-panner", square, square);
    }
    const { frame_width, frame_height } = this.model("opnav-picture");
    if (this.second.isShown || !this.figure) size("opnav-second", frame_width, frame_height);
    size("opnav-magnifier", square, square);
    this.widths = [frame_width, ...(this.widths ?? []).filter((one) => one !== frame_width)].slice(0, MOST_WIDTHS);
    const [n_pixel, n_line] = this.setup.size;
    const longest = this.setup.strip ? [n_pixel, n_line] : [Math.max(n_pixel, n_line), Math.max(n_pixel, n_line)];
    const panner = this.model("opnav-panner");
    quiet(panner.x_range, { start: n_pixel / 2 - 0.5 - longest[0] / 2, end: n_pixel / 2 - 0.5 + longest[0] / 2 });
    quiet(panner.y_range, { start: n_line / 2 - 0.5 + longest[1] / 2, end: n_line / 2 - 0.5 - longest[1] / 2 });
    this.square();
    this.fitted = { width, height };
  }

  // Height of both bars across so much room; asked of the page once, as it has to be laid out for the answer.
  barsHeight(width, narrow) {
    this.bars ??= new Map();
    const key = `${width} ${narrow}`;
    if (!this.bars.has(key)) {
      const { box } = this.layout;
      const shown = box.className;
      box.classList.remove("opnav-slim", "opnav-wide");
      box.classList.toggle("opnav-narrow", narrow);
      this.bars.set(key, this.barsNow());
      box.className = shown;
    }
    return this.bars.get(key);
  }

  barsNow() {
    return this.layout.bar.offsetHeight + this.layout.switches.offsetHeight;
  }

  // Whether the frame's size still follows from the room and the bars; where these have changed, they are asked anew.
  fits() {
    const { clientWidth, clientHeight } = this.page.root.parentElement;
    if (!this.fitted || clientWidth !== this.fitted.width || clientHeight !== this.fitted.height) return false;
    const classes = this.layout.box.classList;
    const now = this.barsNow();
    if (classes.contains("opnav-wide")) this.fitted.beside ??= now; // they stand beside the picture, and take nothing
    const known = this.fitted.beside ?? this.bars?.get(`${clientWidth} ${classes.contains("opnav-narrow")}`);
    if (now === known) return true;
    this.bars?.clear();
    return false;
  }

  // BokehJS lays a figure out and paints it at each property that changes: once for both sides here.
  resize(name, sides) {
    const model = this.model(name);
    if (Object.entries(sides).every(([side, px]) => model[side] === px)) return;
    model.setv(sides, { silent: true });
    const view = this.page.views?.get_by_id(model.id);
    if (!view) return;
    quiet(model, { hold_render: true }); // it would paint what is painted anew at once
    const frame = view.layout?.center_panel;
    // Where it has been laid out, only its frame changes: to lay it out anew puts each of its parts into the page again.
    if (frame?.set_sizing) {
      frame.set_sizing({ width_policy: "fixed", width: model.frame_width, height_policy: "fixed", height: model.frame_height });
      view.compute_layout();
    } else view.invalidate_layout();
    quiet(model, { hold_render: false });
  }

  // Square pixels: the lines shown follow from the pixels shown.
  square() {
    const { x_range, y_range, frame_width, frame_height } = this.model("opnav-picture");
    const half = (Math.abs(x_range.end - x_range.start) * frame_height) / frame_width / 2;
    const middle = (y_range.start + y_range.end) / 2;
    quiet(y_range, { start: middle + half, end: middle - half });
    if (this.figure) this.atOnce();
  }

  look_at(x, y, width) {
    const { x_range, y_range, frame_width, frame_height } = this.model("opnav-picture");
    const height = (width * frame_height) / frame_width;
    x_range.setv({ start: x - width / 2, end: x + width / 2 });
    y_range.setv({ start: y + height / 2, end: y - height / 2 });
  }

  home() {
    const { frame_width, frame_height } = this.model("opnav-picture");
    const [n_pixel, n_line] = this.setup.size;
    const aspect = frame_width / frame_height;
    const whole = Math.max(n_pixel, n_line * aspect);
    this.look_at(n_pixel / 2 - 0.5, n_line / 2 - 0.5, this.setup.strip ? STRIP_MARGIN * n_line * aspect : whole);
  }

  zoomBy(factor) {
    const { x_range, y_range } = this.model("opnav-picture");
    const [x, y] = [(x_range.start + x_range.end) / 2, (y_range.start + y_range.end) / 2];
    const [cx, cy] = this.cursor ?? [x, y];
    this.look_at(cx + (x - cx) / factor, cy + (y - cy) / factor, (x_range.end - x_range.start) / factor);
  }
}

// Tasks of a millisecond one after the other, a key between any two of them; an idle callback comes but every 50 ms.
const whenIdle = (task) => (globalThis.scheduler?.postTask ? scheduler.postTask(task, { priority: "background" }) : setTimeout(task, 0));

// The page's hooks: see bridge.js.
function prepareViews(page, doc) {
  const state = doc.roots().find((root) => root.name === "opnav-state");
  if (!state) return [];
  page.view = new ImagePage(page, doc, state, page.host);
  page.actions = (name) => page.view.do(name);
  return page.view.slots(doc.roots());
}

function attachViews(page) {
  page.view?.attach();
}
