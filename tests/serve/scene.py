"""A made-up bridge of which every view of the page has something to show: for its tests and its pictures."""

import json
import time

import cv2
import numpy as np

from midspan.alarms.messages import iso
from midspan.records import NANOSECONDS, Event
from midspan.store.chunk import Chunk
from midspan.store.store import Batch, open_store

POINTS = ("quarter-span", "midspan", "pier-3")
DAY_S = 86_400
# Each fourth of a day so many minutes of rows, of which natural frequencies are made.
DAYS, STEP_S, LENGTH_S, RATE_HZ = 14, 21_600, 1200, 20
LIVE_RATE_HZ = 100


# Where the infrared camera's target is in the newest frame.
TARGETS = [{"name": "", "roi": [412, 236, 128, 96], "x_px": 1.42, "y_px": -7.85, "quality": 0.98, "matches": None}]


def displacement_mm(time_s, frequencies=((2.13, 0.35), (3.48, 0.12)), seed=0):
    """Vibration at natural frequencies, Hz, with their amplitudes, mm, under vehicles that come about once a minute."""
    value = np.zeros_like(time_s)
    for number, (frequency, amplitude) in enumerate(frequencies):
        slow = 0.6 + 0.4 * np.sin(2 * np.pi * time_s / (37.0 + 11 * number) + seed)
        value += amplitude * slow * np.sin(2 * np.pi * frequency * time_s + seed + number)
    at = (time_s + 13 * seed) % 53.0
    size = 2.0 + np.sin(np.floor((time_s + 13 * seed) / 53.0) * 2.7)
    return value - size * np.exp(-(((at - 20.0) / 2.5) ** 2))


def rows_of(point, time_ns, value_mm, coasting=None):
    """Rows of the store; coasting: which of them rest on no measurement."""
    count, away = len(time_ns), np.zeros(len(time_ns), bool) if coasting is None else coasting
    columns = {
        "displacement_m": 1e-3 * value_mm,
        "std_m": np.where(away, 2.5e-4, 4e-5).astype(np.float32),
        "velocity_m_s": np.zeros(count, np.float32),
        "source": np.where(away, 4, 0).astype(np.int8),
        "status": away.astype(np.int8),
        "zero_std_m": np.full(count, 2e-5, np.float32),
    }
    return Chunk(point, "rows", time_ns, columns, 1, "displacement_m")


def calibration(scale, offset_s, *, infrared=False, radar=False):
    """A calibration's figures."""
    made = {
        "version": 1,
        "warnings": [],
        "accelerometer": {"scale": 1.002, "scale_std": 0.003, "noise_std_m_s2": 0.0021},
    }
    if radar:
        made["radar"] = {"conversion_factor": 1.31 * scale, "conversion_factor_std": 0.004, "target_range_m": 18.42,
                         "time_offset_s": offset_s, "time_offset_std_s": 0.0007}  # fmt: skip
    else:
        name = "infrared" if infrared else "camera"
        made[name] = {"scale_mm_per_px": -1.84 * scale, "scale_std_mm_per_px": 0.006, "time_offset_s": offset_s,
                      "time_offset_std_s": 0.0006, "roi": [412, 236, 128, 96]}  # fmt: skip
    return made


def fill(folder, end_ns):
    """A store of the bridge whose rows end at an instant: two weeks of parts, and the last twenty minutes whole."""
    store = open_store(folder)
    rng = np.random.default_rng(3)
    for number in range(DAYS * DAY_S // STEP_S, 0, -1):
        begin_ns = end_ns - number * STEP_S * NANOSECONDS
        time_s = np.arange(LENGTH_S * RATE_HZ) / RATE_HZ
        warm = np.sin(2 * np.pi * (number % 4) / 4) + 0.5 * np.sin(2 * np.pi * number / 40)
        modes = forced(rng, len(time_s), ((2.13 - 0.012 * warm, 0.3), (3.48 - 0.02 * warm, 0.12), (6.1, 0.05)))
        time_ns = begin_ns + np.round(1e9 * time_s).astype(np.int64)
        store.write(Batch(chunks=[rows_of("quarter-span", time_ns, modes)]))
    for seed, point in enumerate(POINTS):
        time_ns = end_ns + np.arange(-1200 * LIVE_RATE_HZ, 0, dtype=np.int64) * (NANOSECONDS // LIVE_RATE_HZ)
        time_s = time_ns % (1000 * DAY_S * NANOSECONDS) / NANOSECONDS
        away = (time_ns > end_ns - 31 * NANOSECONDS) & (time_ns < end_ns - 24 * NANOSECONDS) & (seed == 0)
        store.write(Batch(chunks=[rows_of(point, time_ns, displacement_mm(time_s, seed=seed), away)]))
    for number, scale in enumerate((1.0, 1.0004, 0.9991, 1.0012, 1.0021, 1.0068, 1.0102, 1.0149)):
        made_ns = end_ns - (8 - number) * 19 * DAY_S * NANOSECONDS
        body = calibration(scale, 0.0312 + 0.0004 * np.cos(number))
        store.add_calibration("quarter-span", made_ns, json.dumps(body), "{}", accept=number < 7)
    for point, kind in (("midspan", {"infrared": True}), ("pier-3", {"radar": True})):
        body = calibration(1.0, 0.0081, **kind)
        store.add_calibration(point, end_ns - 20 * DAY_S * NANOSECONDS, json.dumps(body), "{}", accept=True)
    said = (
        (31, "coasting", "The camera gives nothing: something is before it."),
        (24, "tracking", "The camera measures again."),
    )
    events = [("quarter-span", Event(end_ns - age * NANOSECONDS, kind, text)) for age, kind, text in said]
    store.write(Batch(events=events))
    store.close()


def forced(rng, count, modes):
    """Oscillators (Hz, mm rms) under white force, damped by 0.8 %."""
    value = 0.01 * rng.standard_normal(count)
    frequency = np.fft.rfftfreq(count, 1.0 / RATE_HZ)
    for hz, rms in modes:
        response = 1.0 / (hz**2 - frequency**2 + 2j * 0.008 * hz * frequency)
        own = np.fft.irfft(np.fft.rfft(rng.standard_normal(count)) * response, count)
        value += rms * own / own.std()
    return value


def source(point, name, address, **changes):
    """How a stream stands."""
    return {
        "point": point, "source": name, "reason": "", "text": "", "age_s": 0.06, "records": 184_213, "faults": 0,
        "skipped": 0, "late": 0, "restarts": 0, "stamps": "", "address": address, "rate_hz": 100.0,
        "nominal_rate_hz": 100.0, "delay_s": 0.212, "clock_offset_s": None, "clock_offset_std_s": None,
        "clock_drift_ppm": None, **changes,
    }  # fmt: skip


def state():
    """How the bridge stands: a camera that is off its rate, a radar that is silent, a calibration that is prepared."""
    sources = [
        source("quarter-span", "accelerometer", "mqtt:bridge/acc1"),
        source("quarter-span", "camera", "rtsp://10.0.0.21/stream", rate_hz=27.9, nominal_rate_hz=30.0, stamps="sender",
               delay_s=0.094, skipped=12, restarts=1, clock_offset_s=0.0312, clock_offset_std_s=0.0006,
               clock_drift_ppm=1.8, records=55_310),
        source("midspan", "accelerometer", "mqtt:bridge/acc2"),
        source("midspan", "infrared", "rtsp://10.0.0.22/thermal", rate_hz=9.0, nominal_rate_hz=9.0, stamps="arrival",
               delay_s=0.181, clock_offset_s=0.0081, clock_offset_std_s=0.0021, clock_drift_ppm=-0.4, records=16_604),
        source("pier-3", "accelerometer", "serial:/dev/ttyUSB0", late=3, faults=2),
        source("pier-3", "radar", "udp:4098", rate_hz=49.9, nominal_rate_hz=50.0, clock_offset_s=0.0004,
               clock_offset_std_s=0.0007, clock_drift_ppm=0.2, records=92_106),
    ]  # fmt: skip

    def point(name, **changes):
        own = [one for one in sources if one["point"] == name]
        return {
            "point": name, "status": "tracking", "reason": "", "text": "", "rows_age_s": 0.2, "sigma_mm": 0.04,
            "usual_sigma_mm": 0.04, "calibration": 7, "notice": "", "notice_text": "",
            "stage": "", "stage_left_s": None, "sources": own, **changes,
        }  # fmt: skip

    points = [
        point("quarter-span"),
        point("midspan"),
        point("pier-3", stage="calibrating", stage_left_s=42.0, notice="calibrating",
              notice_text="The point is calibrating."),
    ]  # fmt: skip
    return {
        "ready": True, "points": points, "sources": sources, "settings": None, "store": {"waiting": 0, "dropped": 0}
    }  # fmt: skip


def alarm(point, name, state, value, limit, since_ns, **changes):
    """An alarm as the interface has it."""
    return {
        "id": f"{point}-{name}", "point": point, "name": name, "state": state, "level": "warning", "on": "displacement",
        "reason": "limit", "value": value, "value_std": 0.04, "peak": value, "limit": limit, "unit": "mm",
        "time": iso(since_ns), "since": iso(since_ns), "text": "", "acknowledged_by": "", "silence": None, **changes,
    }  # fmt: skip


def alarms(now_ns):
    """What the engine says of alarms: one that fires, one that is taken care of, and how delivery stands."""
    minute_ns = 60 * NANOSECONDS
    silence = {"until": iso(now_ns + 500 * minute_ns), "owner": "anna", "reason": "load test until the evening"}
    listed = [
        alarm("midspan", "serviceability", "firing", -3.42, 3.0, now_ns - 4 * minute_ns, level="critical"),
        alarm("midspan", "traffic", "acknowledged", -2.31, 2.0, now_ns - 21 * minute_ns, acknowledged_by="tom"),
        alarm("pier-3", "drift", "firing", 1.26, 1.0, now_ns - 190 * minute_ns, on="drift", silence=silence),
    ]
    limits = [{"point": "quarter-span", "name": "traffic", "on": "displacement", "level": "warning", "limit": 2.0,
               "unit": "mm"}]  # fmt: skip
    targets = [{"target": "mail bridge@example.org", "waiting": 0, "sent": 12, "fault": "",
                "sent_s": now_ns / NANOSECONDS - 240.0}]  # fmt: skip
    return {"alarms": listed, "limits": limits, "targets": targets}


def profile():
    """A radar's range profile: the pier, a bank that reflects more, and noise."""
    rng, range_m = np.random.default_rng(7), 0.12 * np.arange(256)
    power = 1e-6 * rng.chisquare(8, 256)
    for place_m, size in ((18.42, 0.3), (24.1, 1.0), (6.3, 0.02), (21.0, 0.01)):
        power += size * np.exp(-(((range_m - place_m) / 0.17) ** 2))
    target = {"bin": 153.5, "range_m": 18.42, "snr_db": 43.0}
    return {"time_ns": time.time_ns(), "range_m": range_m.round(3).tolist(), "targets": [target],
            "magnitude_db": (10 * np.log10(power / power.max())).round(2).tolist()}  # fmt: skip


SITE = """name = "river bridge"

[store]
path = "store"
keep_days = 365

[mqtt]
host = "127.0.0.1"
prefix = "midspan"

[[point]]
name = "quarter-span"

[point.accelerometer]
source = "mqtt:bridge/acc1"
unit = "m/s^2"

[point.camera]
source = "rtsp://10.0.0.21/stream"
direction = "y"
roi = [412, 236, 128, 96]

[[point]]
name = "midspan"

[point.accelerometer]
source = "mqtt:bridge/acc2"
unit = "m/s^2"

[point.infrared]
source = "rtsp://10.0.0.22/thermal"
direction = "y"

[[point]]
name = "pier-3"

[point.accelerometer]
source = "serial:/dev/ttyUSB0"
unit = "m/s^2"

[point.radar]
source = "udp:4098"
config = "radar.cfg"
"""


def picture(width=960, height=540, *, infrared=False):
    """A bank beyond a river with a bolted plate on it, as JPEG; infrared: as a thermal camera shows it."""
    rng = np.random.default_rng(5)
    warm = 70.0 if infrared else 0.0
    ramp = np.linspace(200 - warm, 90 + warm, height)[:, None] + 8 * np.sin(np.arange(width) / 90)[None, :]
    frame = ramp + rng.normal(0, 1, (height, width))
    frame[height // 2 :] -= 25 + 10 * np.sin(np.arange(height // 2) / 6)[:, None]
    for left, top, right, bottom, grey in (
        (60, 110, 230, 330, 95),
        (700, 150, 910, 300, 120),
        (380, 205, 580, 365, 60),
    ):
        frame[top:bottom, left:right] = grey + rng.normal(0, 2, (bottom - top, right - left))
    for x in (425, 475, 525):
        for y in (260, 310):
            cv2.circle(frame, (x, y), 13, 210, -1)
            cv2.circle(frame, (x, y), 6, 40, -1)
    frame = np.clip(cv2.GaussianBlur(frame, (0, 0), 1.2 if not infrared else 3.0), 0, 255).astype(np.uint8)
    return cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
