// The range of values that a chart shows: all values, and the bands of all but the few widest.

import type { Envelope } from "../rows.ts";

// Where a sensor is back after long, or a point begins, some bands are a thousand times as wide as the others: the widest
// tenth may leave the plot, which else would show a flat line.
const SHARE = 0.9;

/** Least and largest, null where there are no values. */
export function valueRange(envelopes: Envelope[]): [number, number] | null {
  const widths: number[] = [];
  const rows: [number, number, number, number][] = [];
  for (const of of envelopes) {
    of.low.forEach((low, k) => {
      const high = of.high[k];
      if (low === null || high == null) return;
      const [lower, upper] = [of.lower[k] ?? low, of.upper[k] ?? high];
      widths.push(low - lower, upper - high);
      rows.push([low, high, lower, upper]);
    });
  }
  if (!rows.length) return null;
  const most = widths.sort((a, b) => a - b)[Math.ceil(SHARE * widths.length) - 1] ?? 0;
  let [least, largest] = [Infinity, -Infinity];
  for (const [low, high, lower, upper] of rows) {
    least = Math.min(least, Math.max(lower, low - most));
    largest = Math.max(largest, Math.min(upper, high + most));
  }
  return [least, largest];
}
