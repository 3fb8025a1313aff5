// The statistics of what a chart shows, as a list of definitions.

import { el } from "../dom.ts";
import type { Statistics } from "../rows.ts";
import { signed } from "../words.ts";

type Figure = readonly [name: string, text: string];

/** Shows statistics (mm), or that there are no rows, and more figures, in a `dl`. */
export function listStatistics(place: Element, found: Statistics | null, more: readonly Figure[] = []): void {
  const figures: Figure[] = found
    ? [
        ["minimum", `${signed(found.low, 3)} mm`],
        ["maximum", `${signed(found.high, 3)} mm`],
        ["range", `${(found.high - found.low).toFixed(3)} mm`],
      ]
    : [["shown", "no rows"]];
  if (found && found.mean !== null) figures.push(["mean", `${signed(found.mean, 3)} mm`]);
  if (found && found.rms !== null) figures.push(["rms about the mean", `${found.rms.toFixed(3)} mm`]);
  place.replaceChildren(
    ...[...figures, ...more].map(([name, text]) => el("div", {}, el("dt", {}, name), el("dd", {}, text))),
  );
}
