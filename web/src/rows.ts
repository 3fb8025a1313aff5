// Rows and buckets in one form: an envelope with its band, where a gap is null.

import type { Buckets, Rows } from "./api.ts";

/** x in s since 1970; low, high: least and largest; lower, upper: those with 1.96 σ; mean; coasting: whether
 * any of it rests on no measurement; rows: how many it stands for, null where that is not known. */
export interface Envelope {
  x: number[];
  low: (number | null)[];
  high: (number | null)[];
  lower: (number | null)[];
  upper: (number | null)[];
  mean: (number | null)[];
  coasting: boolean[];
  rows: (number | null)[];
}

// Rows that are further apart than this many of their usual steps have a gap between them: one row may be late.
const GAP_STEPS = 2.5;

export function emptyEnvelope(): Envelope {
  return { x: [], low: [], high: [], lower: [], upper: [], mean: [], coasting: [], rows: [] };
}

function push(
  into: Envelope,
  x: number,
  low: number | null,
  high: number | null,
  mean: number | null,
  std: number | null,
  status: string | null,
  rows: number | null,
) {
  into.x.push(x);
  into.low.push(low);
  into.high.push(high);
  into.mean.push(mean);
  into.coasting.push(status === "coasting");
  into.rows.push(rows);
  // A bucket without a deviation (over more than 32 days) has no band.
  into.lower.push(low === null || std === null ? null : low - 1.96 * std);
  into.upper.push(high === null || std === null ? null : high + 1.96 * std);
}

/** Buckets, each drawn at its middle; `lost` rows have no value there. */
export function ofBuckets(buckets: Buckets, toMs: number): Envelope {
  const made = emptyEnvelope();
  const { time } = buckets;
  const half = time.length ? (toMs * 1e6 - (time[0] ?? 0)) / time.length / 2 : 0;
  time.forEach((ns, at) => {
    const [low, high] = [buckets.displacement_mm_min[at] ?? null, buckets.displacement_mm_max[at] ?? null];
    push(
      made,
      (ns + half) / 1e9,
      low,
      high,
      buckets.displacement_mm_mean[at] ?? null,
      buckets.displacement_std_mm[at] ?? null,
      buckets.status[at] ?? null,
      buckets.rows[at] ?? null,
    );
  });
  return made;
}

/** Whether what is kept reaches the first row that came, ns: nothing is missing in between. */
export function reaches(kept: Envelope, firstNs: number | undefined): boolean {
  let last = kept.low.length - 1;
  while (last >= 0 && kept.low[last] === null) last -= 1;
  const step = (kept.x[1] ?? 0) - (kept.x[0] ?? 0);
  return firstNs !== undefined && last >= 0 && firstNs / 1e9 <= (kept.x[last] ?? 0) + step;
}

/** The usual step of rows, s; null for fewer than three. */
export function usualStep(time: number[]): number | null {
  if (time.length < 3) return null;
  const steps = time
    .slice(1)
    .map((ns, at) => ns - (time[at] ?? ns))
    .sort((a, b) => a - b);
  return (steps[steps.length >> 1] ?? 0) / 1e9;
}

/** Rows as they are, with a null where some are missing. */
export function ofRows(rows: Rows): Envelope {
  const made = emptyEnvelope();
  const step = usualStep(rows.time) ?? Infinity;
  rows.time.forEach((ns, at) => {
    const x = ns / 1e9;
    const before = made.x[made.x.length - 1];
    if (before !== undefined && x - before > GAP_STEPS * step)
      push(made, before + step, null, null, null, null, null, 0);
    const value = rows.status[at] === "lost" ? null : (rows.displacement_mm[at] ?? null);
    push(
      made,
      x,
      value,
      value,
      value,
      rows.displacement_std_mm[at] ?? null,
      rows.status[at] ?? null,
      value === null ? 0 : 1,
    );
  });
  return made;
}

/** Rows that are not final yet: the next ones replace them. */
export interface Head {
  time: number[];
  displacement_mm: (number | null)[];
  displacement_std_mm: (number | null)[];
}

/** What is drawn differently: measured, coasting and not final, each null where it is another; neighbours touch. */
export function layers(all: Envelope, head: Head | null): [Envelope, Envelope, Envelope] {
  const last = all.x[all.x.length - 1] ?? -Infinity;
  const whole: Envelope = { ...all, x: [...all.x] };
  for (const name of ["low", "high", "lower", "upper", "mean"] as const) whole[name] = [...all[name]];
  whole.coasting = [...all.coasting];
  whole.rows = [...all.rows];
  const count = all.x.length;
  head?.time.forEach((ns, at) => {
    const value = head.displacement_mm[at] ?? null;
    if (ns / 1e9 > last) push(whole, ns / 1e9, value, value, value, head.displacement_std_mm[at] ?? null, null, 1);
  });
  const isCoasting = (at: number) => at < count && whole.coasting[at] === true;
  const hasHead = whole.x.length > count;
  const only = (keep: (at: number) => boolean): Envelope => {
    const made: Envelope = { ...whole };
    for (const name of ["low", "high", "lower", "upper", "mean"] as const)
      made[name] = whole[name].map((value, at) => (keep(at) ? value : null));
    return made;
  };
  return [
    only((at) => at < count && !isCoasting(at)),
    only((at) => isCoasting(at) || ((isCoasting(at - 1) || isCoasting(at + 1)) && at < count)),
    only((at) => at >= count || (hasHead && at === count - 1)),
  ];
}

/** The newest rows of a point, of `keptS` seconds at most. */
export class Newest {
  rows: Rows = { time: [], displacement_mm: [], displacement_std_mm: [], status: [] };
  #keptS: number;
  constructor(keptS: number) {
    this.#keptS = keptS;
  }

  /** Add what is newer than what is there. */
  add(came: Rows): void {
    const { rows } = this;
    const last = rows.time[rows.time.length - 1] ?? -1;
    came.time.forEach((ns, at) => {
      if (ns <= last) return;
      rows.time.push(ns);
      rows.displacement_mm.push(came.displacement_mm[at] ?? null);
      rows.displacement_std_mm.push(came.displacement_std_mm[at] ?? null);
      rows.status.push(came.status[at] ?? "lost");
    });
    const first = (rows.time[rows.time.length - 1] ?? 0) - this.#keptS * 1e9;
    const old = rows.time.findIndex((ns) => ns >= first);
    // Thrown away in one go now and then: each time costs a copy.
    if (old > 1000) this.rows = part(rows, old, rows.time.length);
  }
}

export function part(rows: Rows, from: number, to: number): Rows {
  return {
    time: rows.time.slice(from, to),
    displacement_mm: rows.displacement_mm.slice(from, to),
    displacement_std_mm: rows.displacement_std_mm.slice(from, to),
    status: rows.status.slice(from, to),
  };
}

/** Rows of a time, s since 1970. */
export function within(rows: Rows, fromS: number, toS: number): Rows {
  const begin = rows.time.findIndex((ns) => ns >= fromS * 1e9);
  if (begin < 0) return part(rows, 0, 0);
  let end = rows.time.length;
  while (end > begin && (rows.time[end - 1] ?? 0) > toS * 1e9) end -= 1;
  return part(rows, begin, end);
}

export interface Statistics {
  low: number;
  high: number;
  /** Null where rows have none that is kept. */
  mean: number | null;
  rms: number | null;
  parts: number;
}

/** Of what is drawn from an instant on, s: extremes and mean of every row; rms about the mean, of rows alone. */
export function statistics(of: Envelope, areRows: boolean, fromS = -Infinity): Statistics | null {
  let [low, high, sum, squares, count, parts] = [Infinity, -Infinity, 0, 0, 0, 0];
  of.low.forEach((least, at) => {
    const most = of.high[at] ?? null;
    if (least === null || most === null || (of.x[at] ?? 0) < fromS) return;
    low = Math.min(low, least);
    high = Math.max(high, most);
    // Of what has no mean, or no number of rows, the whole has none.
    const [mean, rows] = [of.mean[at] ?? NaN, of.rows[at] ?? NaN];
    sum += rows * mean;
    squares += rows * mean * mean;
    count += rows;
    parts += 1;
  });
  if (!parts) return null;
  const mean = sum / count;
  const rms = areRows ? Math.sqrt(Math.max(squares / count - mean * mean, 0)) : null;
  return { low, high, mean: Number.isFinite(mean) ? mean : null, rms, parts };
}
