// How long a time is shown: one of a list, or the length of one that was drawn, as a choice of its own.

import { SPANS } from "../charts/window.ts";
import { choice } from "../dom.ts";
import { duration } from "../words.ts";

const OWN = "own";

export class SpanChoice {
  root: HTMLLabelElement;
  #select: HTMLSelectElement | null;

  /** chosen: called with the seconds of one of the list. */
  constructor(seconds: number, chosen: (seconds: number) => void) {
    const spans = SPANS.map(([length, text]): [string, string] => [String(length), text]);
    this.root = choice("Shown", [...spans, [OWN, ""]], String(seconds), (value) => chosen(Number(value)));
    this.#select = this.root.querySelector("select");
    this.show(seconds);
  }

  show(seconds: number): void {
    const own = this.#select?.options[SPANS.length];
    if (!this.#select || !own) return;
    const isListed = SPANS.some(([length]) => length === seconds);
    own.hidden = isListed;
    if (!isListed && own.text !== duration(seconds)) own.text = duration(seconds);
    this.#select.value = isListed ? String(seconds) : OWN;
  }
}
