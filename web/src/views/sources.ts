// Every stream: how it stands, and pauses with a reason.

import { get, post, type SourceState } from "../api.ts";
import { button, el, mark, say, table } from "../dom.ts";
import type { SiteState } from "../site_state.ts";
import { duration } from "../words.ts";
import { repeat, sentenceOf, type View } from "./view.ts";

const ASK_MS = 2000;
const COLUMNS = ["Stream", "State", "Age", "Rate", "Records", "Skipped", "Faults", "Time stamps", "Address", ""];

/** A stream's state in one sentence. */
function words(source: SourceState): string {
  if (source.reason === "paused") return `paused: ${source.text}`;
  return source.reason ? source.text : "fresh";
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
    if (site.session.scope !== "read") this.#cells[this.#cells.length - 1]?.append(this.#pause);
  }

  show(source: SourceState): void {
    this.#paused = source.reason === "paused";
    mark(this.root, source.reason === "" ? "good" : this.#paused ? "unknown" : "wrong");
    const texts = [
      source.name,
      words(source),
      source.age_s === null ? "nothing yet" : duration(source.age_s),
      source.rate_hz === null ? "" : `${source.rate_hz.toFixed(source.rate_hz < 10 ? 2 : 1)} a second`,
      String(source.records),
      String(source.skipped),
      String(source.faults),
      source.stamps,
      source.address,
    ];
    texts.forEach((text, at) => say(this.#cells[at] as HTMLElement, text));
    this.#cells[1]?.classList.add("words");
    mark(this.#cells[1] as HTMLElement, this.root.dataset["state"] ?? "");
    say(this.#pause, this.#paused ? "Resume" : "Pause …");
  }

  async #command(name: string, done: (text: string) => void): Promise<void> {
    const path = `/sources/${encodeURIComponent(name)}`;
    try {
      if (this.#paused) return done((await post<{ text: string }>(`${path}/resume`)).text);
      const reason = window.prompt(`Why is ${name} paused? Everybody sees the reason.`, "");
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
    if (!found.length) say(said, "No process measures here now: there are no streams. Start midspan run.");
  }
  return repeat(() => void ask(), ASK_MS);
};
