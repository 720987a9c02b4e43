// Pixels of pictures, asked of Python piece by piece (sent_arrays.py): first what is shown, then what will be shown next.

const PIECE_BYTES = 1 << 21; // so that keys and marks pass between two of them
const ON_THE_WAY = 2; // pieces asked for and not here yet; of what is not shown yet only one
const HANDS_OFF_MS = 400; // so long after a key or a click nothing is asked for ahead
const LATE_MS = 30000; // then a piece is asked for again
const ARRAYS = { uint16: Uint16Array, float32: Float32Array };

class PixelStore {
  constructor(ask, arrived, signal) {
    Object.assign(this, { ask, arrived, held: new Map(), list: [], asked: new Map(), touched: 0 });
    const touch = () => { this.touched = performance.now(); };
    for (const name of ["keydown", "pointerdown", "wheel"]) document.addEventListener(name, touch, { signal, capture: true, passive: true });
  }

  // What is needed now, and what may be next, most urgent first: {token, dtype, shape}; what is not listed is let go.
  want(now, next) {
    this.list = [...now, ...next];
    this.urgent = new Set(now.map(({ token }) => token));
    const tokens = new Set(this.list.map(({ token }) => token));
    for (const token of this.held.keys()) if (!tokens.has(token)) this.held.delete(token);
    this.pull();
  }

  // All values of an array; undefined while some are on their way.
  values(spec) {
    const one = spec && this.held.get(spec.token);
    return one?.left === 0 ? one.values : undefined;
  }

  // How much of it is here, 0..1.
  share(spec) {
    const one = spec && this.held.get(spec.token);
    return one ? 1 - one.left / one.bytes.length : 0;
  }

  pull() {
    const late = performance.now() - LATE_MS;
    for (const [name, { token, first, since }] of this.asked)
      if (since < late) {
        this.asked.delete(name);
        this.held.get(token)?.missing.push(first);
      }
    for (const spec of this.list) {
      while (this.held.get(spec.token)?.missing.length !== 0) {
        if (this.asked.size >= (this.urgent.has(spec.token) ? ON_THE_WAY : 1)) return;
        const wait = this.urgent.has(spec.token) ? 0 : this.touched + HANDS_OFF_MS - performance.now();
        if (wait > 0) return this.later(wait);
        const one = this.held.get(spec.token) ?? this.begin(spec); // only now: room for a picture takes milliseconds
        const first = one.missing.shift();
        this.asked.set(`${spec.token}:${first}`, { token: spec.token, first, since: performance.now() });
        this.ask({ token: spec.token, first, count: PIECE_BYTES });
        this.later(LATE_MS + 1000);
      }
    }
  }

  later(wait) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.pull(), wait);
  }

  begin({ token, dtype, shape }) {
    const values = new ARRAYS[dtype](shape[0] * shape[1]);
    const bytes = new Uint8Array(values.buffer);
    const missing = Array.from({ length: Math.ceil(bytes.length / PIECE_BYTES) }, (_, i) => i * PIECE_BYTES);
    const one = { values, bytes, missing, left: bytes.length };
    this.held.set(token, one);
    return one;
  }

  receive({ token, first, gone }, [piece]) {
    const was = this.asked.delete(`${token}:${first}`);
    const one = this.held.get(token);
    if (one && was && !gone) {
      const part = new Uint8Array(piece.buffer, piece.byteOffset, piece.byteLength);
      one.bytes.set(part, first);
      one.left -= part.length;
      this.arrived(token, one.left === 0);
    }
    this.pull();
  }
}
