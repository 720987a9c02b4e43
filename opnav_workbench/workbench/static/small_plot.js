// A small plot as SVG, drawn in the page: axes with round ticks, curves, dots, and what its owner adds.

const PLOT_PX = { height: 150, left: 46, right: 10, top: 7, bottom: 32 };

function svgNode(name, attributes, parent, text = "") {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.textContent = text;
  parent?.append(node);
  return node;
}

function roundTicks(low, high, wanted = 4) {
  const span = Math.max(high - low, 1e-12);
  const power = 10 ** Math.floor(Math.log10(span / wanted));
  const step = power * [1, 2, 5, 10].find((m) => m * power * (wanted + 0.5) >= span);
  const ticks = [];
  for (let tick = Math.ceil(low / step - 1e-9) * step; tick <= high + 1e-9 * step; tick += step)
    ticks.push(Number(tick.toPrecision(10)));
  return ticks;
}

const tickText = (value) => (Math.abs(value) >= 1e5 || (value && Math.abs(value) < 1e-3) ? value.toExponential(0) : String(value));

function rangeOf(lists) {
  let [low, high] = [Infinity, -Infinity];
  for (const list of lists)
    for (const value of list)
      if (Number.isFinite(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
  if (!(high >= low)) return [0, 1];
  const margin = 0.05 * (high - low) || 1;
  return [low - margin, high + margin];
}

class SmallPlot {
  constructor(parent, className) {
    this.svg = svgNode("svg", { class: `opnav-plot ${className}` }, parent);
  }

  // `x`, `y`: ranges; `curves`: [class, xs, ys]; `dots`: [class, xs, ys].
  draw(width, { x, y, xLabel, yLabel, curves = [], dots = [], bare = false }) {
    const { height, left, right, top, bottom } = PLOT_PX;
    Object.assign(this, { width, x, y, frame: [left, top, width - right, height - bottom] });
    const { svg } = this;
    svg.replaceChildren();
    for (const [key, value] of Object.entries({ width, height, viewBox: `0 0 ${width} ${height}` })) svg.setAttribute(key, value);
    const [x0, y0, x1, y1] = this.frame;
    svgNode("rect", { class: "frame", x: x0, y: y0, width: x1 - x0, height: y1 - y0 }, svg);
    this.inner = svgNode("svg", { x: x0, y: y0, width: x1 - x0, height: y1 - y0, viewBox: `${x0} ${y0} ${x1 - x0} ${y1 - y0}` }, svg);
    for (const [name, xs, ys] of curves) svgNode("path", { class: name, d: this.path(xs, ys) }, this.inner);
    for (const [name, xs, ys] of dots) svgNode("path", { class: name, d: this.specks(xs, ys) }, this.inner);
    for (const tick of roundTicks(...x)) {
      svgNode("path", { class: "tick", d: `M${this.toX(tick)} ${y1}v4` }, svg);
      svgNode("text", { x: this.toX(tick), y: y1 + 14, "text-anchor": "middle" }, svg, tickText(tick));
    }
    for (const tick of bare ? [] : roundTicks(...y, 3)) {
      svgNode("path", { class: "tick", d: `M${x0} ${this.toY(tick)}h-4` }, svg);
      svgNode("text", { x: x0 - 6, y: this.toY(tick) + 4, "text-anchor": "end" }, svg, tickText(tick));
    }
    svgNode("text", { x: (x0 + x1) / 2, y: height - 4, "text-anchor": "middle" }, svg, xLabel);
    svgNode("text", { transform: `rotate(-90 10 ${(y0 + y1) / 2})`, x: 10, y: (y0 + y1) / 2, "text-anchor": "middle" }, svg, yLabel);
  }

  toX(value) {
    const [x0, , x1] = this.frame;
    return x0 + ((value - this.x[0]) / (this.x[1] - this.x[0])) * (x1 - x0);
  }

  toY(value) {
    const [, y0, , y1] = this.frame;
    return y1 - ((value - this.y[0]) / (this.y[1] - this.y[0])) * (y1 - y0);
  }

  // The value on the x axis under the pointer.
  fromX(event) {
    const [x0, , x1] = this.frame;
    const box = this.svg.getBoundingClientRect();
    return this.x[0] + (((event.clientX - box.left) * this.width) / box.width - x0) * ((this.x[1] - this.x[0]) / (x1 - x0));
  }

  path(xs, ys) {
    let d = "";
    let pen = "M";
    for (let i = 0; i < xs.length; i++) {
      if (Number.isFinite(ys[i])) d += `${pen}${this.toX(xs[i]).toFixed(1)} ${this.toY(ys[i]).toFixed(1)}`;
      pen = Number.isFinite(ys[i]) ? "L" : "M";
    }
    return d;
  }

  specks(xs, ys) {
    return xs.map((x, i) => `M${(this.toX(x) - 1).toFixed(1)} ${this.toY(ys[i]).toFixed(1)}h2`).join("");
  }
}
