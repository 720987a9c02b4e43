// What is read off a picture without Python: its distribution, values along a line, angles on the sky.

const MOST_SAMPLED = 500000; // pixels of a distribution: its bins are then known better than they are drawn
const BINS = 90;

// A picture's values in order: all of them, or every k-th.
function sortedSample(values, n_pixel) {
  let step = Math.max(1, Math.floor(values.length / MOST_SAMPLED));
  const common = (a, b) => (b ? common(b, a % b) : a);
  while (step > 1 && common(step, n_pixel) > 1) step += 1; // else only some columns are looked at
  const sample = new Float32Array(Math.ceil(values.length / step));
  let n = 0;
  for (let i = 0; i < values.length; i += step) if (values[i] === values[i]) sample[n++] = values[i];
  return sample.subarray(0, n).sort();
}

// How many values of a sorted list lie below one.
function countBelow(sorted, value) {
  let [low, high] = [0, sorted.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low;
}

const quantile = (sorted, share) => sorted[Math.min(Math.floor(share * sorted.length), sorted.length - 1)] ?? 0;

// Counts in equal bins from low to high.
function binCounts(sorted, low, high, bins = BINS) {
  const edges = Array.from({ length: bins + 1 }, (_, i) => low + ((high - low) * i) / bins);
  const below = edges.map((edge) => countBelow(sorted, edge));
  return { edges, counts: below.slice(1).map((count, i) => count - below[i]) };
}

// The picture's value between pixels (bilinear); NaN beyond it and beside pixels without a value.
function valueAt(values, n_pixel, n_line, pixel, line) {
  const x = Math.min(Math.max(pixel, 0), n_pixel - 1);
  const y = Math.min(Math.max(line, 0), n_line - 1);
  if (Math.abs(x - pixel) > 0.5 || Math.abs(y - line) > 0.5) return NaN;
  const [i, j] = [Math.min(Math.floor(x), Math.max(n_pixel - 2, 0)), Math.min(Math.floor(y), Math.max(n_line - 2, 0))];
  const [u, v] = [x - i, y - j];
  const at = (di, dj) => values[Math.min(j + dj, n_line - 1) * n_pixel + Math.min(i + di, n_pixel - 1)];
  const above = u ? at(0, 0) * (1 - u) + at(1, 0) * u : at(0, 0);
  if (!v) return above;
  return above * (1 - v) + (u ? at(0, 1) * (1 - u) + at(1, 1) * u : at(0, 1)) * v;
}

// Values along a line, two a pixel.
function lineCut(values, [n_pixel, n_line], [[x0, y0], [x1, y1]]) {
  const length = Math.hypot(x1 - x0, y1 - y0);
  const n = Math.min(Math.max(Math.ceil(2 * length), 1), 4000);
  const shares = Array.from({ length: n + 1 }, (_, i) => i / n);
  return {
    distance: shares.map((share) => share * length),
    values: shares.map((share) => valueAt(values, n_pixel, n_line, x0 + share * (x1 - x0), y0 + share * (y1 - y0))),
  };
}

// Separation and position angle (east of north, at the first) of two places on the sky, [RA, Dec] in degrees.
function skyStep([ra0, dec0], [ra1, dec1]) {
  const [d0, d1, turn] = [dec0 / DEG, dec1 / DEG, (ra1 - ra0) / DEG];
  const east = Math.cos(d1) * Math.sin(turn);
  const north = Math.cos(d0) * Math.sin(d1) - Math.sin(d0) * Math.cos(d1) * Math.cos(turn);
  const along = Math.sin(d0) * Math.sin(d1) + Math.cos(d0) * Math.cos(d1) * Math.cos(turn);
  const angle = Math.atan2(east, north) * DEG;
  return { separation: Math.atan2(Math.hypot(east, north), along) * DEG, angle: angle < 0 ? angle + 360 : angle };
}

function angleText(degrees) {
  const arcsec = degrees * 3600;
  if (arcsec < 3600) return `${arcsec.toPrecision(arcsec < 100 ? 4 : 5)}″`;
  return `${degrees.toFixed(4)}°`;
}
