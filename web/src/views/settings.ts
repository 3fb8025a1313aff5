// Settings as text: checked before they come into force; what is wrong stands next to them.

import { putSettings, Refused, settings } from "../api.ts";
import { button, el, say } from "../dom.ts";
import { sentenceOf, type View } from "./view.ts";

/** file: what they are; below: the address that they are at; note: what becomes of new ones; fault: what is wrong. */
export interface SettingsPlace {
  file: string;
  below: string;
  note: string;
  save: string;
  fault: () => string;
  written?: () => Promise<void>;
}

export const showSettings: View = (root, site) =>
  editSettings(root, {
    file: "SITE.toml",
    below: "",
    note: "SITE.toml. New settings begin the measuring anew, from the kept states. Wrong ones change nothing.",
    save: "Check and put in force",
    fault: () => site.health?.settings?.text ?? "",
  });

/** A form of settings; returns how it ends. */
export function editSettings(root: HTMLElement, place: SettingsPlace): () => void {
  const area = el("textarea", { spellcheck: "false", autocapitalize: "off", "aria-label": place.file });
  const [done, wrong] = [el("p", { class: "done", role: "status" }), el("p", { class: "wrong", role: "alert" })];
  const save = button(place.save, () => void put());
  let [tag, kept] = ["*", ""];

  async function load(): Promise<void> {
    try {
      const found = await settings(place.below);
      [tag, kept, area.value] = [found.tag, found.text, found.text];
      say(wrong, place.fault());
    } catch (error) {
      say(wrong, sentenceOf(error));
    }
  }

  async function put(): Promise<void> {
    save.disabled = true;
    say(done, "");
    say(wrong, "");
    try {
      const found = await putSettings(area.value, tag, place.below);
      [tag, kept] = [found.tag, area.value];
      await place.written?.();
      say(
        done,
        found.restart.length ? `${found.text} Start midspan run again for: ${found.restart.join(", ")}.` : found.text,
      );
    } catch (error) {
      say(wrong, sentenceOf(error));
      if (error instanceof Refused && error.key) select(error.key);
    } finally {
      save.disabled = false;
    }
  }

  /** Select the line of a wrong key, where its name stands once. */
  function select(key: string): void {
    const last = key.split(".").pop() ?? key;
    const at = area.value.search(new RegExp(`^\\s*${last.replace(/[^\w-]/g, "")}\\s*=`, "m"));
    if (at < 0) return;
    area.focus();
    area.setSelectionRange(
      at,
      area.value.indexOf("\n", at + 1) < 0 ? area.value.length : area.value.indexOf("\n", at + 1),
    );
  }

  const ask = (event: BeforeUnloadEvent) => {
    if (area.value !== kept) event.preventDefault();
  };
  window.addEventListener("beforeunload", ask);
  root.replaceChildren(
    el("h1", {}, "Settings"),
    el("p", { class: "quiet" }, place.note),
    el(
      "div",
      { class: "bar" },
      save,
      button("Read again", () => void load()),
    ),
    done,
    wrong,
    area,
  );
  void load();
  return () => window.removeEventListener("beforeunload", ask);
}
