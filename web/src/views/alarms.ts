// Alarms: those that are open, silenced and past; acknowledge, silence, test; where they go and what became of them.

import { type AlarmBody, type AuditBody, get, post, remove, type SilenceBody, type TargetBody } from "../api.ts";
import { measured, openWords, QUANTITY, stateWords, urgency } from "../alarms.ts";
import { button, disable, el, line, mark, say, table } from "../dom.ts";
import type { SiteState } from "../site_state.ts";
import { clock } from "../words.ts";
import { askSilence } from "./silence.ts";
import { repeat, sentenceOf, type View } from "./view.ts";

// Values of open alarms, and how delivery stands, are asked for so often, ms; lists, which change with an alarm alone,
// once that many times.
const ASK_MS = 3000;
const LISTS_EVERY = 10;
const LISTED = 200;
const OPEN_COLUMNS = ["Point", "Alarm", "State", "Of", "Value", "Largest", "Limit", "Since", "Silence", ""];
const SILENCE_COLUMNS = ["Point", "Alarm", "Silent until", "By", "Reason", ""];
const PAST_COLUMNS = ["Point", "Alarm", "Level", "Largest", "Limit", "Since", "Ended"];
const TARGET_COLUMNS = ["Target", "State", "Waiting", "Delivered", "Newest"];
const AUDIT_COLUMNS = ["Time", "What", "By", "Text"];

const when = (iso: string) => clock(Date.parse(iso));

class OpenRow {
  root = el("tr");
  #cells = OPEN_COLUMNS.map((name) => el("td", { "data-name": name }));
  #acknowledge: HTMLButtonElement;
  #silence: HTMLButtonElement;
  #alarm: AlarmBody;

  constructor(alarm: AlarmBody, may: boolean, act: (alarm: AlarmBody, what: string) => void) {
    this.#alarm = alarm;
    const of = `${alarm.point}: ${alarm.name}`;
    this.#acknowledge = button("Acknowledge", () => act(this.#alarm, "acknowledge"), {
      "aria-label": `Acknowledge ${of}`,
    });
    this.#silence = button("Silence …", () => act(this.#alarm, this.#alarm.silence ? "unsilence" : "silence"), {
      "aria-label": `Silence ${of}, or end its silence`,
    });
    this.root.append(...this.#cells);
    const last = this.#cells[OPEN_COLUMNS.length - 1];
    if (may) last?.append(el("span", { class: "bar" }, this.#acknowledge, this.#silence));
  }

  /** What of it may have the focus. */
  get buttons(): HTMLElement[] {
    return [this.#acknowledge, this.#silence];
  }

  show(alarm: AlarmBody): void {
    this.#alarm = alarm;
    const { silence } = alarm;
    const texts = [
      alarm.point,
      alarm.name,
      stateWords(alarm),
      QUANTITY[alarm.on] ?? alarm.on,
      measured(alarm.value, alarm.value_std, alarm.unit),
      measured(alarm.peak, 0, alarm.unit),
      `${alarm.limit} ${alarm.unit}`,
      when(alarm.since),
      silence ? `until ${when(silence.until)} (${silence.owner}): ${silence.reason}` : "",
    ];
    texts.forEach((text, at) => say(this.#cells[at] as HTMLElement, text));
    this.#cells[2]?.classList.add("words");
    mark(this.#cells[2] as HTMLElement, urgency(alarm));
    this.#acknowledge.hidden = alarm.state !== "firing";
    say(this.#silence, silence ? "End the silence" : "Silence …");
  }
}

export const showAlarmsView: View = (root, site) => {
  const view = new AlarmsView(root, site);
  return () => view.end();
};

class AlarmsView {
  #site: SiteState;
  #rows = new Map<string, OpenRow>();
  #said = el("p", { role: "status" });
  #summary = el("p", { class: "summary", role: "status", tabindex: -1 });
  #open = el("tbody");
  #silenced = el("tbody");
  #silences = el("tbody");
  #past = el("tbody");
  #targets = el("tbody");
  #audit = el("tbody");
  #undelivered = el("p", { class: "wrong" });
  #test = button("Send a test message", () => void this.#command("/alarms/test"));
  #silencedPart: HTMLElement;
  #silencesPart: HTMLElement;
  #ends: (() => void)[] = [];
  #soon = 0;
  #count = 0;

  constructor(root: HTMLElement, site: SiteState) {
    this.#site = site;
    this.#silencedPart = el("section", {}, el("h2", {}, "Silenced"), table(OPEN_COLUMNS, this.#silenced));
    this.#silencesPart = el(
      "section",
      { hidden: true },
      el("h2", {}, "Silences without an open alarm"),
      table(SILENCE_COLUMNS, this.#silences),
    );
    root.replaceChildren(
      el("h1", {}, "Alarms"),
      this.#summary,
      this.#said,
      el("section", { class: "not-silenced" }, el("h2", {}, "Open"), table(OPEN_COLUMNS, this.#open)),
      this.#silencedPart,
      this.#silencesPart,
      el("section", {}, el("h2", {}, "Past 30 days"), table(PAST_COLUMNS, this.#past)),
      el(
        "section",
        {},
        el("h2", {}, "Where alarms go"),
        this.#undelivered,
        table(TARGET_COLUMNS, this.#targets),
        this.#may && this.#test,
      ),
      el("section", {}, el("h2", {}, "History"), table(AUDIT_COLUMNS, this.#audit)),
    );
    this.#ends.push(
      site.live.listen((message) => {
        if (!("type" in message) || message.type !== "alarm") return;
        this.#show();
        // The list of what was done is written together with the change, a moment later than it comes here.
        window.clearTimeout(this.#soon);
        this.#soon = window.setTimeout(() => void this.#askLists(), 500);
      }),
      repeat(() => void this.#ask(), ASK_MS),
      () => window.clearTimeout(this.#soon),
    );
  }

  end(): void {
    for (const end of this.#ends) end();
  }

  /** What commands may not be given, as nothing measures, is disabled. */
  #disable(): void {
    const shown = [this.#open, this.#silenced, this.#silences].flatMap((one) => [...one.querySelectorAll("button")]);
    disable([this.#test, ...shown], this.#site.away);
  }

  get #may(): boolean {
    return this.#site.session.scope !== "read";
  }

  async #ask(): Promise<void> {
    if (this.#count++ % LISTS_EVERY === 0) void this.#askLists();
    try {
      await this.#site.askAlarms();
      if (this.#site.away) fill(this.#targets, TARGET_COLUMNS, [], `Not known. ${this.#site.away}`);
      else this.#showTargets(await get<TargetBody[]>("/alarms/targets"));
    } catch (error) {
      say(this.#undelivered, sentenceOf(error));
    }
    this.#show();
  }

  async #askLists(): Promise<void> {
    // Where nothing answers that, none is shown.
    this.#showSilences(await get<SilenceBody[]>("/alarms/silences").catch((): SilenceBody[] => []));
    try {
      const asked = [get<AlarmBody[]>("/alarms?state=ended"), get<AuditBody[]>("/alarms/audit")] as const;
      const [past, audit] = await Promise.all(asked);
      fill(this.#past, PAST_COLUMNS, past.slice(0, LISTED).map(pastTexts));
      fill(this.#audit, AUDIT_COLUMNS, audit.slice(0, LISTED).map(auditTexts));
    } catch (error) {
      say(this.#said, sentenceOf(error));
    }
  }

  /** Rows stay where they are as long as they can, so that a key or a finger meets what it was meant for. */
  #show(): void {
    const { alarms } = this.#site;
    const fires = alarms.filter((one) => one.state === "firing" && !one.silence).length;
    mark(this.#summary, fires ? "wrong" : alarms.length ? "notice" : "good");
    say(this.#summary, openWords(alarms));
    const keepFocus = this.#focus();
    for (const [id, row] of this.#rows) {
      if (alarms.some((one) => one.id === id)) continue;
      row.root.remove();
      this.#rows.delete(id);
    }
    for (const alarm of alarms) {
      let row = this.#rows.get(alarm.id);
      if (!row) this.#rows.set(alarm.id, (row = new OpenRow(alarm, this.#may, (of, what) => this.#act(of, what))));
      row.show(alarm);
      const into = alarm.silence ? this.#silenced : this.#open;
      if (row.root.parentElement !== into) into.append(row.root);
    }
    this.#silencedPart.hidden = !this.#silenced.children.length;
    this.#disable();
    keepFocus();
  }

  /** A function that gives the focus back after rows were moved and removed: to the button that had it, else to another
   * one of its row, of the row that is in its place now, or to the summary. */
  #focus(): () => void {
    const focused = document.activeElement as HTMLElement | null;
    const row = [...this.#rows.values()].find((one) => one.root.contains(focused));
    const table = row?.root.parentElement;
    if (!row || !focused || !table) return () => undefined;
    const place = [...table.children].indexOf(row.root);
    return () => {
      const next = [...this.#rows.values()].find((one) => one.root === table.children[place]);
      const all = [focused, ...row.buttons, ...(next?.buttons ?? []), this.#summary];
      const target = all.find((one) => one.isConnected && one.offsetParent !== null);
      if (target !== document.activeElement) target?.focus();
    };
  }

  /** Silences of rules whose alarm is not open: those of open ones stand with these. */
  #showSilences(all: SilenceBody[]): void {
    const isShown = (one: SilenceBody) =>
      this.#site.alarms.some(({ point, name, silence }) => point === one.point && name === one.name && silence);
    const rest = all.filter((one) => !isShown(one));
    this.#silencesPart.hidden = !rest.length;
    const lines = rest.map(({ point, name, until, owner, reason }) => [point, name, when(until), owner, reason, ""]);
    if (!fill(this.#silences, SILENCE_COLUMNS, lines) || !this.#may) return;
    rest.forEach((one, at) => {
      const end = button("End the silence", () => void this.#endSilence(one), {
        "aria-label": `End the silence of ${one.point}: ${one.name}`,
      });
      this.#silences.children[at]?.lastElementChild?.append(end);
    });
  }

  async #endSilence(of: SilenceBody): Promise<void> {
    try {
      say(this.#said, await remove(`/alarms/silences/${encodeURIComponent(of.id)}`));
    } catch (error) {
      say(this.#said, sentenceOf(error));
    }
    await this.#askLists();
    (this.#silences.querySelector("button") ?? this.#summary).focus();
  }

  #act(alarm: AlarmBody, what: string): void {
    const path = `/alarms/${encodeURIComponent(alarm.id)}/${what}`;
    if (what !== "silence") return void this.#command(path);
    askSilence(alarm, this.#site.now(), (until, reason) => this.#command(path, { until, reason }));
  }

  async #command(path: string, body?: unknown): Promise<void> {
    try {
      say(this.#said, (await post<{ text: string }>(path, body)).text);
    } catch (error) {
      say(this.#said, sentenceOf(error));
    }
    await this.#ask();
    await this.#askLists();
  }

  #showTargets(targets: TargetBody[]): void {
    say(this.#undelivered, "");
    const lines = targets.map((one) => [
      one.target,
      one.fault ? `not delivered: ${one.fault}` : "working",
      String(one.waiting),
      String(one.sent),
      one.sent_s === null ? "none yet" : clock(1000 * one.sent_s),
    ]);
    fill(this.#targets, TARGET_COLUMNS, lines, "Nobody: SITE.toml has no [[notify]] and no [mqtt].");
    targets.forEach((one, at) => {
      const cell = this.#targets.children[at]?.children[1] as HTMLElement;
      cell.classList.add("words");
      mark(cell, one.fault ? "wrong" : "good");
    });
  }
}

function pastTexts(alarm: AlarmBody): string[] {
  const { point, name, level, peak, limit, unit } = alarm;
  return [point, name, level, measured(peak, 0, unit), `${limit} ${unit}`, when(alarm.since), when(alarm.time)];
}

function auditTexts(one: AuditBody): string[] {
  return [when(one.time), one.what, one.who || "midspan", one.text];
}

/** Fill a table where its texts have changed; whether they have. */
function fill(into: HTMLElement, columns: string[], lines: string[][], none = "None."): boolean {
  const now = JSON.stringify(lines.length ? lines : none);
  if (into.dataset["shown"] === now) return false;
  into.dataset["shown"] = now;
  const shown = lines.length ? lines : [[none, ...columns.slice(1).map(() => "")]];
  into.replaceChildren(...shown.map((texts) => line(columns, texts)));
  return true;
}
