// Light and dark: the page's theme, given to BokehJS. It is set in the page and never sent to Python, because two
// pages on one session may differ.

const SHADES = {
  light: { ink: "#1b1f24", faint: "#5c6670", line: "#b4bcc4", paper: "#ffffff", field: "#f6f7f8", accent: "#0b6fb8" },
  dark: { ink: "#e6e9ec", faint: "#a3adb8", line: "#4a525b", paper: "#111417", field: "#1e2328", accent: "#5cb3f0" },
};

function isDark() {
  const said = document.body.dataset.jpThemeLight; // JupyterLab and Notebook 7
  if (said !== undefined) return said === "false";
  return document.body.classList.contains("vscode-dark") || document.body.classList.contains("theme-dark");
}

// Calls `changed(dark)` now and whenever the page's theme changes.
function watchTheme(changed, signal) {
  changed(isDark());
  const observer = new MutationObserver(() => changed(isDark()));
  observer.observe(document.body, { attributes: true, attributeFilter: ["data-jp-theme-light", "class"] });
  signal.addEventListener("abort", () => observer.disconnect());
}

function shadesNow() {
  return SHADES[isDark() ? "dark" : "light"];
}

const quiet = (model, values) => model.setv(values, { sync: false });

// What canvas models take; by class name, most general first.
const CANVAS_COLORS = [
  ["Plot", (s) => ({ background_fill_color: s.field, border_fill_color: null, outline_line_color: s.line })],
  ["Axis", (s) => ({
    axis_label_text_color: s.ink, major_label_text_color: s.ink, axis_line_color: s.line,
    major_tick_line_color: s.line, minor_tick_line_color: s.line,
  })],
  ["Grid", (s) => ({ grid_line_color: s.line })],
  ["Title", (s) => ({ text_color: s.ink })],
  ["Legend", (s) => ({ background_fill_color: s.paper, label_text_color: s.ink, border_line_color: s.line })],
  ["ColorBar", (s) => ({ background_fill_color: s.paper, major_label_text_color: s.ink, title_text_color: s.ink })],
];

// Models tagged "own-colors" keep theirs.
function colorModels(bokeh, models) {
  const shades = shadesNow();
  for (const model of models) {
    if (model.tags?.includes("own-colors")) continue;
    for (const [name, colors] of CANVAS_COLORS) {
      const kind = bokeh.Models.get(name);
      if (kind !== undefined && model instanceof kind) quiet(model, colors(shades));
    }
  }
}

// BokehJS renders into shadow roots and defines its colors there, so that a sheet of ours must be in each of them.
const sheet = new CSSStyleSheet();

function fillSheet() {
  const s = shadesNow();
  sheet.replaceSync(`:host {
    --color: ${s.ink}; --background-color: ${s.paper}; --surface-background-color: ${s.field};
    --disabled-background-color: ${s.field}; --hover-color: ${s.field}; --border-color: ${s.line};
    --divider-color: ${s.line}; --icon-color: ${s.faint}; --placeholder-color: ${s.faint};
    --inverted-color: ${s.paper}; --input-focus-border-color: ${s.accent}; --highlight-color: ${s.accent};
    --active-bg: ${s.accent}; --active-fg: ${s.accent}; color: ${s.ink};
  }`);
}

// Gives the sheet to every shadow root below `node`, now and later.
function adoptSheet(node, signal) {
  fillSheet();
  const seen = new WeakSet();
  const visit = (element) => {
    const shadow = element.shadowRoot;
    if (!shadow || seen.has(shadow)) return;
    seen.add(shadow);
    shadow.adoptedStyleSheets = [...shadow.adoptedStyleSheets, sheet];
    watch(shadow);
  };
  const visitAll = (root) => {
    if (root.nodeType === Node.ELEMENT_NODE) visit(root);
    root.querySelectorAll?.("*").forEach(visit);
  };
  const watch = (root) => {
    visitAll(root);
    const observer = new MutationObserver((records) => records.forEach(({ addedNodes }) => addedNodes.forEach(visitAll)));
    observer.observe(root, { childList: true, subtree: true });
    signal.addEventListener("abort", () => observer.disconnect());
  };
  watch(node);
}
