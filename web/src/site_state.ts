// How the site stands, for every view: asked for every few seconds, and from each live row in between.

import type { AlarmBody, Health, PointState, Session } from "./api.ts";
import { Away, get, Refused } from "./api.ts";
import { type HeadMessage, Live, type Message, type StateMessage } from "./live.ts";
import { type Head, Newest } from "./rows.ts";

// Changes come on their own; whether anything has to be asked for is looked at so often, ms: where nothing comes, or a
// point prepares something whose end is counted down, it is asked for then.
const LOOK_MS = 3000;
// The clock of the server, and what a change may have missed, is asked for this often, ms.
const ASK_MS = 30_000;
// Alarms come on their own as they change; what a cut hid is asked for this often, ms.
const ALARMS_MS = 30_000;
// Of a group of points this many are shown, first those with a reason.
export const SHOWN = 24;
// What is kept of live rows for traces, s.
export const KEPT_S = 130;

export class SiteState {
  live = new Live();
  points: PointState[] = [];
  health: Health | null = null;
  /** The alarms that are open, newest change first. */
  alarms: AlarmBody[] = [];
  newest = new Map<string, Newest>();
  /** Of each point the rows that are not final yet. */
  heads = new Map<string, Head>();
  session: Session;
  /** When the server answered last, ms of performance.now(); what it last failed with. */
  answered = performance.now();
  trouble = "";
  /** The server's clock less this machine's, ms. */
  clockMs = 0;
  #timer = 0;
  #alarmsMs = -Infinity;
  #askedMs = -Infinity;
  // When stages were reported last.
  #stagesMs = 0;
  #changes = 0;
  #states = 0;
  #stopped = false;

  constructor(session: Session) {
    this.session = session;
    this.live.listen((message) => this.#came(message));
    this.live.opened = () => (this.#askedMs = -Infinity);
  }

  /** Another point of a group may be looked at. */
  #turned = () => {
    const [, , name] = window.location.hash.split("/");
    if (name && !this.point(decodeURIComponent(name))) this.#askedMs = -Infinity;
  };

  /** Whether what is shown is of now. */
  get fresh(): boolean {
    return this.live.connected && !this.trouble;
  }

  /** Begin; done once the first answer came, or failed. */
  async start(): Promise<void> {
    this.live.open();
    window.addEventListener("hashchange", this.#turned);
    await this.#ask();
    this.#look();
  }

  stop(): void {
    this.#stopped = true;
    window.removeEventListener("hashchange", this.#turned);
    window.clearTimeout(this.#timer);
    this.live.close();
  }

  /** Why nothing can be commanded, as where no process measures; empty where one does. */
  get away(): string {
    if (!this.health) return "Waiting for the server.";
    return this.health?.sources.find((one) => one.reason === "not_measuring")?.text ?? "";
  }

  /** What is wrong with a source, that it brings nothing to look at; empty where nothing is, or it is paused. */
  troubleOf({ point, source }: { point: string; source: string }): string {
    const found = this.health?.sources.find((one) => one.point === point && one.source === source);
    return found?.reason && found.reason !== "paused" ? found.text : "";
  }

  point(name: string): PointState | undefined {
    return this.points.find((one) => one.name === name);
  }

  /** The open alarms of a point, those that fire first. */
  alarmsOf(name: string): AlarmBody[] {
    return this.alarms.filter((one) => one.point === name);
  }

  /** Ask for the open alarms; a change that comes meanwhile is newer than the answer. */
  async askAlarms(): Promise<void> {
    const before = this.#changes;
    const found = await get<AlarmBody[]>("/alarms?state=open");
    if (this.#changes === before) [this.alarms, this.#alarmsMs] = [inOrder(found), performance.now()];
  }

  /** The server's time, ms since 1970. */
  now(): number {
    return Date.now() + this.clockMs;
  }

  /** How old a point's newest row is, s. */
  ageS(point: PointState): number | null {
    return point.time === null ? null : Math.max(this.now() - Date.parse(point.time), 0) / 1000;
  }

  /** When the connection was lost, or how a point stands became so, ms since 1970; null where that is not known. */
  sinceMs(point: PointState): number | null {
    if (!this.fresh) return this.now() - (performance.now() - Math.max(this.answered, this.live.heard));
    return point.since ? Date.parse(point.since) : null;
  }

  /** How long what a point prepares still takes, s; null where that is not known. */
  leftS(point: PointState): number | null {
    if (point.stage_left_s == null) return null;
    return Math.max(point.stage_left_s - (performance.now() - this.#stagesMs) / 1000, 0);
  }

  rowsOf(name: string): Newest {
    let found = this.newest.get(name);
    if (!found) this.newest.set(name, (found = new Newest(KEPT_S)));
    return found;
  }

  /** The rows of a point that are not final yet; null without any, or without a connection. */
  headOf(name: string): Head | null {
    return this.fresh ? (this.heads.get(name) ?? null) : null;
  }

  /** Ask where that is due, again and again. */
  #look(): void {
    if (this.#stopped) return;
    this.live.check();
    const now = performance.now();
    const isSilent = now - Math.max(this.live.heard, this.#askedMs) > LOOK_MS - 100;
    const isPrepared = this.points.some((one) => one.stage);
    if (this.trouble || isSilent || isPrepared || now - this.#askedMs > ASK_MS) void this.#ask();
    this.#timer = window.setTimeout(() => this.#look(), LOOK_MS);
  }

  async #ask(): Promise<void> {
    this.#askedMs = performance.now();
    const before = this.#states;
    try {
      const [points, health] = await Promise.all([get<PointState[]>(this.#list()), get<Health>("/health")]);
      const dated = points.find((one) => one.time !== null && one.age_s !== null);
      if (dated) this.clockMs = Date.parse(dated.time ?? "") + 1000 * (dated.age_s ?? 0) - Date.now();
      [this.trouble, this.answered] = ["", performance.now()];
      // A change that came meanwhile is newer than the answer.
      if (this.#states === before) [this.points, this.health, this.#stagesMs] = [points, health, performance.now()];
      else this.#askedMs = -Infinity;
      // Views do not wait for them.
      if (performance.now() - this.#alarmsMs > ALARMS_MS)
        this.askAlarms().catch((error: unknown) => this.#failed(error));
    } catch (error) {
      this.#failed(error);
    }
  }

  /** Where the points are listed: of groups the first ones, and the one that is looked at. */
  #list(): string {
    const [, , name] = window.location.hash.split("/");
    return `/points?of_groups=${SHOWN}${name ? `&also=${name}` : ""}`;
  }

  #failed(error: unknown): void {
    if (error instanceof Refused && error.status === 401) return;
    // Changes of alarms may have come meanwhile.
    this.#alarmsMs = -Infinity;
    this.trouble = error instanceof Away || error instanceof Refused ? error.message : String(error);
  }

  #came(message: Message): void {
    // What is missing is in the store alone: rows on both sides of it would look like a gap.
    if ("type" in message && message.type === "gap") this.newest.clear();
    if ("type" in message && message.type === "alarm") this.#changed(message);
    if ("type" in message && message.type === "state") this.#stands(message);
    if ("type" in message && message.type === "head") this.#ahead(message);
    if (!("sequence" in message)) return;
    this.rowsOf(message.point).add(message);
    const point = this.point(message.point);
    const last = message.time.length - 1;
    if (point && last >= 0) {
      point.time = new Date((message.time[last] ?? 0) / 1e6).toISOString();
      point.displacement_mm = message.displacement_mm[last] ?? null;
      point.displacement_std_mm = message.displacement_std_mm[last] ?? null;
    }
  }

  #stands({ points, again, ...standing }: StateMessage): void {
    this.#states += 1;
    this.health = { points: [], ...standing };
    for (const stands of points) {
      const point = this.point(stands.name);
      // Of a point that nothing measures the newest row says how it stood.
      if (point) Object.assign(point, stands, stands.status === null ? { status: point.status } : {});
    }
    if (points.length) this.#stagesMs = performance.now();
    if (again) void this.#ask();
  }

  /** Provisional rows: they follow those that are there, until final rows take their place. */
  #ahead({ point, ...came }: HeadMessage): void {
    const { time } = this.rowsOf(point).rows;
    const finalNs = time[time.length - 1] ?? 0;
    const before = this.heads.get(point);
    const first = came.time[0] ?? 0;
    const stays = (before?.time ?? []).map((one) => one > finalNs && one < first);
    const joined = (values: "time" | "displacement_mm" | "displacement_std_mm") =>
      [...(before?.[values] ?? []).filter((_, at) => stays[at]), ...came[values]] as number[];
    this.heads.set(point, {
      time: joined("time"),
      displacement_mm: joined("displacement_mm"),
      displacement_std_mm: joined("displacement_std_mm"),
    });
  }

  #changed(alarm: AlarmBody): void {
    this.#changes += 1;
    this.#alarmsMs = -Infinity;
    const rest = this.alarms.filter((one) => one.id !== alarm.id);
    if (alarm.state !== "test") this.alarms = inOrder(alarm.state === "ended" ? rest : [alarm, ...rest]);
  }
}

const URGENT = ["firing", "acknowledged", "pending"];

/** Those that fire first, and of these the critical ones. */
function inOrder(alarms: AlarmBody[]): AlarmBody[] {
  const rank = (one: AlarmBody) => 2 * URGENT.indexOf(one.state) - (one.level === "critical" ? 1 : 0);
  return [...alarms].sort((a, b) => rank(a) - rank(b));
}
