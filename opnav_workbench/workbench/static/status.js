// The line below the view: what Python says, what failed in the page, and whether the kernel lives.

const PATIENCE_MS = 1500; // a kernel that has not answered for so long is busy with something else

const DEAD_TEXT =
  "The kernel was restarted or stopped: this view is only a picture of what it was. " +
  "Run the notebook's cells again (Run > Run All Cells); every decision is on disk.";

class StatusLine {
  constructor(root) {
    this.root = root;
    this.banner = root.appendChild(document.createElement("div"));
    this.banner.className = "opnav-banner";
    this.banner.setAttribute("role", "alert");
    this.banner.hidden = true;
    this.line = root.appendChild(document.createElement("div"));
    this.line.className = "opnav-status";
    this.line.setAttribute("role", "status");
    this.pending = new Set();
    this.queued = false;
    this.dead = false;
  }

  say(text, level = "info") {
    this.said = [text, level];
    this.line.textContent = text;
    this.line.dataset.level = level;
  }

  // What has not been answered, or, as "queued", not been sent.
  count(queued = this.queued) {
    this.queued = queued;
    this.root.dataset.pending = queued ? "queued" : String(this.pending.size);
  }

  sent(sequence) {
    this.pending.add(sequence);
    this.count();
    this.timer ??= setTimeout(() => {
      this.line.textContent = "The kernel is busy; what you do is queued.";
      this.line.dataset.level = "busy";
    }, PATIENCE_MS);
  }

  done(sequence) {
    this.pending.delete(sequence);
    this.count();
    if (this.pending.size > 0) return;
    clearTimeout(this.timer);
    this.timer = undefined;
    if (this.line.dataset.level === "busy" && this.said) this.say(...this.said);
  }

  die() {
    this.dead = true;
    clearTimeout(this.timer);
    this.root.classList.add("opnav-dead");
    this.banner.textContent = DEAD_TEXT;
    this.banner.hidden = false;
  }
}
