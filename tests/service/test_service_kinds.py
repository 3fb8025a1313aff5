"""Live points with a radar and with an infrared camera: what they capture is a recording, and their rows are right."""

import socket
import threading
from dataclasses import replace

import numpy as np
import pytest

import midspan
from midspan.engine.point import PointStatus
from midspan.recording.streams.recording import open_recording
from midspan.records import NANOSECONDS, Arrival, Readings
from midspan.service.opening import opened
from midspan.service.point import Phase
from midspan.service.replayed import range_frames, readings
from midspan.service.running import running
from midspan.settings.site import load_site
from midspan.simulate.motion.motion import Sines
from midspan.simulate.radar.signal import Reflector
from midspan.simulate.scene.texture import textured_scene
from midspan.simulate.scene.thermal import ThermalView
from midspan.sources.live.instants import SourceFault
from midspan.sources.live.radar import profiles
from midspan.sources.radar.ti_config import read_settings
from radar_recordings import PLATE, Case, true_mm, write

WALL = Reflector(3.4, 900.0, ratio=1 / 1.27, azimuth_rad=0.2)
BEGIN_NS = 1_790_000_000 * NANOSECONDS
SITE = """
name = "site"
[store]
path = "store"
[[point]]
name = "p"
calibration_s = 12
[point.accelerometer]
source = "replay:recording"
[point.{kind}]
source = "replay:recording"
{more}
"""


def site_of(folder, kind, more=""):
    (folder / "SITE.toml").write_text(SITE.format(kind=kind, more=more))
    (plan,) = load_site(folder / "SITE.toml").points
    return running(plan, folder / "captures", folder).live


def stamped(record):
    return int(record.time_ns[-1] if isinstance(record, Readings) else record.time_ns)


def arrivals(folder, kind):
    """All records of a recording in the order of their stamps, the acceleration first."""
    address = f"replay:{folder}@{BEGIN_NS}#"
    found = [Arrival("accelerometer", 0, one) for _, one in readings(f"{address}accelerometer")]
    if kind == "radar":
        found += [Arrival(kind, 0, one) for _, one in range_frames(f"{address}{kind}")]
    else:
        (view,) = open_recording(folder).views
        moved_ns = BEGIN_NS - int(view.acceleration.time_ns[0])
        found += [Arrival(kind, 0, replace(one, time_ns=one.time_ns + moved_ns)) for one in view.frames.frames()]
    return sorted(found, key=lambda one: (stamped(one.record), one.stream))


def lived(point, records):
    """Push everything, doing the point's jobs at once; returns its rows: stamps, displacement and deviation in m."""
    for arrival in records:
        point.push(arrival)
        if point.job is not None and point.job.kind == "calibrate":
            calibration = midspan.calibrate(point.job.folder)
            point.calibrated(1)
        elif point.job is not None:
            point.is_opened(opened(point.job.folder, "p", calibration, 1))
    assert point.phase is Phase.RUNNING
    assert point.status is PointStatus.TRACKING
    rows = [one for one in point.batch().chunks if one.stream == "rows"]
    return tuple(
        np.concatenate([get(one) for one in rows])
        for get in (lambda c: c.time_ns, lambda c: c.columns["displacement_m"], lambda c: c.columns["std_m"])
    )


def test_a_radar_by_its_range_profiles(tmp_path):
    write(tmp_path / "recording", Case((WALL, PLATE), frames=3000))
    point = site_of(tmp_path, "radar")
    time_ns, value, std = lived(point, arrivals(tmp_path / "recording", "radar"))
    # Stamps move by the replay; the zero is that of the profiles that the point was opened from.
    truth = true_mm(tmp_path / "recording", (time_ns - BEGIN_NS) / NANOSECONDS)
    error = 1e3 * value - truth
    error -= error.mean()
    assert len(time_ns) > 900
    assert np.mean(np.abs(error) < 1.96e3 * std) > 0.9
    assert np.sqrt(np.mean(error**2)) < 0.1
    captured = open_recording(next(tmp_path.glob("captures/calibration-*")))
    (view,) = captured.views
    assert view.radar.info.channels == 2
    assert np.all(np.diff(view.radar.times_ns()) == 10**7)


def test_an_infrared_camera_by_its_temperatures(tmp_path):
    folder, rng = tmp_path / "recording", np.random.default_rng(3)
    folder.mkdir()
    motion = Sines(np.array([2e-3, 1.5e-3]), np.array([1.3, 0.7]), phase_rad=np.array([0.4, 1.0]))
    stamps = np.arange(0.3, 29.8, 1.0 / 8.0)
    scene = textured_scene("natural", (64, 72), rng=rng, reach_px=6.0, lens_px=1.0)
    moved_px = 1e3 * motion.displacement(stamps) / -2.0
    film = list(ThermalView((scene,)).film(np.column_stack((0.0 * moved_px, moved_px)), stamps, rng=rng))
    np.savez(folder / "infrared.npz", celsius=np.array(film), time_s=stamps)
    time_s = np.arange(0.0, 30.2, 0.01)
    acceleration = motion.acceleration(time_s) + rng.normal(0.0, 2e-3, len(time_s))
    np.savez(folder / "accel.npz", time_s=time_s, accel=acceleration)
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.npz"\nunit = "m/s^2"\n[infrared]\nfile = "infrared.npz"\ndirection = "y"\n'
    )
    # The range that would be optimised, which takes most of the time.
    low, high = np.percentile(film[0], (5.0, 95.0)).tolist()
    more = f'direction = "y"\nroi = [12, 10, 48, 44]\ntemperature_range_c = [{low}, {high}]'
    point = site_of(tmp_path, "infrared", more)
    time_ns, value, std = lived(point, arrivals(folder, "infrared"))
    error = 1e3 * (value - motion.displacement((time_ns - BEGIN_NS) / NANOSECONDS))
    error -= error.mean()
    assert len(time_ns) > 700
    assert np.mean(np.abs(error) < 1.96e3 * std) > 0.9
    assert np.sqrt(np.mean(error**2)) < 0.2


def datagrams(folder):
    """The bytes of a capture as the card sends them."""
    data = (folder / "adc_data.bin").read_bytes()
    for number, start in enumerate(range(0, len(data), 1456)):
        head = (number + 1).to_bytes(4, "little") + start.to_bytes(6, "little")
        yield head + data[start : start + 1456]


def test_a_capture_card_by_udp_gives_the_profiles_of_its_file(tmp_path):
    folder = write(tmp_path / "recording", Case((WALL, PLATE), frames=200))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    layout = read_settings(folder / "radar.cfg").layout(folder / "radar.cfg", "QQII")
    assert (layout.order, layout.lanes) == ("QQII", 2)
    begun = threading.Event()

    def send():
        begun.wait(10.0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for one in datagrams(folder):
                out.sendto(one, ("127.0.0.1", port))
                threading.Event().wait(0.0005)

    sender = threading.Thread(target=send)
    sender.start()
    found = []
    read = profiles(f"127.0.0.1:{port}", layout)
    threading.Timer(0.5, begun.set).start()
    with pytest.raises(SourceFault) as fault:
        found.extend(read)
    sender.join()
    assert fault.value.code == "stopped"
    (view,) = open_recording(folder).views
    stored = np.concatenate([one.phasors for one in view.radar.profiles()])
    whole = [k for k, one in enumerate(found) if one.valid.all()]
    # A busy machine may lose a datagram; the last frames are not finished by later ones.
    assert len(whole) > 150
    for k in whole:
        np.testing.assert_array_equal(found[k].phasors, stored[k])


def test_what_listens_nowhere_says_so(tmp_path):
    folder = write(tmp_path / "recording", Case((WALL, PLATE), frames=20))
    layout = read_settings(folder / "radar.cfg").layout(folder / "radar.cfg")
    with pytest.raises(SourceFault) as fault:
        next(profiles("203.0.113.1:4098", layout))
    assert fault.value.code == "not_found"
