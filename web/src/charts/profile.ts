// A radar's range profile: power over range, with the targets of its point.

import uPlot from "uplot";
import type { ProfileBody } from "../api.ts";
import { axis, colour, sizeOf } from "./chart.ts";

// What is weaker than this is noise, dB of the strongest bin.
const WEAKEST_DB = -90;

export class ProfileChart {
  #plot: uPlot;
  #marks: { x: number; text: string }[] = [];
  #watched: ResizeObserver;
  #dark = window.matchMedia("(prefers-color-scheme: dark)");
  #redraw = () => this.#plot.redraw(false);

  constructor(root: HTMLElement, isRange: boolean) {
    const options: uPlot.Options = {
      ...sizeOf(root),
      series: [{}, { stroke: () => colour("trace"), width: 1.5, points: { show: false } }],
      legend: { show: false },
      // Room above the strongest bin for the names of targets.
      scales: { x: { time: false }, y: { range: (_, low) => [Math.max(low, WEAKEST_DB), 8] } },
      axes: [
        { ...axis(), label: isRange ? "Range, m" : "Range bin", labelSize: 20 },
        { ...axis(), label: "dB relative to the strongest", labelSize: 20, size: 60 },
      ],
      cursor: { show: false },
      hooks: { draw: [(plot) => this.#drawMarks(plot)] },
    };
    this.#plot = new uPlot(options, [[], []], root);
    this.#watched = new ResizeObserver(() => this.#plot.setSize(sizeOf(root)));
    this.#watched.observe(root);
    this.#dark.addEventListener("change", this.#redraw);
  }

  draw(of: ProfileBody): void {
    this.#marks = of.targets.flatMap((one, at) => {
      const x = of.range_m ? one.range_m : one.bin;
      return x === null ? [] : [{ x, text: `target ${at + 1}` }];
    });
    this.#plot.setData([of.range_m ?? of.magnitude_db.map((_, at) => at), of.magnitude_db]);
  }

  end(): void {
    this.#watched.disconnect();
    this.#dark.removeEventListener("change", this.#redraw);
    this.#plot.destroy();
  }

  #drawMarks(plot: uPlot): void {
    const { ctx, bbox } = plot;
    const px = devicePixelRatio;
    ctx.save();
    ctx.strokeStyle = ctx.fillStyle = colour("second");
    ctx.setLineDash([4 * px, 4 * px]);
    ctx.lineWidth = px;
    ctx.textAlign = "left";
    ctx.font = `${12 * px}px system-ui, sans-serif`;
    for (const { x, text } of this.#marks) {
      const at = plot.valToPos(x, "x", true);
      ctx.beginPath();
      ctx.moveTo(at, bbox.top);
      ctx.lineTo(at, bbox.top + bbox.height);
      ctx.stroke();
      ctx.fillText(text, at + 4 * px, bbox.top + 12 * px);
    }
    ctx.restore();
  }
}
