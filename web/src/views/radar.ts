// What a radar sees: the newest range profile, again and again, with the targets of its point.

import { get, type ProfileBody, type SourceState } from "../api.ts";
import { ProfileChart } from "../charts/profile.ts";
import { button, el, line, say, table } from "../dom.ts";
import type { SiteState } from "../site_state.ts";
import { clock, duration } from "../words.ts";
import { repeat, sentenceOf } from "./view.ts";

// The server has a new profile so often, ms.
const PROFILE_MS = 500;
const COLUMNS = ["Target", "Range", "Signal-to-noise ratio"];

/** Fills an element; returns how it ends. chooser: of the source that is shown. */
export function showRadar(root: HTMLElement, site: SiteState, source: SourceState, chooser: HTMLElement): () => void {
  const [said, taken, targets] = [el("p", { role: "status" }), el("p", { class: "quiet" }, " "), el("tbody")];
  const frame = el("div", {
    class: "chart",
    role: "img",
    "aria-label": `Range profile of ${source.name}: power over range`,
  });
  let [chart, isFrozen, isAsking] = [null as ProfileChart | null, false, false];
  const freeze = button("Freeze", () => {
    isFrozen = !isFrozen;
    say(freeze, isFrozen ? "Follow" : "Freeze");
  });

  async function ask(): Promise<void> {
    if (isFrozen || isAsking || document.hidden) return;
    const trouble = site.troubleOf(source);
    if (trouble) return say(said, trouble);
    isAsking = true;
    try {
      const found = await get<ProfileBody>(`/sources/${encodeURIComponent(source.name)}/profile`);
      chart ??= new ProfileChart(frame, found.range_m !== null);
      chart.draw(found);
      const ms = found.time_ns / 1e6;
      say(taken, `${clock(ms)}, ${duration(Math.max(site.now() - ms, 0) / 1000)} old`);
      const texts = found.targets.map((one, at) => [
        String(at + 1),
        one.range_m === null ? `bin ${one.bin.toFixed(1)}` : `${one.range_m.toFixed(2)} m`,
        `${one.snr_db.toFixed(0)} dB`,
      ]);
      const none = ["None: the point is not open yet.", "", ""];
      targets.replaceChildren(...(texts.length ? texts : [none]).map((one) => line(COLUMNS, one)));
      say(said, "");
    } catch (error) {
      say(said, sentenceOf(error));
    } finally {
      isAsking = false;
    }
  }

  root.replaceChildren(
    el("h1", {}, "Radar"),
    el("div", { class: "bar" }, chooser, freeze),
    said,
    frame,
    taken,
    table(COLUMNS, targets),
  );
  const end = repeat(() => void ask(), PROFILE_MS);
  return () => {
    end();
    chart?.end();
  };
}
