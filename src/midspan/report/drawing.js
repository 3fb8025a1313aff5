// Panels one above the other with a common time axis, drawn on a canvas in the page's colours.

const MARGIN = { left: 64, right: 12, top: 8, bottom: 38, between: 12 };

/** Round numbers from low to high, about `count` of them. */
function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((k) => k * power >= raw * (1 - 1e-9));
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

class Sheet {
  constructor(canvas) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
  }
  /** Panels of these heights; x goes from time `from` to `to`. */
  open(heights, from, to) {
    const ratio = window.devicePixelRatio || 1, { canvas, pen } = this, style = getComputedStyle(canvas);
    this.colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const total = heights.reduce((sum, one) => sum + one + MARGIN.between, MARGIN.top + MARGIN.bottom - MARGIN.between);
    canvas.style.height = `${total}px`;
    this.width = canvas.clientWidth; this.height = total;
    canvas.width = Math.round(this.width * ratio); canvas.height = Math.round(total * ratio);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = this.colour("sheet"); pen.fillRect(0, 0, this.width, total);
    pen.font = "12px system-ui, sans-serif"; pen.lineJoin = "round";
    this.left = MARGIN.left; this.right = this.width - MARGIN.right;
    this.from = from; this.to = to;
    let top = MARGIN.top;
    this.panels = heights.map((height) => { const panel = { top, bottom: top + height }; top += height + MARGIN.between; return panel; });
  }
  x(time) { return this.left + (time - this.from) / (this.to - this.from) * (this.right - this.left); }
  time(x) { return this.from + (x - this.left) / (this.right - this.left) * (this.to - this.from); }
  /** Sets a panel's range and returns its vertical scale. */
  scale(number, low, high) {
    const panel = this.panels[number], pad = 0.06 * (high - low) || 1e-6;
    panel.low = low - pad; panel.high = high + pad;
    return panel.y = (v) => panel.bottom - (v - panel.low) / (panel.high - panel.low) * (panel.bottom - panel.top);
  }
  inside(panel, drawn) {
    this.pen.save(); this.pen.beginPath();
    this.pen.rect(this.left, panel.top, this.right - this.left, panel.bottom - panel.top);
    this.pen.clip(); drawn(); this.pen.restore();
  }
  shade(from, to, colour) {
    this.pen.fillStyle = colour;
    for (const panel of this.panels)
      this.pen.fillRect(this.x(from), panel.top, Math.max(this.x(to) - this.x(from), 1), panel.bottom - panel.top);
  }
  grid(panel, title, first) {
    const { pen } = this;
    pen.strokeStyle = this.colour("grid"); pen.fillStyle = this.colour("soft"); pen.lineWidth = 1;
    const up = ticks(panel.low, panel.high, Math.max(3, (panel.bottom - panel.top) / 45));
    pen.textAlign = "right"; pen.textBaseline = "middle";
    for (const v of up.found) {
      this.stroke(this.left, panel.y(v), this.right, panel.y(v));
      pen.fillText(v.toFixed(up.digits).replace("-", "−"), this.left - 6, panel.y(v));
    }
    for (const v of this.#across(first).found) this.stroke(this.x(v - first), panel.top, this.x(v - first), panel.bottom);
    pen.save(); pen.translate(12, (panel.top + panel.bottom) / 2); pen.rotate(-Math.PI / 2);
    pen.textAlign = "center"; pen.fillText(title, 0, 0); pen.restore();
  }
  timeAxis(label, first) {
    const { pen } = this, across = this.#across(first), bottom = this.panels.at(-1).bottom;
    pen.fillStyle = this.colour("soft"); pen.textAlign = "center"; pen.textBaseline = "top";
    for (const v of across.found) pen.fillText(v.toFixed(across.digits), this.x(v - first), bottom + 5);
    pen.fillText(label, (this.left + this.right) / 2, bottom + 21);
  }
  #across(first) { return ticks(this.from + first, this.to + first, Math.max(3, (this.right - this.left) / 95)); }
  stroke(x0, y0, x1, y1) { this.pen.beginPath(); this.pen.moveTo(x0, y0); this.pen.lineTo(x1, y1); this.pen.stroke(); }
  /** Runs of segments that no pause interrupts. */
  #runs(t, found, pause, drawn) {
    let start = 0;
    for (let i = 1; i <= found.length; i++) {
      const gap = i < found.length && found[i].row - found[i - 1].row === 1 && t[found[i].row] - t[found[i - 1].row] > pause;
      if (i < found.length && !gap) continue;
      if (i > start) drawn(found.slice(start, i));
      start = i;
    }
  }
  line(t, found, pause, y, colour, width = 1.5, opacity = 1) {
    const { pen } = this;
    pen.strokeStyle = colour; pen.lineWidth = width; pen.globalAlpha = opacity; pen.beginPath();
    this.#runs(t, found, pause, (run) => run.forEach(({ row, low, high }, i) => {
      const x = this.x(t[row]);
      if (i) pen.lineTo(x, y(low)); else pen.moveTo(x, y(low));
      if (high !== low) pen.lineTo(x, y(high));
    }));
    pen.stroke(); pen.globalAlpha = 1;
  }
  area(t, found, pause, y, colour) {
    const { pen } = this;
    pen.fillStyle = colour;
    this.#runs(t, found, pause, (run) => {
      pen.beginPath();
      for (const { row, high } of run) pen.lineTo(this.x(t[row]), y(high));
      for (const { row, low } of run.reverse()) pen.lineTo(this.x(t[row]), y(low));
      pen.fill();
    });
  }
  points(t, found, y, colour, half) {
    const { pen } = this, size = found.length < (this.right - this.left) / 4 ? 5 : 2.4;
    pen.fillStyle = pen.strokeStyle = colour; pen.lineWidth = 1;
    for (const { row, low, high } of found) {
      const x = this.x(t[row]);
      if (size > 3) this.stroke(x, y(low - half(row)), x, y(high + half(row)));
      if (high === low) pen.fillRect(x - size / 2, y(low) - size / 2, size, size); else this.stroke(x, y(low), x, y(high));
    }
  }
  dot(time, y, colour) {
    this.pen.fillStyle = colour; this.pen.beginPath(); this.pen.arc(this.x(time), y, 3.5, 0, 2 * Math.PI); this.pen.fill();
  }
}
