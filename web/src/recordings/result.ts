// Calibrate, estimate, and what came out of it: traces, warnings, comparison, report, files.

import { get, post } from "../api.ts";
import type { Mark } from "../charts/chart.ts";
import { button, choice, el, line, mark, say, table } from "../dom.ts";
import { clock, signed, withSigma } from "../words.ts";
import { quantities } from "../quantities.ts";
import { sentenceOf } from "../views/view.ts";
import { type Desk, type Job, ofRecording, type Recording } from "./desk.ts";
import { type Span, Trace } from "./trace.ts";

const ASK_MS = 500;
const FORMATS = ["csv", "parquet", "h5", "mat", "xlsx", "mseed", "tdms", "uff"];
const EVENT_COLUMNS = ["Time, s", "Event", "What"];
const FIGURE_COLUMNS = ["Quantity", "Value"];

interface Notice {
  code: string;
  severity: string;
  text: string;
}
interface ResultBody extends Span {
  /** Not in results of earlier versions. */
  verdict: string | null;
  method: string;
  /** Of a result along two axes, by their names. */
  axes: Record<string, { column: string }> | null;
  not_in_band: string[] | null;
  notices: Notice[] | null;
  events: { time_s: number; kind: string; text: string }[];
  calibration: Record<string, unknown>;
}
interface Against {
  rmse_mm: number;
  coverage_95: number | null;
}
interface Comparison extends Against {
  bias_mm: number;
  largest_error_mm: number;
  largest_error_at_s: number;
  correlation: number | null;
  lag_s: number | null;
  without_zero: Against | null;
  without_zero_and_lag: Against | null;
  notes: string[];
}

export function showResult(root: HTMLElement, recording: Recording, desk: Desk): () => void {
  const view = new ResultView(root, recording, desk);
  return () => view.end();
}

class ResultView {
  #recording: Recording;
  #desk: Desk;
  #trace: Trace | null = null;
  #before = "";
  #ended = false;
  #wanted = { calibration: "", method: "", tracker: "" };
  #said = el("p", { role: "status", class: "words" });
  #bar = el("progress", { "aria-label": "Progress" });
  #step = el("p", { class: "quiet" });
  #calibrationPart = el("div");
  #result = el("div");
  #buttons: HTMLButtonElement[];
  #choicesPart = el("span", { class: "bar" });
  #timer = 0;
  #cancel = button("Cancel", () => void this.#command("cancel"));

  constructor(root: HTMLElement, recording: Recording, desk: Desk) {
    [this.#recording, this.#desk] = [recording, desk];
    this.#bar.hidden = this.#cancel.hidden = true;
    this.#buttons = [
      button("Calibrate", () => void this.#command("calibrate")),
      button("Estimate", () => void this.#estimate(), { class: "main" }),
    ];
    if (recording.fault) this.#buttons.forEach((one) => (one.disabled = true));
    root.append(
      el("div", { class: "bar" }, this.#choicesPart, ...this.#buttons, this.#cancel),
      this.#bar,
      this.#step,
      this.#said,
      this.#result,
      this.#calibrationPart,
    );
    void this.#look();
    void this.#showFiles();
  }

  end(): void {
    this.#ended = true;
    window.clearTimeout(this.#timer);
    this.#trace?.end();
  }

  #choices({ calibration_s: calibratedS, cameras, method }: Recording): HTMLElement[] {
    const as = (text: string, names: string[]): [string, string][] => [
      ["", text],
      ...names.map((one): [string, string] => [one, one]),
    ];
    const calibrations: [string, string][] = [["", "new calibration"]];
    if (calibratedS !== null) calibrations.push(["kept", `calibration.json of ${clock(1000 * calibratedS)}`]);
    const wanted = this.#wanted;
    const made = [
      choice("Calibration", calibrations, wanted.calibration, (value) => (wanted.calibration = value)),
      choice("Method", as(method || "usual", this.#desk.methods), wanted.method, (value) => (wanted.method = value)),
    ];
    const trackers = as("of recording.toml", this.#desk.trackers);
    if (cameras.length) made.push(choice("Tracker", trackers, wanted.tracker, (value) => (wanted.tracker = value)));
    return made;
  }

  #estimate(): Promise<void> {
    const { calibration, method, tracker } = this.#wanted;
    return this.#command("estimate", {
      calibration: calibration !== "",
      ...(method ? { method } : {}),
      ...(tracker ? { tracker } : {}),
    });
  }

  async #command(what: string, body?: unknown): Promise<void> {
    try {
      say(this.#said, "");
      const found = await post<{ text?: string }>(ofRecording(this.#recording.number, what), body);
      if (found.text) say(this.#said, found.text);
    } catch (error) {
      say(this.#said, sentenceOf(error));
    }
    await this.#look();
  }

  /** How the calculation stands; once it has ended, what it made is shown. */
  async #look(): Promise<void> {
    window.clearTimeout(this.#timer);
    let job: Job;
    try {
      job = await get<Job>(ofRecording(this.#recording.number, "job"));
      this.#desk.trouble = "";
    } catch (error) {
      this.#desk.trouble = sentenceOf(error);
      this.#lookAgain();
      return;
    }
    if (!job.what) return;
    const runs = job.state === "running";
    if (runs) this.#lookAgain();
    this.#bar.hidden = this.#cancel.hidden = !runs;
    this.#buttons.forEach((one) => (one.disabled = runs || this.#recording.fault !== ""));
    if (job.total) [this.#bar.max, this.#bar.value] = [job.total, job.done];
    else this.#bar.removeAttribute("value");
    const begun = job.step || "begins";
    say(this.#step, runs ? `${begun}, ${job.seconds.toFixed(0)} s. ${job.command}` : "");
    if (job.state === this.#before) return;
    const first = this.#before === "";
    this.#before = job.state;
    if (job.state === "failed") say(this.#said, job.text);
    mark(this.#said, job.state === "failed" ? "wrong" : "");
    if (first || job.state !== "done") return;
    say(this.#said, `Done in ${job.seconds.toFixed(0)} s. ${job.command}`);
    // Who calibrates and then estimates means to use it.
    if (job.what === "calibrate") this.#wanted.calibration = "kept";
    await this.#desk.ask();
    await this.#showFiles();
  }

  #lookAgain(): void {
    if (!this.#ended) this.#timer = window.setTimeout(() => void this.#look(), ASK_MS);
  }

  /** What lies in the recording's folder: its result and its calibration. */
  async #showFiles(): Promise<void> {
    const recording = this.#desk.of(String(this.#recording.number)) ?? this.#recording;
    this.#choicesPart.replaceChildren(...this.#choices(recording));
    if (recording.result_s !== null) await this.#showResult(recording);
    if (recording.calibration_s === null || this.#ended) return;
    try {
      const kept = await get<Record<string, unknown>>(ofRecording(recording.number, "calibration"));
      this.#calibrationPart.replaceChildren(
        el("h2", {}, `calibration.json of ${clock(1000 * recording.calibration_s)}`),
        calibrationTable(kept),
      );
    } catch (error) {
      this.#calibrationPart.replaceChildren(el("p", { class: "wrong" }, sentenceOf(error)));
    }
  }

  async #showResult(recording: Recording): Promise<void> {
    const { number } = recording;
    try {
      const found = await get<ResultBody>(ofRecording(number, "result"));
      if (this.#ended) return;
      this.#trace?.end();
      const marks: Mark[] = found.events.map((one) => ({ x: one.time_s, kind: one.kind }));
      const across = Object.entries(found.axes ?? {}).find(([, one]) => one.column !== "displacement_mm")?.[0] ?? "";
      this.#trace = new Trace(number, found, recording.has_reference, across, marks);
      const compared = el("div");
      this.#result.replaceChildren(
        ...this.#headOf(recording, found),
        ...warningsOf(found),
        this.#trace.root,
        ...this.#files(recording),
        compared,
        ...wordsOf(found),
      );
      this.#trace.begin();
      if (recording.has_reference) void showComparison(compared, number);
    } catch (error) {
      this.#result.replaceChildren(el("p", { class: "wrong" }, sentenceOf(error)));
    }
  }

  #headOf(recording: Recording, found: ResultBody): HTMLElement[] {
    const old = (recording.changed_s ?? 0) > (recording.result_s ?? 0);
    const made = `Method ${found.method}, ${found.rows} rows, written ${clock(1000 * (recording.result_s ?? 0))}`;
    return [
      el("h2", {}, "Displacement"),
      el("p", { class: "words" }, found.verdict ?? ""),
      el("p", { class: "quiet" }, `${made}: result.csv in its folder.`),
      el("p", { class: "wrong" }, old ? "recording.toml has changed since: estimate again." : ""),
    ];
  }

  #files(recording: Recording): HTMLElement[] {
    let format = "csv";
    const formats = FORMATS.map((one): [string, string] => [one, one]);
    const save = async (wanted: string) => {
      try {
        say(this.#said, "Writing the file.");
        const { path } = await post<{ path: string }>(ofRecording(recording.number, "files"), { format: wanted });
        say(this.#said, "");
        // A report opens in a tab of its own; a file is saved.
        el(
          "a",
          wanted === "report" ? { href: path, target: "_blank", rel: "noopener" } : { href: path, download: "" },
        ).click();
      } catch (error) {
        say(this.#said, sentenceOf(error));
      }
    };
    return [
      el(
        "div",
        { class: "bar" },
        recording.report_s !== null && button("Open the report", () => void save("report")),
        button("Save all rows", () => void save(format)),
        choice("as", formats, format, (value) => (format = value)),
      ),
    ];
  }
}

function calibrationTable(calibration: Record<string, unknown>): HTMLElement {
  const rows = el("tbody");
  for (const [name, { value, std, unit }] of quantities(calibration))
    rows.append(line(FIGURE_COLUMNS, [name, withSigma(value, std ?? 0, unit)]));
  const warnings = Array.isArray(calibration["warnings"]) ? calibration["warnings"].map(String) : [];
  return el("div", {}, table(FIGURE_COLUMNS, rows), ...warnings.map((text) => el("p", { class: "wrong" }, text)));
}

const list = (texts: string[]) => el("ul", {}, ...texts.map((text) => el("li", {}, text)));

const SEVERITIES = ["serious", "warning", "note"];
const WARNINGS_SHOWN = 3;

/** What a result warns of, above it: the worst three, the others under a heading that opens. */
function warningsOf(found: ResultBody): HTMLElement[] {
  const rank = ({ severity }: Notice) => SEVERITIES.indexOf(severity);
  const worst = [...(found.notices ?? [])].sort((a, b) => rank(a) - rank(b));
  const texts = worst.map((one) => `${one.severity}: ${one.text} [${one.code}]`);
  const others = texts.slice(WARNINGS_SHOWN);
  if (!texts.length) return [];
  const more = el("details", {}, el("summary", {}, `${others.length} more`), list(others));
  return [el("h2", {}, "Warnings"), list(texts.slice(0, WARNINGS_SHOWN)), ...(others.length ? [more] : [])];
}

/** What is not in the band, events and the calibration of a result. */
function wordsOf(found: ResultBody): HTMLElement[] {
  const outside = found.not_in_band ?? [];
  const events = el("tbody");
  for (const one of found.events) events.append(line(EVENT_COLUMNS, [one.time_s.toFixed(3), one.kind, one.text]));
  return [
    el("h2", {}, "Errors outside the band"),
    outside.length ? list(outside) : el("p", {}, "Nothing."),
    el("h2", {}, "Calibration of this result"),
    calibrationTable(found.calibration),
    ...(found.events.length ? [el("h2", {}, "Events"), table(EVENT_COLUMNS, events)] : []),
  ];
}

async function showComparison(into: HTMLElement, number: number): Promise<void> {
  const rows = el("tbody");
  try {
    const found = await get<Comparison>(ofRecording(number, "comparison"));
    const add = (name: string, text: string) => rows.append(line(FIGURE_COLUMNS, [name, text]));
    const error = (of: Against) =>
      `${of.rmse_mm.toPrecision(4)} mm${of.coverage_95 === null ? "" : `, ${(100 * of.coverage_95).toFixed(1)} % inside ±1.96 σ`}`;
    add("RMSE", error(found));
    if (found.without_zero) add("RMSE, zero removed", error(found.without_zero));
    if (found.without_zero_and_lag) add("RMSE, zero and lag removed", error(found.without_zero_and_lag));
    add("bias", `${signed(found.bias_mm, 4)} mm`);
    add("largest error", `${signed(found.largest_error_mm, 4)} mm at ${found.largest_error_at_s.toFixed(3)} s`);
    if (found.correlation !== null) add("correlation", found.correlation.toFixed(6));
    if (found.lag_s !== null) add("lag", `${signed(1000 * found.lag_s, 2)} ms`);
    const notes = found.notes.map((text) => el("p", { class: "quiet" }, text));
    into.replaceChildren(el("h2", {}, "Against the reference"), table(FIGURE_COLUMNS, rows), ...notes);
  } catch (error) {
    into.replaceChildren(el("h2", {}, "Against the reference"), el("p", { class: "wrong" }, sentenceOf(error)));
  }
}
