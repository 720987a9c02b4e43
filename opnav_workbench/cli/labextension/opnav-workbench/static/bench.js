// In the JupyterLab that `opnav lab` starts: runs the workbench's notebook when it is opened, and shows the workbench alone.
// The notebook stands behind it; a cover hides the way there, and goes away when something went wrong on it.
//
// A module federation container by hand: JupyterLab calls init and get (@jupyterlab/builder writes the same).

(() => {
  const MARK = "opnav_lab"; // in the notebook's metadata, put there by `opnav lab`
  const BENCH = ".opnav-workbench .ow-region";
  const RESTORED_MS = 4000; // a kernel that lives on shows its workbench within that; else the notebook is run anew
  const SHOWN_MS = 1500; // after the last cell
  const STARTS_MS = 60000; // a kernel, on a busy machine
  const RESTARTS_MS = 15000;

  const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
  // Of this notebook: another one may show a workbench of its own.
  const benchIsThere = (panel) => panel.node.querySelector(BENCH) !== null;

  async function until(there, ms) {
    const end = Date.now() + ms;
    while (!there() && Date.now() < end) await sleep(50);
    return there();
  }

  class Cover {
    constructor() {
      const dark = matchMedia("(prefers-color-scheme: dark)").matches;
      this.box = document.body.appendChild(document.createElement("div"));
      this.box.id = "opnav-cover";
      const colors = dark ? "#111417; color: #e6e9ec" : "#ffffff; color: #1b1f24";
      this.box.style.cssText = `position: fixed; inset: 0; z-index: 100000; display: flex; flex-direction: column; gap: 14px;
        align-items: center; justify-content: center; font: 15px system-ui, sans-serif; background: ${colors}`;
      this.line = this.box.appendChild(document.createElement("div"));
      this.line.setAttribute("role", "status");
      const bar = this.box.appendChild(document.createElement("progress"));
      bar.style.width = "220px";
      const away = this.box.appendChild(document.createElement("button"));
      Object.assign(away, { type: "button", textContent: "Show the notebook instead" });
      away.style.cssText = "font: inherit; background: none; border: none; color: inherit; text-decoration: underline; cursor: pointer";
      away.addEventListener("click", () => {
        this.unwanted = true;
        document.querySelector("[data-opnav-lab]")?.removeAttribute("data-opnav-lab");
        this.lift();
      });
      this.say("Starting the workbench ...");
    }

    say(text) {
      this.line.textContent = text;
    }

    lift() {
      this.box.remove();
    }
  }

  const isIdle = (panel) => panel.sessionContext.session?.kernel?.status === "idle";

  // Whether the kernel has a variable: it lives on from before.
  async function knows(panel, name) {
    const { kernel } = panel.sessionContext.session;
    const asked = kernel.requestExecute({ code: "", silent: true, user_expressions: { known: `"${name}" in globals()` } });
    const { content } = await asked.done;
    return content.user_expressions?.known?.data?.["text/plain"] === "True";
  }

  async function runAll(app, panel, cover) {
    cover.say("Opening the pictures ...");
    const there = () => benchIsThere(panel);
    const watch = until(there, 120000).then((is) => is && cover.lift());
    await app.commands.execute("notebook:run-all-cells").catch(() => {}); // what a cell says stands below it
    await until(there, SHOWN_MS);
    cover.lift();
    await watch;
    await panel.context.save().catch(() => {}); // a page that is loaded again finds its workbench
  }

  async function open(app, panel, cover) {
    await panel.context.ready;
    if (panel.context.model.sharedModel.getMetadata(MARK) === undefined) return cover.lift();
    cover.say("Starting the kernel ...");
    await panel.sessionContext.ready;
    await until(() => isIdle(panel), STARTS_MS);
    if ((await knows(panel, "bench")) && (await until(() => benchIsThere(panel), RESTORED_MS))) return cover.lift();
    await runAll(app, panel, cover);
  }

  async function startAgain(app, panel) {
    const cover = new Cover();
    cover.say("Starting the kernel again ...");
    const before = panel.node.querySelector(".opnav-workbench.ow-window");
    before?.removeAttribute("popover");
    before?.classList.remove("ow-window");
    // One that was restarted, or that restarts by itself, is not restarted once more on its way.
    if (!(await until(() => isIdle(panel), RESTARTS_MS)) || (await knows(panel, "bench"))) {
      await panel.sessionContext.restartKernel().catch(() => {});
      await until(() => isIdle(panel), STARTS_MS);
    }
    await app.commands.execute("notebook:clear-all-cell-outputs").catch(() => {});
    await runAll(app, panel, cover);
  }

  // JupyterLab's dialogs must not lie behind the workbench.
  function liftDialogs() {
    const lift = (node) => {
      if (!node.classList?.contains("jp-Dialog") || !document.querySelector(".ow-window")) return;
      node.popover = "manual";
      node.showPopover();
    };
    new MutationObserver((changes) => changes.forEach((change) => change.addedNodes.forEach(lift))).observe(document.body, {
      childList: true,
    });
  }

  // The kernel's end is told to the workbench, which cannot see it by itself.
  function watchKernel(panel) {
    panel.sessionContext.statusChanged.connect((_, status) => {
      if (["restarting", "autorestarting", "terminating", "dead"].includes(status))
        document.dispatchEvent(new CustomEvent("opnav-kernel-ended"));
    });
  }

  // The notebook of a path: JupyterLab may bring others back beside it, and before it.
  function openPanel(app, path) {
    for (const widget of app.shell.widgets("main")) if (widget.sessionContext && widget.context?.path === path) return widget;
    return undefined;
  }

  const plugin = {
    id: "opnav-workbench:bench",
    autoStart: true,
    activate: (app) => {
      const path = /\/tree\/([^?]*workbench\.ipynb)$/.exec(location.pathname)?.[1];
      if (path === undefined) return;
      const cover = new Cover();
      liftDialogs();
      void app.restored.then(async () => {
        const panel = () => openPanel(app, decodeURIComponent(path));
        if (!(await until(() => panel() !== undefined, 60000))) return cover.lift();
        const notebook = panel();
        if (!cover.unwanted) notebook.node.dataset.opnavLab = ""; // its workbench takes the window
        app.shell.activateById(notebook.id); // its cells run only while it is the one at hand
        document.addEventListener("opnav-start-again", () => void startAgain(app, notebook));
        watchKernel(notebook);
        await open(app, notebook, cover).catch((error) => {
          console.warn("opnav_workbench:", error);
          cover.lift();
        });
      });
    },
  };

  globalThis._JUPYTERLAB = globalThis._JUPYTERLAB ?? {};
  globalThis._JUPYTERLAB["opnav-workbench"] = {
    init: () => {},
    get: () => Promise.resolve(() => ({ __esModule: true, default: plugin })),
  };
})();
