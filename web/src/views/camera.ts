// A camera's picture on demand, and the region of interest: drawn and moved by mouse, touch and keys.

import {
  type CalibrationBody,
  get,
  ofPoint,
  picture,
  type Picture,
  putSettings,
  settings,
  type SourceState,
} from "../api.ts";
import { colour } from "../charts/chart.ts";
import { button, choice, el, say } from "../dom.ts";
import { between, calibrated, holds, inside, MIN_PX, type Region, regionOf, withRegion } from "../region.ts";
import type { SiteState } from "../site_state.ts";
import { clock, duration } from "../words.ts";
import { sentenceOf, type View } from "./view.ts";

const CAMERAS = ["camera", "infrared"];
// The server has a new picture so often, ms.
const PICTURE_MS = 500;
// A key moves by this much, px; with Shift by one.
const STEP_PX = 8;

export const showCamera: View = (root, site, name) => {
  let end: () => void = () => undefined;
  let ended = false;
  const wait = el("p", { role: "status" }, "Waiting for the cameras.");
  root.replaceChildren(el("h1", {}, "Camera"), wait);

  async function begin(): Promise<void> {
    try {
      const cameras = (await get<SourceState[]>("/sources")).filter((one) => CAMERAS.includes(one.source));
      const chosen = cameras.find((one) => one.name === name) ?? cameras[0];
      if (ended) return;
      if (!chosen) return say(wait, "No camera brings pictures here now.");
      const view = new CameraView(root, site, chosen, cameras);
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

class CameraView {
  #site: SiteState;
  #source: SourceState;
  #may: boolean;
  #canvas: HTMLCanvasElement;
  #image: ImageBitmap | null = null;
  #region: Region | null = null;
  #changed = false;
  #watching = false;
  #ended = false;
  #drag: { x: number; y: number; from: Region | null } | null = null;
  #said = el("p", { role: "status" });
  #taken = el("p", { class: "quiet" }, " ");
  #where = el("p");
  #watch = button("Watch", () => this.#toggle(), { "aria-pressed": "false" });
  #save = button("Put the region in force", () => void this.#put(), { disabled: true });

  constructor(root: HTMLElement, site: SiteState, source: SourceState, all: SourceState[]) {
    this.#site = site;
    this.#source = source;
    this.#may = site.session.scope === "admin";
    const hint = this.#may
      ? " Draw or drag the region; keys: arrows move, Shift and arrows by one pixel, Alt and arrows size it."
      : "";
    this.#canvas = el("canvas", {
      tabindex: 0,
      role: "img",
      "aria-label": `Picture of ${source.name}.${hint}`,
      width: 640,
      height: 360,
    });
    const names = all.map((one): [string, string] => [one.name, one.name]);
    root.replaceChildren(
      el("h1", {}, "Camera"),
      el(
        "div",
        { class: "bar" },
        choice("Camera", names, source.name, (name) => (location.hash = `#/camera/${encodeURIComponent(name)}`)),
        button("New picture", () => void this.#ask()),
        this.#watch,
        this.#may && this.#save,
      ),
      this.#said,
      el("div", { class: "picture" }, this.#canvas),
      this.#taken,
      this.#where,
      (this.#may && el("p", { class: "quiet" }, `${hint.trim()} It is written into SITE.toml.`)) || el("p"),
    );
    if (this.#may) this.#listen();
    void this.#begin();
  }

  end(): void {
    this.#ended = true;
    this.#image?.close();
  }

  async #begin(): Promise<void> {
    const { point, source } = this.#source;
    if (this.#may)
      this.#region = await settings().then(
        (found) => regionOf(found.text, point, source),
        () => null,
      );
    this.#region ??= await get<CalibrationBody[]>(ofPoint(point, "calibrations")).then(
      (all) => calibrated(all.find((one) => one.state === "in force")?.calibration ?? {}, source),
      () => null,
    );
    await this.#ask();
  }

  async #ask(): Promise<void> {
    try {
      const found = await picture(this.#source.name);
      const image = await createImageBitmap(found.blob);
      if (this.#ended) return image.close();
      this.#image?.close();
      this.#image = image;
      this.#show(found, image);
      say(this.#said, "");
    } catch (error) {
      say(this.#said, sentenceOf(error));
    }
  }

  #show(found: Picture, image: ImageBitmap): void {
    this.#canvas.width = found.width || image.width;
    this.#canvas.height = found.height || image.height;
    const age = duration(Math.max(this.#site.now() - found.ms, 0) / 1000);
    say(this.#taken, `${this.#canvas.width} × ${this.#canvas.height} px, ${clock(found.ms)}, ${age} old`);
    this.#draw();
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

  #draw(): void {
    const context = this.#canvas.getContext("2d");
    if (!context || !this.#image) return;
    context.drawImage(this.#image, 0, 0, this.#canvas.width, this.#canvas.height);
    say(this.#where, this.#regionText());
    this.#save.disabled = !this.#changed;
    if (!this.#region) return;
    const { x, y, width, height } = this.#region;
    // A dark line below a bright one is seen on any picture.
    for (const [style, size] of [
      ["#000", 4],
      [this.#changed ? colour("notice-ground") : "#fff", 2],
    ] as const) {
      context.strokeStyle = style;
      context.lineWidth = size * Math.max(this.#canvas.width / 800, 1);
      context.strokeRect(x, y, width, height);
    }
  }

  #regionText(): string {
    if (!this.#region) return "Region: not chosen yet.";
    const { x, y, width, height } = this.#region;
    return `Region: ${width} × ${height} px at ${x}, ${y}${this.#changed ? " (not in force yet)" : ""}`;
  }

  #set(region: Region): void {
    this.#region = inside(region, this.#canvas);
    this.#changed = true;
    this.#draw();
  }

  #at(event: PointerEvent): { x: number; y: number } {
    const box = this.#canvas.getBoundingClientRect();
    return {
      x: ((event.clientX - box.left) / box.width) * this.#canvas.width,
      y: ((event.clientY - box.top) / box.height) * this.#canvas.height,
    };
  }

  #listen(): void {
    this.#canvas.addEventListener("pointerdown", (event) => {
      const { x, y } = this.#at(event);
      this.#canvas.setPointerCapture(event.pointerId);
      this.#drag = { x, y, from: this.#region && holds(this.#region, x, y) ? this.#region : null };
    });
    this.#canvas.addEventListener("pointermove", (event) => {
      if (!this.#drag || !this.#image) return;
      const [{ x, y }, { from }] = [this.#at(event), this.#drag];
      if (from) this.#set({ ...from, x: from.x + x - this.#drag.x, y: from.y + y - this.#drag.y });
      else if (Math.hypot(x - this.#drag.x, y - this.#drag.y) >= MIN_PX / 2)
        this.#set(between(this.#drag.x, this.#drag.y, x, y));
    });
    for (const name of ["pointerup", "pointercancel"]) this.#canvas.addEventListener(name, () => (this.#drag = null));
    this.#canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  #key(event: KeyboardEvent): void {
    const ways: Record<string, [number, number]> = {
      ArrowLeft: [-1, 0],
      ArrowRight: [1, 0],
      ArrowUp: [0, -1],
      ArrowDown: [0, 1],
    };
    const way = ways[event.key];
    if (!way || !this.#image) return;
    event.preventDefault();
    const step = event.shiftKey ? 1 : STEP_PX;
    const { width, height } = this.#canvas;
    const now = this.#region ?? { x: width / 2 - 32, y: height / 2 - 32, width: 64, height: 64 };
    const [dx, dy] = [way[0] * step, way[1] * step];
    this.#set(
      event.altKey
        ? { ...now, width: now.width + dx, height: now.height + dy }
        : { ...now, x: now.x + dx, y: now.y + dy },
    );
  }

  async #put(): Promise<void> {
    if (!this.#region) return;
    try {
      const { text, tag } = await settings();
      const changed = withRegion(text, this.#source.point, this.#source.source, this.#region);
      if (changed === null)
        throw new Error("The section of this camera is not found in SITE.toml: write roi there, in Settings.");
      say(this.#said, (await putSettings(changed, tag)).text);
      this.#changed = false;
      this.#draw();
    } catch (error) {
      say(this.#said, sentenceOf(error));
    }
  }
}
