// The region of interest on a camera's first frame, written into recording.toml.

import { get, picture, putSettings, settings } from "../api.ts";
import { button, choice, el, say } from "../dom.ts";
import { calibrated, regionOf, withRegion } from "../region.ts";
import { HOW_TO_DRAW, RegionCanvas } from "../region_canvas.ts";
import { sentenceOf } from "../views/view.ts";
import { type Desk, ofRecording, type Recording } from "./desk.ts";

export function showRegion(root: HTMLElement, recording: Recording, desk: Desk): () => void {
  const cameras = recording.cameras;
  let camera = cameras[0];
  if (!camera) {
    root.append(el("p", {}, recording.fault ? "" : "This recording has no camera."));
    return () => undefined;
  }
  let ended = false;
  let end: () => void = () => undefined;
  const below = `/recordings/${recording.number}`;
  const part = el("div");
  const names = cameras.map((one): [string, string] => [one.name, one.name]);

  function show(): void {
    end();
    const { name, kind, regions } = camera as (typeof cameras)[number];
    const may = regions.length < 2;
    const [said, where] = [el("p", { role: "status" }, "Reading the first frame."), el("p")];
    const chosen = el("p", { class: "quiet" });
    const save = button("Save the region", () => void put(), { disabled: true });
    const drawn = new RegionCanvas(`First frame of ${name}.`, may, () => {
      say(where, may ? drawn.text : `${regions.length} targets: change their regions in Settings.`);
      save.disabled = !drawn.changed;
    });
    if (!may) drawn.others = regions.map(([x = 0, y = 0, width = 0, height = 0]) => ({ x, y, width, height }));
    end = () => drawn.end();

    async function begin(): Promise<void> {
      try {
        drawn.region = regionOf((await settings(below)).text, { kind, name });
        if (!drawn.region && may && recording.calibration_s !== null) {
          drawn.region = calibrated(await get(ofRecording(recording.number, "calibration")), kind);
          if (drawn.region) say(chosen, "The calibration selected this region; recording.toml names none.");
        }
        const found = await picture(ofRecording(recording.number, `cameras/${encodeURIComponent(name)}`));
        const image = await createImageBitmap(found.blob);
        if (ended) return image.close();
        say(said, "");
        drawn.show(image, found.width, found.height);
      } catch (error) {
        say(said, sentenceOf(error));
      }
    }

    async function put(): Promise<void> {
      if (!drawn.region) return;
      try {
        const { text, tag } = await settings(below);
        const changed = withRegion(text, { kind, name }, drawn.region);
        if (changed === null) throw new Error("recording.toml has no section of this camera: set roi in Settings.");
        say(said, (await putSettings(changed, tag, below)).text);
        drawn.changed = false;
        say(chosen, "");
        drawn.draw();
        await desk.ask();
      } catch (error) {
        say(said, sentenceOf(error));
      }
    }

    part.replaceChildren(
      el("div", { class: "bar" }, may && save),
      said,
      el("div", { class: "picture" }, drawn.canvas),
      where,
      chosen,
      (may &&
        el("p", { class: "quiet" }, `${HOW_TO_DRAW} Saved in recording.toml; without a region midspan selects one.`)) ||
        el("p"),
    );
    void begin();
  }

  if (cameras.length > 1)
    root.append(
      el(
        "div",
        { class: "bar" },
        choice("Camera", names, camera.name, (name) => {
          camera = cameras.find((one) => one.name === name);
          show();
        }),
      ),
    );
  root.append(part);
  show();
  return () => {
    ended = true;
    end();
  };
}
