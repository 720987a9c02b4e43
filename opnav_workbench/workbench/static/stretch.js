// From DN to colors in the page, as stretch.py describes it, so that a change of stretch sends no pixels.

const LEVELS = 16384; // of the table; log's steep foot then moves by 2 of 256 shades from one level to the next
const NO_VALUE = 0xff808080; // mid-gray, for pixels without a number

const STRETCHES = {
  linear: (t) => t,
  asinh: (t) => Math.asinh(10 * t) / Math.asinh(10),
  log: (t) => Math.log1p(1000 * t) / Math.log1p(1000),
  sqrt: Math.sqrt,
};

// "rrggbb" x 256 -> little-endian RGBA words
function paletteWords(hex) {
  return Uint32Array.from({ length: hex.length / 6 }, (_, i) => {
    const rgb = parseInt(hex.slice(6 * i, 6 * i + 6), 16);
    return (0xff000000 | ((rgb & 0xff) << 16) | (rgb & 0xff00) | (rgb >> 16)) >>> 0;
  });
}

function colorTable({ stretch, contrast, bias, inverted }, palette) {
  const curve = STRETCHES[stretch] ?? STRETCHES.linear;
  return Uint32Array.from({ length: LEVELS }, (_, i) => {
    const shade = Math.min(Math.max((curve(i / (LEVELS - 1)) - bias) * contrast + 0.5, 0), 1);
    return palette[Math.round((inverted ? 1 - shade : shade) * (palette.length - 1))];
  });
}

// RGBA words of `values`.
function colored(values, low, high, table) {
  const words = new Uint32Array(values.length);
  const scale = (LEVELS - 1) / (high - low);
  for (let i = 0; i < values.length; i++) {
    const level = (values[i] - low) * scale + 0.5;
    words[i] = level >= LEVELS ? table[LEVELS - 1] : level > 0 ? table[level | 0] : level <= 0 ? table[0] : NO_VALUE;
  }
  return words;
}

// Means of k x k pixels: a picture shown smaller than it is must not drop pixels, or stars go with them.
// Of a part of it, whole blocks: [first block, first row, past block, past row].
function binned(values, n_pixel, n_line, k, [x0, y0, x1, y1] = [0, 0, Math.ceil(n_pixel / k), Math.ceil(n_line / k)]) {
  const [width, height] = [x1 - x0, y1 - y0];
  const sums = new Float32Array(width * height);
  const counts = new Uint16Array(width * height);
  const past = Math.min(y1 * k, n_line);
  for (let line = y0 * k; line < past; line++) {
    const first = (Math.floor(line / k) - y0) * width;
    let i = line * n_pixel + x0 * k;
    for (let column = 0; column < width; column++) {
      const end = Math.min((x0 + column + 1) * k, n_pixel) + line * n_pixel;
      let [sum, count] = [0, 0];
      for (; i < end; i++) {
        const value = values[i];
        if (value === value) { sum += value; count += 1; }
      }
      sums[first + column] += sum;
      counts[first + column] += count;
    }
  }
  for (let at = 0; at < sums.length; at++) sums[at] /= counts[at]; // 0/0: no value
  return { values: sums, width, height };
}

// A part of a picture: [first pixel, first line, past pixel, past line].
function cutOut({ values, width, height }, [x0, y0, x1, y1]) {
  if (x0 <= 0 && y0 <= 0 && x1 >= width && y1 >= height) return { values, width, height };
  const [across, down] = [x1 - x0, y1 - y0];
  const part = new values.constructor(across * down);
  for (let row = 0; row < down; row++) part.set(values.subarray((y0 + row) * width + x0, (y0 + row) * width + x0 + across), row * across);
  return { values: part, width: across, height: down };
}
