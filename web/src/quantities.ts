// What a calibration holds that has a number: value and deviation, one a sensor and quantity.

export interface Quantity {
  value: number;
  /** One standard deviation; null where none is known. */
  std: number | null;
  unit: string;
}

/** What is shown of a sensor's section. */
const QUANTITIES: [key: string, std: string, text: string, unit: string, factor: number][] = [
  ["scale_mm_per_px", "scale_std_mm_per_px", "scale", "mm/px", 1],
  ["phase_scale_mm_per_rad", "", "phase scale", "mm/rad", 1],
  ["conversion_factor", "conversion_factor_std", "conversion factor", "", 1],
  ["target_range_m", "", "range of the target", "m", 1],
  ["scale", "scale_std", "gain", "", 1],
  ["time_offset_s", "time_offset_std_s", "clock offset", "ms", 1000],
  ["noise_std_m_s2", "", "noise", "m/s²", 1],
];

type Section = Record<string, unknown>;

function number(of: Section, key: string): number | null {
  const found = of[key];
  return typeof found === "number" ? found : null;
}

/** The quantities of a calibration by their names. */
export function quantities(calibration: Record<string, unknown>): Map<string, Quantity> {
  const found = new Map<string, Quantity>();
  for (const [kind, content] of Object.entries(calibration)) {
    for (const section of Array.isArray(content) ? content : [content]) {
      if (typeof section !== "object" || section === null) continue;
      const own = (section as Section)["name"];
      const sensor = typeof own === "string" ? `${kind} ${own}` : kind;
      for (const [key, stdKey, text, unit, factor] of QUANTITIES) {
        const value = number(section as Section, key);
        if (value === null) continue;
        const std = stdKey ? number(section as Section, stdKey) : null;
        found.set(`${sensor}: ${text}`, { value: factor * value, std: std === null ? null : factor * std, unit });
      }
    }
  }
  return found;
}

/** The sensors of a calibration, each with its image axis: where they are others, its quantities mean something else. */
function sensorsOf(calibration: Record<string, unknown>): string {
  const sensors = Object.entries(calibration).flatMap(([kind, content]) =>
    (Array.isArray(content) ? content : [content])
      .filter((one): one is Section => typeof one === "object" && one !== null)
      // Others are no sensor's.
      .filter((one) => QUANTITIES.some(([key]) => number(one, key) !== null))
      .map(({ name, direction }) => [kind, name ?? "", typeof direction === "string" ? direction : ""].join(" ")),
  );
  return sensors.sort().join(";");
}

/** Those of calibrations, the newest last, that have the sensors and the axes of the newest one. */
export function comparable<T extends { calibration: Record<string, unknown> }>(all: T[]): T[] {
  const newest = all[all.length - 1];
  return newest ? all.filter((one) => sensorsOf(one.calibration) === sensorsOf(newest.calibration)) : [];
}

export interface Change {
  /** From the first to the last one, in their unit. */
  by: number;
  /** The same in its standard deviations; null where none is known. */
  sigmas: number | null;
}

/** By how much a quantity changed between instants x: on the line that their values and deviations make likeliest. */
export function changeOf(values: { x: number; of: Quantity }[]): Change | null {
  const [first, last] = [values[0], values[values.length - 1]];
  if (!first || !last || values.length < 2) return null;
  // Values without a deviation are compared, and nothing is said of chance.
  if (values.some(({ of }) => !of.std)) return { by: last.of.value - first.of.value, sigmas: null };
  const weight = ({ of }: { of: Quantity }) => 1 / (of.std ?? 1) ** 2;
  const sum = (what: (one: { x: number; of: Quantity }) => number) =>
    values.reduce((total, one) => total + weight(one) * what(one), 0);
  const middle = sum(({ x }) => x) / sum(() => 1);
  const spread = sum(({ x }) => (x - middle) ** 2);
  if (spread === 0) return null;
  const slope = sum(({ x, of }) => (x - middle) * of.value) / spread;
  const by = slope * (last.x - first.x);
  return { by, sigmas: Math.abs(slope) * Math.sqrt(spread) };
}
