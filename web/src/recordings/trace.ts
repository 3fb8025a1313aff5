// The trace of a result with its band, and of its reference: zoom by mouse and keys, statistics, spectrum.

import { Chart, type Drawn, type Mark } from "../charts/chart.ts";
import { load, type Loaded } from "../charts/series.ts";
import { listStatistics } from "../charts/figures.ts";
import { TimeWindow } from "../charts/window.ts";
import { button, choice, el, say } from "../dom.ts";
import { emptyEnvelope, statistics } from "../rows.ts";
import { clock, duration, signed } from "../words.ts";
import { SpectrumPanel } from "../views/spectrum.ts";
import { sentenceOf } from "../views/view.ts";
import { ofRecording, rowsOf, type What } from "./desk.ts";

// Times after this are instants since 1970, s: 1973; a recording's own clock is not kept running for years.
const CLOCK_S = 1e8;
// Lines that an envelope is drawn of.
const SERIES = 4;

export interface Span {
  from_s: number;
  to_s: number;
  rows: number;
}

export class Trace {
  root = el("div");
  #number: number;
  #span: Span;
  #window: TimeWindow;
  #chart: Chart | null = null;
  #frame: HTMLElement;
  #marks: Mark[];
  #shows: string;
  #asking: AbortController | null = null;
  #wrong = el("p", { class: "wrong", role: "status" });
  #readout = el("p", { class: "quiet" }, " ");
  #shown = el("p", { class: "quiet" });
  #figures = el("dl", { class: "figures" });
  #spectrum = new SpectrumPanel();

  /** across: the name of a second axis; empty without one. */
  constructor(number: number, span: Span, hasReference: boolean, across: string, marks: Mark[]) {
    [this.#number, this.#span, this.#marks, this.#shows] = [number, span, marks, hasReference ? "both" : "result"];
    this.#window = new TimeWindow(1, () => 1000 * span.to_s);
    this.#frame = el("div", {
      class: "chart",
      tabindex: 0,
      role: "img",
      "aria-label": "Displacement over time. Keys: left, right move; plus, minus zoom; A shows all.",
      keydown: (event) => this.#key(event as KeyboardEvent),
    });
    const shown: [string, string][] = [["result", "result"]];
    if (hasReference) shown.unshift(["both", "result and reference"]);
    if (hasReference) shown.push(["error", "result − reference"]);
    if (across) shown.push(["across", `result along ${across}`]);
    const traces = choice("Trace", shown, this.#shows, (value) => this.#change(() => (this.#shows = value)));
    this.root.append(
      el(
        "div",
        { class: "bar" },
        button("All", () => this.#change(() => this.#all())),
        button("Earlier", () => this.#change(() => this.#window.move(-0.5))),
        button("Later", () => this.#change(() => this.#window.move(0.5))),
        button("Zoom in", () => this.#change(() => this.#window.zoom(0.5))),
        button("Zoom out", () => this.#change(() => this.#window.zoom(2))),
        shown.length > 1 && traces,
        hasReference && el("span", { class: "second" }, "reference"),
      ),
      this.#wrong,
      this.#frame,
      this.#readout,
      this.#shown,
      this.#figures,
      button("Spectrum of the shown span", () => void this.#showSpectrum()),
      this.#spectrum.root,
    );
  }

  /** Once it is on the page, which its width depends on. The result is drawn over its reference. */
  begin(): void {
    this.#chart = new Chart(
      this.#frame,
      [{ colour: "second" }, { colour: "trace" }],
      ([from, to]) => this.#change(() => this.#window.show(1000 * from, 1000 * to)),
      (x, values) => this.#read(x, values.slice(SERIES)),
      this.#span.from_s > CLOCK_S,
    );
    this.#change(() => this.#all());
  }

  end(): void {
    this.#asking?.abort();
    this.#spectrum.end();
    this.#chart?.destroy();
  }

  get #what(): What {
    return this.#shows === "both" ? "result" : (this.#shows as What);
  }

  #all(): void {
    this.#window.show(1000 * this.#span.from_s, 1000 * this.#span.to_s + 1);
  }

  #change(how: () => void): void {
    how();
    void this.#ask();
  }

  #key(event: KeyboardEvent): void {
    const acts: Record<string, () => void> = {
      ArrowLeft: () => this.#window.move(-0.25),
      ArrowRight: () => this.#window.move(0.25),
      "+": () => this.#window.zoom(0.5),
      "-": () => this.#window.zoom(2),
      a: () => this.#all(),
    };
    const act = acts[event.key];
    if (!act) return;
    event.preventDefault();
    this.#change(act);
  }

  async #ask(): Promise<void> {
    if (!this.#chart) return;
    const { width } = this.#chart;
    this.#asking?.abort();
    const { signal } = (this.#asking = new AbortController());
    const { fromMs, toMs } = this.#window;
    const step = (this.#span.to_s - this.#span.from_s) / Math.max(this.#span.rows - 1, 1);
    const of = (what: What) => load(rowsOf(this.#number, what), fromMs, toMs, width, step, signal);
    const nothing: Loaded = { envelope: emptyEnvelope(), areRows: false };
    try {
      const [result, reference] = await Promise.all([
        of(this.#what),
        this.#shows === "both" ? of("reference") : nothing,
      ]);
      say(this.#wrong, "");
      this.#draw(result, [{ envelope: reference.envelope }, { envelope: result.envelope }]);
    } catch (error) {
      if (!signal.aborted) say(this.#wrong, sentenceOf(error));
    }
  }

  #draw(result: Loaded, drawn: Drawn[]): void {
    const [from, to] = [this.#window.fromMs / 1000, this.#window.toMs / 1000];
    this.#chart?.draw([from, to], drawn, this.#marks);
    say(this.#shown, `${this.#instant(from)} to ${this.#instant(to)} (${duration(to - from)}), accelerometer's clock`);
    listStatistics(this.#figures, statistics(result.envelope, result.areRows));
  }

  #instant(seconds: number): string {
    return this.#span.from_s > CLOCK_S ? clock(1000 * seconds) : `${seconds.toFixed(3)} s`;
  }

  #read(x: number | null, values: (number | null)[]): void {
    const [lower, upper, low, high] = values;
    if (x === null) say(this.#readout, " ");
    else if (low == null || high == null) say(this.#readout, `${this.#instant(x)}: no value`);
    else {
      const range = low === high ? signed(low, 3) : `${signed(low, 3)} to ${signed(high, 3)}`;
      const band = lower == null || upper == null ? "" : `, with the band ${signed(lower, 3)} to ${signed(upper, 3)}`;
      say(this.#readout, `${this.#instant(x)}: ${range} mm${band}`);
    }
  }

  async #showSpectrum(): Promise<void> {
    const time = { from_s: this.#window.fromMs / 1000, to_s: this.#window.toMs / 1000 };
    await this.#spectrum.show(ofRecording(this.#number, "spectrum", { ...time, of: this.#what }));
  }
}
