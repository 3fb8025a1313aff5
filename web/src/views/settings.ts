// Settings as text: checked before they come into force; what is wrong stands next to them, with its line.

import { putSettings, Refused, settings, type SettingsDone } from "../api.ts";
import { button, el, mark, say } from "../dom.ts";
import { lineOf } from "../site_text.ts";
import { SiteForm } from "./site_form.ts";
import { sentenceOf, type View } from "./view.ts";

/** file: what they are; below: the address that they are at; note: what becomes of new ones; fault: what is wrong;
 * isSite: whether points can be added, and a check says what would change. */
export interface SettingsPlace {
  file: string;
  below: string;
  note: string;
  save: string;
  isSite?: boolean;
  fault: () => { text: string; key: string | null } | null;
  written?: () => Promise<void>;
}

export const showSettings: View = (root, site) => {
  if (site.health?.has_settings === false) {
    const none = "This store has no SITE.toml here: no midspan run was started on it.";
    root.replaceChildren(el("h1", {}, "Settings"), el("p", {}, none));
    return () => undefined;
  }
  return editSettings(root, {
    file: "SITE.toml",
    below: "",
    note: "SITE.toml. Wrong settings are rejected. Check reports the effect of new ones.",
    save: "Save and apply",
    isSite: true,
    fault: () => site.health?.settings ?? null,
  });
};

/** Text that is not saved, with the text and the tag that it was made from, by its place: it outlasts its view. */
const drafts = new Map<string, { text: string; tag: string; kept: string }>();
/** At logging out: the next who logs in here may be somebody else. */
export function forgetDrafts(): void {
  drafts.clear();
}
window.addEventListener("beforeunload", (event) => {
  if (drafts.size) event.preventDefault();
});

/** What settings change, a line each. */
export function changesOf({ added = [], changed = [], removed = [], restart }: SettingsDone): string[] {
  const named: [string, string[]][] = [
    ["Start", added],
    ["Restart", changed],
    ["Stop", removed],
    ["Take effect after a restart of midspan run", restart],
  ];
  return named.filter(([, names]) => names.length).map(([text, names]) => `${text}: ${names.join(", ")}.`);
}

/** A form of settings; returns how it ends. */
export function editSettings(root: HTMLElement, place: SettingsPlace): () => void {
  const area = el("textarea", { spellcheck: "false", autocapitalize: "off", "aria-label": place.file });
  const [done, changes] = [el("p", { class: "done", role: "status" }), el("ul", { class: "changes" })];
  const wrong = el("p", { class: "wrong", role: "alert", id: "settings-wrong" });
  const save = button(place.save, () => void put(false), { class: "main" });
  const check = button("Check", () => void put(true));
  const unsaved = el("p", { class: "words", role: "status" });
  mark(unsaved, "notice");
  const text = {
    get: () => area.value,
    set: (value: string) => {
      area.value = value;
      noteDraft();
    },
  };
  const of = `${place.below}/${place.file}`;
  const form = place.isSite ? new SiteForm(text) : null;
  let [tag, kept] = ["*", ""];

  /** What is not saved is kept for when somebody comes back to the view. */
  function noteDraft(): void {
    if (area.value === kept) drafts.delete(of);
    else drafts.set(of, { text: area.value, tag, kept });
    say(unsaved, drafts.has(of) ? "Not saved." : "");
  }

  async function load(): Promise<void> {
    try {
      const found = await settings(place.below);
      [tag, kept, area.value] = [found.tag, found.text, found.text];
      noteDraft();
      const fault = place.fault();
      show("", [], fault?.text ?? "", fault?.key ?? null);
      form?.show();
    } catch (error) {
      show("", [], sentenceOf(error), null);
    }
  }

  async function put(isTrial: boolean): Promise<void> {
    save.disabled = check.disabled = true;
    show("", [], "", null);
    try {
      const sent = area.value;
      const found = await putSettings(sent, tag, place.below, isTrial);
      if (!isTrial) {
        [tag, kept] = [found.tag, sent];
        noteDraft();
        await place.written?.();
      }
      show(isTrial ? `No errors. ${found.text}` : found.text, changesOf(found), "", null);
    } catch (error) {
      show("", [], sentenceOf(error), error instanceof Refused ? error.key : null);
    } finally {
      save.disabled = check.disabled = false;
    }
  }

  /** What was done, what changes, or what is wrong; the line of a wrong key is selected. */
  function show(text: string, lines: string[], fault: string, key: string | null): void {
    say(done, text);
    changes.replaceChildren(...lines.map((one) => el("li", {}, one)));
    const at = fault ? lineOf(area.value, key, fault) : null;
    say(wrong, at === null ? fault : `Line ${at + 1}: ${fault}`);
    if (fault) area.setAttribute("aria-describedby", wrong.id);
    else area.removeAttribute("aria-describedby");
    if (at !== null) select(at);
  }

  function select(at: number): void {
    const lines = area.value.split("\n");
    const from = lines.slice(0, at).join("\n").length + (at ? 1 : 0);
    area.focus();
    area.setSelectionRange(from, from + (lines[at] ?? "").length);
    area.scrollTop = (at / lines.length) * area.scrollHeight - area.clientHeight / 2;
  }

  area.addEventListener("input", noteDraft);
  root.replaceChildren(
    el("h1", {}, "Settings"),
    el("p", { class: "quiet" }, place.note),
    form?.root ?? "",
    el(
      "div",
      { class: "bar" },
      place.isSite ? check : "",
      save,
      button("Read again", () => void load()),
    ),
    done,
    changes,
    wrong,
    unsaved,
    area,
  );
  const draft = drafts.get(of);
  if (draft) {
    ({ tag, kept, text: area.value } = draft);
    noteDraft();
    form?.show();
  } else void load();
  return () => undefined;
}
