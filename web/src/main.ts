// The page: login, then one view a time, named by the address's part after #.

import { urgency } from "./alarms.ts";
import { logout, session, type Session, whenOver } from "./api.ts";
import { button, el, mark, say } from "./dom.ts";
import { SiteState } from "./site_state.ts";
import "./style.css";
import { duration } from "./words.ts";
import { showAlarmsView } from "./views/alarms.ts";
import { showLogin } from "./views/login.ts";
import { showCalibration } from "./views/calibration.ts";
import { showCamera } from "./views/camera.ts";
import { showCompare } from "./views/compare.ts";
import { showPoint } from "./views/point.ts";
import { showSettings } from "./views/settings.ts";
import { showSite } from "./views/site.ts";
import { showSources } from "./views/sources.ts";
import { sentenceOf, type View } from "./views/view.ts";

interface Entry {
  path: string;
  text: string;
  show: View;
  scope?: "admin";
}

const VIEWS: Entry[] = [
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

let site: SiteState | null = null;
let end: () => void = () => undefined;

function place(): { path: string; name: string } {
  const [, path = "", name = ""] = location.hash.split("/");
  return { path: path || "site", name: decodeURIComponent(name) };
}

function show(): void {
  if (!site) return;
  end();
  const { path, name } = place();
  const entry = VIEWS.find((one) => one.path === path) ?? VIEWS[0];
  if (!entry) return;
  document.title = `${name ? `${name} – ` : ""}${entry.text} – midspan`;
  for (const link of head.querySelectorAll("a")) {
    if (link.dataset["path"] === entry.path) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  end = entry.show(main, site, name);
}

function showHead(of: Session): void {
  const links = VIEWS.filter((one) => !one.scope || one.scope === of.scope);
  const list = el("ul");
  for (const one of links)
    list.append(el("li", {}, el("a", { href: `#/${one.path}`, "data-path": one.path }, one.text, " ", el("span"))));
  const who = el("span", { class: "quiet" }, `${of.user} (${of.scope})`);
  head.replaceChildren(
    el("strong", {}, "midspan"),
    el("nav", { "aria-label": "Views" }, list),
    el(
      "span",
      { class: "who" },
      who,
      " ",
      button("Log out", () => void leave()),
    ),
  );
}

async function begin(of: Session): Promise<void> {
  const begun = (site = new SiteState(of));
  showHead(of);
  await begun.start();
  if (site !== begun) return;
  show();
  main.focus();
}

function askLogin(): void {
  end();
  end = () => undefined;
  site?.stop();
  site = null;
  head.replaceChildren(el("strong", {}, "midspan"));
  say(connection, "");
  showLogin(main, (of) => void begin(of));
}

async function leave(): Promise<void> {
  try {
    await logout();
  } finally {
    askLogin();
  }
}

function showConnection(): void {
  if (!site) return;
  const cut = !site.fresh;
  mark(connection, cut ? "cut" : "");
  const since = duration((performance.now() - Math.max(site.answered, site.live.heard)) / 1000);
  say(
    connection,
    cut && site.health ? `No connection to the server. What is shown is ${since} old; it is tried again.` : "",
  );
}

/** How many alarms are open, next to the name of their view. */
function showBadge(): void {
  const badge = head.querySelector<HTMLElement>("a[data-path=alarms] span");
  if (!site || !badge) return;
  const { alarms } = site;
  badge.className = alarms.length ? "badge" : "";
  mark(badge, alarms.some((one) => urgency(one) === "wrong") ? "wrong" : "notice");
  say(badge, alarms.length ? `${alarms.length} open` : "");
}

async function start(): Promise<void> {
  whenOver(askLogin);
  window.addEventListener("hashchange", show);
  window.setInterval(() => {
    showConnection();
    showBadge();
  }, 500);
  for (;;) {
    try {
      const found = await session();
      if (found) await begin(found);
      else askLogin();
      return;
    } catch (error) {
      mark(connection, "cut");
      say(connection, `${sentenceOf(error)} It is tried again.`);
      await new Promise((resolve) => window.setTimeout(resolve, 2000));
    }
  }
}

void start();
