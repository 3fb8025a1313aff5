// The columns that history_data.py packs, and the extremes of ever longer segments of each, so that any zoom draws quickly.

async function unpack(text, columns) {
  const raw = atob(text), packed = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) packed[i] = raw.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  let next = 0;
  return columns.map(({ quantum, count, order, width }) => {
    const value = new Float64Array(count), inverse = Math.round(1 / quantum);
    for (let place = 0, weight = 1; place < width; place++, weight *= 256)
      for (let i = 0; i < count; i++) value[i] += weight * bytes[next++];
    for (let i = 0; i < count; i++) value[i] = value[i] % 2 ? -(value[i] + 1) / 2 : value[i] / 2;
    for (let k = 0; k < order; k++) for (let i = 1; i < count; i++) value[i] += value[i - 1];
    // A decimal fraction is nearer to n / 1000 than to n · 0.001.
    for (let i = 0; i < count; i++) value[i] = quantum < 1 ? value[i] / inverse : value[i] * quantum;
    return value;
  });
}

const FACTOR = 4;

/** The extremes of segments of 1, 4, 16, … rows of the range from `low` to `high`, which may be one array. */
function pyramid(low, high) {
  const levels = [{ low, high }];
  while (low.length > 2 * FACTOR) {
    const count = Math.ceil(low.length / FACTOR), below = new Float64Array(count), above = new Float64Array(count);
    for (let k = 0; k < count; k++) {
      let least = Infinity, most = -Infinity;
      for (let i = k * FACTOR; i < Math.min((k + 1) * FACTOR, low.length); i++) {
        if (low[i] < least) least = low[i];
        if (high[i] > most) most = high[i];
      }
      below[k] = least; above[k] = most;
    }
    levels.push({ low: low = below, high: high = above });
  }
  return levels;
}

/** Segments of rows a to b (not b itself), `most` or fewer where that is possible: row, lowest and highest value. */
function segments(levels, a, b, most) {
  let level = 0, size = 1;
  while ((b - a) / size > most && level < levels.length - 1) { level++; size *= FACTOR; }
  const { low, high } = levels[level], found = [];
  for (let k = Math.floor(a / size); k * size < b; k++) found.push({ row: k * size, low: low[k], high: high[k] });
  return found;
}

/** First row at or after `time`. */
function rowAt(t, time) {
  let low = 0, high = t.length;
  while (low < high) { const middle = (low + high) >> 1; if (t[middle] < time) low = middle + 1; else high = middle; }
  return low;
}

/** Row nearest to `time`. */
function nearest(t, time) {
  const row = Math.min(rowAt(t, time), t.length - 1);
  return row > 0 && time - t[row - 1] < t[row] - time ? row - 1 : row;
}
