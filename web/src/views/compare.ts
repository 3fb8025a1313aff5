// Two traces on one axis: another point, or another day of the same.

import { Chart, type Drawn } from "../charts/chart.ts";
import { load, ofAPoint, rowStep } from "../charts/series.ts";
import { button, choice, el, say } from "../dom.ts";
import { statistics } from "../rows.ts";
import { clock, duration, signed } from "../words.ts";
import { SpanChoice } from "./span_choice.ts";
import { nothing, sentenceOf, type View } from "./view.ts";

const DAYS: [string, string][] = [
  ["0", "the same time"],
  ["1", "the day before"],
  ["2", "two days before"],
  ["7", "a week before"],
  ["28", "four weeks before"],
  ["365", "a year before"],
];
const DAY_MS = 86_400_000;

export const showCompare: View = (root, site) => {
  const names = site.points.map((one): [string, string] => [one.name, one.name]);
  if (!names[0]) return nothing(root, "Compare");
  let [first, second, days, seconds] = [names[0][0], names[0][0], "1", 3600];
  let toMs = Date.parse(site.point(first)?.time ?? "") || site.now();
  let asking: AbortController | null = null;
  const [wrong, shown] = [el("p", { class: "wrong", role: "status" }), el("p", { class: "quiet" })];
  const [one, other] = [el("p", { class: "first" }), el("p", { class: "second" })];
  const frame = el("div", { class: "chart", role: "img", "aria-label": "Two traces of displacement over time" });
  const pick = (label: string, set: (name: string) => void) =>
    choice(label, names, names[0]?.[0] ?? "", (name) => {
      set(name);
      void ask();
    });
  const span = new SpanChoice(seconds, (length) => {
    seconds = length;
    void ask();
  });
  root.replaceChildren(
    el("h1", {}, "Compare"),
    el(
      "div",
      { class: "bar" },
      pick("Point", (name) => (first = name)),
      pick("with", (name) => (second = name)),
      choice("of", DAYS, days, (value) => {
        days = value;
        void ask();
      }),
      span.root,
      button("Earlier", () => {
        toMs -= 500 * seconds;
        void ask();
      }),
      button("Later", () => {
        toMs += 500 * seconds;
        void ask();
      }),
      button("Newest", () => {
        toMs = Date.parse(site.point(first)?.time ?? "") || site.now();
        void ask();
      }),
    ),
    wrong,
    frame,
    shown,
    one,
    other,
  );
  const chart = new Chart(
    frame,
    [{ colour: "trace" }, { colour: "second" }],
    ([from, to]) => {
      seconds = to - from;
      toMs = 1000 * to;
      span.show(seconds);
      void ask();
    },
    () => undefined,
  );

  async function trace(point: string, shiftMs: number, signal: AbortSignal): Promise<{ drawn: Drawn; text: string }> {
    const newest = Date.parse(site.point(point)?.time ?? "") || toMs;
    const step = await rowStep(point, newest, site.rowsOf(point).rows);
    const loaded = await load(
      ofAPoint(point),
      toMs - 1000 * seconds - shiftMs,
      toMs - shiftMs,
      chart.width,
      step,
      signal,
    );
    const figures = statistics(loaded.envelope, loaded.areRows);
    const text = figures
      ? `minimum ${signed(figures.low, 3)}, maximum ${signed(figures.high, 3)}` +
        `${figures.mean === null ? "" : `, mean ${signed(figures.mean, 3)}`} mm`
      : "no rows";
    const x = loaded.envelope.x.map((at) => at + shiftMs / 1000);
    return {
      drawn: { envelope: { ...loaded.envelope, x } },
      text: `${point}, ${clock(toMs - 1000 * seconds - shiftMs)} to ${clock(toMs - shiftMs)}: ${text}`,
    };
  }

  async function ask(): Promise<void> {
    asking?.abort();
    const { signal } = (asking = new AbortController());
    try {
      const found = await Promise.all([trace(first, 0, signal), trace(second, Number(days) * DAY_MS, signal)]);
      say(wrong, "");
      chart.draw(
        [toMs / 1000 - seconds, toMs / 1000],
        found.map((each) => each.drawn),
        [],
      );
      say(one, found[0]?.text ?? "");
      say(other, found[1]?.text ?? "");
      say(shown, `The second trace is shifted by ${duration(seconds)} to the time of the first.`);
    } catch (error) {
      if (!signal.aborted) say(wrong, sentenceOf(error));
    }
  }
  void ask();
  return () => {
    asking?.abort();
    chart.destroy();
  };
};
