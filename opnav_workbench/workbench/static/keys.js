// Keys pressed in a view stay in the view: JupyterLab must not cut cells on x and d, d.

const PASSED_ON = ["Tab", "Escape"]; // the ways out

// The name of a pressed key: as KeyboardEvent has it, with Ctrl+ (or Meta), Alt+ and, for named keys, Shift+ before.
function keyName(event) {
  const held = event.ctrlKey || event.metaKey;
  const shifted = event.shiftKey && (event.key.length > 1 || held);
  const key = held && event.key.length === 1 ? event.key.toLowerCase() : event.key;
  return (held ? "Ctrl+" : "") + (event.altKey ? "Alt+" : "") + (shifted ? "Shift+" : "") + key;
}

function isTyping(event) {
  const target = event.composedPath()[0];
  return target.matches?.("input:not([type=checkbox]):not([type=range]), textarea, select") ?? false;
}

// Hears the keys of `root`; `pressed(name)` tells whether it took the key.
function listenForKeys(root, pressed, signal) {
  root.tabIndex = 0;
  root.dataset.lmSuppressShortcuts = "true";
  root.addEventListener("keydown", (event) => {
    if (!isTyping(event) && pressed(keyName(event))) {
      event.preventDefault();
      event.stopPropagation();
    } else if (!PASSED_ON.includes(event.key)) event.stopPropagation();
    else if (event.key === "Escape" && isTyping(event)) root.focus({ preventScroll: true });
  }, { signal });
  keepFocus(root, signal);
}

// The focus stays with `root`, though what has it inside may be drawn anew, until the analyst goes elsewhere.
function keepFocus(root, signal) {
  let engaged = false;
  const focus = () => root.focus({ preventScroll: true }); // without the option the notebook jumps
  const inside = (event) => event.composedPath().includes(root);
  document.addEventListener("pointerdown", (event) => { engaged = inside(event); }, { signal, capture: true });
  root.addEventListener("mousedown", (event) => {
    if (event.composedPath()[0].matches?.("input, textarea, select, option, label")) return;
    event.preventDefault(); // else a canvas inside takes the focus
    focus();
  }, { signal });
  root.addEventListener("focusout", (event) => {
    if (event.relatedTarget !== null || !engaged) return;
    setTimeout(() => engaged && document.activeElement === document.body && focus(), 0);
  }, { signal });
}
