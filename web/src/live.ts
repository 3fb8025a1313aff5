// Live rows over the websocket: connected again after a cut from the newest sequence on, so that no row is missing.

import type { AlarmBody, Health, PointStands, Rows } from "./api.ts";
import type { Head } from "./rows.ts";

export interface RowsMessage extends Rows {
  sequence: number;
  point: string;
}
export interface EventMessage {
  type: "event";
  point: string;
  time_ns: number;
  kind: string;
  text: string;
}
export interface GapMessage {
  type: "gap";
  after: number;
  first: number;
}
/** Rows that are not final yet. */
export interface HeadMessage extends Head {
  type: "head";
  point: string;
}
/** How points stand that stand otherwise than before, and all that is wrong; again: other points are there. */
export interface StateMessage extends Omit<Health, "points"> {
  type: "state";
  points: PointStands[];
  again: boolean;
}
export type AlarmMessage = AlarmBody & { type: "alarm" };
export type Message = RowsMessage | EventMessage | GapMessage | HeadMessage | StateMessage | AlarmMessage;

// Tried again after, ms: at first at once, later as a server's restart takes seconds.
const FIRST_MS = 250;
const LAST_MS = 5000;
// With rows five times a second a connection on which nothing came for so long is looked at anew, ms.
const SILENT_MS = 15_000;

export class Live {
  connected = false;
  /** Called at each connection: what changed meanwhile did not come. */
  opened: () => void = () => undefined;
  /** When something came last, ms of performance.now(). */
  heard = 0;
  #sequence = 0;
  #socket: WebSocket | null = null;
  #wait = FIRST_MS;
  #timer = 0;
  #closed = true;
  #listeners = new Set<(message: Message) => void>();

  listen(listener: (message: Message) => void): () => void {
    this.#listeners.add(listener);
    return () => void this.#listeners.delete(listener);
  }

  open(): void {
    if (!this.#closed) return;
    this.#closed = false;
    this.#connect();
  }

  close(): void {
    this.#closed = true;
    window.clearTimeout(this.#timer);
    this.#socket?.close();
    this.#socket = null;
    this.connected = false;
    this.#sequence = 0;
  }

  /** Connect anew where nothing came for long: a cut network ends no connection. */
  check(): void {
    if (this.connected && performance.now() - this.heard > SILENT_MS) this.#again();
  }

  #connect(): void {
    const after = this.#sequence ? `&after=${this.#sequence}` : "";
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/api/v1/live?head=true${after}`);
    this.#socket = socket;
    socket.onopen = () => {
      this.connected = true;
      this.heard = performance.now();
      this.#wait = FIRST_MS;
      this.opened();
    };
    socket.onmessage = (event: MessageEvent<string>) => this.#came(JSON.parse(event.data) as Message);
    socket.onclose = () => {
      if (this.#socket === socket) this.#again();
    };
  }

  #again(): void {
    this.connected = false;
    const old = this.#socket;
    this.#socket = null;
    old?.close();
    if (this.#closed) return;
    window.clearTimeout(this.#timer);
    this.#timer = window.setTimeout(() => this.#connect(), this.#wait);
    this.#wait = Math.min(2 * this.#wait, LAST_MS);
  }

  #came(message: Message): void {
    this.heard = performance.now();
    if ("sequence" in message) this.#sequence = message.sequence;
    for (const listener of this.#listeners) listener(message);
  }
}
