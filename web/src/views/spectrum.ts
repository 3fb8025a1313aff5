// The spectrum of a time of a point, on demand: it takes the server seconds.

import { get, type SpectrumBody } from "../api.ts";
import { spectrumChart } from "../charts/chart.ts";
import { el } from "../dom.ts";
import { sentenceOf } from "./view.ts";

export class SpectrumPanel {
  root = el("div");
  #end: () => void = () => undefined;

  /** path: of the interface, with the time. */
  async show(path: string): Promise<void> {
    this.end();
    this.root.replaceChildren(el("p", { role: "status" }, "Computing the spectrum."));
    try {
      const found = await get<SpectrumBody>(path);
      if (!found.frequency_hz.length) throw new Error(`There is no spectrum: ${found.reason}`);
      const frame = el("div", { class: "chart", role: "img", "aria-label": "Spectrum of displacement" });
      const modes = found.modes.map((one) => `${(one["frequency_hz"] ?? NaN).toFixed(3)} Hz`).join(", ");
      const text = modes ? `Natural frequencies: ${modes}` : "No natural frequency is significant.";
      this.root.replaceChildren(el("h2", {}, "Spectrum"), el("p", {}, text), frame);
      const frequency = found.frequency_hz.map((one) => one ?? 0);
      this.#end = spectrumChart(frame, frequency, found.density_mm2_hz);
    } catch (error) {
      this.root.replaceChildren(el("p", { class: "wrong" }, sentenceOf(error)));
    }
  }

  end(): void {
    this.#end();
    this.#end = () => undefined;
  }
}
