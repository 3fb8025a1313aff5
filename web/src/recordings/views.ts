// The views over recordings: the list, what is in one, its region, its result, its settings.

import { el, line, table } from "../dom.ts";
import { choice } from "../dom.ts";
import { clock } from "../words.ts";
import { editSettings } from "../views/settings.ts";
import type { Entry } from "../views/view.ts";
import type { Desk, Recording } from "./desk.ts";
import { showContents } from "./contents.ts";
import { showRegion } from "./region.ts";
import { showResult } from "./result.ts";

type OfRecording = (root: HTMLElement, recording: Recording, desk: Desk) => () => void;
const COLUMNS = ["Recording", "Sensors", "Calibrated", "Result", "Folder"];

/** A view of one recording, with the choice of another one above it. */
function ofOne(path: string, title: string, show: OfRecording): Entry<Desk>["show"] {
  return (root, desk, name) => {
    const recording = desk.of(name);
    if (!recording) {
      root.replaceChildren(el("h1", {}, title), el("p", {}, "There is no recording."));
      return () => undefined;
    }
    const names = desk.recordings.map((one): [string, string] => [String(one.number), one.name]);
    const body = el("div");
    root.replaceChildren(
      el("h1", {}, `${title}: ${recording.name}`),
      desk.recordings.length > 1
        ? el(
            "div",
            { class: "bar" },
            choice("Recording", names, String(recording.number), (number) => (location.hash = `#/${path}/${number}`)),
          )
        : "",
      el("p", { class: "wrong" }, recording.fault),
      body,
    );
    return show(body, recording, desk);
  };
}

const when = (seconds: number | null) => (seconds === null ? "no" : clock(1000 * seconds));

const showList: Entry<Desk>["show"] = (root, desk) => {
  const body = el("tbody");
  root.replaceChildren(el("h1", {}, "Recordings"), table(COLUMNS, body));
  for (const one of desk.recordings) {
    const sensors = one.fault || one.streams.map((stream) => stream.name).join(", ");
    const row = line(COLUMNS, ["", sensors, when(one.calibration_s), when(one.result_s), one.folder]);
    row.firstElementChild?.append(el("a", { href: `#/contents/${one.number}` }, one.name));
    body.append(row);
  }
  return () => undefined;
};

const showSettings: OfRecording = (root, recording, desk) =>
  editSettings(root, {
    file: "recording.toml",
    below: `/recordings/${recording.number}`,
    note: `${recording.folder}/recording.toml. Wrong settings are rejected.`,
    save: "Check and save",
    fault: () => (recording.fault ? { text: recording.fault, key: null } : null),
    written: () => desk.ask(),
  });

export const RECORDING_VIEWS: Entry<Desk>[] = [
  { path: "recordings", text: "Recordings", show: showList },
  { path: "contents", text: "Contents", show: ofOne("contents", "Contents", showContents) },
  { path: "region", text: "Region", show: ofOne("region", "Region", showRegion) },
  { path: "result", text: "Result", show: ofOne("result", "Result", showResult) },
  { path: "settings", text: "Settings", show: ofOne("settings", "Settings", showSettings) },
];
