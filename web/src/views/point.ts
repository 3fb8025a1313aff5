// A point: live traces with their band, every zoom, events, statistics, spectrum, export.

import { showAlarms } from "../alarms.ts";
import { type EventBody, get, type LimitBody, ofPoint, span } from "../api.ts";
import { Chart, type Level, type Mark, type Style } from "../charts/chart.ts";
import { joined, load, type Loaded, ofAPoint, rowStep } from "../charts/series.ts";
import { listStatistics } from "../charts/figures.ts";
import { TimeWindow } from "../charts/window.ts";
import { button, choice, el, line, mark, say, table } from "../dom.ts";
import { type Envelope, emptyEnvelope, layers, ofRows, reaches, statistics, within } from "../rows.ts";
import type { SiteState } from "../site_state.ts";
import { clock, duration, signed, withBand, ZONE } from "../words.ts";
import { FrequencyPanel } from "./frequencies.ts";
import { SpanChoice } from "./span_choice.ts";
import { SpectrumPanel } from "./spectrum.ts";
import { OLD_S, showOffer, showWarnings, standing, trouble } from "./site.ts";
import { nothing, repeat, sentenceOf, type View } from "./view.ts";

// A trace that follows is drawn so often, ms; over more than ten minutes nothing moves that fast.
const DRAW_MS = 250;
// What is kept is asked for again while it is followed: soon where rows are missing between it and the live ones, else
// before live rows end, s.
const [SOON_S, AGAIN_S] = [3, 100];
const FORMATS = ["csv", "parquet", "h5", "mat", "xlsx", "mseed", "tdms", "uff"];
const LISTED = 200;
const EVENT_COLUMNS = ["Time", "Event", "What"];

// What is drawn differently, with its words: as `layers` has it.
const LAYERS: (Style & { text: string })[] = [
  { colour: "trace", text: "measured" },
  { colour: "coasting", text: "predicted: no measurement" },
  { colour: "head", dash: [4, 3], text: "preliminary" },
];
const BAND = "± and the shaded band: the displacement is within them with 95 % (1.96 σ).";
// Of each of them: lower, upper, low, high.
const SERIES = 4;

// The point and the time that were shown last, as the address had them: the view's own link comes back to them.
let last: string[] = [];
// Browsers let a page change its address some times a second; a key that is held down would do so more often, ms.
const ADDRESS_MS = 300;

export const showPoint: View = (root, site, given, rest) => {
  const [before, ...time] = last;
  const isThere = before !== undefined && site.point(before) !== undefined;
  const name = given || (isThere ? before : site.points[0]?.name);
  if (!name) return nothing(root, "Point");
  const shown = new PointView(root, site, name, given || !isThere ? rest : time);
  return () => shown.end();
};

class PointView {
  #site: SiteState;
  #name: string;
  #window: TimeWindow;
  #chart: Chart;
  #loaded: Loaded = { envelope: emptyEnvelope(), areRows: false };
  #events: EventBody[] = [];
  #levels: Level[] = [];
  #asking: AbortController | null = null;
  #askedMs = 0;
  #failed = false;
  #ends: (() => void)[] = [];
  #now = el("p", { class: "value" });
  #words = el("p", { class: "words" });
  #why = el("p", { class: "why" });
  #offer = el("p", { class: "offer", hidden: true });
  #warned = el("p", { class: "offer", hidden: true });
  #alarms = el("ul", { class: "alarms" });
  #wrong = el("p", { class: "wrong", role: "status" });
  #spanText = el("p", { class: "quiet" });
  #readout = el("p", { class: "quiet" }, " ");
  #figures = el("dl", { class: "figures" });
  #eventList = el("tbody");
  #spectrum = new SpectrumPanel();
  #frequencies: FrequencyPanel;
  #keys = LAYERS.map(({ colour, text }) => el("span", { class: `key ${colour}` }, text));
  #follow = button("Freeze", () => this.#toggle());
  #shown: SpanChoice;
  #writing = 0;
  // The address of what is shown; one that a link changed since is not ours to write over.
  #address = location.hash;

  constructor(root: HTMLElement, site: SiteState, name: string, time: string[]) {
    [this.#site, this.#name] = [site, name];
    this.#window = new TimeWindow(60, () => this.#newestMs());
    this.#window.open(time);
    this.#remember();
    this.#shown = new SpanChoice(this.#window.seconds, (seconds) =>
      this.#change(() => (this.#window.seconds = seconds)),
    );
    this.#frequencies = new FrequencyPanel(name, () => this.#window.toMs);
    const frame = el("div", {
      class: "chart",
      tabindex: 0,
      role: "img",
      "aria-label": `Displacement of ${name} over time. Keys: left, right move; plus, minus zoom; F follows, freezes.`,
      keydown: (event) => this.#key(event as KeyboardEvent),
    });
    root.replaceChildren(...this.#parts(frame));
    this.#chart = new Chart(
      frame,
      LAYERS,
      ([from, to]) => this.#change(() => this.#window.show(1000 * from, 1000 * to)),
      (x, values) => this.#read(x, values),
    );
    this.#ends.push(
      site.live.listen((message) => {
        if ("type" in message && ["event", "gap"].includes(message.type)) this.#askedMs = 0;
      }),
      repeat(() => this.#tick(), DRAW_MS),
    );
    void this.#askLimits();
  }

  end(): void {
    window.clearTimeout(this.#writing);
    this.#asking?.abort();
    for (const end of this.#ends) end();
    this.#spectrum.end();
    this.#frequencies.end();
    this.#chart.destroy();
  }

  #parts(frame: HTMLElement): HTMLElement[] {
    const names = this.#site.points.map((one): [string, string] => [one.name, one.name]);
    const zoom = (factor: number) => this.#change(() => this.#window.zoom(factor));
    const move = (part: number) => this.#change(() => this.#window.move(part));
    const bar = el(
      "div",
      { class: "bar" },
      choice(
        "Point",
        names.length ? names : [[this.#name, this.#name]],
        this.#name,
        (name) => (location.hash = `#/point/${encodeURIComponent(name)}/${this.#window.path}`),
      ),
      this.#shown.root,
      this.#follow,
      button("Earlier", () => move(-0.5)),
      button("Later", () => move(0.5)),
      button("Zoom in", () => zoom(0.5)),
      button("Zoom out", () => zoom(2)),
    );
    const below = el(
      "div",
      { class: "bar" },
      button("Spectrum of the shown span", () => void this.#spectrum.show(this.#path("spectrum"))),
      this.#exportForm(),
    );
    return [
      el("h1", {}, this.#name),
      this.#now,
      this.#words,
      this.#why,
      this.#offer,
      this.#warned,
      this.#alarms,
      bar,
      this.#wrong,
      frame,
      el("p", { class: "quiet legend" }, ...this.#keys, BAND),
      this.#readout,
      this.#spanText,
      this.#figures,
      below,
      this.#spectrum.root,
      this.#frequencies.root,
      el("h2", {}, "Events in the shown span"),
      table(EVENT_COLUMNS, this.#eventList),
    ];
  }

  #exportForm(): HTMLElement {
    let format = "csv";
    const pick = choice(
      "as",
      FORMATS.map((one): [string, string] => [one, one]),
      format,
      (value) => (format = value),
    );
    const save = button("Save all rows of the shown span", () =>
      el("a", { href: `/api/v1${this.#path("export", { format })}`, download: "" }).click(),
    );
    return el("span", { class: "bar" }, save, pick, el("span", { class: "quiet" }, "times in the file are UTC"));
  }

  /** The address of something of the time that is shown. */
  #path(what: string, query: Record<string, string> = {}): string {
    return ofPoint(this.#name, what, { ...span(this.#window.fromMs, this.#window.toMs), ...query });
  }

  #newestMs(): number {
    const { time } = this.#site.rowsOf(this.#name).rows;
    const point = this.#site.point(this.#name);
    const head = this.#site.headOf(this.#name)?.time ?? [];
    const newest =
      Math.max(time[time.length - 1] ?? 0, head[head.length - 1] ?? 0) / 1e6 ||
      Date.parse(point?.time ?? "") ||
      this.#site.now();
    // Rows that stay away are a gap that is seen to grow; of a store that nothing measures the newest rows are shown.
    const isAway = point?.reason !== "not_measuring" && this.#site.now() - newest > 1000 * OLD_S;
    return isAway ? this.#site.now() : newest;
  }

  #change(how: () => void): void {
    how();
    this.#askedMs = 0;
    this.#tick();
    this.#remember();
  }

  /** Write what is shown into the address, which can be handed on. */
  #remember(): void {
    const { path } = this.#window;
    last = [this.#name, ...path.split("/")];
    window.clearTimeout(this.#writing);
    this.#writing = window.setTimeout(() => {
      if (location.hash !== this.#address) return;
      history.replaceState(null, "", `#/point/${encodeURIComponent(this.#name)}/${path}`);
      this.#address = location.hash;
    }, ADDRESS_MS);
  }

  #toggle(): void {
    this.#change(() => (this.#window.following ? this.#window.freeze() : this.#window.follow()));
  }

  #key(event: KeyboardEvent): void {
    const acts: Record<string, () => void> = {
      ArrowLeft: () => this.#window.move(-0.25),
      ArrowRight: () => this.#window.move(0.25),
      "+": () => this.#window.zoom(0.5),
      "-": () => this.#window.zoom(2),
    };
    const act = acts[event.key];
    if (act) this.#change(act);
    else if (event.key === "f") this.#toggle();
    else return;
    event.preventDefault();
  }

  #tick(): void {
    const { following } = this.#window;
    say(this.#follow, following ? "Freeze" : "Follow");
    this.#shown.show(this.#window.seconds);
    this.#showState();
    const { live } = this.#site;
    const isWhole = live.connected && reaches(this.#loaded.envelope, this.#site.rowsOf(this.#name).rows.time[0]);
    const again = isWhole ? AGAIN_S : SOON_S;
    const late = performance.now() - this.#askedMs > 1000 * again;
    if (document.hidden) return;
    if (this.#askedMs === 0 || ((following || this.#failed) && late)) void this.#ask();
    if (following) this.#draw();
  }

  #showState(): void {
    const point = this.#site.point(this.#name);
    if (!point) return;
    const { state, words } = standing(point, this.#site);
    const sinceMs = this.#site.sinceMs(point);
    const since = sinceMs === null ? "" : ` since ${clock(sinceMs)}`;
    say(this.#now, withBand(point.displacement_mm, point.displacement_std_mm));
    say(this.#words, `${words[0]?.toUpperCase() ?? ""}${words.slice(1)}${since}`);
    mark(this.#words, state);
    say(this.#why, trouble(point, this.#site));
    showOffer(this.#offer, point);
    showWarnings(this.#warned, point);
    showAlarms(this.#alarms, this.#site.alarmsOf(this.#name));
  }

  /** The limits of its displacement; where nothing measures there are none to draw. */
  async #askLimits(): Promise<void> {
    if (this.#site.away) return;
    const all = await get<LimitBody[]>("/alarms/limits").catch((): LimitBody[] => []);
    const own = all.filter((one) => one.point === this.#name && one.on === "displacement");
    this.#levels = own.flatMap(({ name, limit }) => [limit, -limit].map((y) => ({ y, name })));
  }

  async #ask(): Promise<void> {
    this.#askedMs = performance.now();
    this.#asking?.abort();
    const asking = (this.#asking = new AbortController());
    const { fromMs, toMs } = this.#window;
    try {
      const step = await rowStep(this.#name, this.#newestMs(), this.#site.rowsOf(this.#name).rows);
      this.#loaded = await load(ofAPoint(this.#name), fromMs, toMs, this.#chart.width, step, asking.signal);
      this.#failed = false;
      say(this.#wrong, "");
      // The trace is what is waited for.
      this.#draw();
      this.#events = await get<EventBody[]>(ofPoint(this.#name, "events", span(fromMs, toMs)), asking.signal);
      this.#draw();
      this.#listEvents();
    } catch (error) {
      if (asking.signal.aborted) return;
      this.#failed = true;
      say(this.#wrong, sentenceOf(error));
    }
  }

  #draw(): void {
    const [from, to] = [this.#window.fromMs / 1000, this.#window.toMs / 1000];
    const came = ofRows(within(this.#site.rowsOf(this.#name).rows, from, to));
    const all = this.#window.following ? joined(this.#loaded.envelope, came) : this.#loaded.envelope;
    const marks: Mark[] = this.#events.map((one) => ({ x: one.time_ns / 1e9, kind: one.kind }));
    const drawn = layers(all, this.#window.following ? this.#site.headOf(this.#name) : null);
    const envelopes = drawn.map((envelope) => ({ envelope }));
    this.#chart.draw([from, to], envelopes, marks, this.#levels);
    const isIn = ({ x, low }: Envelope) => low.some((one, at) => one !== null && (x[at] ?? 0) >= from);
    drawn.forEach((one, at) => this.#keys[at]?.toggleAttribute("hidden", !isIn(one)));
    say(this.#spanText, `${clock(1000 * from)} to ${clock(1000 * to)} (${duration(to - from)}), ${ZONE}`);
    const limits = this.#levels.filter(({ y }) => y > 0).map(({ y, name }) => [`limit ${name}`, `±${y} mm`] as const);
    listStatistics(this.#figures, statistics(all, this.#loaded.areRows, from), limits);
  }

  #read(x: number | null, values: (number | null)[]): void {
    const layer = LAYERS.findIndex((_, at) => values[SERIES * at + 2] != null);
    const [lower, upper, low, high] = values.slice(SERIES * layer);
    if (x === null) say(this.#readout, " ");
    else if (low == null || high == null) say(this.#readout, `${clock(1000 * x)}: no value`);
    else {
      const range = low === high ? signed(low, 3) : `${signed(low, 3)} to ${signed(high, 3)}`;
      const band = lower == null || upper == null ? "" : `, with the band ${signed(lower, 3)} to ${signed(upper, 3)}`;
      const ms = new Date(1000 * x).getMilliseconds().toString().padStart(3, "0");
      say(
        this.#readout,
        `${clock(1000 * x)}.${ms}: ${range} mm${band}${layer ? `, ${LAYERS[layer]?.text ?? ""}` : ""}`,
      );
    }
  }

  #listEvents(): void {
    const lines = this.#events
      .slice(-LISTED)
      .reverse()
      .map((one) => line(EVENT_COLUMNS, [clock(one.time_ns / 1e6), one.kind, one.text]));
    this.#eventList.replaceChildren(...(lines.length ? lines : [line(EVENT_COLUMNS, ["None.", "", ""])]));
  }
}
