// The pointer over the picture: click, drag of a tool's shape, and DS9's right drag for contrast and bias.

const CLICK_PX = 4; // less is a click with a trembling hand

class ImagePointer {
  constructor(view, element) {
    Object.assign(this, { view, element });
    this.band = make("div", "opnav-band", element);
    this.band.hidden = true;
    const listen = (name, heard) =>
      element.addEventListener(name, (event) => view.page.guard(() => heard.call(this, event)), { capture: true, signal: view.signal });
    listen("pointerdown", this.down);
    listen("pointermove", (event) => {
      view.byKeys = false;
      this.move(event);
    });
    listen("pointerup", this.up);
    listen("pointercancel", this.cancel);
    listen("pointerleave", () => view.leave());
    listen("dblclick", (event) => event.stopPropagation());
    listen("contextmenu", (event) => {
      if (event.shiftKey) return; // the browser's own menu stays within reach
      event.preventDefault();
      event.stopPropagation();
    });
  }

  down(event) {
    const at = this.view.place(event);
    if (!at) return;
    if (event.button === 0 && this.view.tools.takesPointer) {
      event.stopPropagation();
      this.capture(event);
      this.measuring = true;
      return this.view.tools.down(at);
    }
    this.start = { event, at, button: event.button, state: { ...this.view.shading() } };
    if (event.button === 2 || this.view.state.drag) event.stopPropagation(); // else bokeh pans
    if (event.button === 2 || this.view.state.drag) this.capture(event);
  }

  capture({ pointerId }) {
    if (pointerId !== undefined) this.element.setPointerCapture(pointerId); // keys have no pointer
  }

  move(event) {
    const { start, view } = this;
    view.hover(event);
    if (this.measuring) return view.tools.move(view.place(event, true), event.shiftKey);
    if (!start) return;
    if (start.button === 2) return view.shade(start.state, this.offset(event));
    if (view.state.drag && !this.isClick(event)) this.draw(event);
  }

  up(event) {
    const { start, view } = this;
    this.start = undefined;
    this.band.hidden = true;
    if (this.measuring) {
      this.measuring = false;
      return view.tools.up();
    }
    if (!start) return;
    const at = view.place(event, true);
    if (start.button === 2) {
      event.stopPropagation();
      if (this.isClick(event, start)) view.shade({ contrast: 1, bias: 0.5 }, [0, 0]);
      return view.tellShading();
    }
    if (start.button !== 0) return;
    if (this.isClick(event, start)) view.page.event("tap", start.at);
    else if (view.state.drag) view.page.event("drag", [...start.at, ...at]);
  }

  cancel() {
    this.start = undefined;
    this.measuring = false;
    this.view.tools.held = undefined;
    this.band.hidden = true;
  }

  // -- by keys: the cursor goes in steps, and is pressed where it is

  step(across, down) {
    const { view } = this;
    const pixel = Math.max(1, 1 / view.scale()); // one of the picture that is one on the screen, too
    const { x_range, y_range } = view.model("opnav-picture");
    const edge = 0.5 / view.scale(); // the frame's last screen pixel is in it
    const within = (at, { start, end }) => Math.min(Math.max(at, Math.min(start, end) + edge), Math.max(start, end) - edge);
    const [x, y] = view.cursor ?? view.tools.middle();
    view.byKeys = true;
    view.cursor = [within(x + across * pixel, x_range), within(y + down * pixel, y_range)];
    this.move(this.atCursor());
  }

  // A click; of a shape that is dragged (a box, a line), its begin and then its end.
  press() {
    const { view } = this;
    view.byKeys = true;
    view.cursor ??= view.tools.middle();
    const drags = view.state.drag === "box" || (view.tools.takesPointer && view.tools.name !== "aperture");
    if (!drags) this.cancel(); // what was begun with another tool
    if (!this.start && !this.measuring) {
      this.down(this.atCursor());
      if (drags) return view.cross();
    }
    this.up(this.atCursor());
  }

  // What a pointer at the cursor would tell.
  atCursor() {
    const { frame, canvas_view } = this.view.figure;
    const box = canvas_view.el.getBoundingClientRect();
    const [x, y] = this.view.cursor;
    return { button: 0, shiftKey: false, clientX: box.left + frame.x_scale.compute(x), clientY: box.top + frame.y_scale.compute(y), stopPropagation() {} };
  }

  isClick(event, start = this.start) {
    return Math.hypot(event.clientX - start.event.clientX, event.clientY - start.event.clientY) < CLICK_PX;
  }

  // Shares of the picture's width and height that the pointer went.
  offset(event) {
    const { width, height } = this.element.getBoundingClientRect();
    return [(event.clientX - this.start.event.clientX) / width, (event.clientY - this.start.event.clientY) / height];
  }

  draw(event) {
    const box = this.element.getBoundingClientRect();
    const [x0, y0] = [this.start.event.clientX - box.left, this.start.event.clientY - box.top];
    const [x1, y1] = [event.clientX - box.left, event.clientY - box.top];
    const shape = this.view.state.drag;
    const r = Math.hypot(x1 - x0, y1 - y0);
    const boxes = {
      circle: [x0 - r, y0 - r, 2 * r, 2 * r],
      line: [x0, y0, r, 0],
      box: [Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0)],
    };
    const [left, top, width, height] = boxes[shape];
    const turned = shape === "line" ? `rotate(${Math.atan2(y1 - y0, x1 - x0)}rad)` : "";
    Object.assign(this.band.style, { left: `${left}px`, top: `${top}px`, width: `${width}px`, height: `${height}px`, transform: turned });
    this.band.dataset.shape = shape;
    this.band.hidden = false;
  }
}
