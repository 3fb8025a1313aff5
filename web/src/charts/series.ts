// Series of a point for a width of the screen: rows where they are few, else buckets of the server.

import { type Buckets, get, ofPoint, type Rows, span } from "../api.ts";
import { type Envelope, ofBuckets, ofRows, usualStep } from "../rows.ts";

// Up to this time rows are drawn, s: of 100 Hz 3000, of 1 kHz 30 000, which a browser draws in some ms.
const ROWS_S = 30;
// Buckets shorter than two rows would be empty in between, as if rows were missing.
const ROWS_A_BUCKET = 2;
const MAX_BUCKETS = 2000;
// Where no row says how far they are apart, s.
const UNKNOWN_STEP_S = 0.1;

export interface Loaded {
  envelope: Envelope;
  areRows: boolean;
}

const steps = new Map<string, number>();

/** The rows' step, s: of rows that came, else of the newest that are kept. */
export async function rowStep(point: string, newestMs: number, came: Rows): Promise<number> {
  const known = usualStep(came.time) ?? steps.get(point);
  if (known !== undefined) {
    steps.set(point, known);
    return known;
  }
  const asked = span(newestMs - 3000, newestMs + 1);
  const step = usualStep((await get<Rows>(ofPoint(point, "series", asked))).time);
  if (step !== null) steps.set(point, step);
  return step ?? UNKNOWN_STEP_S;
}

/** The address of rows, or of buckets of equal length, from an instant to another, ms. */
export type Address = (fromMs: number, toMs: number, buckets: number | null) => string;

/** That of a point. */
export function ofAPoint(point: string): Address {
  return (fromMs, toMs, buckets) =>
    ofPoint(point, "series", { ...span(fromMs, toMs), ...(buckets === null ? {} : { buckets }) });
}

/** What is kept of a time. */
export async function load(
  address: Address,
  fromMs: number,
  toMs: number,
  pixels: number,
  stepS: number,
  signal: AbortSignal,
): Promise<Loaded> {
  const seconds = (toMs - fromMs) / 1000;
  if (seconds <= ROWS_S) {
    return { envelope: ofRows(await get<Rows>(address(fromMs, toMs, null), signal)), areRows: true };
  }
  const buckets = Math.max(1, Math.min(pixels, MAX_BUCKETS, Math.floor(seconds / (ROWS_A_BUCKET * stepS))));
  const found = await get<Buckets>(address(fromMs, toMs, buckets), signal);
  return { envelope: ofBuckets(found, toMs), areRows: false };
}

/** What is kept, and behind it the rows that came since. */
export function joined(kept: Envelope, came: Envelope): Envelope {
  const first = came.x[0];
  if (first === undefined) return kept;
  let end = kept.x.length;
  while (end > 0 && (kept.x[end - 1] ?? 0) >= first) end -= 1;
  const both = (name: Exclude<keyof Envelope, "coasting">) => [...kept[name].slice(0, end), ...came[name]];
  return {
    x: both("x") as number[],
    low: both("low"),
    high: both("high"),
    lower: both("lower"),
    upper: both("upper"),
    mean: both("mean"),
    coasting: [...kept.coasting.slice(0, end), ...came.coasting],
    rows: both("rows"),
  };
}
