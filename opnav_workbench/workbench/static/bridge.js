// One page's end of the bridge: shows the bokeh document that Python holds, and exchanges bokeh's JSON patches.
//
// to Python    open, patch, pull, key, event, error, closed
// from Python  bokeh, document, patch, piece, refresh, keys, do, status, done

const TITLE = "opnav_workbench"; // of Python's document
const GATHER_MS = 40; // changes of a pan or a zoom go out together
const LOAD_MS = 30000; // BokehJS must have come by then

const loading = (globalThis.opnavBokehLoading ??= new Map());

// BokehJS `version` in this page, once for all views; `ask` gets its scripts from Python.
function bokehOfPage(version, parts, ask) {
  const present = () => {
    const bokeh = globalThis.Bokeh?.[version];
    const has = { bokeh: bokeh, "bokeh-widgets": bokeh?.Widgets, "bokeh-tables": bokeh?.Tables };
    return parts.filter((part) => !has[part]);
  };
  const earlier = loading.get(version) ?? Promise.resolve();
  const loaded = earlier.catch(() => {}).then(async () => {
    const missing = present();
    if (missing.length) for (const script of await ask(missing)) await runScript(script);
    if (present().length) throw new Error(`BokehJS ${version} did not load: ${present().join(", ")}`);
    calm(globalThis.Bokeh[version]);
    return globalThis.Bokeh[version];
  });
  loading.set(version, loaded);
  return loaded;
}

// BokehJS writes the style of each of a figure's parts at each paint, and asks the browser for styles in between, which then
// works all of them out anew: a fifth of a paint. What stands there already is not written again; and of our own figures the
// size of letters is asked for once, and no color is looked for among the page's styles (`--bk-...`), where they have none.
function calm(bokeh) {
  const sheet = bokeh.require("core/dom").InlineStyleSheet?.prototype;
  if (!sheet?._update || sheet.opnavCalm) return;
  const isOurs = (view) => view.model.document?.title() === TITLE;
  const look = bokeh.require("core/visuals/visual").VisualProperties?.prototype;
  const ask = look?._get_css_value;
  if (ask)
    look._get_css_value = function (name) {
      return isOurs(this.obj) ? "" : ask.call(this, name);
    };
  const plot = bokeh.require("models/plots/plot_canvas").PlotView?.prototype;
  const size = plot && Object.getOwnPropertyDescriptor(plot, "base_font_size")?.get;
  if (size)
    Object.defineProperty(plot, "base_font_size", {
      get() {
        return isOurs(this) ? (this.opnavFontPx ??= size.call(this)) : size.call(this);
      },
    });
  const write = sheet._update;
  sheet.opnavCalm = true;
  sheet._update = function (css) {
    if (this.opnavCss === css) return;
    this.opnavCss = css;
    write.call(this, css);
  };
}

function runScript(bytes) {
  return new Promise((resolve, reject) => {
    const url = URL.createObjectURL(new Blob([bytes], { type: "text/javascript" }));
    const script = document.createElement("script");
    script.onload = () => resolve(URL.revokeObjectURL(url));
    script.onerror = () => reject(new Error("the page refused to run BokehJS"));
    script.src = url;
    document.head.append(script);
  });
}

const asBuffer = (view) => view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength);

// A message's document or patch: JSON text in the first buffer, arrays in the others.
function payload(message, buffers) {
  const arrays = new Map(message.buffer_ids.map((id, i) => [id, asBuffer(buffers[i + 1])]));
  return [JSON.parse(new TextDecoder().decode(buffers[0])), arrays];
}

// Arrays that the page sends become text.
const plain = (_, value) => (typeof value?.to_base64 === "function" ? value.to_base64() : value);

class Page {
  constructor(model, el, signal) {
    Object.assign(this, { model, signal, sequence: 0, keys: new Set(), pageKeys: {}, queue: [], failures: 0 });
    this.id = [...crypto.getRandomValues(new Uint8Array(8))].map((b) => b.toString(16).padStart(2, "0")).join("");
    this.root = el.appendChild(document.createElement("div"));
    this.root.className = "opnav-bridge";
    this.host = this.root.appendChild(document.createElement("div"));
    this.status = new StatusLine(this.root);
    this.status.say("Loading ...");
    const pull = (piece) => this.send({ kind: "pull", ...piece });
    this.pixels = new PixelStore(pull, (token, all) => this.view?.arrived(token, all), signal);
  }

  async start() {
    this.model.on("msg:custom", (message, buffers) => this.guard(() => this.receive(message, buffers)));
    this.model.on("comm_live_update", () => this.status.die());
    this.watchKernel();
    listenForKeys(this.root, (name) => this.pressed(name), this.signal);
    const heard = (event) => this.isShown && this.pressed(event.detail) && event.preventDefault();
    this.root.addEventListener("opnav-key", heard, { signal: this.signal }); // of the workbench around it
    adoptSheet(this.host, this.signal);
    watchTheme((dark) => this.guard(() => this.recolor(dark)), this.signal);
    this.signal.addEventListener("abort", () => this.close());
    const ask = (parts) => this.askForBokeh(parts);
    this.bokeh = await bokehOfPage(this.model.get("bokeh_version"), this.model.get("bokeh_parts"), ask);
    this.send({ kind: "open" });
  }

  // -- to Python

  send(message) {
    if (this.status.dead) return;
    try {
      this.model.send({ ...message, page: this.id });
    } catch {
      this.status.die(); // the front end knows that the kernel is gone
    }
  }

  // As `send`, for what the analyst did: the line says so while it waits.
  act(message) {
    if (this.status.dead) return;
    this.sequence += 1;
    this.status.sent(this.sequence);
    this.send({ ...message, sequence: this.sequence });
  }

  event(name, values) {
    this.flush();
    this.act({ kind: "event", name, values });
  }

  // Whether there is a picture to do anything with.
  get isShown() {
    return this.view !== undefined && !this.view.state.message;
  }

  pressed(name) {
    const action = this.pageKeys[name];
    if (action !== undefined && this.do(action)) return true;
    if (!this.keys.has(name)) return name === "Ctrl+s"; // everything is saved; the browser need not save the page
    this.flush();
    this.act({ kind: "key", key: name });
    return true;
  }

  changed(event) {
    const events = event.events ?? [event];
    if (event.sync === false) return;
    for (const one of events.filter((e) => e.sync !== false)) {
      const same = (e) => e.kind === "ModelChanged" && one.kind === e.kind && e.model === one.model && e.attr === one.attr;
      this.queue = this.queue.filter((e) => !same(e));
      this.queue.push(one);
    }
    if (!this.queue.length || this.timer !== undefined) return;
    this.timer = setTimeout(() => this.guard(() => this.flush()), GATHER_MS);
    this.status.count(true);
  }

  flush() {
    clearTimeout(this.timer);
    this.timer = undefined;
    this.status.count(false);
    const events = this.queue.splice(0);
    if (!events.length || !this.doc) return;
    const patch = this.doc.create_json_patch(events);
    this.act({ kind: "patch", patch: JSON.parse(JSON.stringify(patch, plain)) });
  }

  // -- from Python

  receive(message, buffers) {
    if (this.signal.aborted) return;
    if (message.page !== undefined && message.page !== this.id) return;
    const { kind } = message;
    if (kind === "document") return this.show(message, buffers);
    if (kind === "bokeh") return this.scripts?.(buffers.map(asBuffer));
    if (kind === "piece") return this.pixels.receive(message, buffers);
    if (kind === "status") return this.status.say(message.text, message.level);
    if (kind === "done") return this.status.done(message.sequence);
    if (kind === "refresh") return this.send({ kind: "open" });
    if (kind === "keys") return this.takeKeys(message);
    if (kind === "do") return void this.do(message.name);
    if (kind === "patch" && this.doc && message.origin !== this.id) return this.patch(message, buffers);
  }

  askForBokeh(parts) {
    this.model.send({ kind: "bokeh", page: this.id, parts });
    return new Promise((resolve, reject) => {
      this.scripts = resolve;
      setTimeout(() => reject(new Error("the kernel did not send BokehJS; is it busy?")), LOAD_MS);
    });
  }

  takeKeys({ keys, page_keys }) {
    this.keys = new Set(keys);
    this.pageKeys = page_keys;
  }

  async show(message, buffers) {
    this.clear();
    this.takeKeys(message);
    const [json, arrays] = payload(message, buffers);
    const { Document } = this.bokeh.require("document");
    const doc = (this.doc = Document.from_json(json, undefined, arrays));
    colorModels(this.bokeh, doc.all_models);
    const slots = prepareViews(this, doc); // an image view lays out its own figures
    doc.on_change((event) => this.guard(() => this.changed(event)), true);
    const views = await this.bokeh.embed.add_document_standalone(doc, this.host, slots);
    if (this.doc !== doc) return views.clear(); // closed, or drawn anew, meanwhile
    this.views = views;
    this.failures = 0;
    attachViews(this);
    this.root.dataset.ready = message.page;
  }

  patch(message, buffers) {
    const [json, arrays] = payload(message, buffers);
    try {
      const before = new Set(this.doc.all_models);
      this.doc.apply_json_patch(json, arrays);
      colorModels(this.bokeh, [...this.doc.all_models].filter((model) => !before.has(model)));
      this.view?.patched();
    } catch (error) {
      // A model that this page does not know: ask for the whole document, once.
      this.failures += 1;
      if (this.failures > 1) throw error;
      console.warn("opnav_workbench: the view is drawn anew,", error);
      this.send({ kind: "open" });
    }
  }

  do(name) {
    return this.actions?.(name) ?? false;
  }

  // -- life and death

  recolor() {
    fillSheet();
    this.root.dataset.theme = isDark() ? "dark" : "light";
    if (this.doc) colorModels(this.bokeh, this.doc.all_models);
  }

  watchKernel() {
    const kernel = this.model.widget_manager?.kernel;
    const ended = ["restarting", "autorestarting", "terminating", "dead"];
    const heard = (_, status) => ended.includes(status) && this.status.die();
    kernel?.statusChanged?.connect(heard);
    kernel?.disposed?.connect(() => this.status.die());
    this.signal.addEventListener("abort", () => kernel?.statusChanged?.disconnect(heard));
  }

  clear() {
    this.queue = [];
    this.views?.clear();
    const { documents } = this.bokeh ?? {};
    if (documents?.includes(this.doc)) documents.splice(documents.indexOf(this.doc), 1);
    this.doc = this.views = this.view = this.actions = undefined;
    this.host.replaceChildren();
  }

  close() {
    this.clear();
    this.send({ kind: "closed" });
  }

  guard(task) {
    const fail = (error) => {
      console.error(error);
      this.status.say(`The view failed: ${error.message ?? error}. Reload the page; nothing decided is lost.`, "error");
      this.send({ kind: "error", text: String(error.message ?? error), stack: String(error.stack ?? "") });
    };
    try {
      const result = task();
      if (result instanceof Promise) result.catch(fail);
      return result;
    } catch (error) {
      fail(error);
    }
  }
}

async function attached(el, signal) {
  while (!el.isConnected && !signal.aborted) await new Promise((resolve) => setTimeout(resolve, 20));
}

export default {
  async render({ model, el, signal }) {
    const end = new AbortController();
    signal?.addEventListener("abort", () => end.abort());
    const page = new Page(model, el, end.signal);
    void attached(el, end.signal).then(() => page.guard(() => page.start()));
    return () => end.abort();
  },
};
