// What needs no browser: gaps, joints, statistics, windows of time, regions and their place in SITE.toml.

import assert from "node:assert/strict";
import { test } from "node:test";
import { openWords } from "../src/alarms.ts";
import { joined } from "../src/charts/series.ts";
import { valueRange } from "../src/charts/value_range.ts";
import { TimeWindow } from "../src/charts/window.ts";
import { changeOf, comparable } from "../src/quantities.ts";
import { between, inside, regionOf, withRegion } from "../src/region.ts";
import { layers, Newest, ofBuckets, ofRows, statistics } from "../src/rows.ts";
import { lineOf, pointNames, withoutPoint, withPoint, withSource } from "../src/site_text.ts";
import { duration, withBand } from "../src/words.ts";

// Ten rows a second from a whole second on, three missing.
const rows = (from: number, to: number, value = 1) => {
  const time = Array.from({ length: to - from }, (_, at) => 1e9 + (from + at) * 1e8);
  return {
    time,
    displacement_mm: time.map(() => value),
    displacement_std_mm: time.map(() => 0.5),
    status: time.map(() => "tracking"),
  };
};

test("missing rows are a gap, and a lost row has no value", () => {
  const [a, b] = [rows(0, 5), rows(8, 12)];
  const all = {
    time: [...a.time, ...b.time],
    displacement_mm: [...a.displacement_mm, ...b.displacement_mm],
    displacement_std_mm: [...a.displacement_std_mm, ...b.displacement_std_mm],
    status: [...a.status, ...b.status],
  };
  all.status[8] = "lost";
  const drawn = ofRows(all);
  assert.deepEqual(drawn.low, [1, 1, 1, 1, 1, null, 1, 1, 1, null]);
  assert.ok(Math.abs((drawn.upper[0] ?? 0) - 1.98) < 1e-12);
});

test("a bucket is drawn at its middle, and an empty one is a gap", () => {
  const drawn = ofBuckets(
    {
      time: [0, 1e9],
      displacement_mm_min: [-1, null],
      displacement_mm_max: [7, null],
      displacement_mm_mean: [0, null],
      displacement_std_mm: [1, null],
      status: ["tracking", null],
      rows: [10, 0],
    },
    2000,
  );
  assert.deepEqual(drawn.x, [0.5, 1.5]);
  assert.deepEqual(
    [drawn.high, drawn.low],
    [
      [7, null],
      [-1, null],
    ],
  );
});

test("rows that came stand behind what is kept, none twice", () => {
  const both = joined(ofRows(rows(0, 10, 1)), ofRows(rows(7, 12, 2)));
  assert.deepEqual(both.low, [1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2]);
});

test("what comes again after a cut is not added twice, and old rows go", () => {
  const newest = new Newest(100);
  newest.add(rows(0, 50));
  newest.add(rows(40, 60));
  assert.equal(newest.rows.time.length, 60);
  newest.add(rows(60, 5000));
  assert.ok(newest.rows.time.length <= 1001);
});

test("statistics have the extremes of every row", () => {
  const found = statistics(
    ofRows({
      time: [0, 1e8, 2e8, 3e8],
      displacement_mm: [1, -1, 1, -1],
      displacement_std_mm: [0, 0, 0, 0],
      status: ["", "", "", ""],
    }),
    true,
  );
  assert.deepEqual(found, { low: -1, high: 1, mean: 0, rms: 1, parts: 4 });
});

test("the mean of buckets and of the rows that came since is that of every row", () => {
  // An hour in buckets of 6 s, of 60 rows each; then 100 rows at another place.
  const time = Array.from({ length: 600 }, (_, at) => at * 6e9);
  const every = <T>(value: T) => time.map(() => value);
  const kept = ofBuckets(
    {
      time,
      displacement_mm_min: every(-1),
      displacement_mm_max: every(3),
      displacement_mm_mean: every(0),
      displacement_std_mm: every(0.1),
      status: every("tracking"),
      rows: every(60),
    },
    3600e3,
  );
  const all = joined(kept, ofRows(rows(36_000, 36_100, 6)));
  assert.equal(statistics(all, false)?.mean, 600 / 36_100);
  // What a window that follows has left behind does not count.
  assert.equal(statistics(all, false, 3600)?.mean, 6);
  // Of buckets without a mean there is none.
  assert.equal(statistics({ ...all, mean: all.mean.map(() => null) }, false)?.mean, null);
});

test("open alarms are counted by how they stand", () => {
  const silence = { until: "", owner: "", reason: "" };
  const one = (state: string, isSilent = false) => ({ state, silence: isSilent ? silence : null });
  assert.equal(openWords([]), "No alarm is open.");
  assert.equal(openWords([one("acknowledged")]), "1 alarm is open: 1 acknowledged.");
  const all = [one("firing"), one("firing"), one("firing", true), one("pending")];
  assert.equal(openWords(all), "4 alarms are open: 2 fire, 1 silenced, 1 pending.");
});

test("a window that follows ends with the newest row, one that is zoomed keeps its middle", () => {
  let now = 10_000;
  const shown = new TimeWindow(4, () => now);
  assert.deepEqual([shown.fromMs, shown.toMs], [6000, 10_000]);
  now = 20_000;
  shown.freeze();
  now = 30_000;
  shown.zoom(0.5);
  assert.deepEqual([shown.fromMs, shown.toMs], [17_000, 19_000]);
});

test("a region stays in the frame and keeps its size", () => {
  const frame = { width: 320, height: 240 };
  assert.deepEqual(inside({ x: -50, y: 300, width: 64, height: 32 }, frame), { x: 0, y: 208, width: 64, height: 32 });
  assert.deepEqual(inside({ x: 10, y: 10, width: 900, height: 2 }, frame), { x: 0, y: 10, width: 320, height: 16 });
  assert.deepEqual(between(40, 30, 10, 50, frame), { x: 10, y: 30, width: 30, height: 20 });
  // Drawn beyond an edge it is cut there, and not moved.
  const beyond = between(250, 200, 400, 260, frame);
  assert.deepEqual(inside(beyond, frame), { x: 250, y: 200, width: 70, height: 40 });
  assert.deepEqual(between(-30, 10, 20, 500, frame), { x: 0, y: 10, width: 20, height: 230 });
});

const SITE = `[[point]]
name = "a"
[point.camera]
source = "rtsp://one"   # roi is chosen
[[point]]
name = "b"
[point.camera]
roi = [1, 2, 30, 40]  # the bolt
source = "rtsp://two"
`;

test("a region goes into its own point's section, and nowhere else", () => {
  const region = { x: 5, y: 6, width: 70, height: 80 };
  assert.equal(regionOf(SITE, { kind: "camera", point: "a" }), null);
  assert.deepEqual(regionOf(SITE, { kind: "camera", point: "b" }), { x: 1, y: 2, width: 30, height: 40 });
  assert.equal(
    withRegion(SITE, { kind: "camera", point: "b" }, region),
    SITE.replace("[1, 2, 30, 40]", "[5, 6, 70, 80]"),
  );
  assert.equal(
    withRegion(SITE, { kind: "camera", point: "a" }, region),
    SITE.replace(
      '[point.camera]\nsource = "rtsp://one"',
      '[point.camera]\nroi = [5, 6, 70, 80]\nsource = "rtsp://one"',
    ),
  );
  assert.equal(withRegion(SITE, { kind: "camera", point: "c" }, region), null);
  assert.equal(
    withRegion(SITE.replace("[1, 2, 30, 40]", "[1,\n2, 30, 40]"), { kind: "camera", point: "b" }, region),
    null,
  );
});

const RECORDING = `name = "left"
[accelerometer]
file = "a.csv"
[[camera]]
name = "left"
file = "l.mkv"
[[camera.target]]
roi = [9, 9, 30, 30]
[[camera]]
name = "right"
file = "r.mkv"
`;

test("of several cameras of a recording the one of that name gets the region", () => {
  const region = { x: 5, y: 6, width: 70, height: 80 };
  const right = { kind: "camera", name: "right" };
  const written = RECORDING.replace('name = "right"', 'roi = [5, 6, 70, 80]\nname = "right"');
  assert.equal(withRegion(RECORDING, right, region), written);
  assert.deepEqual(regionOf(written, right), region);
  assert.equal(withRegion(RECORDING, { kind: "camera", name: "other" }, region), null);
  const one = '[camera]\nfile = "c.mkv"\n';
  assert.equal(
    withRegion(one, { kind: "camera", name: "camera" }, region),
    '[camera]\nroi = [5, 6, 70, 80]\nfile = "c.mkv"\n',
  );
});

test("numbers and durations are said with what matters of them", () => {
  assert.equal(withBand(-1.23456, 0.01), "−1.235 ± 0.020 mm");
  assert.equal(withBand(null, null), "no value");
  assert.deepEqual([2, 75, 3600, 100_000].map(duration), ["2.0 s", "1 min 15 s", "1 h", "1 d 3 h"]);
});

test("a change is that of the likeliest line, and of two values their difference", () => {
  const at = (x: number, value: number, std: number | null) => ({ x, of: { value, std, unit: "" } });
  const two = changeOf([at(0, 1, 3), at(1, 6, 4)]);
  assert.ok(two && Math.abs(two.by - 5) < 1e-9 && Math.abs((two.sigmas ?? 0) - 1) < 1e-9);
  // Unweighted: slope Σ(x−2)y / Σ(x−2)² = 10/10, over four steps, with a deviation of 4/√10.
  const line = changeOf([0, 1, 2, 3, 4].map((x) => at(x, x + (x === 2 ? 7 : 0), 1)));
  assert.ok(line && Math.abs(line.by - 4) < 1e-9 && Math.abs((line.sigmas ?? 0) - Math.sqrt(10)) < 1e-9);
  assert.deepEqual(changeOf([at(0, 1, null), at(1, 3, 1)]), { by: 2, sigmas: null });
  assert.equal(changeOf([at(0, 1, 1)]), null);
});

test("calibrations of another axis or of other sensors are not compared", () => {
  const camera = (direction: string, scale_mm_per_px: number, name?: string) => ({ direction, scale_mm_per_px, name });
  const of = (camera: object, more: object = {}) => ({ calibration: { version: 1, camera, ...more } });
  const [x, first] = [of(camera("x", 1)), of(camera("y", 1), { notices: [{ name: "a" }] })];
  const [second, wider] = [of(camera("y", 2)), of(camera("y", 1), { radar: { conversion_factor: 1 } })];
  assert.deepEqual(comparable([x, first, second]), [first, second]);
  assert.deepEqual(comparable([first, wider, second]), [first, second]);
  assert.deepEqual(comparable([first, of([camera("x", 1, "a")]), x]), [x]);
  assert.deepEqual(comparable([]), []);
});

const BRIDGE = `name = "site" # of all
[store]
path = "store"

[[point]]
name = "a"
[point.accelerometer]
source = "x"
unit = "g"

# The second one.
[[point]]
name = "b"

[point.camera]
source = "y"
[[point.alarm]]
name = "high"
[[point.alarm]]
name = "low"
levl = "critical"

[mqtt]
host = "h"

[[notify]]
smtp = "s"
[[notify]]
webhok = "w"
`;

test("the line of a wrong key is found in its own point, and of a missing one its section", () => {
  const at = (key: string | null, fault = "") => BRIDGE.split("\n")[lineOf(BRIDGE, key, fault) ?? -1];
  assert.equal(at("point 'a': accelerometer.unit"), 'unit = "g"');
  assert.equal(at("point 'b': camera.source"), 'source = "y"');
  assert.equal(at("point[2]: camera.direction"), "[point.camera]");
  assert.equal(at("point[1]: accelerometer.unit"), 'unit = "g"');
  assert.equal(at("mqtt.host"), 'host = "h"');
  assert.equal(at("name"), 'name = "site" # of all');
  assert.equal(at(null, "is not valid TOML (at line 3, column 8)."), 'path = "store"');
  assert.equal(at("point 'c': camera.source"), undefined);
  assert.equal(at("point 'b': alarm 'low': levl"), 'levl = "critical"');
  assert.equal(lineOf(BRIDGE, "point 'b': alarm[2]: limit_mm", ""), BRIDGE.split("\n").indexOf('name = "low"') - 1);
  assert.equal(lineOf(BRIDGE, "point 'b': alarm 'low'", ""), BRIDGE.split("\n").indexOf('name = "low"') - 1);
  assert.equal(lineOf(BRIDGE, "point 'b': alarm[1]: on", ""), BRIDGE.split("\n").indexOf('name = "high"') - 1);
  assert.equal(at("notify[2].webhok"), 'webhok = "w"');
  assert.equal(at("notify"), "[[notify]]");
  assert.equal(lineOf(BRIDGE, null, "no line"), null);
});

test("points and sources are added and removed, and everything else stays as it is", () => {
  const source = { kind: "radar", source: "udp:4098", keys: { config: "radar.cfg", unit: "" } };
  assert.deepEqual(pointNames(BRIDGE), ["a", "b"]);
  const block = '[point.radar]\nsource = "udp:4098"\nconfig = "radar.cfg"\n';
  assert.equal(withPoint(BRIDGE, "c", source), `${BRIDGE}\n[[point]]\nname = "c"\n\n${block}`);
  assert.equal(withSource(BRIDGE, "a", source), BRIDGE.replace('unit = "g"\n', `unit = "g"\n\n${block}`));
  // Before the point's alarms.
  assert.equal(withSource(BRIDGE, "b", source), BRIDGE.replace("[[point.alarm]]", `${block}\n[[point.alarm]]`));
  assert.equal(withSource(BRIDGE, "b", { ...source, kind: "camera" }), null);
  assert.equal(withoutPoint(BRIDGE, "a"), BRIDGE.replace(/\[\[point\]\]\nname = "a"[^]*?(?=# The)/, ""));
  assert.equal(withoutPoint(BRIDGE, "b"), BRIDGE.replace(/# The second[^]*?(?=\[mqtt\])/, ""));
  assert.equal(withoutPoint(BRIDGE, "c"), null);
});

test("coasting rows and those that are not final are layers of their own, which touch", () => {
  const came = rows(0, 5);
  came.status[2] = "coasting";
  const head = { time: [1.4e9, 1.5e9, 1.6e9], displacement_mm: [7, 8, null], displacement_std_mm: [1, 1, 1] };
  const [measured, coasting, open] = layers(ofRows(came), head);
  assert.deepEqual(measured.low, [1, 1, null, 1, 1, null, null]);
  assert.deepEqual(coasting.low, [null, 1, 1, 1, null, null, null]);
  // What is final by now is not drawn as if it were not.
  assert.deepEqual(open.low, [null, null, null, null, 1, 8, null]);
  assert.equal(measured.x, coasting.x);
  assert.ok(layers(ofRows(rows(0, 3)), null)[2].low.every((one) => one === null));
});

test("a few bands that are a thousand times as wide leave the values to be seen", () => {
  const at = Array.from({ length: 100 }, (_, k) => k);
  const of = (width: (k: number) => number) => ({
    x: at,
    low: at.map((k) => k / 128),
    high: at.map((k) => k / 128),
    lower: at.map((k) => k / 128 - width(k)),
    upper: at.map((k) => k / 128 + width(k)),
    mean: at,
    coasting: at.map(() => false),
    rows: at.map(() => 1),
  });
  assert.deepEqual(valueRange([of((k) => (k < 5 ? 100 : 0.125))]), [-0.125, 99 / 128 + 0.125]);
  // Where many are wide, they are the news.
  assert.deepEqual(valueRange([of((k) => (k < 50 ? 10 : 0.125))]), [-10, 49 / 128 + 10]);
  assert.equal(valueRange([]), null);
});
