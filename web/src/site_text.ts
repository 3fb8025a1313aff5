// SITE.toml as text: where a key stands, and points and sources that are added and removed; comments and order stay.

interface Part {
  /** Of its header, from 0; to: the line after its last one that is not empty. */
  from: number;
  to: number;
  /** As the header has it: "point.camera". */
  section: string;
  /** The place of its point, from 0, where the server counts from 1; -1 before the first one. */
  point: number;
  name: string;
}

const HEADER = /^\s*\[{1,2}\s*([^\]]+?)\s*\]{1,2}\s*(#.*)?$/;
const NAME = /^\s*name\s*=\s*(?:"([^"\\]*)"|'([^']*)')/;

/** The parts of a text that begin with a header, and before them the one without, whose header is -1. */
function partsOf(lines: string[]): Part[] {
  const parts: Part[] = [{ from: -1, to: 0, section: "", point: -1, name: "" }];
  let point = -1;
  lines.forEach((line, at) => {
    const section = HEADER.exec(line)?.[1]?.replace(/\s/g, "");
    if (section !== undefined) {
      if (section === "point") point += 1;
      parts.push({ from: at, to: at + 1, section, point: section.startsWith("point") ? point : -1, name: "" });
    }
    const part = parts[parts.length - 1] as Part;
    const named = NAME.exec(line);
    if (named && !part.name) part.name = named[1] ?? named[2] ?? "";
    if (line.trim() && !line.trim().startsWith("#")) part.to = at + 1;
  });
  return parts;
}

/** The names of the points, in the order of the text. */
export function pointNames(text: string): string[] {
  return partsOf(text.split("\n"))
    .filter((one) => one.section === "point")
    .map((one) => one.name);
}

// The point, or the alarm, that a key belongs to: by its name, or by its place from 1.
const OWNER = /^(point|alarm)(?: '([^']*)'|\[(\d+)\])(?:: |$)/;
const PLACE = /\[(\d+)\]$/;
const AT_LINE = /\(at line (\d+), column \d+\)/;

/** The line, from 0, that a fault is about; null where it is not found. key: as the server names it. */
export function lineOf(text: string, key: string | null, fault: string): number | null {
  const syntax = AT_LINE.exec(fault);
  if (syntax) return Number(syntax[1]) - 1;
  if (!key) return null;
  const lines = text.split("\n");
  let [path, among, section] = [key, partsOf(lines), ""];
  for (let owner = OWNER.exec(path); owner; owner = OWNER.exec(path)) {
    const [whole, word, name, place] = owner;
    section = section ? `${section}.${word}` : (word ?? "");
    const same = among.filter((one) => one.section === section);
    const meant = name === undefined ? same[Number(place) - 1] : same.find((one) => one.name === name);
    if (!meant) return null;
    among = word === "point" ? among.filter((one) => one.point === meant.point) : [meant];
    path = path.slice(whole.length);
    if (!path) return meant.from;
  }
  const words = path.split(".");
  const last = (words.pop() ?? "").replace(PLACE, "");
  const place = Number(PLACE.exec(words[words.length - 1] ?? "")?.[1] ?? 1);
  section = [section, ...words.map((word) => word.replace(PLACE, ""))].filter(Boolean).join(".");
  const meant = among.filter((one) => one.section === section)[place - 1];
  // A key that is a section itself.
  const header = among.find((one) => one.section === [section, last].filter(Boolean).join("."));
  if (!meant) return header?.from ?? null;
  const own = new RegExp(`^\\s*${last.replace(/[^\w-]/g, "")}\\s*=`);
  const at = lines.slice(meant.from + 1, meant.to).findIndex((line) => own.test(line));
  if (at >= 0) return meant.from + 1 + at;
  // A key that is missing is one of its section.
  return header?.from ?? Math.max(meant.from, 0);
}

export interface Source {
  kind: string;
  source: string;
  /** Further keys, as unit or direction; those without a value are left out. */
  keys: Record<string, string>;
}

const quoted = (value: string) => JSON.stringify(value);

function blockOf({ kind, source, keys }: Source): string[] {
  const rest = Object.entries(keys).filter(([, value]) => value);
  return [`[point.${kind}]`, `source = ${quoted(source)}`, ...rest.map(([key, value]) => `${key} = ${quoted(value)}`)];
}

/** The text with a new point at its end. */
export function withPoint(text: string, name: string, source: Source): string {
  return [text.trimEnd(), "", "[[point]]", `name = ${quoted(name)}`, "", ...blockOf(source), ""].join("\n");
}

/** The text with one more source of a point; null where it has one of that kind, or is not found. */
export function withSource(text: string, name: string, source: Source): string | null {
  const lines = text.split("\n");
  const own = ofPoint(partsOf(lines), name);
  const last = own[own.length - 1];
  if (!last || own.some((one) => one.section === `point.${source.kind}`)) return null;
  // Before what else belongs to the point, as its alarms.
  const before = own.find((one) => one.section === "point.alarm") ?? null;
  const block = blockOf(source);
  if (before) lines.splice(before.from, 0, ...block, "");
  else lines.splice(last.to, 0, "", ...block);
  return lines.join("\n");
}

/** The text without a point; null where it is not found. */
export function withoutPoint(text: string, name: string): string | null {
  const lines = text.split("\n");
  const own = ofPoint(partsOf(lines), name);
  const [first, last] = [own[0], own[own.length - 1]];
  if (!first || !last) return null;
  let from = first.from;
  // Comments that stand directly above it are about it.
  while (from > 0 && lines[from - 1]?.trim().startsWith("#")) from -= 1;
  let to = last.to;
  while (to < lines.length && !lines[to]?.trim()) to += 1;
  lines.splice(from, to - from);
  return lines.join("\n");
}

function ofPoint(parts: Part[], name: string): Part[] {
  const point = parts.find((one) => one.section === "point" && one.name === name)?.point;
  return point === undefined ? [] : parts.filter((one) => one.point === point);
}
