// What stands around the picture: menus, switches for the overlays that are their legend too, and the readout.

function make(tag, className, parent, text = "") {
  const node = document.createElement(tag);
  node.className = className;
  node.textContent = text;
  parent?.append(node);
  return node;
}

const SVG = "http://www.w3.org/2000/svg";
const DASHES = { solid: "", dashed: "4 2", dotted: "1 2", dotdash: "5 2 1 2" };
const SHAPES = {
  circle: '<circle cx="7" cy="7" r="5"/>',
  x: '<path d="M3 3 11 11M11 3 3 11"/>',
  square_x: '<path d="M2 2H12V12H2ZM2 2 12 12M12 2 2 12"/>',
  inverted_triangle: '<path d="M2 3H12L7 12Z"/>',
  line: '<path d="M0 7H14"/>',
  arrow: '<path d="M1 12 12 2M7 2H12V7"/>',
  hatch: '<path d="M1 6 6 1M1 13 13 1M8 13 13 8"/>',
  dots: '<path d="M3 3h.1M7 3h.1M11 3h.1M3 7h.1M7 7h.1M11 7h.1M3 11h.1M7 11h.1M11 11h.1" stroke-linecap="round" stroke-width="2.2"/>',
};

// A mark of the legend, on the dark ground that it has in the picture.
function symbol([color, shape, dash]) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "-1 -1 16 16");
  svg.setAttribute("class", "opnav-symbol");
  svg.innerHTML = `<g fill="none" stroke="${color}" stroke-width="1.6" stroke-dasharray="${DASHES[dash] ?? ""}">${SHAPES[shape] ?? ""}</g>`;
  return svg;
}

// Words of the switches; what each mark means stands in the tooltip too.
const GROUP_WORDS = {
  predicted: [["predicted", "predicted"], ["missing", "missing"]],
  observed: [["used", "used"], ["rejected", "rejected"]],
  magnitudes: [[null, "mag"]],
  residuals: [["residual", "residual"]],
  bodies: [["body", "limb"], ["body_predicted", "predicted"], ["terminator", "terminator"], ["pole", "pole"]],
  masks: [["bad", "bad"], ["saturated", "saturated"]],
  grid: [["grid", "RA, Dec"]],
  compass: [["compass", "N, E"]],
};
const GROUP_HINTS = {
  predicted: "Stars where they are predicted; those that were not detected.",
  observed: "Star centers as measured: used for the pointing, or rejected.",
  magnitudes: "Magnitudes of the brightest stars.",
  residuals: "Observed minus predicted center, enlarged as the number says.",
  bodies: "Bodies: limb where observed and where predicted, terminator, and the line to the north pole (N).",
  masks: "Pixels that are not used: bad ones, and saturated ones.",
  grid: "Lines of right ascension and declination (J2000).",
  compass: "Where north, east and the Sun lie.",
};

function menu(parent, title, choices, chosen) {
  const select = make("select", "opnav-menu", parent);
  select.title = title;
  select.setAttribute("aria-label", title);
  fillMenu(select, choices);
  select.addEventListener("change", () => chosen(select.value));
  return select;
}

function fillMenu(select, choices) {
  const now = select.value;
  if (choices.length === select.options.length && choices.every(([value, text], i) => select.options[i].value === value && select.options[i].text === text)) return;
  select.replaceChildren(...choices.map(([value, text]) => {
    const option = make("option", "", null, text);
    option.value = value;
    return option;
  }));
  select.value = now;
}

function button(parent, text, title, clicked) {
  const node = make("button", "opnav-button", parent, text);
  node.type = "button";
  node.title = title;
  node.addEventListener("click", clicked);
  return node;
}

function numberField(parent, title, entered) {
  const input = make("input", "opnav-number", parent);
  input.type = "text";
  input.inputMode = "decimal";
  input.title = title;
  input.setAttribute("aria-label", title);
  input.addEventListener("change", () => Number.isFinite(Number(input.value)) && input.value.trim() && entered(Number(input.value)));
  input.addEventListener("keydown", (event) => event.key === "Enter" && input.blur());
  return input;
}

// Buttons beside the picture: what is zoomed, measured and compared with; each with its drawing.
const TOOL_ICONS = {
  histogram: '<path d="M1 15V11H4V15M4 15V5H7V15M7 15V2H10V15M10 15V8H13V15M13 15V12H16V15"/>',
  cut: '<path d="M1 15V1M1 15H16M2 12C6 12 6 3 8.5 3S11 12 16 12"/>',
  aperture: '<circle cx="8.5" cy="8.5" r="6.5"/><circle cx="8.5" cy="8.5" r="1.5"/>',
  measure: '<path d="M3 14 14 3M1 12 5 16M12 1 16 5"/>',
  crosshair: '<path d="M8.5 0V7M8.5 10V17M0 8.5H7M10 8.5H17"/>',
  beside: '<path d="M1 3H7.5V14H1ZM9.5 3H16V14H9.5Z"/>',
  wipe: '<path d="M1 3H16V14H1ZM8.5 1V16M10.5 6H14M10.5 8.5H14M10.5 11H14"/>',
};

// The page's elements around the figures; `view` is an ImagePage.
class ImageLayout {
  constructor(view, host) {
    this.view = view;
    const { state } = view;
    const set = (name) => (value) => state.setv({ [name]: value });
    this.box = make("div", "opnav-image", host);
    this.bar = make("div", "opnav-bar", this.box);
    const plain = (list) => list.map((name) => [name, name]);
    const { setup } = view;
    this.image = menu(this.bar, "Picture that is shown", [], set("image"));
    this.stretch = menu(this.bar, view.hint("stretch"), plain(setup.stretches), set("stretch"));
    this.limits = menu(this.bar, view.hint("limits"), plain(setup.limits), (name) => view.setLimits(name));
    this.low = numberField(this.bar, "Shown black, DN", (low) => view.setLimits("manual", { low }));
    this.high = numberField(this.bar, "Shown white, DN", (high) => view.setLimits("manual", { high }));
    this.colormap = menu(this.bar, view.hint("colormap"), plain(Object.keys(setup.colormaps)), set("colormap"));
    this.inverted = button(this.bar, "Invert", view.hint("invert"), () => view.do("invert"));
    this.blink = button(this.bar, "Blink", view.hint("blink"), () => view.do("blink"));
    this.partner = menu(this.bar, "Picture to blink against", [], set("partner"));
    this.partner.classList.add("opnav-partner");
    this.blinkOn = button(this.bar, "Auto-blink", view.hint("blink_on"), () => view.do("blink_on"));
    this.lock = button(this.bar, "", view.hint("lock"), () => view.do("lock"));
    button(this.bar, "PNG", view.hint("save_view"), () => view.do("save_view"));
    this.switches = make("div", "opnav-switches", this.box);
    this.stage = make("div", "opnav-stage", this.box);
    this.picture = make("div", "opnav-figure", this.stage);
    this.message = make("div", "opnav-message", this.picture);
    this.cross = make("div", "opnav-cross", this.picture);
    this.second = make("div", "opnav-figure opnav-second", this.stage);
    this.secondCross = make("div", "opnav-cross", this.second);
    this.curtain = make("div", "opnav-curtain", this.stage);
    this.captions = ["left", "right"].map((side) => make("div", `opnav-caption opnav-caption-${side}`, this.stage));
    this.coming = make("div", "opnav-caption opnav-coming", this.picture);
    for (const node of [this.coming, this.cross, this.second, this.secondCross, this.curtain, ...this.captions]) node.hidden = true;
    this.zoom = make("div", "opnav-zoom", this.box);
    for (const [name, text] of [["home", "All"], ["zoom_in", "+"], ["zoom_out", "−"]])
      button(this.zoom, text, view.hint(name), () => view.do(name));
    this.toolButtons = Object.fromEntries(Object.entries(TOOL_ICONS).map(([name, icon]) => [name, this.toolButton(name, icon)]));
    this.side = make("div", "opnav-side", this.box);
    this.magnifier = make("div", "opnav-figure opnav-small", this.side);
    this.panner = make("div", "opnav-figure opnav-small", setup.strip ? null : this.side);
    if (setup.strip) this.stage.before(this.panner);
    this.readout = make("div", "opnav-readout", this.side);
    this.lines = ["place", "value", "ra", "dec", "degrees", "body", "star", "scale", "shade"].map((name) => make("div", `opnav-read-${name}`, this.readout));
    this.lines[5].title = "Distance from the body's center; click for the next body.";
    this.lines[5].addEventListener("click", () => view.nextBody());
    this.theme = menu(this.readout, "Colors of the marks", setup.themes.map((name) => [name, `marks: ${name}`]), set("theme"));
    this.theme.classList.add("opnav-theme");
    this.box.classList.toggle("opnav-strip", setup.strip);
  }

  toolButton(name, icon) {
    const node = button(this.zoom, "", this.view.hint(name), () => this.view.do(name));
    node.classList.add("opnav-tool");
    node.dataset.tool = name;
    node.setAttribute("aria-label", this.view.setup.actions[name][0]);
    const svg = svgNode("svg", { viewBox: "0 0 17 17", width: 17, height: 17 }, node);
    svg.innerHTML = icon;
    return node;
  }

  updateTools(many) {
    const { view } = this;
    const pressed = { crosshair: view.crossing, beside: view.state.compare === "beside", wipe: view.state.compare === "wipe" };
    for (const [name, node] of Object.entries(this.toolButtons)) {
      node.setAttribute("aria-pressed", String(Boolean(pressed[name] ?? view.tools.name === name)));
      node.hidden = !many && (name === "beside" || name === "wipe");
    }
    this.lock.textContent = `Lock: ${view.state.lock}`;
    this.lock.hidden = ![view.state.image, view.partner()].some((key) => key.startsWith("other:"));
    this.box.classList.toggle("opnav-comparing", Boolean(view.state.compare) || view.state.image.startsWith("other:"));
  }

  // How much of the picture's pixels is here, 0..1; undefined: all.
  arriving(share) {
    this.coming.hidden = share === undefined;
    const what = this.view.images.data?.pixels?.coarse ? "full depth" : "the picture";
    this.coming.textContent = `${what} is on its way: ${Math.round(100 * (share ?? 1))} %`;
  }

  // Shows the state in menus and switches.
  update() {
    const { view } = this;
    const { state, images } = view;
    this.message.textContent = state.message;
    this.box.classList.toggle("opnav-blank", Boolean(state.message));
    const named = Object.entries(images).map(([key, { label }]) => [key, label]);
    fillMenu(this.image, named);
    fillMenu(this.partner, named.filter(([key]) => key !== "data").concat(named.filter(([key]) => key === "data")));
    const values = { image: state.image, stretch: state.stretch, limits: state.limits, colormap: state.colormap, theme: state.theme };
    for (const [name, value] of Object.entries(values)) this[name].value = value;
    this.partner.value = view.partner();
    const many = named.length > 1;
    for (const node of [this.image, this.blink, this.partner, this.blinkOn]) node.hidden = !many;
    const [low, high] = view.limits();
    for (const [node, value] of [[this.low, low], [this.high, high]])
      if (node !== document.activeElement) node.value = String(Number(value.toPrecision(5)));
    for (const node of [this.low, this.high]) node.classList.toggle("opnav-automatic", state.limits !== "manual");
    this.inverted.setAttribute("aria-pressed", String(state.inverted));
    this.blinkOn.setAttribute("aria-pressed", String(view.blinking));
    this.updateTools(many);
    this.updateSwitches();
  }

  updateSwitches() {
    const { state, setup } = this.view;
    const shown = JSON.stringify([state.theme, state.groups, state.vector_scale]);
    if (shown === this.switchesShown) return;
    this.switchesShown = shown;
    const styles = setup.styles[state.theme];
    const switches = Object.entries(GROUP_WORDS).map(([group, words]) => {
      const action = group in setup.actions ? ` ${setup.actions[group][1]}` : "";
      const node = button(null, "", GROUP_HINTS[group] + (action && ` Key: ${action.split("Key: ")[1]}`), () => this.view.toggle(group));
      node.className = "opnav-switch";
      node.dataset.group = group;
      node.setAttribute("aria-pressed", String(state.groups.includes(group)));
      for (const [kind, word] of words) {
        const pair = make("span", "opnav-pair", node); // a sign stays with its word
        if (kind) pair.append(symbol(styles[kind]));
        make("span", "", pair, group === "residuals" ? `${word} ×${compact(state.vector_scale)}` : word);
      }
      return node;
    });
    const focused = document.activeElement?.dataset?.group;
    this.switches.replaceChildren(...switches);
    if (focused) this.switches.querySelector(`[data-group="${focused}"]`)?.focus({ preventScroll: true });
  }
}

const compact = (number) => (number >= 10000 ? `${Number((number / 1000).toPrecision(3))}k` : String(Number(number.toPrecision(3))));
