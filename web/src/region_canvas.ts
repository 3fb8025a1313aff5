// A picture with the region of interest on it: drawn and moved by mouse, touch and keys.

import { colour } from "./charts/chart.ts";
import { el } from "./dom.ts";
import { between, holds, inside, MIN_PX, type Region } from "./region.ts";

// A key moves by this much, px; with Shift by one.
const STEP_PX = 8;

export const HOW_TO_DRAW =
  "Draw or drag the region. Keys: arrows move it, with Shift by one pixel; Alt and arrows resize it.";

export class RegionCanvas {
  canvas: HTMLCanvasElement;
  region: Region | null = null;
  /** Further regions, which are shown and cannot be moved. */
  others: Region[] = [];
  /** Where targets are now: dashed. */
  tracked: Region[] = [];
  /** Whether it was drawn or moved since it was set. */
  changed = false;
  #image: ImageBitmap | null = null;
  #drag: { x: number; y: number; from: Region | null } | null = null;
  #moved: () => void;

  /** may: whether the region may be drawn; moved: called when it was drawn, or shown anew. */
  constructor(label: string, may: boolean, moved: () => void) {
    this.#moved = moved;
    this.canvas = el("canvas", {
      tabindex: 0,
      role: "img",
      "aria-label": may ? `${label} ${HOW_TO_DRAW}` : label,
      width: 640,
      height: 360,
    });
    if (may) this.#listen();
  }

  /** Show a picture of a size, px. */
  show(image: ImageBitmap, width: number, height: number): void {
    this.#image?.close();
    this.#image = image;
    this.canvas.width = width || image.width;
    this.canvas.height = height || image.height;
    this.draw();
  }

  end(): void {
    this.#image?.close();
  }

  draw(): void {
    const context = this.canvas.getContext("2d");
    if (!context || !this.#image) return;
    context.drawImage(this.#image, 0, 0, this.canvas.width, this.canvas.height);
    this.#moved();
    const scale = Math.max(this.canvas.width / 800, 1);
    // A dark line below a bright one is seen on any picture.
    for (const [style, size] of [
      ["#000", 4],
      [this.changed ? colour("notice-ground") : "#fff", 2],
    ] as const) {
      context.strokeStyle = style;
      context.lineWidth = size * scale;
      for (const { x, y, width, height } of this.region ? [this.region, ...this.others] : this.others)
        context.strokeRect(x, y, width, height);
      context.setLineDash([8 * scale, 6 * scale]);
      for (const { x, y, width, height } of this.tracked) context.strokeRect(x, y, width, height);
      context.setLineDash([]);
    }
  }

  get text(): string {
    if (!this.region) return "Region: not selected yet.";
    const { x, y, width, height } = this.region;
    return `Region: ${width} × ${height} px at ${x}, ${y}${this.changed ? " (not applied yet)" : ""}`;
  }

  #set(region: Region): void {
    this.region = inside(region, this.canvas);
    this.changed = true;
    this.draw();
  }

  #at(event: PointerEvent): { x: number; y: number } {
    const box = this.canvas.getBoundingClientRect();
    return {
      x: ((event.clientX - box.left) / box.width) * this.canvas.width,
      y: ((event.clientY - box.top) / box.height) * this.canvas.height,
    };
  }

  #listen(): void {
    this.canvas.addEventListener("pointerdown", (event) => {
      const { x, y } = this.#at(event);
      this.canvas.setPointerCapture(event.pointerId);
      this.#drag = { x, y, from: this.region && holds(this.region, x, y) ? this.region : null };
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!this.#drag || !this.#image) return;
      const [{ x, y }, { from }] = [this.#at(event), this.#drag];
      if (from) this.#set({ ...from, x: from.x + x - this.#drag.x, y: from.y + y - this.#drag.y });
      else if (Math.hypot(x - this.#drag.x, y - this.#drag.y) >= MIN_PX / 2)
        this.#set(between(this.#drag.x, this.#drag.y, x, y, this.canvas));
    });
    for (const name of ["pointerup", "pointercancel"]) this.canvas.addEventListener(name, () => (this.#drag = null));
    this.canvas.addEventListener("keydown", (event) => this.#key(event));
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
    const { width, height } = this.canvas;
    const now = this.region ?? { x: width / 2 - 32, y: height / 2 - 32, width: 64, height: 64 };
    const [dx, dy] = [way[0] * step, way[1] * step];
    this.#set(
      event.altKey
        ? between(now.x, now.y, now.x + now.width + dx, now.y + now.height + dy, this.canvas)
        : { ...now, x: now.x + dx, y: now.y + dy },
    );
  }
}
