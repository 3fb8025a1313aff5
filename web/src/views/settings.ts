// SITE.toml as text: checked before it comes into force; what is wrong stands next to it.

import { putSettings, Refused, settings } from "../api.ts";
import { button, el, say } from "../dom.ts";
import { sentenceOf, type View } from "./view.ts";

export const showSettings: View = (root, site) => {
  const area = el("textarea", { spellcheck: "false", autocapitalize: "off", "aria-label": "SITE.toml" });
  const [done, wrong] = [el("p", { class: "done", role: "status" }), el("p", { class: "wrong", role: "alert" })];
  const save = button("Check and put in force", () => void put());
  let [tag, kept] = ["*", ""];

  async function load(): Promise<void> {
    try {
      const found = await settings();
      [tag, kept, area.value] = [found.tag, found.text, found.text];
      say(wrong, site.health?.settings?.text ?? "");
    } catch (error) {
      say(wrong, sentenceOf(error));
    }
  }

  async function put(): Promise<void> {
    save.disabled = true;
    say(done, "");
    say(wrong, "");
    try {
      const found = await putSettings(area.value, tag);
      [tag, kept] = [found.tag, area.value];
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
    el(
      "p",
      { class: "quiet" },
      "SITE.toml. New settings begin the measuring anew, from the kept states. Wrong ones change nothing.",
    ),
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
};
