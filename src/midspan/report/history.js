// The time history: legend, read-out, ranges, keyboard, pointer. Without it the drawn figure stays.

const WORDS = ["tracking", "coasting", "lost"];
const COLOURS = { line: "result", under: "reference", points: "sensor" };
const HEIGHTS = { displacement: 270, velocity: 110, acceleration: 110, "σ": 64 };

class TimeHistory {
  constructor(figure, layout, columns) {
    Object.assign(this, layout);
    for (const line of this.lines) {
      line.t = columns[line.time]; line.v = columns[line.value]; line.s = columns[line.std];
      line.levels = pyramid(line.v, line.v);
      line.shown = line.shape !== "points" && line.panel === "displacement";
    }
    this.main = this.lines[0];
    const { v, s, t } = this.main;
    this.bands = pyramid(v.map((d, i) => d - this.band * s[i]), v.map((d, i) => d + this.band * s[i]));
    this.stds = pyramid(s, s);
    this.codes = pyramid(columns[this.status], columns[this.status]);
    this.start = t[0]; this.end = t.at(-1);
    this.step = (this.end - this.start) / Math.max(t.length - 1, 1);
    this.from = this.start; this.to = this.end;
    this.showBand = true; this.cursor = null;
    this.#build(figure);
    this.draw();
  }

  #build(figure) {
    const made = (tag, kind, text = "") => Object.assign(document.createElement(tag), { className: kind, textContent: text });
    const chart = made("div", "chart"), bar = made("div", "bar"), keys = made("div", "keys");
    this.canvas = made("canvas", "");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "application");
    this.readout = made("output", "readout");
    this.buttons = [["whole", Infinity], ["60 s", 60], ["10 s", 10], ["1 s", 1]].map(([text, length]) => {
      const button = made("button", "range", text);
      button.type = "button"; button.disabled = length < Infinity && length >= this.end - this.start;
      button.addEventListener("click", () => this.length(length));
      bar.append(button);
      return { button, length };
    });
    if (this.main.every) {
      const save = made("button", "save", "CSV");
      save.type = "button"; save.title = "Rows of the shown range as a CSV file";
      save.addEventListener("click", () => this.#save());
      bar.append(save);
    }
    const key = (text, colour, shape, toggle, on) => {
      const found = made(toggle ? "button" : "span", "key"), swatch = made("i", `swatch ${shape}`);
      swatch.style.setProperty("--own", `var(--${colour})`);
      found.append(swatch, text);
      if (toggle) {
        found.type = "button"; found.setAttribute("aria-pressed", on);
        found.addEventListener("click", () => { found.setAttribute("aria-pressed", on = !on); toggle(on); this.draw(); });
      }
      keys.append(found);
    };
    for (const line of this.lines) {
      key(line.name, COLOURS[line.shape], line.shape, line !== this.main && ((on) => { line.shown = on; }), line.shown);
      if (line === this.main) key(`±${this.band} σ`, "band", "area", (on) => { this.showBand = on; }, true);
    }
    for (const code of [1, 2]) if (this.codes[0].low.includes(code)) key(WORDS[code], WORDS[code], "area");
    const hint = made("p", "note hint", matchMedia("(pointer: coarse)").matches
      ? "Touch to read values, drag sideways to move, two fingers zoom."
      : "Drag to move; the wheel zooms with Ctrl, or after a click. Keys: ← → cursor, + − zoom, Home whole record.");
    chart.append(bar, keys, this.canvas, this.readout, hint);
    figure.prepend(chart);
    figure.classList.add("live");
    this.sheet = new Sheet(this.canvas);
    this.#listen();
  }

  /** Show `length` seconds about the cursor, or about the middle of what is shown. */
  length(length) {
    const middle = this.cursor ?? (this.from + this.to) / 2;
    this.show(middle - length / 2, length);
  }
  show(from, length) {
    length = Math.min(Math.max(length, 10 * this.step), this.end - this.start);
    this.from = Math.min(Math.max(from, this.start), this.end - length); this.to = this.from + length;
    this.draw();
  }
  zoom(factor, at) { this.show(at - (at - this.from) * factor, (this.to - this.from) * factor); }
  point(time) { this.cursor = time === null ? null : this.main.t[nearest(this.main.t, time)]; this.draw(); }

  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.#draw(); });
  }
  #draw() {
    const { sheet, main, first } = this;
    const names = [...new Set(this.lines.filter((line) => line.shown).map((line) => line.panel)), "σ"];
    sheet.open(names.map((name) => HEIGHTS[name]), this.from, this.to);
    this.#shade();
    names.forEach((name, number) => {
      const lines = this.lines.filter((line) => line.shown && line.panel === name);
      const y = sheet.scale(number, ...this.#range(lines, name)), panel = sheet.panels[number];
      sheet.grid(panel, `${name} (${lines[0]?.unit ?? main.unit})`, first);
      sheet.inside(panel, () => {
        if (name === "σ") return sheet.line(main.t, this.#seen(main, this.stds), main.pause, y, sheet.colour("result"));
        if (name === main.panel && this.showBand)
          sheet.area(main.t, this.#seen(main, this.bands), main.pause, y, sheet.colour("band"));
        for (const line of [...lines].sort((a, b) => (a === main) - (b === main))) this.#line(line, y);
        this.#mark(panel, lines, y);
      });
    });
    sheet.timeAxis(this.label, first);
    this.#say();
  }
  /** What of a line's segments lies in the view, one more on each side; a few for each dot. */
  #seen(line, levels) {
    const a = Math.max(0, rowAt(line.t, this.from) - 1), b = Math.min(line.t.length, rowAt(line.t, this.to) + 2);
    return segments(levels, a, b, 4 * (this.sheet.right - this.sheet.left));
  }
  #range(lines, name) {
    let low = Infinity, high = -Infinity;
    const take = (found) => { for (const one of found) { if (one.low < low) low = one.low; if (one.high > high) high = one.high; } };
    if (name === "σ") { take(this.#seen(this.main, this.stds)); return [0, high]; }
    for (const line of lines) take(this.#seen(line, line.levels));
    if (name !== this.main.panel || !this.showBand) return [low, high];
    // A band that grows in a gap must not hide the motion.
    const own = [low, high], room = Math.max((high - low) / 2, 2 * this.band * this.main.typical);
    take(this.#seen(this.main, this.bands));
    return [Math.max(low, own[0] - room), Math.min(high, own[1] + room)];
  }
  #shade() {
    const { t } = this.main, found = this.#seen(this.main, this.codes);
    for (let i = 0, end; i < found.length; i = end) {
      const { row, high: code } = found[i];
      for (end = i + 1; end < found.length && found[end].high === code;) end++;
      const last = t[found[end]?.row ?? t.length - 1];
      if (code) this.sheet.shade(Math.max(t[row], this.from), Math.min(last, this.to), this.sheet.colour(WORDS[code]));
    }
  }
  #line(line, y) {
    const { sheet, band } = this, colour = sheet.colour(COLOURS[line.shape]), found = this.#seen(line, line.levels);
    if (line.shape === "points") sheet.points(line.t, found, y, colour, (row) => band * line.s[row]);
    // The reference lies under the result's line and is wider: where both agree it shows on either side.
    else if (line.shape === "under") sheet.line(line.t, found, line.pause, y, colour, 4.5, 0.6);
    else sheet.line(line.t, found, line.pause, y, colour);
  }
  #mark(panel, lines, y) {
    if (this.cursor === null || this.cursor < this.from || this.cursor > this.to) return;
    const { sheet } = this, x = sheet.x(this.cursor);
    sheet.pen.strokeStyle = sheet.colour("ink"); sheet.pen.lineWidth = 1;
    sheet.stroke(x, panel.top, x, panel.bottom);
    for (const line of lines.filter((one) => one.shape === "line")) {
      const row = nearest(line.t, this.cursor);
      sheet.dot(line.t[row], y(line.v[row]), sheet.colour("result"));
    }
  }

  /** The read-out, the label for those who do not see, the buttons. */
  #say() {
    const length = this.to - this.from, { first } = this, ends = [this.from, this.to].map((t) => (t + first).toPrecision(6));
    this.canvas.setAttribute("aria-label", `Chart of the displacement from ${ends[0]} to ${ends[1]} s. The arrow keys ` +
      "move a cursor, plus and minus zoom, Home shows the whole record.");
    for (const { button, length: own } of this.buttons)
      button.setAttribute("aria-pressed", Math.abs(Math.min(own, this.end - this.start) - length) < 1e-6 * length);
    this.readout.textContent = this.cursor === null ? "" : this.#values(this.cursor).join(" · ");
  }
  /** The shown rows as a file: times, what has a value at each of them, status. */
  #save() {
    const { main } = this;
    const named = this.lines.filter((line) => line.time === main.time).flatMap((line) => {
      const unit = line.unit.replace("/", "_").replace("²", "2");
      const value = [`${line.name}_${unit}`, line.v, this.#digits(line.value)];
      return line.s ? [value, [`${line.name}_std_${unit}`, line.s, this.#digits(line.std)]] : [value];
    });
    const clock = this.label === "time (s)" ? "time_s" : this.label;
    const rows = [[clock, ...named.map(([name]) => name), "status"].join(",")];
    for (let row = rowAt(main.t, this.from); row < main.t.length && main.t[row] <= this.to; row++) {
      const values = named.map(([, value, digits]) => value[row].toFixed(digits));
      rows.push([(main.t[row] + this.first).toFixed(6), ...values, WORDS[this.codes[0].low[row]]].join(","));
    }
    const link = document.createElement("a"), ends = [this.from, this.to].map((t) => (t + this.first).toFixed(2));
    link.href = URL.createObjectURL(new Blob([rows.join("\n"), "\n"], { type: "text/csv" }));
    link.download = `displacement_${ends.join("_to_")}_s.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 0);
  }
  #digits(column) { return Math.max(0, Math.ceil(-Math.log10(this.columns[column].quantum) - 1e-9)); }
  #values(time) {
    const sign = (value, digits) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;
    const code = this.codes[0].low[nearest(this.main.t, time)];
    const shown = (t) => `${(t + this.first).toFixed(Math.max(3, Math.ceil(-Math.log10(this.step)) + 1))} s`;
    const texts = [`t = ${shown(time)}`];
    for (const line of this.lines.filter((one) => one.shown)) {
      const row = nearest(line.t, time), digits = this.#digits(line.value);
      if (Math.abs(line.t[row] - time) > 2 * Math.max(this.step, (line.t.at(-1) - line.t[0]) / line.t.length)) continue;
      const half = line.s ? ` ± ${(this.band * line.s[row]).toPrecision(3)}` : "";
      const own = Math.abs(line.t[row] - time) > this.step / 2 ? ` at ${shown(line.t[row])}` : "";
      texts.push(`${line.name} ${sign(line.v[row], digits)}${half} ${line.unit}${own}`);
    }
    return [...texts, WORDS[code]];
  }

  #listen() {
    const { canvas } = this, fingers = new Map();
    const place = (event) => event.clientX - canvas.getBoundingClientRect().left;
    const timeAt = (event) => this.sheet.time(place(event));
    let held = [];
    const hold = () => { held = [...fingers.values()].map((x) => this.sheet.time(x)); };
    canvas.addEventListener("pointerdown", (event) => {
      fingers.set(event.pointerId, place(event)); hold();
      canvas.setPointerCapture(event.pointerId);
      this.#read(timeAt(event), "off");
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!fingers.has(event.pointerId)) { if (event.pointerType === "mouse") this.#read(timeAt(event), "off"); return; }
      fingers.set(event.pointerId, place(event));
      this.#follow([...fingers.values()], held);
    });
    for (const end of ["pointerup", "pointercancel"])
      canvas.addEventListener(end, (event) => { fingers.delete(event.pointerId); hold(); });
    canvas.addEventListener("pointerleave", (event) => { if (event.pointerType === "mouse" && !fingers.size && document.activeElement !== canvas) this.point(null); });
    canvas.addEventListener("dblclick", () => this.show(this.start, Infinity));
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey && document.activeElement !== canvas) return;
      // Where there is nothing more to show the page scrolls on.
      if (event.deltaY > 0 && this.to - this.from >= this.end - this.start) return;
      event.preventDefault();
      this.zoom(Math.exp(0.0015 * event.deltaY), timeAt(event));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.#key(event));
    new ResizeObserver(() => { if (canvas.clientWidth !== this.sheet.width) this.draw(); }).observe(canvas);
    for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", () => this.draw());
  }
  #read(time, live) { this.readout.setAttribute("aria-live", live); this.point(time); }
  /** The times under one or two fingers stay under them. */
  #follow(places, held) {
    const across = this.sheet.right - this.sheet.left, [a, b] = places;
    let length = this.to - this.from;
    if (places.length > 1 && Math.abs(b - a) > 10) length = Math.abs((held[1] - held[0]) / (b - a)) * across;
    this.show(held[0] - (a - this.sheet.left) / across * length, length);
  }
  #key(event) {
    const length = this.to - this.from, middle = this.cursor ?? (this.from + this.to) / 2;
    const step = (event.shiftKey ? 10 : 1) * Math.max(this.step, length / 200);
    const moves = {
      ArrowLeft: () => this.#read(Math.max(middle - step, this.start), "polite"),
      ArrowRight: () => this.#read(Math.min(middle + step, this.end), "polite"),
      "+": () => this.zoom(0.5, middle), "=": () => this.zoom(0.5, middle), "-": () => this.zoom(2, middle),
      Home: () => this.show(this.start, Infinity),
      Escape: () => { this.canvas.blur(); this.point(null); },
    };
    if (!moves[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    moves[event.key]();
    // The view follows a cursor that leaves it.
    const at = this.cursor, now = this.to - this.from;
    if (at !== null && (at < this.from || at > this.to)) this.show(at - now / 2, now);
  }
}

for (const figure of document.querySelectorAll("figure[data-chart]")) {
  const layout = JSON.parse(figure.dataset.chart);
  if (window.DecompressionStream) unpack(figure.dataset.rows, layout.columns).then((columns) => new TimeHistory(figure, layout, columns));
}
