// What is in a recording, stream by stream, as `midspan inspect` finds it.

import { get } from "../api.ts";
import { el, say } from "../dom.ts";
import { duration } from "../words.ts";
import { sentenceOf } from "../views/view.ts";
import { type Desk, ofRecording, type Recording } from "./desk.ts";

type Tree = Record<string, unknown>;

const number = (of: Tree, key: string): number | null => (typeof of[key] === "number" ? (of[key] as number) : null);
const texts = (of: Tree, key: string): string[] => (Array.isArray(of[key]) ? (of[key] as unknown[]).map(String) : []);

/** A number with the digits that matter; what is a trifle of rounding is nought. */
function shortOf(value: number): string {
  return (Math.abs(value) < 1e-9 ? "0" : value.toPrecision(4)).replace("-", "−");
}

/** Names and values of a stream, in the order in which a person asks for them. */
function linesOf(of: Tree): [string, string][] {
  const found: [string, string][] = [["file", String(of["file"] ?? "")]];
  const add = (name: string, text: string | null) => text !== null && found.push([name, text]);
  const [rate, length, jitter] = [number(of, "rate_hz"), number(of, "duration_s"), number(of, "jitter_ms")];
  add("rate", rate === null ? null : `${rate.toPrecision(5)} Hz, jitter ${shortOf(jitter ?? 0)} ms rms`);
  add("length", length === null ? null : `${duration(length)}, from ${String(of["start"])}`);
  const gaps = Array.isArray(of["gaps"]) ? (of["gaps"] as Tree[]) : [];
  const longest = Math.max(0, ...gaps.map((one) => number(one, "length_s") ?? 0));
  add("gaps", gaps.length ? `${gaps.length}, the longest ${duration(longest)}` : "none");
  if ("samples" in of) {
    add("channel", `${String(of["channel"])} in ${String(of["unit"])}, ${String(of["samples"])} samples`);
    // In the file's unit; in SI where that takes a sensitivity.
    const factor = number(of, "unit_in_si");
    const unit = String(of[factor === null ? "value_unit" : "unit"]);
    const values = ["smallest", "largest", "mean", "std"].map((key) =>
      shortOf((number(of, key) ?? NaN) / (factor ?? 1)),
    );
    add("values", `${values[0]} to ${values[1]}, mean ${values[2]}, rms about the mean ${values[3]} ${unit}`);
    const unusable = ["missing", "frozen", "clipped"].map((key) => `${String(of[`${key}_samples`])} ${key}`);
    add("unusable samples", unusable.join(", "));
  }
  if ("width" in of) {
    add("image", `${String(of["width"])} × ${String(of["height"])} px, ${String(of["codec"])}`);
    add("frames", `${String(of["frames_used"])} used`);
    const poor = ["frozen", "dark", "saturated"].map((key) => `${String(of[`${key}_frames`])} ${key}`);
    add("poor frames", `${poor.join(", ")} of ${String(of["frames_looked_at"])} checked`);
  }
  if ("carrier_hz" in of)
    add("radar", `${((number(of, "carrier_hz") ?? 0) / 1e9).toPrecision(4)} GHz, ${String(of["frames"])} frames`);
  for (const note of texts(of, "notes")) add("found", note);
  return found;
}

function stream(name: string, of: Tree): HTMLElement {
  const problem = typeof of["error"] === "string" ? [of["error"]] : texts(of, "warnings");
  const lines = linesOf(of).map(([key, text]) => el("div", {}, el("dt", {}, key), el("dd", {}, text)));
  return el(
    "section",
    {},
    el("h2", {}, name),
    el("dl", { class: "figures column" }, ...("error" in of ? [] : lines)),
    ...problem.map((text) => el("p", { class: "wrong" }, text)),
  );
}

export function showContents(root: HTMLElement, recording: Recording, _: Desk): () => void {
  const asking = new AbortController();
  const said = el("p", { role: "status" }, "Checking the recording.");
  root.append(said);

  async function ask(): Promise<void> {
    try {
      const found = await get<Tree>(ofRecording(recording.number, "contents"), asking.signal);
      const streams = Object.entries(found).filter(([, of]) => typeof of === "object" && of !== null && "file" in of);
      const overlap = found["overlap"] as Tree | null;
      const together = overlap
        ? `${texts(overlap, "streams").join(" and ")} ${overlap["overlapping"] ? `overlap for ${duration(number(overlap, "duration_s") ?? 0)}` : "do not overlap in time: correct start_s"}.`
        : "";
      say(said, together);
      root.append(...streams.map(([name, of]) => stream(name, of as Tree)));
    } catch (error) {
      if (!asking.signal.aborted) say(said, sentenceOf(error));
    }
  }
  if (!recording.fault) void ask();
  else said.remove();
  return () => asking.abort();
}
