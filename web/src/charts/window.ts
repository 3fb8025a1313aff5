// The time that is shown: one that follows the newest rows, or one that is held.

export const SPANS: [seconds: number, text: string][] = [
  [1, "1 s"],
  [10, "10 s"],
  [60, "1 minute"],
  [600, "10 minutes"],
  [3600, "1 hour"],
  [10800, "3 hours"],
  [43200, "12 hours"],
  [86400, "1 day"],
  [604800, "1 week"],
  [2764800, "32 days"],
  [31622400, "1 year"],
];
// From some rows of a fast sensor to more than a year, s.
const SHORTEST_S = 0.05;
const LONGEST_S = 5 * 31622400;

export class TimeWindow {
  seconds: number;
  following = true;
  #toMs = 0;
  #now: () => number;

  constructor(seconds: number, now: () => number) {
    this.seconds = seconds;
    this.#now = now;
  }

  /** As an address has it: how long it is, s, or where it begins and ends. */
  get path(): string {
    const iso = (ms: number) => new Date(ms).toISOString();
    return this.following ? String(this.seconds) : `${iso(this.fromMs)}/${iso(this.toMs)}`;
  }

  /** Show what the parts of such an address say; anything else is left out. */
  open([first = "", last = ""]: string[]): void {
    const [from, to] = [Date.parse(first), Date.parse(last)];
    if (last && to > from) this.show(from, to);
    else if (!last && Number(first) > 0) this.zoom(Number(first) / this.seconds);
  }

  get toMs(): number {
    return this.following ? this.#now() : this.#toMs;
  }

  get fromMs(): number {
    return this.toMs - 1000 * this.seconds;
  }

  freeze(): void {
    this.#toMs = this.toMs;
    this.following = false;
  }

  follow(): void {
    this.following = true;
  }

  /** Show a given time. */
  show(fromMs: number, toMs: number): void {
    this.seconds = Math.min(Math.max((toMs - fromMs) / 1000, SHORTEST_S), LONGEST_S);
    this.#toMs = (fromMs + toMs) / 2 + 500 * this.seconds;
    this.following = false;
  }

  /** Longer (above 1) or shorter about the middle; of a window that follows its end stays the newest. */
  zoom(factor: number): void {
    const seconds = Math.min(Math.max(this.seconds * factor, SHORTEST_S), LONGEST_S);
    if (!this.following) this.#toMs += 500 * (seconds - this.seconds);
    this.seconds = seconds;
  }

  /** Earlier (negative) or later by a part of what is shown. */
  move(part: number): void {
    this.freeze();
    this.#toMs += 1000 * part * this.seconds;
  }
}
