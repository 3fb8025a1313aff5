// A region of interest in the frame's pixels, and its place in SITE.toml or recording.toml.

export interface Region {
  x: number;
  y: number;
  width: number;
  height: number;
}
export interface Size {
  width: number;
  height: number;
}

// The trackers need some texture; a region of less has none, px.
export const MIN_PX = 16;

const clamp = (value: number, low: number, high: number) => Math.min(Math.max(value, low), Math.max(low, high));

/** In whole pixels and inside the frame: too large is cut, too far out is moved. */
export function inside(of: Region, frame: Size): Region {
  const width = clamp(Math.round(of.width), Math.min(MIN_PX, frame.width), frame.width);
  const height = clamp(Math.round(of.height), Math.min(MIN_PX, frame.height), frame.height);
  const x = clamp(Math.round(of.x), 0, frame.width - width);
  return { x, y: clamp(Math.round(of.y), 0, frame.height - height), width, height };
}

/** Between two corners, which may be outside the frame: what reaches beyond its edge is cut off. */
export function between(ax: number, ay: number, bx: number, by: number, frame: Size): Region {
  const [left, right] = [Math.min(ax, bx), Math.max(ax, bx)].map((x) => clamp(x, 0, frame.width));
  const [top, bottom] = [Math.min(ay, by), Math.max(ay, by)].map((y) => clamp(y, 0, frame.height));
  return { x: left ?? 0, y: top ?? 0, width: (right ?? 0) - (left ?? 0), height: (bottom ?? 0) - (top ?? 0) };
}

/** Whether a pixel is in a region. */
export function holds(of: Region, x: number, y: number): boolean {
  return x >= of.x && y >= of.y && x < of.x + of.width && y < of.y + of.height;
}

/** A camera's section: of a point in SITE.toml, or of a recording, where several of a kind have names. */
export interface Section {
  kind: string;
  point?: string;
  name?: string;
}

interface Place {
  header: number;
  name: string;
  roi: number | null;
  region: Region | null;
}

const HEADER = /^\s*\[{1,2}\s*([^\]]+?)\s*\]{1,2}\s*(#.*)?$/;
const ROI = /^\s*roi\s*=\s*\[\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*,?\s*\]\s*(#.*)?$/;
const NAME = /^\s*name\s*=\s*(?:"([^"\\]*)"|'([^']*)')/;

/** Where a camera's section stands; null where it is not found, or stands there several times. */
function placeOf(lines: string[], { kind, point, name }: Section): Place | null {
  const wanted = point === undefined ? kind : `point.${kind}`;
  let [section, current] = ["", ""];
  const places: Place[] = [];
  lines.forEach((line, at) => {
    const header = HEADER.exec(line)?.[1]?.replace(/\s/g, "");
    if (header !== undefined) {
      section = header;
      if (section === "point") current = "";
      if (section === wanted && current === (point ?? ""))
        places.push({ header: at, name: "", roi: null, region: null });
      return;
    }
    const named = NAME.exec(line);
    const place = places[places.length - 1];
    if (section === "point" && named) current = named[1] ?? named[2] ?? "";
    if (section !== wanted || current !== (point ?? "") || !place) return;
    if (named) place.name = named[1] ?? named[2] ?? "";
    if (!/^\s*roi\s*=/.test(line)) return;
    const numbers = ROI.exec(line)?.slice(1, 5).map(Number);
    const [x, y, width, height] = numbers ?? [];
    place.roi = at;
    if (x !== undefined && y !== undefined && width !== undefined && height !== undefined)
      place.region = { x, y, width, height };
  });
  const meant = places.length > 1 ? places.filter((one) => one.name !== "" && one.name === name) : places;
  return meant.length === 1 ? (meant[0] ?? null) : null;
}

/** The region that settings have for a camera; null for none, which is chosen automatically. */
export function regionOf(text: string, section: Section): Region | null {
  return placeOf(text.split("\n"), section)?.region ?? null;
}

/** Settings with another region; null where the place for it is not clear, and a person has to write it. */
export function withRegion(text: string, section: Section, region: Region): string | null {
  const lines = text.split("\n");
  const place = placeOf(lines, section);
  if (!place || (place.roi !== null && !place.region)) return null;
  const line = `roi = [${region.x}, ${region.y}, ${region.width}, ${region.height}]`;
  if (place.roi === null) lines.splice(place.header + 1, 0, line);
  else lines[place.roi] = line + (/\s*#.*$/.exec(lines[place.roi] ?? "")?.[0] ?? "");
  return lines.join("\n");
}

/** The region that a calibration was made with; null where it has none. */
export function calibrated(calibration: Record<string, unknown>, kind: string): Region | null {
  const section = calibration[kind];
  const roi = typeof section === "object" && section !== null && "roi" in section ? section.roi : null;
  if (!Array.isArray(roi) || roi.length !== 4 || !roi.every((one) => typeof one === "number")) return null;
  const [x, y, width, height] = roi as [number, number, number, number];
  return { x, y, width, height };
}
