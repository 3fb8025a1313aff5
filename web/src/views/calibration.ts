// Calibrations of a point: start, progress, the one offered next to the one in force, accept and refuse, history.

import { type CalibrationBody, get, ofPoint, post } from "../api.ts";
import { button, choice, el, line, say, table } from "../dom.ts";
import type { SiteState } from "../site_state.ts";
import { clock, withSigma } from "../words.ts";
import { nothing, repeat, sentenceOf, type View } from "./view.ts";

const ASK_MS = 2000;
const COLUMNS = ["Number", "Made", "State"];

/** What is shown of a sensor's section: value, deviation, digits, unit. */
const FIGURES: [key: string, std: string, text: string, unit: string, factor: number][] = [
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

/** The figures of a calibration, one a sensor and quantity, by their names. */
export function figures(calibration: Record<string, unknown>): Map<string, string> {
  const found = new Map<string, string>();
  for (const [kind, content] of Object.entries(calibration)) {
    for (const section of Array.isArray(content) ? content : [content]) {
      if (typeof section !== "object" || section === null) continue;
      for (const [key, stdKey, text, unit, factor] of FIGURES) {
        const value = number(section as Section, key);
        if (value === null) continue;
        const std = stdKey ? number(section as Section, stdKey) : null;
        const name = typeof (section as Section)["name"] === "string" ? ` ${String((section as Section)["name"])}` : "";
        found.set(`${kind}${name}: ${text}`, withSigma(factor * value, factor * (std ?? 0), unit));
      }
    }
  }
  return found;
}

function compared(shown: CalibrationBody[]): HTMLElement {
  const columns = shown.map((one) => figures(one.calibration));
  const names = [...new Set(columns.flatMap((one) => [...one.keys()]))];
  const heads = shown.map((one) => el("th", { scope: "col" }, `${one.id}, ${one.state}`));
  const lines = names.map((name) =>
    el("tr", {}, el("th", { scope: "row" }, name), ...columns.map((of) => el("td", {}, of.get(name) ?? "–"))),
  );
  return el(
    "div",
    { class: "wide" },
    el(
      "table",
      {},
      el("thead", {}, el("tr", {}, el("th", { scope: "col" }, "± one σ"), ...heads)),
      el("tbody", {}, ...lines),
    ),
  );
}

function warnings(of: CalibrationBody): string[] {
  const found = of.calibration["warnings"];
  return Array.isArray(found) ? found.map(String) : [];
}

export const showCalibration: View = (root, site, given) => {
  const name = given || site.points[0]?.name;
  if (!name) return nothing(root, "Calibration");
  return shownOf(root, site, name);
};

function shownOf(root: HTMLElement, site: SiteState, name: string): () => void {
  const [said, progress] = [el("p", { role: "status", class: "words" }), el("p")];
  const [offered, history] = [el("div"), el("tbody")];
  const may = site.session.scope !== "read";
  let before = "";

  async function command(what: string): Promise<void> {
    try {
      say(said, (await post<{ text: string }>(ofPoint(name, what))).text);
      await ask();
    } catch (error) {
      say(said, sentenceOf(error));
    }
  }

  function show(all: CalibrationBody[]): void {
    const inForce = all.filter((one) => one.state === "in force");
    const waiting = all.filter((one) => one.state === "offered");
    offered.replaceChildren(
      ...(inForce.length || waiting.length
        ? [compared([...inForce, ...waiting])]
        : [el("p", {}, "No calibration is kept yet.")]),
    );
    for (const one of waiting) {
      const bar = el(
        "div",
        { class: "bar" },
        `Calibration ${one.id}:`,
        button("Accept", () => void command(`calibrations/${one.id}/accept`)),
        button("Refuse", () => void command(`calibrations/${one.id}/refuse`)),
      );
      if (may) offered.append(bar);
      for (const text of warnings(one)) offered.append(el("p", { class: "wrong" }, text));
    }
    const lines = [...all].reverse();
    history.replaceChildren(
      ...lines.map((one) => line(COLUMNS, [String(one.id), clock(Date.parse(one.time)), one.state])),
    );
  }

  async function ask(): Promise<void> {
    const point = site.point(name ?? "");
    say(progress, point ? point.text || "The point is measured with the calibration in force." : "");
    try {
      const all = await get<CalibrationBody[]>(ofPoint(name, "calibrations"));
      const now = JSON.stringify(all.map((one) => [one.id, one.state]));
      if (now !== before) show(all);
      before = now;
    } catch (error) {
      say(said, sentenceOf(error));
    }
  }

  const names = site.points.map((one): [string, string] => [one.name, one.name]);
  root.replaceChildren(
    el("h1", {}, "Calibration"),
    el(
      "div",
      { class: "bar" },
      choice(
        "Point",
        names.length ? names : [[name, name]],
        name,
        (other) => (location.hash = `#/calibration/${encodeURIComponent(other)}`),
      ),
      may && button("Calibrate again", () => void command("calibrate")),
    ),
    said,
    progress,
    offered,
    el("h2", {}, "History"),
    table(COLUMNS, history),
  );
  return repeat(() => void ask(), ASK_MS);
}
