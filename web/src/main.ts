// The page: login, then one view a time, named by the address's part after #; over a site, or over recordings.

import { urgency } from "./alarms.ts";
import { changeLink, logout, Refused, session, type Session, whenOver } from "./api.ts";
import { button, el, mark, say } from "./dom.ts";
import { Desk } from "./recordings/desk.ts";
import { RECORDING_VIEWS } from "./recordings/views.ts";
import { SiteState } from "./site_state.ts";
import "./style.css";
import { duration } from "./words.ts";
import { showAlarmsView } from "./views/alarms.ts";
import { showLogin } from "./views/login.ts";
import { showCalibration } from "./views/calibration.ts";
import { showCamera } from "./views/camera.ts";
import { showCompare } from "./views/compare.ts";
import { showPoint } from "./views/point.ts";
import { forgetDrafts, showSettings } from "./views/settings.ts";
import { showSite } from "./views/site.ts";
import { showSources } from "./views/sources.ts";
import { type Entry, sentenceOf } from "./views/view.ts";

const VIEWS: Entry<SiteState>[] = [
  { path: "site", text: "Site", show: showSite },
  { path: "point", text: "Point", show: showPoint },
  { path: "alarms", text: "Alarms", show: showAlarmsView },
  { path: "sources", text: "Sources", show: showSources },
  { path: "calibration", text: "Calibration", show: showCalibration },
  { path: "camera", text: "Camera", show: showCamera },
  { path: "compare", text: "Compare", show: showCompare },
  { path: "settings", text: "Settings", show: showSettings, scope: "admin" },
];

const head = document.getElementById("head") as HTMLElement;
const main = document.getElementById("main") as HTMLElement;
const connection = document.getElementById("connection") as HTMLElement;

/** What is shown: its views, and what is done now and then, and at its end. */
interface Shown {
  views: { path: string; text: string; show: (name: string, rest: string[]) => () => void }[];
  /** The name that a link to a view keeps, as that of a recording. */
  keepsName: boolean;
  refresh: () => void;
  stop: () => void;
}

let shown: Shown | null = null;
let end: () => void = () => undefined;

function place(): { path: string; name: string; rest: string[] } {
  const [, path = "", name = "", ...rest] = location.hash.split("/");
  return { path: path || (shown?.views[0]?.path ?? ""), name: decodeURIComponent(name), rest };
}

function show(): void {
  if (!shown) return;
  const { path, name, rest } = place();
  if (path === "link") return void start();
  end();
  const entry = shown.views.find((one) => one.path === path) ?? shown.views[0];
  if (!entry) return;
  document.title = `${name && !shown.keepsName ? `${name} – ` : ""}${entry.text} – midspan`;
  for (const link of head.querySelectorAll("a")) {
    if (link.dataset["path"] === entry.path) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
    if (shown.keepsName && name) link.href = `#/${link.dataset["path"] ?? ""}/${encodeURIComponent(name)}`;
  }
  end = entry.show(name, rest);
}

function showHead(views: Shown["views"], ...right: (Node | string)[]): void {
  const list = el("ul");
  for (const one of views)
    list.append(el("li", {}, el("a", { href: `#/${one.path}`, "data-path": one.path }, one.text, " ", el("span"))));
  head.replaceChildren(
    el("strong", {}, "midspan"),
    el("nav", { "aria-label": "Views" }, list),
    el("span", { class: "who" }, ...right),
  );
}

/** The views of what there is, for who may see them. */
function viewsOf<State>(entries: Entry<State>[], state: State, scope: string): Shown["views"] {
  return entries
    .filter((one) => !one.scope || one.scope === scope)
    .map(({ path, text, show }) => ({ path, text, show: (name, rest) => show(main, state, name, rest) }));
}

async function beginSite(of: Session): Promise<void> {
  const site = new SiteState(of);
  const begun: Shown = (shown = {
    views: viewsOf(VIEWS, site, of.scope),
    keepsName: false,
    refresh: () => {
      showConnection(site);
      showBadge(site);
    },
    stop: () => site.stop(),
  });
  const who = el("span", { class: "quiet" }, `${of.user} (${of.scope})`);
  showHead(
    begun.views,
    who,
    " ",
    button("Log out", () => void leave()),
  );
  await site.start();
  if (shown === begun) show();
}

async function beginRecordings(): Promise<void> {
  const desk = new Desk();
  await desk.ask();
  const views = viewsOf(RECORDING_VIEWS, desk, "admin");
  const begun: Shown = (shown = {
    // A list of one is none.
    views: desk.recordings.length > 1 ? views : views.slice(1),
    keepsName: true,
    refresh: () => {
      mark(connection, desk.trouble ? "cut" : "");
      say(connection, desk.trouble);
    },
    stop: () => undefined,
  });
  showHead(begun.views);
  show();
}

async function begin(of: Session): Promise<void> {
  await (of.serves === "site" ? beginSite(of) : beginRecordings());
  // What is above it, as the views' names, stays in sight.
  main.focus({ preventScroll: true });
}

/** Nobody is logged in: what was shown ends. */
function stop(): void {
  end();
  end = () => undefined;
  shown?.stop();
  shown = null;
  head.replaceChildren(el("strong", {}, "midspan"));
  mark(connection, "");
  say(connection, "");
}

function askLogin(): void {
  stop();
  showLogin(main, (of) => void begin(of));
}

function askLink(text: string): void {
  stop();
  main.replaceChildren(el("h1", {}, "A link is needed"), el("p", { role: "status" }, text));
}

async function leave(): Promise<void> {
  try {
    await logout();
  } finally {
    forgetDrafts();
    askLogin();
  }
}

function showConnection(site: SiteState): void {
  const cut = !site.fresh;
  mark(connection, cut ? "cut" : "");
  const since = duration((performance.now() - Math.max(site.answered, site.live.heard)) / 1000);
  say(
    connection,
    cut && site.health ? `No connection to the server. The values shown are ${since} old; reconnecting.` : "",
  );
}

/** How many alarms are open, next to the name of their view. */
function showBadge({ alarms }: SiteState): void {
  const badge = head.querySelector<HTMLElement>("a[data-path=alarms] span");
  if (!badge) return;
  badge.className = alarms.length ? "badge" : "";
  mark(badge, alarms.some((one) => urgency(one) === "wrong") ? "wrong" : "notice");
  say(badge, alarms.length ? `${alarms.length} open` : "");
}

/** A link that was printed is in no request: only what stands before # is. */
async function takeLink(): Promise<void> {
  const { path, name } = place();
  if (path !== "link") return;
  history.replaceState(null, "", "#/");
  await changeLink(name);
}

async function start(): Promise<void> {
  for (;;) {
    try {
      await takeLink();
      const found = await session();
      if (found) await begin(found);
      return;
    } catch (error) {
      // What whenOver was called for is on the page already.
      if (error instanceof Refused && error.status === 401) return;
      mark(connection, "cut");
      say(connection, `${sentenceOf(error)} Retrying.`);
      await new Promise((resolve) => window.setTimeout(resolve, 2000));
    }
  }
}

whenOver((refused) => (refused.code === "link" ? askLink(refused.message) : askLogin()));
window.addEventListener("hashchange", () => {
  if (shown) show();
  // A login that is being typed stays.
  else if (place().path === "link") void start();
});
window.setInterval(() => shown?.refresh(), 500);
void start();
