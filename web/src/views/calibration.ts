// Calibrations: what is prepared, the offered one next to the one in force, how they went over time, and their rows.

import { type CalibrationBody, get, ofPoint, type PointState, post, type Warned } from "../api.ts";
import { type History, historyChart } from "../charts/history.ts";
import { button, choice, disable, el, line, mark, say, table } from "../dom.ts";
import { type Change, changeOf, comparable, type Quantity, quantities } from "../quantities.ts";
import type { SiteState } from "../site_state.ts";
import { clock, day, duration, signed, withSigma } from "../words.ts";
import { nothing, repeat, sentenceOf, type View } from "./view.ts";

const [ASK_MS, DRAW_MS] = [3000, 500];
const COLUMNS = ["Number", "Made", "State", "Rows made with it"];
// Spans of rows that a line of the history names, the newest of them.
const LISTED_SPANS = 3;
// A change that chance makes once in 16 000 calibrations is one, standard deviations.
const CHANGED_SIGMAS = 4;

/** What a point prepares, in words. */
const STAGES: Record<string, string> = {
  capturing: "Records are captured",
  calibrating: "The calibration is computed",
  opening: "The point opens with it",
};

/** A change in words: relative where the value is no offset, and in deviations. */
function changeWords({ by, sigmas }: Change, from: Quantity): string {
  const isOffset = from.unit === "ms";
  const [value, unit] = isOffset ? [by, from.unit] : [(100 * by) / Math.abs(from.value), "%"];
  // What is none in these digits has no sign.
  const sign = value > 0 && Number(value.toFixed(2)) !== 0 ? "+" : "";
  return `${sign}${signed(value, 2)} ${unit}${sigmas === null ? "" : ` (${sigmas.toFixed(1)} σ)`}`;
}

const isSure = ({ sigmas }: Change) => (sigmas ?? 0) > CHANGED_SIGMAS;

/** Calibrations side by side; of two, what the second one changes. */
function compared(shown: CalibrationBody[]): HTMLElement {
  const columns = shown.map((one) => quantities(one.calibration));
  const names = [...new Set(columns.flatMap((one) => [...one.keys()]))];
  const titles = shown.map((one) => `${one.id}, ${one.state}`);
  const heads = [...titles, ...(shown.length === 2 ? ["Change"] : [])].map((text) => el("th", { scope: "col" }, text));
  const lines = names.map((name) => {
    const values = columns.map((of) => of.get(name));
    const cells = values.map((of, at) =>
      el("td", { "data-name": titles[at] }, of ? withSigma(of.value, of.std ?? 0, of.unit) : "–"),
    );
    const [first, second] = values;
    if (shown.length === 2) {
      const by =
        first && second
          ? changeOf([
              { x: 0, of: first },
              { x: 1, of: second },
            ])
          : null;
      const cell = el("td", { class: "words", "data-name": "Change" }, by && first ? changeWords(by, first) : "–");
      if (by && isSure(by)) mark(cell, "notice");
      cells.push(cell);
    }
    return el("tr", {}, el("th", { scope: "row" }, name), ...cells);
  });
  const head = el("thead", {}, el("tr", {}, el("th", { scope: "col" }, "± one σ"), ...heads));
  const frame = { class: "wide", tabindex: 0, role: "region", "aria-label": "Calibrations side by side" };
  return el("div", frame, el("table", { class: "stacked" }, head, el("tbody", {}, ...lines)));
}

/** Quantities with a deviation over time, those of the newest calibration's sensors, and whether they drifted. Returns how the charts end. */
function showCourse(root: HTMLElement, all: CalibrationBody[]): () => void {
  const used = comparable(all.filter((one) => one.state !== "refused"));
  const names = [
    ...new Set(
      used.flatMap((one) => [...quantities(one.calibration)].filter(([, of]) => of.std).map(([name]) => name)),
    ),
  ];
  const ends = names.map((name) => {
    const found = used.flatMap((one) => {
      const of = quantities(one.calibration).get(name);
      return of?.std ? [{ x: Date.parse(one.time) / 1000, is: one.state, of }] : [];
    });
    const [first, by] = [found[0], changeOf(found)];
    if (!first || !by) return () => undefined;
    const words = `${isSure(by) ? "Has drifted" : "Has not drifted"}: ${changeWords(by, first.of)} since ${day(1000 * first.x)}`;
    const said = el("p", { class: "words" }, words);
    mark(said, isSure(by) ? "notice" : "good");
    const frame = el("div", {
      class: "chart small",
      role: "img",
      "aria-label": `${name} of ${found.length} calibrations: ${words}`,
    });
    root.append(el("section", {}, el("h3", {}, name), said, frame));
    const of = (offered: boolean): History => ({
      colour: offered ? "notice" : "trace",
      open: offered,
      points: found
        .filter((one) => (one.is === "offered") === offered)
        .map((one) => ({ x: one.x, y: one.of.value, half: 1.96 * (one.of.std ?? 0) })),
    });
    return historyChart(frame, [of(false), of(true)], first.of.unit || "factor");
  });
  return () => ends.forEach((end) => end());
}

/** The state of a calibration; of a refused one by whom and why. */
function stateWords({ state, refusal }: CalibrationBody): string {
  if (!refusal) return state;
  return `${state} by ${refusal.owner || "a script"}${refusal.reason ? `: ${refusal.reason}` : ""}`;
}

/** When a calibration made rows, the newest spans first. */
function rowsWords({ rows }: CalibrationBody): string {
  if (!rows) return "";
  const when = (iso: string) => clock(Date.parse(iso));
  const texts = rows
    .slice(-LISTED_SPANS)
    .reverse()
    .map((one) => `${when(one.from)} to ${when(one.to)}`);
  if (rows.length > LISTED_SPANS) texts.push(`${rows.length - LISTED_SPANS} earlier spans`);
  return texts.join("; ");
}

/** What is prepared, with a bar; nothing where nothing is. */
class Progress {
  root = el("div");
  #words = el("p");
  #bar = el("progress", { max: 1, "aria-label": "Progress of the preparation" });

  constructor() {
    this.root.append(this.#words, this.#bar);
  }

  show(point: PointState | undefined, site: SiteState): void {
    const [stage, left] = [point?.stage ?? "", point ? site.leftS(point) : null];
    this.#bar.hidden = stage === "";
    const words = STAGES[stage];
    if (!words)
      return say(this.#words, point ? point.text || "The point is measured with the calibration in force." : "");
    say(
      this.#words,
      left === null
        ? `${words}.`
        : `${words}: ${left > 1 ? `about ${duration(Math.round(left))} left` : "nearly done"}.`,
    );
    const passedS = point?.since ? Math.max(site.now() - Date.parse(point.since), 0) / 1000 : null;
    if (left === null || passedS === null) this.#bar.removeAttribute("value");
    else this.#bar.value = passedS / (passedS + left + 1e-3);
  }
}

const MARKS: Record<string, string> = { note: "unknown", serious: "wrong" };

/** What a calibration reports, the worst in red; earlier versions have sentences alone. */
function warnings({ id, calibration }: CalibrationBody): HTMLElement[] {
  const listed = (key: string): unknown[] => (Array.isArray(calibration[key]) ? calibration[key] : []);
  const coded = listed("notices") as Partial<Warned>[];
  const found = coded.length ? coded : listed("warnings").map((text): Partial<Warned> => ({ text: String(text) }));
  return found.map(({ severity, text }) => {
    const said = el("p", { class: "words" }, `Calibration ${id}: ${text}`);
    mark(said, MARKS[severity ?? ""] ?? "notice");
    return said;
  });
}

export const showCalibration: View = (root, site, given) => {
  const name = given || site.points[0]?.name;
  if (!name) return nothing(root, "Calibration");
  return shownOf(root, site, name);
};

function shownOf(root: HTMLElement, site: SiteState, name: string): () => void {
  const said = el("p", { role: "status", class: "words" });
  const [offered, history, course] = [el("div"), el("tbody"), el("div", { class: "small-charts" })];
  const courseHead = el("h2", { hidden: true }, "Over time, with 95 % bars");
  const progress = new Progress();
  const may = site.session.scope !== "read";
  const again = button("Calibrate again", () => void command("calibrate"));
  let [before, endCourse] = ["", () => undefined as void];

  async function command(what: string, body?: unknown): Promise<void> {
    try {
      say(said, (await post<{ text: string }>(ofPoint(name, what), body)).text);
      await ask();
    } catch (error) {
      say(said, sentenceOf(error));
    }
  }

  function refuse(id: number): void {
    const reason = window.prompt(`Why is calibration ${id} of ${name} refused? All users see the reason.`, "");
    if (reason !== null) void command(`calibrations/${id}/refuse`, { reason: reason.trim().slice(0, 200) });
  }

  function show(all: CalibrationBody[]): void {
    const inForce = all.filter((one) => one.state === "in force");
    const waiting = all.filter((one) => one.state === "offered");
    const shown = [...inForce, ...waiting];
    offered.replaceChildren(shown.length ? compared(shown) : el("p", {}, "No calibration is stored yet."));
    for (const one of waiting) {
      const bar = el(
        "div",
        { class: "bar" },
        `Calibration ${one.id}:`,
        button("Accept", () => void command(`calibrations/${one.id}/accept`)),
        button("Refuse …", () => refuse(one.id)),
      );
      if (may) offered.append(bar);
    }
    offered.append(...shown.flatMap(warnings));
    const texts = [...all].reverse().map((one) => [String(one.id), clock(Date.parse(one.time)), stateWords(one), ""]);
    history.replaceChildren(...texts.map((one) => line(COLUMNS, one)));
    endCourse();
    course.replaceChildren();
    endCourse = showCourse(course, all);
    courseHead.hidden = !course.childElementCount;
  }

  async function ask(): Promise<void> {
    try {
      const all = await get<CalibrationBody[]>(ofPoint(name, "calibrations"));
      // The rows grow all the time: what is built anew loses the focus.
      const now = JSON.stringify(all.map((one) => [one.id, one.state]));
      if (now !== before) show(all);
      before = now;
      [...all].reverse().forEach((one, at) => {
        const cell = history.rows[at]?.cells[COLUMNS.length - 1];
        if (cell) say(cell, rowsWords(one));
      });
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
      may && again,
    ),
    said,
    progress.root,
    offered,
    courseHead,
    course,
    el("h2", {}, "History"),
    table(COLUMNS, history),
  );
  const ends = [
    repeat(() => {
      progress.show(site.point(name), site);
      disable([again, ...offered.querySelectorAll("button")], site.away);
    }, DRAW_MS),
    repeat(() => void ask(), ASK_MS),
    () => endCourse(),
  ];
  return () => ends.forEach((end) => end());
}
