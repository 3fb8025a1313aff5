// Every stream: how it stands, and pauses with a reason.

import { get, post, type SourceState } from "../api.ts";
import { button, el, mark, say, table } from "../dom.ts";
import type { SiteState } from "../site_state.ts";
import { duration, signed, withSigma } from "../words.ts";
import { repeat, sentenceOf, type View } from "./view.ts";

const ASK_MS = 2000;
const COLUMNS = ["Stream", "State", "Age", "Rate", "Delay", "Records", "Rejected", "Time stamps", "Clock ± σ", ""];
/** How a camera's frames are dated. */
const STAMPS: Record<string, string> = { sender: "the camera's clock", arrival: "arrival here" };

/** A stream's state in one sentence. */
function words(source: SourceState): string {
  if (source.reason === "paused") return `paused: ${source.text}`;
  return source.reason ? source.text : "fresh";
}

/** The rate next to the one that the calibration saw, a second. */
export function rateWords(source: SourceState): string {
  if (source.rate_hz === null) return "";
  // Three digits of it, as many as matter.
  const short = (rate: number) => String(Number(rate.toPrecision(rate < 1000 ? 3 : 4)));
  return `${short(source.rate_hz)}${source.nominal_rate_hz ? ` of ${short(source.nominal_rate_hz)}` : ""} /s`;
}

/** What was not used of a stream, and how often it was opened again. */
export function leftOut({ skipped, late, faults, restarts }: SourceState): string {
  const counts: [number | null | undefined, string][] = [
    [skipped, "skipped"],
    [late, "late"],
    [faults, "faulty"],
  ];
  const texts = counts.filter(([count]) => count).map(([count, text]) => `${count} ${text}`);
  if (restarts) texts.push(`reconnected ${restarts === 1 ? "once" : `${restarts} times`}`);
  return texts.join(", ") || "none";
}

/** The offset of a stream's clock from the accelerometer's, and how it drifts. */
export function clockWords(source: SourceState): string {
  const { clock_offset_s: offset, clock_offset_std_s: std, clock_drift_ppm: drift } = source;
  if (offset == null) return "";
  const text = std == null ? `${signed(1000 * offset, 1)} ms` : withSigma(1000 * offset, 1000 * std, "ms");
  return drift == null ? text : `${text}, ${signed(drift, 1)} ppm`;
}

class Row {
  root = el("tr");
  #cells: HTMLElement[];
  #pause: HTMLButtonElement;
  #paused = false;

  constructor(source: SourceState, site: SiteState, done: (text: string) => void) {
    this.#cells = COLUMNS.map((name) => el("td", { "data-name": name }));
    this.#pause = button("Pause", () => void this.#command(source.name, done), {
      "aria-label": `Pause or resume ${source.name}`,
    });
    this.root.append(...this.#cells);
    this.#cells[0]?.append(source.name, el("span", { class: "quiet below" }, source.address));
    if (site.session.scope !== "read") this.#cells[this.#cells.length - 1]?.append(this.#pause);
  }

  show(source: SourceState): void {
    this.#paused = source.reason === "paused";
    mark(this.root, source.reason === "" ? "good" : this.#paused ? "unknown" : "wrong");
    const texts = [
      words(source),
      source.age_s === null ? "no data yet" : duration(source.age_s),
      rateWords(source),
      source.delay_s == null ? "" : `${(1000 * source.delay_s).toFixed(0)} ms`,
      String(source.records),
      leftOut(source),
      STAMPS[source.stamps] ?? source.stamps,
      clockWords(source),
    ];
    texts.forEach((text, at) => say(this.#cells[at + 1] as HTMLElement, text));
    this.#cells[1]?.classList.add("words");
    mark(this.#cells[1] as HTMLElement, this.root.dataset["state"] ?? "");
    say(this.#pause, this.#paused ? "Resume" : "Pause …");
  }

  async #command(name: string, done: (text: string) => void): Promise<void> {
    const path = `/sources/${encodeURIComponent(name)}`;
    try {
      if (this.#paused) return done((await post<{ text: string }>(`${path}/resume`)).text);
      const reason = window.prompt(`Why is ${name} paused? All users see the reason.`, "");
      if (reason?.trim())
        done((await post<{ text: string }>(`${path}/pause`, { reason: reason.trim().slice(0, 200) })).text);
    } catch (error) {
      done(sentenceOf(error));
    }
  }
}

export const showSources: View = (root, site) => {
  const said = el("p", { role: "status" });
  const body = el("tbody");
  const rows = new Map<string, Row>();
  root.replaceChildren(el("h1", {}, "Sources"), said, table(COLUMNS, body));

  async function ask(): Promise<void> {
    let found: SourceState[];
    try {
      found = await get<SourceState[]>("/sources");
    } catch {
      return; // The page's own line says that the server is away.
    }
    for (const source of found) {
      let row = rows.get(source.name);
      if (!row) {
        rows.set(
          source.name,
          (row = new Row(source, site, (text) => {
            say(said, text);
            void ask();
          })),
        );
        body.append(row.root);
      }
      row.show(source);
    }
    for (const [name, row] of rows) {
      if (found.some((one) => one.name === name)) continue;
      row.root.remove();
      rows.delete(name);
    }
    if (!found.length) say(said, "No measuring process is running: there are no streams. Start midspan run.");
  }
  return repeat(() => void ask(), ASK_MS);
};
