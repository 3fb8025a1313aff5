// Every point on one screen: value, state, age, since when, and what is wrong in one sentence.

import { showAlarms } from "../alarms.ts";
import type { Group, PointState } from "../api.ts";
import { el, mark, say } from "../dom.ts";
import { SHOWN, type SiteState } from "../site_state.ts";
import { clock, duration, STATUS_WORDS, withBand } from "../words.ts";
import { repeat, type View } from "./view.ts";

// A person reads no faster, ms.
const DRAW_MS = 500;
// Rows older than this are no newest value, s: they come five times a second, and a second after their sample.
export const OLD_S = 5;

// A point that begins, and what it does.
const BEGINS: Record<string, string> = {
  starting: "begins",
  calibrating: "is calibrating",
  opening: "is opening",
};

const isDoubtful = (point: PointState) => point.warnings?.some((one) => one.severity === "serious") ?? false;

/** How a point stands: good is shown green, and only where all that it needs is fresh. */
export function standing(
  point: PointState,
  site: SiteState,
): { state: "good" | "notice" | "wrong" | "unknown"; words: string } {
  if (!site.fresh) return { state: "unknown", words: "unknown: no connection" };
  const age = site.ageS(point);
  const status = point.status ?? "";
  if (point.reason === "not_measuring") return { state: "unknown", words: "not measured now" };
  const begins = BEGINS[point.reason];
  if (begins) return { state: "notice", words: begins };
  if (point.status === null) return { state: "wrong", words: "no rows" };
  if (status === "lost" || age === null || age > OLD_S)
    return { state: "wrong", words: status === "lost" ? "lost" : "no new rows" };
  const sources = site.health?.sources.filter((one) => one.point === point.name && one.reason) ?? [];
  if (status !== "tracking" || point.reason || sources.length)
    return { state: "notice", words: STATUS_WORDS[status] ?? status };
  if (isDoubtful(point)) return { state: "notice", words: "measured; its calibration is doubtful" };
  if (site.alarmsOf(point.name).some((one) => one.state !== "pending"))
    return { state: "notice", words: "measured, all streams fresh" };
  return { state: "good", words: "measured, all streams fresh" };
}

/** The same with its alarms: red where a critical one fires that nobody has silenced. */
function urgencyOf(point: PointState, site: SiteState): "good" | "notice" | "wrong" | "unknown" {
  const isCritical = site
    .alarmsOf(point.name)
    .some((one) => one.level === "critical" && one.state === "firing" && !one.silence);
  return isCritical && site.fresh ? "wrong" : standing(point, site).state;
}

/** That a calibration waits to be accepted, whatever else there is to say of its point; hidden where none does. */
export function showOffer(into: HTMLElement, point: PointState): void {
  into.hidden = (point.notice ?? point.reason) !== "calibration_offered";
  const href = `#/calibration/${encodeURIComponent(point.name)}`;
  if (!into.childElementCount) into.append(el("a", { href }, "A calibration awaits acceptance: accept or refuse it."));
}

/** How much its calibration warns of, and the way there; hidden where it warns of nothing. */
export function showWarnings(into: HTMLElement, point: PointState): void {
  const count = point.warnings?.length ?? 0;
  into.hidden = count === 0;
  const href = `#/calibration/${encodeURIComponent(point.name)}`;
  if (!into.childElementCount) into.append(el("a", { href }));
  say(into.firstElementChild as HTMLElement, `Its calibration has ${count === 1 ? "a warning" : `${count} warnings`}.`);
}

/** What is wrong with a point, in one sentence; empty where nothing is. */
export function trouble(point: PointState, site: SiteState): string {
  const source = site.health?.sources.find((one) => one.point === point.name && one.reason);
  if (source) return `${source.source}: ${source.reason === "paused" ? "paused: " : ""}${source.text}`;
  // That has a line of its own.
  return point.reason === "calibration_offered" ? "" : point.text;
}

/** What is not shown of a group, in one sentence. */
export function ofGroup({ group, numbers: [first, end, step], reasons }: Group): string {
  const count = Math.ceil((end - first) / step);
  const wrong = Object.entries(reasons).map(([reason, points]) => `${points} ${reason.replace("_", " ")}`);
  const listed = count > SHOWN ? ` ${SHOWN} are shown, first those that need attention.` : "";
  return `Group ${group}: ${count} points; ${wrong.length ? wrong.join(", ") : "all are measured"}.${listed}`;
}

/** Points that are none of a group's. */
const alone = (site: SiteState) =>
  site.points.filter((one) => !site.health?.groups?.some(({ group }) => isOf(group, one.name)));

const isOf = (group: string, name: string) =>
  name.startsWith(`${group}-`) && /^\d+$/.test(name.slice(group.length + 1));

/** One sentence on the whole site. */
function summary(site: SiteState): { state: string; text: string } {
  const groups = site.health?.groups ?? [];
  const inGroups = groups.reduce((sum, { numbers: [first, end, step] }) => sum + Math.ceil((end - first) / step), 0);
  const badInGroups = groups.flatMap((one) => Object.values(one.reasons)).reduce((sum, one) => sum + one, 0);
  const count = alone(site).length + inGroups;
  if (!site.health) return { state: "unknown", text: "Waiting for the server." };
  if (!site.fresh) return { state: "unknown", text: "No connection: the values shown are old." };
  if (!count) return { state: "unknown", text: "There are no points yet." };
  const states = alone(site).map((one) => urgencyOf(one, site));
  const bad = states.filter((one) => one !== "good").length + badInGroups;
  if (!bad && site.health.ready)
    return {
      state: "good",
      text:
        count === 1
          ? "The point is measured, all its streams are fresh."
          : `All ${count} points are measured, all streams are fresh.`,
    };
  if (bad) {
    const text = count === 1 ? "The point needs attention." : `${bad} of ${count} points need attention.`;
    return { state: states.includes("wrong") ? "wrong" : "notice", text };
  }
  const source = site.health.sources.find((one) => one.reason);
  return { state: "notice", text: source ? source.text : "Something is not ready." };
}

interface Card {
  root: HTMLElement;
  value: HTMLElement;
  words: HTMLElement;
  age: HTMLElement;
  since: HTMLElement;
  text: HTMLElement;
  offer: HTMLElement;
  warned: HTMLElement;
  alarms: HTMLElement;
}

function card(name: string): Card {
  const [value, words, age, since, text, offer, warned, alarms] = [
    el("p", { class: "value" }),
    el("p", { class: "words" }),
    el("span"),
    el("span"),
    el("p", { class: "why" }),
    el("p", { class: "offer", hidden: true }),
    el("p", { class: "offer", hidden: true }),
    el("ul", { class: "alarms" }),
  ];
  const link = el("a", { href: `#/point/${encodeURIComponent(name)}` }, name);
  const root = el(
    "li",
    { class: "card" },
    el("h2", {}, link),
    value,
    words,
    el("p", { class: "quiet" }, age, since),
    text,
    offer,
    warned,
    alarms,
  );
  return { root, value, words, age, since, text, offer, warned, alarms };
}

function fill(into: Card, point: PointState, site: SiteState): void {
  const { state, words } = standing(point, site);
  const age = site.ageS(point);
  const sinceMs = site.sinceMs(point);
  mark(into.root, urgencyOf(point, site));
  mark(into.words, state);
  say(into.value, withBand(point.displacement_mm, point.displacement_std_mm));
  say(into.words, words);
  say(into.age, age === null ? "no row yet" : `newest row ${age < 3 ? "now" : `${duration(age)} ago`}`);
  say(into.since, sinceMs === null ? "" : `, in this state since ${clock(sinceMs)}`);
  say(into.text, site.fresh ? trouble(point, site) : "");
  showOffer(into.offer, point);
  showWarnings(into.warned, point);
  showAlarms(into.alarms, site.alarmsOf(point.name));
}

export const showSite: View = (root, site) => {
  const head = el("p", { class: "summary", role: "status" });
  const list = el("ul", { class: "cards" });
  const settings = el("p", { class: "wrong" });
  const cards = new Map<string, Card>();
  const groups = el("div");
  root.replaceChildren(el("h1", {}, "Site"), head, settings, groups, list);

  return repeat(() => {
    const { state, text } = summary(site);
    mark(head, state);
    say(head, text);
    say(settings, site.health?.settings ? `SITE.toml: ${site.health.settings.text}` : "");
    const lines = (site.health?.groups ?? []).map(ofGroup);
    if (lines.join() !== [...groups.children].map((one) => one.textContent).join())
      groups.replaceChildren(...lines.map((one) => el("p", { class: "quiet" }, one)));
    for (const point of site.points) {
      let shown = cards.get(point.name);
      if (!shown) {
        cards.set(point.name, (shown = card(point.name)));
        list.append(shown.root);
      }
      fill(shown, point, site);
    }
    for (const [name, shown] of cards) {
      if (site.point(name)) continue;
      shown.root.remove();
      cards.delete(name);
    }
  }, DRAW_MS);
};
