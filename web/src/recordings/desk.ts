// The recordings that were opened, and the calculation that runs.

import { get } from "../api.ts";
import type { Address } from "../charts/series.ts";
import { sentenceOf } from "../views/view.ts";

export interface Recording {
  number: number;
  name: string;
  folder: string;
  streams: { name: string; file: string }[];
  cameras: { name: string; kind: string; regions: number[][] }[];
  has_reference: boolean;
  method: string;
  /** What is wrong with recording.toml; empty where nothing is. */
  fault: string;
  /** When its files were written, s since 1970; null where there are none. */
  changed_s: number | null;
  result_s: number | null;
  report_s: number | null;
  calibration_s: number | null;
}

export interface Job {
  what?: "calibrate" | "estimate";
  state: "running" | "done" | "failed" | "cancelled";
  done: number;
  total: number;
  step: string;
  text: string;
  seconds: number;
  command: string;
}

/** The address of something of a recording. */
export function ofRecording(number: number, what: string, query: Record<string, string | number> = {}): string {
  const asked = new URLSearchParams(Object.entries(query).map(([key, value]) => [key, String(value)])).toString();
  return `/recordings/${number}/${what}${asked ? `?${asked}` : ""}`;
}

/** What a trace is of; across: the result along its second axis; error: result less reference. */
export type What = "result" | "across" | "reference" | "error";

export function rowsOf(number: number, of: What): Address {
  return (fromMs, toMs, buckets) => {
    const time = { from_s: fromMs / 1000, to_s: toMs / 1000, of };
    return ofRecording(number, "series", buckets === null ? time : { ...time, buckets });
  };
}

export class Desk {
  recordings: Recording[] = [];
  methods: string[] = [];
  trackers: string[] = [];
  /** Why the newest question had no answer. */
  trouble = "";

  async ask(): Promise<void> {
    try {
      const found = await get<Pick<Desk, "recordings" | "methods" | "trackers">>("/recordings");
      [this.recordings, this.methods, this.trackers] = [found.recordings, found.methods, found.trackers];
      this.trouble = "";
    } catch (error) {
      this.trouble = sentenceOf(error);
    }
  }

  /** The recording of a number as addresses have it; the first one where there is none. */
  of(number: string): Recording | undefined {
    return this.recordings.find((one) => String(one.number) === number) ?? this.recordings[0];
  }
}
