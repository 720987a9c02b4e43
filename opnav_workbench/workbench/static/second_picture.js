// The other picture, beside the one shown or under a curtain that the analyst draws; both move and zoom as one.

class SecondPicture {
  constructor(view) {
    Object.assign(this, { view, share: 0.5 }); // of the picture that the curtain leaves open
  }

  attach() {
    const { view } = this;
    const { layout, page, signal } = view;
    this.figure = page.views.get_by_id(view.model("opnav-second").id);
    const on = (node, name, heard) => node.addEventListener(name, (event) => page.guard(() => heard(event)), { signal });
    on(layout.second, "pointermove", (event) => view.hover(event, this.figure));
    on(layout.second, "pointerleave", () => view.leave());
    const observer = new ResizeObserver(() => view.soon("paint")); // BokehJS lays out in its own time
    for (const shown of [view.figure, this.figure]) observer.observe(shown.el);
    signal.addEventListener("abort", () => observer.disconnect());
    on(layout.curtain, "pointerdown", (event) => layout.curtain.setPointerCapture(event.pointerId));
    on(layout.curtain, "pointermove", (event) => event.buttons && this.draw(event));
    this.update();
  }

  get how() {
    const { state, images } = this.view;
    return Object.keys(images ?? {}).length > 1 && !state.message ? state.compare : "";
  }

  get isBeside() {
    return this.how === "beside" && !this.view.setup.strip;
  }

  get isShown() {
    return this.isBeside || this.how === "wipe";
  }

  update() {
    const { layout } = this.view;
    quiet(this.view.model("opnav-second"), { visible: this.isShown });
    layout.second.hidden = !this.isShown;
    layout.second.classList.toggle("opnav-second-over", this.isShown && !this.isBeside);
    layout.curtain.hidden = !this.isShown || this.isBeside;
    const labels = [this.view.shownKey(), this.key].map((key) => this.view.images?.[key]?.label ?? "");
    layout.captions.forEach((node, i) => {
      node.hidden = !this.isShown;
      node.textContent = labels[i];
    });
    if (this.isShown !== this.was) {
      this.was = this.isShown;
      this.view.soon("fit");
    }
  }

  get key() {
    return this.view.partner();
  }

  paint() {
    if (!this.isShown) return;
    const { view, key } = this;
    const values = view.images[key]?.ready ? view.pixels(key) : undefined;
    if (values) view.fillSight("opnav-second-shown", values, view.localLimits ?? view.limitsOf(key));
    this.place();
  }

  // Over the other frame exactly, or beside it; BokehJS says where its frames are.
  place() {
    const { figure, view } = this;
    if (!figure?.frame?.bbox.width || !view.figure?.frame?.bbox.width) return;
    const { layout } = view;
    const [here, there] = [view.figure.frame.bbox, figure.frame.bbox];
    const left = layout.picture.offsetLeft + here.left;
    const top = layout.picture.offsetTop + here.top;
    const over = !this.isBeside;
    if (over) {
      Object.assign(layout.second.style, { left: `${left - there.left}px`, top: `${top - there.top}px` });
      const open = this.share * here.width;
      layout.second.style.clipPath = `inset(0 0 0 ${there.left + open}px)`;
      Object.assign(layout.curtain.style, { left: `${left + open - 5}px`, top: `${top}px`, height: `${here.height}px` });
    } else Object.assign(layout.second.style, { left: "", top: "", clipPath: "" });
    const right = over ? left + here.width : layout.second.offsetLeft + there.left + there.width;
    Object.assign(layout.captions[0].style, { left: `${left + 4}px`, top: `${top + 4}px` });
    Object.assign(layout.captions[1].style, { left: "", right: `${layout.stage.clientWidth - right + 4}px`, top: `${top + 4}px` });
  }

  draw(event) {
    const { bbox } = this.view.figure.frame;
    const box = this.view.layout.picture.getBoundingClientRect();
    this.share = Math.min(Math.max((event.clientX - box.left - bbox.left) / bbox.width, 0), 1);
    this.place();
  }

  // What the other picture has in a pixel, for the readout.
  valueText(i, j) {
    if (!this.isShown) return "";
    const { images, setup } = this.view;
    const dn = images[this.key]?.ready ? this.view.pixels(this.key)?.[j * setup.size[0] + i] : undefined;
    return dn === undefined ? "" : ` | ${dnText(dn)} DN`;
  }
}
