// Traces over time with uPlot: an envelope of least and largest with its 95 % band, gaps open, events as lines.

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import type { Envelope } from "../rows.ts";
import { valueRange } from "./value_range.ts";

export interface Mark {
  x: number;
  kind: string;
}
/** A limit of the value, drawn where it is in sight. */
export interface Level {
  y: number;
  name: string;
}
type Range = [fromS: number, toS: number];

// Ticks in the 24 h form. Each: smallest step (s), text, and what stands below it where year, day or minute begin.
const DAY = "\n{D} {MMM}";
export const TIME_TEXTS: uPlot.Axis.Values = [
  [31536000, "{YYYY}", null, null, null, null, null, null, 1],
  [2419200, "{MMM}", "\n{YYYY}", null, null, null, null, null, 1],
  [86400, "{D} {MMM}", "\n{YYYY}", null, null, null, null, null, 1],
  [60, "{HH}:{mm}", `${DAY} {YYYY}`, null, DAY, null, null, null, 1],
  [1, ":{ss}", `${DAY} {HH}:{mm}`, null, `${DAY} {HH}:{mm}`, null, "\n{HH}:{mm}", null, 1],
  [0.001, ":{ss}.{fff}", `${DAY} {HH}:{mm}`, null, `${DAY} {HH}:{mm}`, null, "\n{HH}:{mm}", null, 1],
];

/** A colour of the style sheet, which differs in the dark. */
export function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

const faded = (name: string, percent: number) => `color-mix(in srgb, ${colour(name)} ${percent}%, transparent)`;

export interface Drawn {
  envelope: Envelope;
}
/** How a trace is drawn: in a colour of the style sheet, with dashes (px) or without. */
export interface Style {
  colour: string;
  dash?: number[];
}

export class Chart {
  #plot: uPlot;
  #range: Range = [0, 1];
  #marks: Mark[] = [];
  #levels: Level[] = [];
  #drawn: Drawn[];
  #watched: ResizeObserver;
  #dark = window.matchMedia("(prefers-color-scheme: dark)");
  #redraw = () => this.#plot.redraw(false);

  /** selected: a range that was drawn with the mouse; read: what is below the pointer, null for nothing; isClock: x are
   * instants since 1970, else seconds of a clock of its own. */
  constructor(
    root: HTMLElement,
    styles: Style[],
    selected: (range: Range) => void,
    read: (x: number | null, values: (number | null)[]) => void,
    isClock = true,
  ) {
    this.#drawn = [];
    const series = [{}, ...styles.flatMap((style) => [0, 0, 1, 1].map((width) => lineOf(style, width)))];
    const options: uPlot.Options = {
      ...sizeOf(root),
      series,
      legend: { show: false },
      scales: { x: { time: isClock, range: () => this.#range }, y: { range: () => this.#values() } },
      axes: [
        isClock
          ? { ...axis(), values: TIME_TEXTS, space: 70 }
          : { ...axis(), label: "Time, s", labelSize: 20, space: 70 },
        { ...axis(), label: "Displacement, mm", labelSize: 20, size: 60 },
      ],
      cursor: { drag: { x: true, y: false, setScale: false }, points: { show: false } },
      hooks: {
        setSelect: [(plot) => this.#selected(plot, selected)],
        setCursor: [
          (plot) => read(plot.cursor.idx == null ? null : (plot.data[0][plot.cursor.idx] ?? null), valuesAt(plot)),
        ],
        drawAxes: [(plot) => styles.forEach((style, at) => fillBands(plot, style, 4 * at + 1))],
        draw: [(plot) => this.#drawMarks(plot)],
      },
    };
    this.#plot = new uPlot(options, [[], ...series.slice(1).map(() => [])] as uPlot.AlignedData, root);
    this.#watched = new ResizeObserver(() => this.#plot.setSize(sizeOf(root)));
    this.#watched.observe(root);
    this.#dark.addEventListener("change", this.#redraw);
  }

  /** Width of the plot, px: more buckets than that show nothing more. */
  get width(): number {
    return Math.max(Math.round(this.#plot.bbox.width), 200);
  }

  draw(range: Range, drawn: Drawn[], marks: Mark[], levels: Level[] = []): void {
    [this.#range, this.#drawn, this.#marks, this.#levels] = [range, drawn, marks, levels];
    const tables = this.#drawn.map(
      ({ envelope: of }) => [of.x, of.lower, of.upper, of.low, of.high] as uPlot.AlignedData,
    );
    const first = tables[0];
    if (!first) return;
    // Parts of one trace have one axis of time already.
    const isOne = tables.every((one) => one[0] === first[0]);
    if (isOne) this.#plot.setData([first[0], ...tables.flatMap(([, ...values]) => values)] as uPlot.AlignedData);
    else
      this.#plot.setData(
        uPlot.join(
          tables,
          tables.map((one) => one.map(() => 2)),
        ),
      );
  }

  #values(): Range {
    const found = valueRange(this.#drawn.map(({ envelope }) => envelope));
    // A tenth of it is free on each side.
    return found ? (uPlot.rangeNum(...found, 0.1, true) as Range) : [0, 1];
  }

  destroy(): void {
    this.#watched.disconnect();
    this.#dark.removeEventListener("change", this.#redraw);
    this.#plot.destroy();
  }

  #selected(plot: uPlot, selected: (range: Range) => void): void {
    const { left, width } = plot.select;
    if (width < 4) return;
    plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    selected([plot.posToVal(left, "x"), plot.posToVal(left + width, "x")]);
  }

  #drawMarks(plot: uPlot): void {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.strokeStyle = ctx.fillStyle = colour("notice");
    ctx.lineWidth = devicePixelRatio;
    ctx.setLineDash([4 * devicePixelRatio, 4 * devicePixelRatio]);
    for (const { x } of this.#marks) {
      if (x < this.#range[0] || x > this.#range[1]) continue;
      const at = plot.valToPos(x, "x", true);
      ctx.beginPath();
      ctx.moveTo(at, bbox.top);
      ctx.lineTo(at, bbox.top + bbox.height);
      ctx.stroke();
    }
    ctx.strokeStyle = ctx.fillStyle = colour("wrong");
    ctx.textAlign = "left";
    ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
    for (const { y, name } of this.#levels) {
      const at = plot.valToPos(y, "y", true);
      if (at < bbox.top || at > bbox.top + bbox.height) continue;
      ctx.beginPath();
      ctx.moveTo(bbox.left, at);
      ctx.lineTo(bbox.left + bbox.width, at);
      ctx.stroke();
      // Outside the limits, where there is room within the plot.
      const [above, below] = [at - 4 * devicePixelRatio, at + 14 * devicePixelRatio];
      const isAbove = y > 0 ? above - 12 * devicePixelRatio > bbox.top : below > bbox.top + bbox.height;
      ctx.fillText(`limit ${name}`, bbox.left + 4 * devicePixelRatio, isAbove ? above : below);
    }
    ctx.restore();
  }
}

function lineOf({ colour: name, dash }: Style, width: number): uPlot.Series {
  // Of lines without width the bands are made.
  const points = { show: false };
  return width ? { stroke: () => colour(name), width, points, ...(dash ? { dash } : {}) } : { width: 0, points };
}

/** Fills the band (lower, upper) and the envelope (low, high) of a style, whose first series it is; gaps are open. */
function fillBands(plot: uPlot, { colour: name }: Style, first: number): void {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  for (const [low, percent] of [
    [first, 22],
    [first + 2, 70],
  ] as const) {
    ctx.fillStyle = faded(name, percent);
    fillBetween(plot, low, low + 1);
  }
  ctx.restore();
}

/** Fills what lies between two series, a rectangle for each column of pixels. One polygon, or uPlot's own bands, which
 * clip to one, take three to ten times as long where buckets go up and down: its edges cross everywhere. */
function fillBetween(plot: uPlot, low: number, high: number): void {
  const [{ bbox }, [x], below, above] = [plot, plot.data, plot.data[low] ?? [], plot.data[high] ?? []];
  let last: { at: number; top: number; bottom: number } | null = null;
  x.forEach((instant, k) => {
    const [bottom, top] = [below[k], above[k]];
    if (bottom == null || top == null) return void (last = null);
    const at = Math.round(plot.valToPos(instant, "x", true));
    const now = { at, top: plot.valToPos(top, "y", true), bottom: plot.valToPos(bottom, "y", true) };
    const end = Math.min(at, bbox.left + bbox.width);
    for (let column = Math.max(last?.at ?? end, bbox.left); last && column < end; column += 1) {
      const part = (column + 0.5 - last.at) / (at - last.at);
      const from = last.top + part * (now.top - last.top);
      plot.ctx.fillRect(column, from, 1, last.bottom + part * (now.bottom - last.bottom) - from);
    }
    if (last?.at === at) [now.top, now.bottom] = [Math.min(now.top, last.top), Math.max(now.bottom, last.bottom)];
    last = now;
  });
}

export function axis(): uPlot.Axis {
  return {
    stroke: () => colour("text"),
    grid: { stroke: () => colour("grid"), width: 1 },
    ticks: { stroke: () => colour("grid"), width: 1 },
    font: "13px system-ui, sans-serif",
  };
}

export function sizeOf(root: HTMLElement): { width: number; height: number } {
  return { width: Math.max(root.clientWidth, 200), height: Math.max(Math.min(root.clientWidth * 0.5, 420), 260) };
}

function valuesAt(plot: uPlot): (number | null)[] {
  const at = plot.cursor.idx;
  return at == null ? [] : plot.data.slice(1).map((values) => values[at] ?? null);
}

/** A line over frequencies, on logarithmic density. */
export function spectrumChart(root: HTMLElement, frequency: number[], density: (number | null)[]): () => void {
  const options: uPlot.Options = {
    ...sizeOf(root),
    series: [{}, { stroke: () => colour("trace"), width: 1, points: { show: false } }],
    legend: { show: false },
    scales: { x: { time: false }, y: { distr: 3 } },
    axes: [
      { ...axis(), label: "Frequency, Hz", labelSize: 20 },
      { ...axis(), label: "mm²/Hz", labelSize: 20, size: 80, values: powers },
    ],
    cursor: { points: { show: false } },
  };
  const plot = new uPlot(options, [frequency, density.map((one) => (one !== null && one > 0 ? one : null))], root);
  const watched = new ResizeObserver(() => plot.setSize(sizeOf(root)));
  watched.observe(root);
  return () => {
    watched.disconnect();
    plot.destroy();
  };
}

// uPlot leaves the ticks between powers of ten out, as null.
function powers(_: uPlot, values: number[]): string[] {
  return values.map((one) => (one === null ? "" : one.toExponential(0).replace("e+0", "e0").replace("-", "−")));
}
