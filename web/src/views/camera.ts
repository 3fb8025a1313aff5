// A camera's picture on demand, and the region of interest on it; of a radar its range profile.

import {
  type CalibrationBody,
  get,
  ofPoint,
  picture,
  type Picture,
  putSettings,
  settings,
  type SourceState,
  type TrackedTarget,
} from "../api.ts";
import { button, choice, el, say } from "../dom.ts";
import { calibrated, regionOf, withRegion } from "../region.ts";
import { HOW_TO_DRAW, RegionCanvas } from "../region_canvas.ts";
import type { SiteState } from "../site_state.ts";
import { clock, duration, signed } from "../words.ts";
import { showRadar } from "./radar.ts";
import { sentenceOf, type View } from "./view.ts";

const SHOWN = ["camera", "infrared", "radar"];
// Enough to see what the camera sees and where its region is, ms; each picture costs the server a millisecond.
const PICTURE_MS = 1000;

export const showCamera: View = (root, site, name) => {
  let end: () => void = () => undefined;
  let ended = false;
  const wait = el("p", { role: "status" }, "Waiting for the cameras.");
  root.replaceChildren(el("h1", {}, "Camera"), wait);

  async function begin(): Promise<void> {
    try {
      const cameras = (await get<SourceState[]>("/sources")).filter((one) => SHOWN.includes(one.source));
      const chosen = cameras.find((one) => one.name === name) ?? cameras[0];
      if (ended) return;
      if (!chosen) return say(wait, "No camera or radar is available.");
      const names = cameras.map((one): [string, string] => [one.name, one.name]);
      const go = (other: string) => (location.hash = `#/camera/${encodeURIComponent(other)}`);
      const chooser = choice(chosen.source === "radar" ? "Radar" : "Camera", names, chosen.name, go);
      if (chosen.source === "radar") {
        end = showRadar(root, site, chosen, chooser);
        return;
      }
      const view = new CameraView(root, site, chosen, chooser);
      end = () => view.end();
    } catch (error) {
      say(wait, sentenceOf(error));
    }
  }
  void begin();
  return () => {
    ended = true;
    end();
  };
};

/** Where a target is in the newest frame, and how surely it was found there. */
function trackedWords({ name, x_px, y_px, quality, matches }: TrackedTarget, isOneOfSeveral: boolean): string {
  const of = isOneOfSeveral ? ` (${name})` : "";
  if (x_px === null || y_px === null) return `Target${of}: lost in the newest frame.`;
  const found = matches === null ? `quality ${(100 * (quality ?? 0)).toFixed(0)} %` : `${matches} matches`;
  return `Target${of} now, dashed: moved by ${signed(x_px, 2)} px to the right, ${signed(y_px, 2)} px down; ${found}.`;
}

class CameraView {
  #site: SiteState;
  #source: SourceState;
  #may: boolean;
  #drawn: RegionCanvas;
  #watching = false;
  #ended = false;
  #said = el("p", { role: "status" });
  #taken = el("p", { class: "quiet" }, " ");
  #where = el("p");
  #tracked = el("ul", { class: "keys" });
  #scale = el("p", { class: "scale", hidden: true });
  #watch = button("Watch", () => this.#toggle(), { "aria-pressed": "false" });
  #save = button("Apply the region", () => void this.#put(), { disabled: true });

  constructor(root: HTMLElement, site: SiteState, source: SourceState, chooser: HTMLElement) {
    this.#site = site;
    this.#source = source;
    this.#may = site.session.scope === "admin";
    this.#drawn = new RegionCanvas(`Image of ${source.name}.`, this.#may, () => {
      say(this.#where, this.#drawn.text);
      this.#save.disabled = !this.#drawn.changed;
    });
    root.replaceChildren(
      el("h1", {}, "Camera"),
      el(
        "div",
        { class: "bar" },
        chooser,
        button("New image", () => void this.#ask()),
        this.#watch,
        this.#may && this.#save,
      ),
      this.#said,
      el("div", { class: "picture" }, this.#drawn.canvas),
      this.#scale,
      this.#taken,
      this.#where,
      this.#tracked,
      (this.#may && el("p", { class: "quiet" }, `${HOW_TO_DRAW} Saved in SITE.toml.`)) || el("p"),
    );
    void this.#begin();
  }

  end(): void {
    this.#ended = true;
    this.#drawn.end();
  }

  async #begin(): Promise<void> {
    const { point, source } = this.#source;
    if (this.#may)
      this.#drawn.region = await settings().then(
        (found) => regionOf(found.text, { kind: source, point }),
        () => null,
      );
    this.#drawn.region ??= await get<CalibrationBody[]>(ofPoint(point, "calibrations")).then(
      (all) => calibrated(all.find((one) => one.state === "in force")?.calibration ?? {}, source),
      () => null,
    );
    await this.#ask();
  }

  async #ask(): Promise<void> {
    const trouble = this.#site.troubleOf(this.#source);
    if (trouble) return say(this.#said, trouble);
    try {
      const found = await picture(`/sources/${encodeURIComponent(this.#source.name)}`);
      const image = await createImageBitmap(found.blob);
      if (this.#ended) return image.close();
      this.#show(found, image);
      say(this.#said, "");
    } catch (error) {
      say(this.#said, sentenceOf(error));
    }
  }

  #show(found: Picture, image: ImageBitmap): void {
    this.#drawn.tracked = found.targets.flatMap(({ roi: [x, y, width, height], x_px, y_px }) =>
      x_px === null || y_px === null ? [] : [{ x: x + x_px, y: y + y_px, width, height }],
    );
    this.#tracked.replaceChildren(
      ...found.targets.map((one) => el("li", {}, trackedWords(one, found.targets.length > 1))),
    );
    this.#drawn.show(image, found.width, found.height);
    const { width, height } = this.#drawn.canvas;
    this.#scale.hidden = !found.shown;
    if (found.shown) {
      const [low, high] = [found.shown.low, found.shown.high].map((one) => signed(one, 1));
      const bar = el("span", { class: "shades", role: "img", "aria-label": "from black to white" });
      this.#scale.replaceChildren(`${low ?? ""} ${found.shown.unit} `, bar, ` ${high ?? ""} ${found.shown.unit}`);
    }
    const age = duration(Math.max(this.#site.now() - found.ms, 0) / 1000);
    say(this.#taken, `${width} × ${height} px, ${clock(found.ms)}, ${age} old`);
  }

  #toggle(): void {
    this.#watching = !this.#watching;
    this.#watch.setAttribute("aria-pressed", String(this.#watching));
    if (this.#watching) void this.#keepWatching();
  }

  async #keepWatching(): Promise<void> {
    while (this.#watching && !this.#ended) {
      if (!document.hidden) await this.#ask();
      await new Promise((resolve) => window.setTimeout(resolve, PICTURE_MS));
    }
  }

  async #put(): Promise<void> {
    const { region } = this.#drawn;
    if (!region) return;
    try {
      const { text, tag } = await settings();
      const changed = withRegion(text, { kind: this.#source.source, point: this.#source.point }, region);
      if (changed === null) throw new Error("SITE.toml has no section of this camera: set roi in Settings.");
      say(this.#said, (await putSettings(changed, tag)).text);
      this.#drawn.changed = false;
      this.#drawn.draw();
    } catch (error) {
      say(this.#said, sentenceOf(error));
    }
  }
}
