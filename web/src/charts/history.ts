// A few values over days and weeks, each with its 95 % bar: calibrations, natural frequencies.

import uPlot from "uplot";
import { axis, colour, sizeOf, TIME_TEXTS } from "./chart.ts";

export interface HistoryPoint {
  /** s since 1970. */
  x: number;
  y: number;
  /** Half of the 95 % bar; 0 for none. */
  half: number;
}
export interface History {
  /** A colour of the style sheet. */
  colour: string;
  /** Whether its points are open circles. */
  open?: boolean;
  points: HistoryPoint[];
}
type Range = [from: number, to: number];

// Of the range that points and bars take, on each side.
const MARGIN = 0.08;
// A single value stands in the middle of this share of itself, and of a day.
const ALONE_SHARE = 0.01;
const ALONE_S = 86_400;
const [RADIUS_PX, HEIGHT_PX] = [4, 220];

/** The range of values with a margin. */
export function spread(low: number, high: number, alone: number): Range {
  const margin = high > low ? MARGIN * (high - low) : alone || 1;
  return [low - margin, high + margin];
}

/** Draws histories on one axis until the end that it gives; range: of time, s, left out what the points take. */
export function historyChart(root: HTMLElement, of: History[], label: string, range?: Range): () => void {
  const all = of.flatMap((one) => one.points);
  const [x, y] = [all.map((one) => one.x), all.flatMap((one) => [one.y - one.half, one.y + one.half])];
  const xRange = range ?? spread(Math.min(...x), Math.max(...x), ALONE_S);
  const yRange = spread(Math.min(...y), Math.max(...y), Math.abs(y[0] ?? 0) * ALONE_SHARE);
  const size = () => ({ ...sizeOf(root), height: HEIGHT_PX });
  const options: uPlot.Options = {
    ...size(),
    series: [{}, { points: { show: false }, width: 0 }],
    legend: { show: false },
    scales: { x: { time: true, range: xRange }, y: { range: yRange } },
    axes: [
      { ...axis(), values: TIME_TEXTS, space: 70 },
      { ...axis(), label, labelSize: 20, size: 70 },
    ],
    cursor: { show: false },
    hooks: { draw: [(plot) => of.forEach((one) => drawHistory(plot, one))] },
  };
  const plot = new uPlot(options, [xRange, yRange], root);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const redraw = () => plot.redraw(false);
  const watched = new ResizeObserver(() => plot.setSize(size()));
  watched.observe(root);
  dark.addEventListener("change", redraw);
  return () => {
    watched.disconnect();
    dark.removeEventListener("change", redraw);
    plot.destroy();
  };
}

function drawHistory(plot: uPlot, of: History): void {
  const { ctx } = plot;
  const px = devicePixelRatio;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = colour(of.colour);
  ctx.lineWidth = 1.5 * px;
  for (const { x, y, half } of of.points) {
    const [at, value] = [plot.valToPos(x, "x", true), plot.valToPos(y, "y", true)];
    ctx.beginPath();
    ctx.moveTo(at, plot.valToPos(y - half, "y", true));
    ctx.lineTo(at, plot.valToPos(y + half, "y", true));
    ctx.stroke();
    ctx.beginPath();
    ctx.arc(at, value, RADIUS_PX * px, 0, 2 * Math.PI);
    if (!of.open) ctx.fill();
    ctx.stroke();
  }
  ctx.restore();
}
