// The time history to zoom and drag; without it the drawn figure stays. Data: float32 columns, see history_data.py.
"use strict";
(() => {
  const figure = document.querySelector("figure[data-history]");
  if (!figure || !window.atob || !window.PointerEvent) return;
  const { rows, names, first, label, grounds, pause } = JSON.parse(figure.dataset.layout);
  const bytes = Uint8Array.from(atob(figure.dataset.history), (c) => c.charCodeAt(0));
  const all = new Float32Array(bytes.buffer);
  const column = Object.fromEntries(names.map((name, i) => [name, all.subarray(i * rows, (i + 1) * rows)]));
  const t = column.t, end = t[rows - 1];
  const canvas = document.createElement("canvas");
  const still = figure.querySelector("img");
  const hint = document.createElement("div");
  hint.className = "note interactive-hint";
  hint.textContent = "Turn the wheel to zoom, drag to move, double-click for the whole record.";
  figure.insertBefore(canvas, still);
  figure.insertBefore(hint, still);
  still.style.display = "none";
  let from = t[0], to = end, width = 0, height = 0;
  const margin = { left: 62, right: 10, top: 10, bottom: 40 };
  const pen = canvas.getContext("2d");

  function index(time) { // first row at or after `time`
    let low = 0, high = rows;
    while (low < high) { const mid = (low + high) >> 1; if (t[mid] < time) low = mid + 1; else high = mid; }
    return low;
  }
  function ticks(low, high, count) {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find((k) => k * power >= raw);
    const found = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
    return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  }
  function draw() {
    const ratio = window.devicePixelRatio || 1;
    width = canvas.clientWidth - 14; height = Math.round(Math.min(340, Math.max(220, 0.34 * width)));
    canvas.width = width * ratio; canvas.height = height * ratio;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    const a = Math.max(0, index(from) - 1), b = Math.min(rows, index(to) + 2);
    let low = Infinity, high = -Infinity;
    for (const name of names) {
      if (name === "t") continue;
      for (let i = a; i < b; i++) { const v = column[name][i]; if (v < low) low = v; if (v > high) high = v; }
    }
    const pad = 0.05 * (high - low || 1e-3); low -= pad; high += pad;
    const x = (v) => margin.left + (v - from) / (to - from) * (width - margin.left - margin.right);
    const y = (v) => height - margin.bottom - (v - low) / (high - low) * (height - margin.top - margin.bottom);
    axes(x, y, low, high);
    pen.save();
    pen.beginPath();
    pen.rect(margin.left, margin.top, width - margin.left - margin.right, height - margin.top - margin.bottom);
    pen.clip();
    for (const [start, length, colour] of grounds) {
      pen.fillStyle = colour;
      pen.fillRect(x(start), margin.top, Math.max(x(start + length) - x(start), 1), height - margin.top - margin.bottom);
    }
    area(a, b, x, y, "band_low", "band_high", "rgba(86,180,233,0.45)");
    if (column.reference_low) line(a, b, x, y, "reference_low", "reference_high", "#D55E00", [5, 3]);
    line(a, b, x, y, "low", "high", "#0072B2", []);
    pen.restore();
  }
  function axes(x, y, low, high) {
    pen.fillStyle = "#fff"; pen.fillRect(0, 0, width, height);
    pen.font = "12px system-ui, sans-serif"; pen.fillStyle = "#444"; pen.strokeStyle = "#e3e3e3"; pen.lineWidth = 1;
    const across = ticks(from + first, to + first, Math.max(3, width / 120)), up = ticks(low, high, 6);
    pen.textAlign = "center"; pen.textBaseline = "top";
    for (const v of across.found) {
      const at = x(v - first);
      stroke(at, margin.top, at, height - margin.bottom);
      pen.fillText(v.toFixed(across.digits), at, height - margin.bottom + 5);
    }
    pen.fillText(label, (margin.left + width) / 2, height - 17);
    pen.textAlign = "right"; pen.textBaseline = "middle";
    for (const v of up.found) { stroke(margin.left, y(v), width - margin.right, y(v)); pen.fillText(v.toFixed(up.digits), margin.left - 6, y(v)); }
    pen.save(); pen.translate(12, height / 2 - 10); pen.rotate(-Math.PI / 2); pen.textAlign = "center";
    pen.fillText("displacement (mm)", 0, 0); pen.restore();
  }
  function stroke(x0, y0, x1, y1) { pen.beginPath(); pen.moveTo(x0, y0); pen.lineTo(x1, y1); pen.stroke(); }
  function area(a, b, x, y, lower, upper, colour) {
    pen.fillStyle = colour;
    for (let start = a, i = a + 1; i <= b; i++) {
      if (i < b && t[i] - t[i - 1] <= pause) continue;
      pen.beginPath();
      for (let k = start; k < i; k++) pen.lineTo(x(t[k]), y(column[upper][k]));
      for (let k = i - 1; k >= start; k--) pen.lineTo(x(t[k]), y(column[lower][k]));
      pen.fill();
      start = i;
    }
  }
  function line(a, b, x, y, lower, upper, colour, dash) {
    pen.beginPath();
    let down = false;
    for (let i = a; i < b; i++) {
      const bottom = column[lower][i], top = column[upper][i];
      if (!(bottom === bottom)) { down = false; continue; }
      if (i > 0 && t[i] - t[i - 1] > pause) down = false;
      if (down) pen.lineTo(x(t[i]), y(bottom)); else pen.moveTo(x(t[i]), y(bottom));
      if (top !== bottom) pen.lineTo(x(t[i]), y(top));
      down = true;
    }
    pen.strokeStyle = colour; pen.lineWidth = 1.2; pen.setLineDash(dash); pen.stroke(); pen.setLineDash([]);
  }
  function show(start, length) {
    length = Math.min(Math.max(length, 20 * end / Math.max(rows, 100)), end - t[0]);
    from = Math.min(Math.max(start, t[0]), end - length); to = from + length;
    window.requestAnimationFrame(draw);
  }
  const perPixel = () => (to - from) / (width - margin.left - margin.right);
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const factor = Math.exp(0.0015 * event.deltaY), at = from + (event.offsetX - 7 - margin.left) * perPixel();
    show(at - (at - from) * factor, (to - from) * factor);
  }, { passive: false });
  let held = null;
  canvas.addEventListener("pointerdown", (event) => { held = { x: event.clientX, from }; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointermove", (event) => { if (held) show(held.from - (event.clientX - held.x) * perPixel(), to - from); });
  canvas.addEventListener("pointerup", () => { held = null; });
  canvas.addEventListener("dblclick", () => show(t[0], end - t[0]));
  window.addEventListener("resize", draw);
  draw();
})();
