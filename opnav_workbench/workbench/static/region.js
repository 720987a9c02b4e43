// One region of the workbench: shows the HTML that Python renders, and reports clicks, fields, boxes and keys.
// Python decides everything; here is no state but what the browser must keep (focus, scroll, an open drag).
// keys.js stands before this file: keyName, isTyping.

const ROOT = ".opnav-workbench";
const BUSY_MS = 2500; // an event that is not answered for so long: the kernel is busy with something else
const SILENCE_MS = 8000; // so long without a beat: the page says that nothing is heard, and waits on
const GRAVE = "The kernel was restarted or stopped: this is only a picture of what it was. Every decision is on disk.";
const PANEL_PX = { usual: 468, least: 300, picture: 330 }; // width of the panel; what it leaves to the picture
const ROOM_KEY = "opnav-workbench-room"; // what this browser remembers of the room that the parts have
const LAB = "[data-opnav-lab]"; // the notebook that `opnav lab` has opened, among others that may stand beside it
const DRAG_PX = 4; // less is a click with a trembling hand

// Another tab's page has nothing of the one before: it takes its place as it is.
const isSamePart = (old, wanted) =>
  old.tagName === wanted.tagName && old.id === wanted.id && (!wanted.classList.contains("page") || old.className === wanted.className);

// Bring `node` to the state of `wanted`, touching only what differs, so that focus, scroll and selection survive.
function morph(node, wanted) {
  for (const { name } of [...node.attributes]) if (!wanted.hasAttribute(name)) node.removeAttribute(name);
  for (const { name, value } of [...wanted.attributes])
    if (node.getAttribute(name) !== value) {
      node.setAttribute(name, value);
      if (name === "value" && node !== document.activeElement) node.value = value;
    }
  const fresh = [...wanted.childNodes];
  fresh.forEach((child, i) => {
    const old = node.childNodes[i];
    if (!old) node.append(child);
    else if (old.isEqualNode(child)) return;
    else if (old.nodeType === 1 && child.nodeType === 1 && isSamePart(old, child)) morph(old, child);
    else node.replaceChild(child, old);
  });
  while (node.childNodes.length > fresh.length) node.lastChild.remove();
}

// The first element of a text; `beside` tells whether it is one of HTML or of SVG, and a row of a table stands in none but one.
function elementOf(text, beside) {
  const parsed = document.createElement("template"); // inert: pictures that stand already are not loaded once more
  const svg = beside.namespaceURI.endsWith("svg");
  parsed.innerHTML = svg ? `<svg>${text}</svg>` : text;
  return svg ? parsed.content.firstElementChild.firstElementChild : parsed.content.firstElementChild;
}

// Whether the kernel answers: one watch for all regions of a workbench.  Only what tells that it has ended makes it dead.
class Life {
  constructor(root) {
    Object.assign(this, { root, asked: 0, heard: Date.now(), listening: new AbortController() });
    this.watch = setInterval(() => this.look(), 500);
    const { signal } = this.listening; // else the page keeps every workbench that it has shown
    document.addEventListener("opnav-kernel-ended", () => this.end(), { signal }); // where a front end tells
  }

  stop() {
    clearInterval(this.watch);
    this.listening.abort();
  }

  ask() {
    this.asked ||= Date.now();
  }

  answer() {
    this.asked = 0;
    this.beat();
  }

  beat() {
    this.heard = Date.now();
    this.look();
  }

  look() {
    if (!this.root.isConnected) return;
    const now = Date.now();
    const silent = this.asked && now - Math.max(this.asked, this.heard) > SILENCE_MS;
    const busy = this.asked && now - this.asked > BUSY_MS;
    const seconds = Math.round((now - this.heard) / 1000);
    const word = silent ? `Nothing was heard of the kernel for ${seconds} s; what you do is queued.` : busy ? "The kernel is busy; what you do is queued." : "";
    if (word) this.root.dataset.owWait = word;
    else delete this.root.dataset.owWait;
  }

  end() {
    this.stop();
    delete this.root.dataset.owWait;
    if (this.root.classList.contains("ow-dead")) return;
    this.root.classList.add("ow-dead");
    const grave = Object.assign(document.createElement("div"), { className: "ow-grave", textContent: GRAVE });
    const alone = this.root.closest(LAB) !== null;
    const again = Object.assign(document.createElement("button"), { type: "button", textContent: "Start it again" });
    again.addEventListener("click", () => document.dispatchEvent(new CustomEvent("opnav-start-again")));
    grave.append(document.createElement("p"), alone ? again : "Run the notebook's cells again (Run > Run All Cells).");
    this.root.append(grave);
    if (alone) again.focus({ preventScroll: true });
  }
}

// The room that the parts have: the panel's width, what is folded away, and whether the whole window is filled.
class Room {
  constructor(root) {
    this.root = root;
    this.kept = { panel: PANEL_PX.usual, folded: [] };
    try {
      Object.assign(this.kept, JSON.parse(localStorage.getItem(ROOM_KEY) ?? "{}"));
    } catch {
      // this browser keeps nothing: as it comes
    }
    this.splitter();
    this.show();
    if (root.closest(LAB) && !document.querySelector(".ow-window")) this.fill(true);
  }

  do(name) {
    const actions = {
      full: () => this.full(),
      fold_panel: () => this.fold("panel"),
      fold_list: () => this.fold("list"),
      filter: () => this.filter(),
      window: () => this.fill(!this.filled),
    };
    actions[name]?.();
    return name in actions;
  }

  get filled() {
    return this.root.classList.contains("ow-window");
  }

  // The browser's top layer: whatever the notebook does around the workbench, it has the window.
  fill(on) {
    const { root } = this;
    if (!root.showPopover || on === this.filled) return;
    root.classList.toggle("ow-window", on);
    if (on) {
      root.popover = "manual";
      root.showPopover();
    } else root.removeAttribute("popover");
    root.focus({ preventScroll: true });
    if (!on) root.scrollIntoView({ block: "end" });
  }

  full() {
    const alone = ["panel", "list"].every((part) => this.kept.folded.includes(part)) && this.filled;
    if (alone) {
      this.kept.folded = this.before?.folded ?? [];
      if (this.before && !this.before.filled) this.fill(false);
    } else {
      this.before = { folded: this.kept.folded, filled: this.filled };
      this.kept.folded = ["panel", "list"];
      this.fill(true);
    }
    this.show();
  }

  fold(part) {
    const { folded } = this.kept;
    this.kept.folded = folded.includes(part) ? folded.filter((one) => one !== part) : [...folded, part];
    this.show();
  }

  // The list's field of words takes the keys.
  filter() {
    if (this.kept.folded.includes("list")) this.fold("list");
    const field = this.root.querySelector(".ow-queue input");
    field?.focus();
    field?.select();
  }

  show() {
    const { root, kept } = this;
    const back = root.classList.contains("ow-no-panel") && !kept.folded.includes("panel");
    for (const part of ["panel", "list"]) root.classList.toggle(`ow-no-${part}`, kept.folded.includes(part));
    if (back) requestAnimationFrame(() => root.querySelector(".ow-panel [data-reveal]")?.scrollIntoView({ block: "nearest" }));
    root.style.setProperty("--ow-panel-px", `${kept.panel}px`);
    root.dispatchEvent(new CustomEvent("opnav-room")); // the picture fits itself into it
    try {
      localStorage.setItem(ROOM_KEY, JSON.stringify(kept));
    } catch {
      // it is as it is until the page is closed
    }
  }

  splitter() {
    const { root } = this;
    const bar = root.appendChild(document.createElement("div"));
    bar.className = "ow-split";
    bar.title = "Drag: more room for the picture, or for the panel. Double click: as it was.";
    bar.setAttribute("role", "separator");
    const set = (width) => {
      const most = root.clientWidth - PANEL_PX.picture;
      this.kept.panel = Math.round(Math.max(Math.min(width, most), PANEL_PX.least));
      this.show();
    };
    bar.addEventListener("pointerdown", (event) => {
      const start = this.kept.panel + event.clientX;
      const move = (next) => set(start - next.clientX);
      bar.setPointerCapture(event.pointerId);
      bar.addEventListener("pointermove", move);
      bar.addEventListener("pointerup", () => bar.removeEventListener("pointermove", move), { once: true });
    });
    bar.addEventListener("dblclick", () => set(PANEL_PX.usual));
  }
}

// Whether the picture did what a key means nowhere but in it, without asking Python; see bridge.js.
function pictureTakes(root, name) {
  const picture = root.querySelector(".opnav-picture .opnav-bridge");
  return picture?.dispatchEvent(new CustomEvent("opnav-key", { detail: name, cancelable: true })) === false;
}

// Where it has the whole window its keys are heard, too, when the focus was lost with what had it: a button that was folded
// away or is not made any more.
function hearTheWindow(bench) {
  const hear = (event) => {
    const root = bench.deref();
    if (!root) return document.removeEventListener("keydown", hear, true);
    if (event.target !== document.body || !root.owRoom.filled || !root.isConnected) return;
    root.focus({ preventScroll: true });
    root.owHear(event);
  };
  document.addEventListener("keydown", hear, true);
}

// The regions of a workbench share its root: keys are heard there, wherever in the workbench the focus is.
function adopt(root, post) {
  if (root.dataset.owKeys) return;
  root.dataset.owKeys = "on";
  root.tabIndex = 0;
  root.setAttribute("data-lm-suppress-shortcuts", "true"); // else JupyterLab cuts cells on x and d,d
  root.owRoom = new Room(root);
  root.owHear = (event) => {
    if (isTyping(event)) {
      if (event.key !== "Escape") return;
      root.focus({ preventScroll: true });
      if (event.target.dataset.take !== undefined) post({ act: "key", arg: "Escape" }); // its menu is closed, too
      return;
    }
    const name = keyName(event);
    if (root.owTyped !== undefined && (event.key.length === 1 || event.key === "Enter")) {
      root.owTyped += event.key.length === 1 ? event.key : "\n"; // for the field that is on its way, and no command
      event.preventDefault();
      event.stopPropagation();
      return;
    }
    const { keys, own, alone, room, typing } = root.owKeymap ?? { keys: [], own: [], alone: [], room: {}, typing: [] };
    if (!keys.includes(name)) return;
    if (own.includes(name) && event.target.closest(".opnav-picture")) return; // the picture is quicker by itself
    event.preventDefault();
    event.stopPropagation();
    if (alone.includes(name) && pictureTakes(root, name)) return;
    if (root.owRoom?.do(room[name])) return;
    post({ act: "key", arg: name });
    if (typing.includes(name) && !root.querySelector("[data-take]")) root.owTyped = "";
  };
  root.addEventListener("keydown", root.owHear, true);
  hearTheWindow(new WeakRef(root));
  root.addEventListener("keydown", (event) => {
    if (!["Tab", "Escape"].includes(event.key)) event.stopPropagation();
  });
  // JupyterLab takes the focus when a cell is clicked: take it back once it is done.
  root.addEventListener("click", (event) => {
    const back = () => root.contains(document.activeElement) || root.focus({ preventScroll: true });
    if (!isTyping(event)) setTimeout(back, 0);
  });
}

function boxOf(start, event) {
  const [left, right] = [start.x, event.clientX].sort((a, b) => a - b);
  const [top, bottom] = [start.y, event.clientY].sort((a, b) => a - b);
  return { left, right, top, bottom };
}

// A drag over an area with data-box picks all its data-pick children that the rectangle touches.
function listenForBoxes(el, post) {
  let start = null;
  let band = null;
  const end = () => {
    band?.remove();
    start = band = null;
  };
  el.addEventListener("pointerdown", (event) => {
    const area = event.target.closest("[data-box]");
    if (area && event.button === 0) start = { x: event.clientX, y: event.clientY, area };
  });
  el.addEventListener("pointermove", (event) => {
    if (!start || Math.hypot(event.clientX - start.x, event.clientY - start.y) < DRAG_PX) return;
    if (!band) {
      band = document.createElement("div");
      band.className = "ow-band";
      document.body.append(band);
      start.area.setPointerCapture?.(event.pointerId);
    }
    const box = boxOf(start, event);
    Object.assign(band.style, {
      left: `${box.left}px`,
      top: `${box.top}px`,
      width: `${box.right - box.left}px`,
      height: `${box.bottom - box.top}px`,
    });
  });
  el.addEventListener("pointerup", (event) => {
    if (!band) return end();
    const box = boxOf(start, event);
    const picks = [...start.area.querySelectorAll("[data-pick]")].filter((item) => {
      const r = item.getBoundingClientRect();
      return r.left < box.right && r.right > box.left && r.top < box.bottom && r.bottom > box.top;
    });
    el.owDragged = true; // the click that follows is the end of this drag
    post({ act: start.area.dataset.box, picks: picks.map((item) => item.dataset.pick) });
    end();
  });
  el.addEventListener("pointercancel", end);
}

function listenForClicks(el, post) {
  el.addEventListener("click", (event) => {
    if (el.owDragged) {
      el.owDragged = false;
      return;
    }
    const target = event.target.closest("[data-act]");
    if (!target || target.disabled || target.matches("select, input:not([type=checkbox])")) return;
    if (el.closest(ROOT)?.owRoom?.do(target.dataset.act)) return;
    post({ act: target.dataset.act, arg: target.dataset.arg ?? null, shift: event.shiftKey });
  });
  el.addEventListener("change", (event) => {
    const target = event.target;
    if (!target.dataset.act || target.type === "checkbox") return;
    post({ act: target.dataset.act, arg: target.dataset.arg ?? null, value: target.value });
  });
  el.addEventListener("input", (event) => {
    const { act, live } = event.target.dataset;
    if (live !== undefined) post({ act, value: event.target.value });
  });
  el.addEventListener("keydown", (event) => {
    if (event.key === "Enter" && event.target.matches("input")) {
      event.target.blur(); // the change event then reports the value
      el.closest(ROOT)?.focus({ preventScroll: true });
    }
  });
}

function render({ model, el }) {
  el.classList.add("ow-region", `ow-${model.get("name")}`);
  const body = document.createElement("div");
  body.className = "ow-body";
  el.append(body);
  const root = () => el.closest(ROOT);
  const life = () => (root() ? (root().owLife ??= new Life(root())) : undefined);
  const dead = () => life()?.end();
  const post = (message) => {
    try {
      model.send(message);
      life()?.ask();
    } catch {
      dead(); // the front end knows that the kernel is gone
    }
  };
  const paint = () => show(model.get("html"));
  const show = (html) => change(() => morph(body, elementOf(`<div class="ow-body">${html}</div>`, body)));
  // Nothing but what has changed; a page that was opened meanwhile, or shown anew, may lack its place.
  const patch = (parts) => {
    model.owPatched = true;
    const places = Object.entries(parts).map(([number, text]) => [body.querySelector(`[data-part="${number}"]`), text]);
    if (!places.every(([place]) => place)) return post({ act: "whole" });
    change(() => {
      for (const [place, text] of places) {
        const wanted = elementOf(text, place);
        if (isSamePart(place, wanted)) morph(place, wanted);
        else place.replaceWith(wanted);
      }
    });
  };
  const change = (task) => {
    const lost = root()?.contains(document.activeElement);
    task();
    if (lost && !root().contains(document.activeElement)) root().focus({ preventScroll: true });
    count();
    take();
    body.querySelector("[data-reveal]")?.scrollIntoView({ block: "nearest", inline: "nearest" });
    el.dispatchEvent(new CustomEvent("ow-painted", { bubbles: true }));
  };
  // The field that this page's key has asked for, with what was typed meanwhile.
  const take = () => {
    const field = body.querySelector("[data-take]");
    if (!field || root()?.owTyped === undefined) return;
    const [text, ...ended] = root().owTyped.split("\n");
    root().owTyped = undefined;
    field.focus();
    if (text) document.execCommand("insertText", false, text); // as if it were typed: the field tells of it when it is left
    if (ended.length) root().focus({ preventScroll: true });
  };
  // A class of the root's: with `:has` the browser would look at all the workbench at each change of anything in it.
  const count = () => {
    const list = body.querySelector(".queue");
    if (list) root()?.classList.toggle("ow-one", list.dataset.count === "1");
  };
  const keys = () => {
    const shell = root();
    if (shell && model.get("keymap").length)
      shell.owKeymap = { keys: model.get("keymap"), own: model.get("picture_keys"), alone: model.get("picture_alone"), room: model.get("page_keys"), typing: model.get("typing_keys") };
  };
  model.on("change:html", () => {
    model.owPatched = false;
    paint();
  });
  model.on("change:keymap", keys);
  model.on("msg:custom", (message) => {
    if (message.beat) return life()?.beat();
    if (message.parts) return patch(message.parts);
    if (message.whole !== undefined) return show(message.whole);
    if (root()?.owKeymap?.typing.includes(message.key)) root().owTyped = undefined; // it is answered: no field has come
    life()?.answer();
  });
  model.on("comm:close", dead);
  model.on("comm_live_update", dead);
  listenForClicks(el, post);
  listenForBoxes(el, post);
  paint();
  if (model.owPatched) post({ act: "whole" }); // of the same region shown once more: what the model holds is older
  let shell = null;
  const attached = () => {
    shell = root();
    if (!shell) return setTimeout(attached, 50); // the box that holds the regions is not in the page yet
    keys();
    count();
    if (model.get("keymap").length) adopt(shell, post);
  };
  attached();
  return () => shell?.owLife?.stop();
}

export default { render };
