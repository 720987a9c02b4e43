// What the analyst can do to the view by keys and buttons; ImagePage has the rest.

const BLINK_MS = 600;
const ZOOM = 1.5;
const SIDES = { left: [-1, 0], right: [1, 0], up: [0, -1], down: [0, 1] };
const LONGEST_SCALE = 100000; // of residual vectors

class ImageActions {
  do(name) {
    const { state, setup } = this;
    const next = (list, now) => list[(list.indexOf(now) + 1) % list.length];
    const actions = {
      stretch: () => { state.stretch = next(setup.stretches, state.stretch); },
      limits: () => this.setLimits(next(setup.limits.filter((one) => one !== "manual"), state.limits)),
      colormap: () => { state.colormap = next(Object.keys(setup.colormaps), state.colormap); },
      invert: () => { state.inverted = !state.inverted; },
      blink: () => this.blink(),
      blink_on: () => this.blinkOn(),
      home: () => this.home(),
      zoom_in: () => this.zoomBy(ZOOM),
      zoom_out: () => this.zoomBy(1 / ZOOM),
      overlays: () => this.toggleAll(),
      save_view: () => this.saveView(),
      histogram: () => this.tools.take("histogram"),
      cut: () => this.tools.take("cut"),
      aperture: () => this.tools.take("aperture"),
      measure: () => this.tools.take("measure"),
      crosshair: () => this.toggleCross(),
      beside: () => this.compare("beside"),
      wipe: () => this.compare("wipe"),
      lock: () => { state.lock = state.lock === "sky" ? "pixel" : "sky"; },
      press: () => this.pointer.press(),
      longer: () => { state.vector_scale = this.longer(state.vector_scale); },
    };
    for (const [side, [across, down]] of Object.entries(SIDES))
      for (const [far, steps] of [["", 1], ["far_", 10]]) actions[`cursor_${far}${side}`] = () => this.pointer.step(steps * across, steps * down);
    if (name === "put_away") return this.tools.putAway();
    const action = actions[name] ?? (name in setup.groups ? () => this.toggle(name) : undefined);
    if (!action) return false;
    this.page.guard(action);
    return true;
  }

  setLimits(name, changed = {}) {
    const [low, high] = this.limits();
    this.state.setv(name === "manual" ? { limits: name, low, high, ...changed } : { limits: name });
  }

  // DS9's habit: bias along, contrast across.
  shade({ contrast, bias }, [across, along]) {
    this.local = { bias: bias + across, contrast: Math.min(Math.max(contrast * 4 ** -along, 0.1), 10) };
    this.soon("paint");
    this.tellScale();
  }

  tellShading() {
    const { local } = this;
    this.local = undefined;
    this.state.setv(local ?? {});
    this.soon("update");
  }

  partner() {
    const { partner, image } = this.state;
    const others = Object.keys(this.images).filter((key) => key !== image);
    return others.includes(partner) ? partner : others[0] ?? image;
  }

  // The two pictures change places.
  blink() {
    const [image, partner] = [this.partner(), this.state.image];
    this.state.setv({ image, partner });
  }

  // Show the other picture beside this one, or under a curtain; once more: alone.
  compare(how) {
    const { state } = this;
    const [n_pixel] = this.setup.size;
    const { x_range } = this.model("opnav-picture");
    const whole = Math.abs(x_range.end - x_range.start) >= n_pixel - 1;
    state.setv({ compare: state.compare === how ? "" : how, partner: this.partner() });
    this.second.update();
    this.fit();
    if (whole) this.home();
    this.update();
  }

  toggleCross() {
    this.crossing = !this.crossing;
    this.cross();
    this.soon("update");
  }

  blinkOn() {
    clearInterval(this.blinker);
    this.blinking = !this.blinking;
    this.blinkKey = undefined;
    if (this.blinking) {
      const pair = [this.partner(), this.state.image];
      if (!this.images[pair[0]]?.ready) this.state.setv({ image: pair[0], partner: pair[1] }); // Python makes it
      let turn = 0;
      this.blinker = setInterval(() => {
        if (this.signal.aborted || this.page.doc !== this.doc) return clearInterval(this.blinker);
        turn = 1 - turn;
        this.blinkKey = pair[turn];
        this.soon("paint");
      }, BLINK_MS);
    }
    this.soon("update");
  }

  toggle(group) {
    const { groups } = this.state;
    this.state.groups = groups.includes(group) ? groups.filter((one) => one !== group) : [...groups, group];
  }

  saveView() {
    const { canvas } = this.figure.export("png", true);
    const link = document.createElement("a");
    link.download = `${this.state.title || "picture"}.png`;
    link.href = canvas.toDataURL("image/png");
    link.click();
  }

  toggleAll() {
    if (this.state.groups.length) this.hidden = this.state.groups;
    this.state.groups = this.state.groups.length ? [] : this.hidden ?? Object.keys(this.setup.groups);
  }

  showGroups() {
    for (const model of this.doc.all_models) {
      if (!model.name?.startsWith?.("overlay:")) continue;
      const group = model.name.slice("overlay:".length);
      if (group !== "tools" && !model.tags.includes("stars")) quiet(model, { visible: this.state.groups.includes(group) }); // stars: see crowd.js
    }
  }

  longer(scale) {
    const steps = [1, 10, 100, 1000, 10000, 100000];
    return steps.find((step) => step > scale * 1.001 && step <= LONGEST_SCALE) ?? steps[0];
  }
}
