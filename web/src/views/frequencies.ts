// The course of the first natural frequencies over days and weeks, on demand: it takes the server seconds.

import { type FrequenciesBody, get, ofPoint, span } from "../api.ts";
import { type History, historyChart } from "../charts/history.ts";
import { button, choice, el, say } from "../dom.ts";
import { withSigma } from "../words.ts";
import { sentenceOf } from "./view.ts";

const SPANS: [days: string, text: string][] = [
  ["1", "1 day"],
  ["7", "1 week"],
  ["28", "4 weeks"],
  ["365", "1 year"],
];
const DAY_MS = 86_400_000;
const COLOURS = ["trace", "second", "coasting"];

/** A natural frequency in words: the mean, with the range that it went through. */
function words(course: FrequenciesBody["modes"][number]): string {
  const known = course.frequency_hz.filter((one) => one !== null);
  const mean = known.reduce((sum, one) => sum + one, 0) / known.length;
  const stds = course.frequency_std_hz.filter((one) => one !== null).sort((a, b) => a - b);
  const usual = stds[stds.length >> 1] ?? 0;
  const range = [Math.min(...known), Math.max(...known)].map((one) => one.toFixed(3)).join(" to ");
  return `${withSigma(mean, usual, "Hz")}, from ${range}, in ${known.length} segments`;
}

export class FrequencyPanel {
  root = el("section");
  #days = "7";
  #said = el("p", { role: "status" });
  #list = el("ul", { class: "keys" });
  #frame = el("div");
  #end: () => void = () => undefined;
  #asking: AbortController | null = null;

  /** toMs: where the time that is shown ends. */
  constructor(point: string, toMs: () => number) {
    const spans = choice("over", SPANS, this.#days, (days) => (this.#days = days));
    const show = button("Natural frequencies over time", () => void this.#show(point, toMs()));
    this.root.append(el("div", { class: "bar" }, show, spans), this.#said, this.#list, this.#frame);
  }

  end(): void {
    this.#asking?.abort();
    this.#end();
    this.#end = () => undefined;
  }

  async #show(point: string, toMs: number): Promise<void> {
    this.end();
    const { signal } = (this.#asking = new AbortController());
    const fromMs = toMs - Number(this.#days) * DAY_MS;
    say(this.#said, "Computing the natural frequencies.");
    try {
      for (let isWhole = false; !isWhole;) {
        const found = await get<FrequenciesBody>(ofPoint(point, "frequencies", span(fromMs, toMs)), signal);
        isWhole = found.complete;
        this.#draw(found, [fromMs / 1000, toMs / 1000]);
      }
    } catch (error) {
      if (!signal.aborted) say(this.#said, sentenceOf(error));
    }
  }

  #draw(found: FrequenciesBody, range: [number, number]): void {
    const minutes = `one segment of ${found.segment_s / 60} minutes in each ${found.step_s / 3600} h, with 95 % bars`;
    say(this.#said, found.complete ? found.reason || `Natural frequencies, ${minutes}.` : "Computing more segments.");
    this.#list.replaceChildren(
      ...found.modes.map((one, at) => el("li", { class: `key ${COLOURS[at] ?? ""}` }, words(one))),
    );
    this.#end();
    this.#frame.replaceChildren();
    const ends = found.modes.map((course, at) => {
      const points = found.time.flatMap((ns, k) => {
        const [y, std] = [course.frequency_hz[k] ?? null, course.frequency_std_hz[k] ?? null];
        return y === null ? [] : [{ x: ns / 1e9 + found.segment_s / 2, y, half: 1.96 * (std ?? 0) }];
      });
      const history: History = { colour: COLOURS[at] ?? "trace", points };
      const frame = el("div", { class: "chart small", role: "img", "aria-label": `${words(course)} over time` });
      this.#frame.append(frame);
      return historyChart(frame, [history], "Hz", range);
    });
    this.#end = () => ends.forEach((end) => end());
  }
}
