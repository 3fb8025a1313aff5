// Numbers, ages and times in words.

/** Displacement with its 95 % band, mm. */
export function withBand(value: number | null, std: number | null): string {
  if (value === null) return "no value";
  if (std === null) return `${value.toFixed(3)} mm`;
  const half = 1.96 * std;
  const digits = half >= 1 ? 1 : half >= 0.1 ? 2 : 3;
  return `${signed(value, digits)} ± ${half.toFixed(digits)} mm`;
}

export function signed(value: number, digits: number): string {
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? `−${text}` : text;
}

/** A value with one standard deviation, in two digits of that. */
export function withSigma(value: number, std: number, unit: string): string {
  const digits = std > 0 ? Math.min(Math.max(1 - Math.floor(Math.log10(std)), 0), 9) : 5;
  return `${signed(value, digits)}${std > 0 ? ` ± ${std.toFixed(digits)}` : ""} ${unit}`.trim();
}

/** A duration with the two units that matter. */
export function duration(seconds: number): string {
  if (!Number.isFinite(seconds)) return "unknown";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 60) return `${Math.floor(seconds)} s`;
  const units: [number, string][] = [
    [86400, "d"],
    [3600, "h"],
    [60, "min"],
    [1, "s"],
  ];
  const first = units.findIndex(([size]) => seconds >= size);
  const [size, name] = units[first] ?? [1, "s"];
  const [next, below] = units[first + 1] ?? [1, "s"];
  const rest = Math.floor((seconds % size) / next);
  return `${Math.floor(seconds / size)} ${name}${rest > 0 ? ` ${rest} ${below}` : ""}`;
}

/** An instant (ms since 1970) in the zone of the reader, with seconds. */
export function clock(ms: number): string {
  const when = new Date(ms);
  const today = new Date().toDateString() === when.toDateString();
  const time = when.toLocaleTimeString([], { hour12: false });
  return today ? time : `${day(ms)} ${time}`;
}

/** A day (ms since 1970) in the zone of the reader. */
export function day(ms: number): string {
  return new Date(ms).toLocaleDateString([], { year: "numeric", month: "short", day: "numeric" });
}

/** How a point is measured, as a sentence's subject needs it. */
export const STATUS_WORDS: Record<string, string> = {
  tracking: "measured",
  coasting: "predicted: no camera or radar measurement at present",
  lost: "lost",
  warming: "starting",
  calibrating: "calibrating",
};

/** The zone that all times of the page are in. */
export const ZONE = Intl.DateTimeFormat().resolvedOptions().timeZone;
