// Alarms in words, for every view.

import type { AlarmBody } from "./api.ts";
import { el, mark, say } from "./dom.ts";
import { clock, signed } from "./words.ts";

/** What an alarm's value is. */
export const QUANTITY: Record<string, string> = {
  displacement: "displacement",
  drift: "drift of the daily mean",
  velocity: "velocity",
  std: "standard deviation",
  silent: "age of a source's newest data",
  disk: "used share of the disk",
  no_data: "age of the newest row",
};

/** How an alarm is shown: one that only the band touches, or that somebody takes care of, is a notice. */
export function urgency(alarm: AlarmBody): "wrong" | "notice" | "unknown" {
  if (alarm.silence) return "unknown";
  return alarm.state === "firing" ? "wrong" : "notice";
}

/** State and level of an alarm. */
export function stateWords(alarm: AlarmBody): string {
  const states: Record<string, string> = {
    pending: alarm.reason === "band" ? "pending: only the band exceeds the limit" : "pending",
    acknowledged: `acknowledged by ${alarm.acknowledged_by}`,
  };
  return `${alarm.level}, ${states[alarm.state] ?? alarm.state}${alarm.silence ? ", silenced" : ""}`;
}

/** How many alarms are open, and how they stand. */
export function openWords(alarms: Pick<AlarmBody, "state" | "silence">[]): string {
  if (!alarms.length) return "No alarm is open.";
  const count = (state: string, isSilent: boolean) =>
    alarms.filter((one) => one.state === state && (one.silence !== null) === isSilent).length;
  const fires = count("firing", false);
  const counted: [count: number, text: string][] = [
    [fires, fires === 1 ? "fires" : "fire"],
    [count("acknowledged", false) + count("acknowledged", true), "acknowledged"],
    [count("firing", true), "silenced"],
    [count("pending", false) + count("pending", true), "pending"],
  ];
  const parts = counted.filter(([number]) => number).map(([number, text]) => `${number} ${text}`);
  return `${alarms.length === 1 ? "1 alarm is" : `${alarms.length} alarms are`} open: ${parts.join(", ")}.`;
}

/** The largest value of an alarm that has fired, where its value is no longer that. */
function peakWords({ state, value, peak, unit }: AlarmBody): string {
  return state !== "pending" && Math.abs(peak) > Math.abs(value) ? `, largest ${measured(peak, 0, unit)}` : "";
}

/** A value in the alarm's unit, with its 95 % band. */
export function measured(value: number, std: number, unit: string): string {
  const half = 1.96 * std;
  const digits = Math.min(Math.max(1 - Math.floor(Math.log10(Math.max(half, Math.abs(value) / 100, 1e-9))), 0), 6);
  return `${signed(value, digits)}${std ? ` ± ${half.toFixed(digits)}` : ""} ${unit}`;
}

/** The alarms of a point as lines that lead to their view; left alone where nothing changed. */
export function showAlarms(into: HTMLElement, alarms: AlarmBody[]): void {
  const texts = alarms.map(
    (one) =>
      `${stateWords(one)}: ${one.name}, ${measured(one.value, one.value_std, one.unit)} (limit ${one.limit} ${one.unit}${peakWords(one)}) ` +
      `since ${clock(Date.parse(one.since))}`,
  );
  while (into.children.length > texts.length) into.lastElementChild?.remove();
  texts.forEach((text, at) => {
    if (!into.children[at]) into.append(el("li", { class: "words" }, el("a", { href: "#/alarms" })));
    const item = into.children[at] as HTMLElement;
    mark(item, urgency(alarms[at] as AlarmBody));
    say(item.firstElementChild as HTMLElement, text);
  });
}
