// The REST interface below /api/v1 and its schemas (GET /api/v1/openapi.json).

export interface Session {
  user: string;
  scope: "read" | "operate" | "admin";
  csrf: string;
  /** What the page is over. */
  serves: "site" | "recordings";
}
/** What a calibration warns of; serious: the displacement may be wrong by more than its band. */
export interface Warned {
  severity: string;
  text: string;
}
/** How a point stands, without its newest row. */
export interface PointStands {
  name: string;
  status: string | null;
  reason: string;
  text: string;
  /** What is prepared, or waits, also while there are no rows: a reason code. */
  notice?: string;
  /** Of the calibration that makes the rows, the worst first. */
  warnings?: Warned[];
  since: string | null;
  calibration: number | null;
  /** capturing, calibrating or opening; empty where nothing is prepared. */
  stage?: string;
  stage_left_s?: number | null;
}
export interface PointState extends PointStands {
  displacement_mm: number | null;
  displacement_std_mm: number | null;
  time: string | null;
  age_s: number | null;
}
export interface SourceState {
  name: string;
  point: string;
  source: string;
  reason: string;
  text: string;
  age_s: number | null;
  records: number;
  faults: number;
  skipped: number;
  stamps: string;
  address: string;
  rate_hz: number | null;
  nominal_rate_hz?: number | null;
  /** Arrival less stamp. */
  delay_s?: number | null;
  late?: number | null;
  restarts?: number | null;
  /** Added to its stamps for the accelerometer's clock. */
  clock_offset_s?: number | null;
  clock_offset_std_s?: number | null;
  clock_drift_ppm?: number | null;
}
/** Points that are filtered together: NAME-NUMBER; of each reason how many points have it. */
export interface Group {
  group: string;
  /** First number, end and step. */
  numbers: [number, number, number];
  reasons: Record<string, number>;
}
export interface Health {
  ready: boolean;
  groups?: Group[];
  points: { point: string; reason: string; text: string }[];
  sources: { point: string; source: string; reason: string; text: string }[];
  settings: { text: string; file: string | null; key: string | null } | null;
  /** Whether a SITE.toml belongs to the store. */
  has_settings: boolean;
}
type Numbers = (number | null)[];
export interface Buckets {
  time: number[];
  displacement_mm_min: Numbers;
  displacement_mm_max: Numbers;
  displacement_mm_mean: Numbers;
  displacement_std_mm: Numbers;
  status: (string | null)[];
  /** How many have a value; null over more than 32 days. */
  rows: Numbers;
}
export interface Rows {
  time: number[];
  displacement_mm: Numbers;
  displacement_std_mm: Numbers;
  status: string[];
}
export interface EventBody {
  time: string;
  time_ns: number;
  kind: string;
  text: string;
}
export interface CalibrationBody {
  id: number;
  time: string;
  state: string;
  calibration: Record<string, unknown>;
  /** When it made rows. */
  rows?: { from: string; to: string }[];
  /** Of a refused one: by whom and why. */
  refusal?: { time: string; owner: string; reason: string } | null;
}
export interface SpectrumBody {
  frequency_hz: Numbers;
  density_mm2_hz: Numbers;
  segment_s: number | null;
  modes: Record<string, number>[];
  reason: string;
}
/** One segment a step; complete: false where asking again gives more. */
export interface FrequenciesBody {
  step_s: number;
  segment_s: number;
  time: number[];
  modes: { frequency_hz: Numbers; frequency_std_hz: Numbers; rms_mm: Numbers }[];
  complete: boolean;
  reason: string;
}
export interface AlarmBody {
  id: string;
  point: string;
  name: string;
  /** pending, firing, acknowledged or ended; test: of a message that was asked for. */
  state: string;
  level: string;
  on: string;
  reason: string;
  value: number;
  value_std: number;
  peak: number;
  limit: number;
  unit: string;
  time: string;
  since: string;
  text: string;
  acknowledged_by: string;
  silence: { until: string; owner: string; reason: string } | null;
}
/** A silence of a rule, with or without an open alarm. */
export interface SilenceBody {
  id: string;
  point: string;
  name: string;
  until: string;
  owner: string;
  reason: string;
}
export interface TargetBody {
  target: string;
  waiting: number;
  sent: number;
  fault: string;
  sent_s: number | null;
}
export interface AuditBody {
  time: string;
  alarm: string;
  what: string;
  who: string;
  text: string;
}
export interface LimitBody {
  point: string;
  name: string;
  on: string;
  level: string;
  limit: number;
  unit: string;
}

/** What the server refused, with its own sentence: what, the rule, the remedy. */
export class Refused extends Error {
  status: number;
  key: string | null;
  code: string;
  constructor(status: number, detail: string, key: string | null, code: string) {
    super(detail);
    [this.status, this.key, this.code] = [status, key, code];
  }
}

/** The server was not reached. */
export class Away extends Error {}

const ROOT = "/api/v1";
// An answer that takes longer than the server's own limits comes no more, ms.
const LONGEST_MS = 70_000;

let csrf = "";
// Of a page over recordings: kept for this port alone and until its tab is closed; sites have a cookie instead.
const TOKEN = "midspan-token";
let token: string | null = null;
let over: (refused: Refused) => void = () => undefined;

/** What is done when a login is over, or there was none. */
export function whenOver(done: (refused: Refused) => void): void {
  over = done;
}

async function ask(path: string, options: RequestInit = {}): Promise<Response> {
  const headers = new Headers(options.headers);
  if (options.method && options.method !== "GET") headers.set("X-CSRF-Token", csrf);
  token ??= sessionStorage.getItem(TOKEN) ?? "";
  if (token) headers.set("Authorization", `Bearer ${token}`);
  let answer: Response;
  try {
    answer = await fetch(ROOT + path, {
      ...options,
      headers,
      signal: options.signal ?? AbortSignal.timeout(LONGEST_MS),
    });
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new Away("The server cannot be reached.");
  }
  if (answer.ok) return answer;
  const body = (await answer.json().catch(() => ({}))) as { detail?: string; key?: string; code?: string };
  const text = body.detail ?? `The server answered ${answer.status}.`;
  const refused = new Refused(answer.status, text, body.key ?? null, body.code ?? "");
  if (answer.status === 401 && path !== "/login") over(refused);
  throw refused;
}

export async function get<T>(path: string, signal?: AbortSignal): Promise<T> {
  return (await (await ask(path, signal ? { signal } : {})).json()) as T;
}

export async function post<T>(path: string, body?: unknown): Promise<T> {
  const content =
    body === undefined ? {} : { body: JSON.stringify(body), headers: { "Content-Type": "application/json" } };
  const answer = await ask(path, { method: "POST", ...content });
  return (answer.status === 204 ? undefined : await answer.json()) as T;
}

/** DELETE: the server's sentence. */
export async function remove(path: string): Promise<string> {
  return ((await (await ask(path, { method: "DELETE" })).json()) as { text: string }).text;
}

/** A session that goes on; null where there is none, after `whenOver` was called. */
export async function session(): Promise<Session | null> {
  try {
    // That nobody is logged in is no fault, which a browser would report.
    const found = await get<Session | { user: null; text: string; code: string }>("/session?optional=true");
    if (found.user === null) {
      over(new Refused(401, found.text, null, found.code));
      return null;
    }
    csrf = found.csrf;
    return found;
  } catch (error) {
    if (error instanceof Refused && error.status === 401) return null;
    throw error;
  }
}

/** Change a link that was printed for what this page sends from now on. */
export async function changeLink(link: string): Promise<void> {
  token = "";
  token = (await post<{ token: string }>("/link", { link })).token;
  sessionStorage.setItem(TOKEN, token);
}

export async function login(user: string, password: string): Promise<Session> {
  const begun = await post<Session>("/login", { user, password });
  csrf = begun.csrf;
  return begun;
}

export async function logout(): Promise<void> {
  await post("/logout");
}

/** Settings as text: of the site, or of something below it. */
export async function settings(below = ""): Promise<{ text: string; tag: string }> {
  const answer = await ask(`${below}/settings`);
  return { text: await answer.text(), tag: answer.headers.get("ETag") ?? "*" };
}

/** What became of settings, or would: names of points, and keys that hold only after another start. */
export interface SettingsDone {
  text: string;
  restart: string[];
  added?: string[];
  changed?: string[];
  removed?: string[];
}

/** isTrial: nothing is written, and the answer says what would happen. */
export async function putSettings(
  text: string,
  tag: string,
  below = "",
  isTrial = false,
): Promise<SettingsDone & { tag: string }> {
  const headers = { "Content-Type": "text/plain", "If-Match": tag };
  const path = `${below}/settings${isTrial ? "?dry_run=true" : ""}`;
  const answer = await ask(path, { method: "PUT", body: text, headers });
  const body = (await answer.json()) as Partial<SettingsDone> & { text: string };
  return { restart: [], ...body, tag: answer.headers.get("ETag") ?? "*" };
}

export interface Picture {
  blob: Blob;
  ms: number;
  width: number;
  height: number;
  /** What black and white stand for: of grey levels nothing. */
  shown: { low: number; high: number; unit: string } | null;
  /** Where targets are in the newest frame that was tracked. */
  targets: TrackedTarget[];
}
/** A region in the reference frame, and how far it has moved from there, px; null where the target is lost. */
export interface TrackedTarget {
  name: string;
  roi: [x: number, y: number, width: number, height: number];
  x_px: number | null;
  y_px: number | null;
  /** From 0 to 1. */
  quality: number | null;
  /** Of a tracker that counts them. */
  matches: number | null;
}

/** The newest range profile of a radar: dB of its strongest bin over range, m; null: the range of bins is not known. */
export interface ProfileBody {
  time_ns: number;
  range_m: number[] | null;
  magnitude_db: number[];
  targets: { bin: number; range_m: number | null; snr_db: number }[];
}

/** of: the address of what has a picture. */
export async function picture(of: string): Promise<Picture> {
  const answer = await ask(`${of}/picture`);
  const number = (name: string) => Number(answer.headers.get(name) ?? 0);
  const unit = answer.headers.get("X-Midspan-Unit");
  const shown = {
    low: number("X-Midspan-Low"),
    high: number("X-Midspan-High"),
    unit: unit === "degC" ? "°C" : (unit ?? ""),
  };
  return {
    blob: await answer.blob(),
    ms: number("X-Midspan-Time") / 1e6,
    width: number("X-Midspan-Width"),
    height: number("X-Midspan-Height"),
    shown: unit ? shown : null,
    targets: JSON.parse(answer.headers.get("X-Midspan-Targets") ?? "[]") as TrackedTarget[],
  };
}

/** The address of something of a point. */
export function ofPoint(name: string, what: string, query: Record<string, string | number> = {}): string {
  const asked = new URLSearchParams(Object.entries(query).map(([key, value]) => [key, String(value)])).toString();
  return `/points/${encodeURIComponent(name)}/${what}${asked ? `?${asked}` : ""}`;
}

/** From and to as the interface takes them: whole ns, from ms; BigInt, as a double has 16 digits. */
export function span(fromMs: number, toMs: number): { from: string; to: string } {
  const ns = (ms: number) => String(BigInt(Math.round(ms * 1000)) * 1000n);
  return { from: ns(fromMs), to: ns(toMs) };
}
