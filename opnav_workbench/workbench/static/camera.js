// RA and Dec of a place in the picture, as readout.py describes it.

function chebyshev(series, x) {
  let [b1, b2] = [0, 0];
  for (let k = series.length - 1; k > 0; k--) [b1, b2] = [2 * x * b1 - b2 + series[k], b1];
  return x * b1 - b2 + series[0];
}

const DEG = 180 / Math.PI;

// J2000 [RA, Dec], deg; null off the detector.
function skyAt({ tiles, j2000_from_focal }, pixel, line) {
  const inside = ({ corners: [[p0, l0], [p1, l1]] }) => pixel >= p0 && pixel <= p1 && line >= l0 && line <= l1;
  const tile = tiles.find(inside);
  if (!tile) return null;
  const [first, last] = tile.corners;
  const [u, v] = [pixel, line].map((x, i) => (2 * (x - first[i])) / (last[i] - first[i]) - 1);
  const ray = tile.coefficients.map((rows) => chebyshev(rows.map((row) => chebyshev(row, v)), u));
  const [x, y, z] = j2000_from_focal.map((row) => row[0] * ray[0] + row[1] * ray[1] + row[2]);
  const ra = Math.atan2(y, x) * DEG;
  return [ra < 0 ? ra + 360 : ra, Math.atan2(z, Math.hypot(x, y)) * DEG];
}

// 12.3456 -> "12 20 44.2" for the units 60 x 60; `digits` of the seconds.
function sexagesimal(value, digits) {
  const steps = Math.round(Math.abs(value) * 3600 * 10 ** digits);
  const seconds = steps / 10 ** digits;
  const [h, m] = [Math.floor(seconds / 3600), Math.floor((seconds % 3600) / 60)];
  const s = (seconds - 3600 * h - 60 * m).toFixed(digits).padStart(3 + digits, "0");
  return [String(h).padStart(2, "0"), String(m).padStart(2, "0"), s];
}

function skyText([ra, dec]) {
  const [h, m, s] = sexagesimal(ra / 15, 2);
  const [d, arcmin, arcsec] = sexagesimal(dec, 1);
  const sign = dec < 0 ? "−" : "+";
  return [`${h}h${m}m${s}s`, `${sign}${d}°${arcmin}′${arcsec}″`];
}
