// A form that writes points and sources into SITE.toml's text.

import { button, choice, el, say } from "../dom.ts";
import { pointNames, withoutPoint, withPoint, withSource } from "../site_text.ts";

/** What a kind of sensor asks for: an address that shows the form, and one key with its values; none: any text. */
const KINDS: Record<string, { address: string; key: string; text: string; values: string[] }> = {
  accelerometer: { address: "mqtt:bridge/acc1", key: "unit", text: "Unit", values: ["m/s^2", "g", "mg"] },
  camera: { address: "rtsp://10.0.0.21/stream", key: "direction", text: "Image axis", values: ["y", "x", "xy"] },
  infrared: { address: "rtsp://10.0.0.22/stream", key: "direction", text: "Image axis", values: ["y", "x", "xy"] },
  radar: { address: "udp:4098", key: "config", text: "Configuration file", values: [] },
  displacement: { address: "mqtt:bridge/gnss", key: "unit", text: "Unit", values: ["mm", "m"] },
  velocity: { address: "mqtt:bridge/vibrometer", key: "unit", text: "Unit", values: ["mm/s", "m/s"] },
};
const NEW = "";

/** What the form reads and changes. */
export interface Text {
  get: () => string;
  set: (text: string) => void;
}

export class SiteForm {
  root = el("details", {}, el("summary", {}, "Add or remove points and sources"));
  #text: Text;
  #said = el("p", { role: "status" });
  #body = el("div");
  #point = NEW;
  #kind = "accelerometer";

  constructor(text: Text) {
    this.#text = text;
    this.root.append(this.#body, this.#said);
    this.root.addEventListener("toggle", () => this.show());
  }

  /** Show it anew: the points may be others. */
  show(): void {
    const names = pointNames(this.#text.get()).filter((name) => name !== "");
    if (!names.includes(this.#point)) this.#point = NEW;
    this.#body.replaceChildren(this.#adding(names), this.#removing(names));
  }

  #adding(names: string[]): HTMLElement {
    const about = KINDS[this.#kind] ?? { address: "", key: "", text: "", values: [] };
    const name = el("input", { required: true, pattern: "[A-Za-z0-9_\\-]{1,64}", maxlength: 64, size: 14 });
    const address = el("input", { required: true, placeholder: about.address, size: 24 });
    const value = about.values.length ? el("select") : el("input", { required: true, placeholder: "radar.cfg" });
    for (const one of about.values) value.append(el("option", { value: one }, one));
    const points = [[NEW, "a new one"], ...names.map((one) => [one, one])] as [string, string][];
    const kinds = Object.keys(KINDS).map((one): [string, string] => [one, one]);
    return el(
      "form",
      {
        class: "bar",
        submit: (event) => {
          event.preventDefault();
          this.#add(name.value, address.value, { [about.key]: value.value });
        },
      },
      choice("Point", points, this.#point, (chosen) => this.#choose(chosen, this.#kind)),
      this.#point === NEW && el("label", {}, "Name ", name),
      choice("Sensor", kinds, this.#kind, (chosen) => this.#choose(this.#point, chosen)),
      el("label", {}, "Source ", address),
      el("label", {}, `${about.text} `, value),
      button("Insert", () => undefined, { type: "submit" }),
    );
  }

  #removing(names: string[]): HTMLElement | string {
    const [first] = names;
    if (first === undefined) return "";
    let chosen = first;
    const pick = choice(
      "Point",
      names.map((one): [string, string] => [one, one]),
      first,
      (one) => (chosen = one),
    );
    return el(
      "div",
      { class: "bar" },
      pick,
      button("Remove from the text", () => this.#remove(chosen)),
    );
  }

  #choose(point: string, kind: string): void {
    [this.#point, this.#kind] = [point, kind];
    this.show();
  }

  #add(name: string, source: string, keys: Record<string, string>): void {
    const [text, made] = [this.#text.get(), { kind: this.#kind, source: source.trim(), keys }];
    if (this.#point === NEW && pointNames(text).includes(name))
      return say(this.#said, `Point ${name} exists: choose it, or another name.`);
    const changed = this.#point === NEW ? withPoint(text, name, made) : withSource(text, this.#point, made);
    if (changed === null)
      return say(this.#said, `${this.#point} has a source of this kind: add another one with a name in the text.`);
    this.#text.set(changed);
    const point = this.#point || name;
    this.#point = point;
    this.show();
    say(this.#said, `${made.kind} of ${point} is in the text below. Check it, then save.`);
  }

  #remove(name: string): void {
    const changed = withoutPoint(this.#text.get(), name);
    if (changed === null) return say(this.#said, `${name} was not found in the text.`);
    this.#text.set(changed);
    this.show();
    say(this.#said, `${name} was removed from the text below. Its rows stay in the store. Check, then save.`);
  }
}
