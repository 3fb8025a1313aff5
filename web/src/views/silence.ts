// Until when an alarm is silent, and why: a dialog, which keys and screen readers know how to leave.

import type { AlarmBody } from "../api.ts";
import { button, choice, el } from "../dom.ts";

const HOUR_MS = 3_600_000;
const SPANS: [hours: string, text: string][] = [
  ["1", "for an hour"],
  ["8", "for 8 hours"],
  ["24", "for a day"],
  ["168", "for a week"],
  ["", "until …"],
];

/** Ask, and give the end (ISO 8601) and the reason to `done`; nothing where it is left. */
export function askSilence(alarm: AlarmBody, nowMs: number, done: (until: string, reason: string) => void): void {
  let hours = "1";
  const reason = el("input", { required: true, maxlength: 200, autocomplete: "off", autofocus: true });
  const instant = el("input", { type: "datetime-local", "aria-label": "Silenced until" });
  instant.hidden = true;
  const span = choice("Silent", SPANS, hours, (value) => {
    hours = value;
    instant.hidden = hours !== "";
    instant.required = hours === "";
  });
  const form = el(
    "form",
    { method: "dialog", submit: () => done(new Date(untilMs()).toISOString(), reason.value.trim()) },
    el("h2", {}, `Silence ${alarm.point}: ${alarm.name}`),
    el("p", { class: "quiet" }, "No webhook and no mail until then. The alarm is still measured, shown and stored."),
    el("div", { class: "bar" }, span, instant),
    el("label", {}, "Reason, visible to all users", reason),
    el(
      "div",
      { class: "bar" },
      button("Silence", () => undefined, { type: "submit" }),
      button("Cancel", () => dialog.close()),
    ),
  );
  const dialog = el("dialog", { "aria-label": `Silence ${alarm.name}`, close: () => dialog.remove() }, form);

  function untilMs(): number {
    return hours === "" ? new Date(instant.value).getTime() : nowMs + Number(hours) * HOUR_MS;
  }

  document.body.append(dialog);
  dialog.showModal();
}
