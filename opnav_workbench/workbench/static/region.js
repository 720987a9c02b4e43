// One region of the workbench: shows the HTML that Python renders, and reports clicks, fields, boxes and keys.
// Python decides everything; here is no state but what the browser must keep (focus, scroll, an open drag).
// keys.js stands before this file: keyName, isTyping.

const ROOT = ".opnav-workbench";
const SILENCE_MS = 6000; // a kernel that says nothing for so long after an event is dead or stuck
const DRAG_PX = 4; // less is a click with a trembling hand

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
    else if (old.nodeType === 1 && child.nodeType === 1 && old.tagName === child.tagName && old.id === child.id)
      morph(old, child);
    else node.replaceChild(child, old);
  });
  while (node.childNodes.length > fresh.length) node.lastChild.remove();
}

// The regions of a workbench share its root: keys are heard there, wherever in the workbench the focus is.
function adopt(root, post) {
  if (root.dataset.owKeys) return;
  root.dataset.owKeys = "on";
  root.tabIndex = 0;
  root.setAttribute("data-lm-suppress-shortcuts", "true"); // else JupyterLab cuts cells on x and d,d
  root.addEventListener(
    "keydown",
    (event) => {
      if (isTyping(event)) {
        if (event.key === "Escape") root.focus({ preventScroll: true });
        return;
      }
      const name = keyName(event);
      const { keys, own } = root.owKeymap ?? { keys: [], own: [] };
      if (!keys.includes(name)) return;
      if (own.includes(name) && event.target.closest(".opnav-picture")) return; // the picture is quicker by itself
      event.preventDefault();
      event.stopPropagation();
      post({ act: "key", arg: name });
    },
    true,
  );
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
    post({ act: target.dataset.act, arg: target.dataset.arg ?? null, shift: event.shiftKey });
  });
  el.addEventListener("change", (event) => {
    const target = event.target;
    if (!target.dataset.act || target.type === "checkbox") return;
    post({ act: target.dataset.act, arg: target.dataset.arg ?? null, value: target.value });
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
  let waiting = null;
  const root = () => el.closest(ROOT);
  const alive = () => {
    clearTimeout(waiting);
    waiting = null;
    root()?.classList.remove("ow-dead");
  };
  const dead = () => root()?.classList.add("ow-dead");
  const post = (message) => {
    model.send(message);
    waiting ??= setTimeout(dead, SILENCE_MS);
  };
  const paint = () => {
    const wanted = document.createElement("div");
    wanted.className = "ow-body";
    wanted.innerHTML = model.get("html");
    const lost = root()?.contains(document.activeElement);
    morph(body, wanted);
    if (lost && !root().contains(document.activeElement)) root().focus({ preventScroll: true });
    body.querySelector("[data-reveal]")?.scrollIntoView({ block: "nearest", inline: "nearest" });
    el.dispatchEvent(new CustomEvent("ow-painted", { bubbles: true }));
  };
  const keys = () => {
    const shell = root();
    if (shell && model.get("keymap").length)
      shell.owKeymap = { keys: model.get("keymap"), own: model.get("picture_keys") };
  };
  model.on("change:html", paint);
  model.on("change:keymap", keys);
  model.on("msg:custom", alive);
  model.on("comm:close", dead);
  listenForClicks(el, post);
  listenForBoxes(el, post);
  paint();
  const attached = () => {
    const shell = root();
    if (!shell) return setTimeout(attached, 50); // the box that holds the regions is not in the page yet
    keys();
    if (model.get("keymap").length) adopt(shell, post);
  };
  attached();
  return () => clearTimeout(waiting);
}

export default { render };
