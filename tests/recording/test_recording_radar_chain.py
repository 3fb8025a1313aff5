"""The radar's stage as it is built from a calibration, over a capture on disk."""

from dataclasses import replace

import numpy as np
import pytest

import midspan
from midspan.engine.channels import OTHER_ZERO_STD_M, radar_chain
from midspan.engine.radar import RadarChain
from midspan.records import NANOSECONDS, Source, Status
from midspan.simulate.radar.signal import Reflector
from radar_recordings import PLATE, Case, true_mm, write

WALL, PIER = Reflector(3.4, 900.0, ratio=1 / 1.27, azimuth_rad=0.2), Reflector(6.1, 700.0, ratio=-1 / 1.6)


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """Folder, recording and the radar's part of the calibration of two targets, with lost packets."""
    folder = write(tmp_path_factory.mktemp("radar") / "capture", Case((WALL, PIER, PLATE), lost=tuple(range(500, 510))))
    recording = midspan.open_recording(folder)
    return folder, recording, midspan.calibrate(recording).radar


def test_every_target_shows_the_displacement_to_its_noise_and_holes_are_no_measurements(known) -> None:
    folder, recording, calibration = known
    chain, channels = radar_chain(calibration, recording.radar.info)
    time_ns = recording.radar.times_ns()
    true = true_mm(folder, time_ns / NANOSECONDS + calibration.offset.value_s)
    frames = [frame for block in recording.radar.slow_time(chain.bins) for frame in block]
    assert [frame.time_ns for frame in frames] == time_ns.tolist()
    met, zero = [], np.nan
    for frame, moved in zip(frames, true, strict=True):
        # Predicted as by an estimator that is good to 0.1 mm.
        expected = [(1e-3 * channel.units_per_m * (moved - zero), 0.1) for channel in channels]
        met.append(chain.push(frame, expected if np.isfinite(zero) else None))
        zero = moved if not np.isfinite(zero) and met[-1][0].status == Status.TRACKING else zero
    for k, (target, channel) in enumerate(zip(calibration.used, channels, strict=True)):
        value = 1e3 * np.array([one[k].phase_rad for one in met]) / channel.units_per_m
        std = 1e3 * np.sqrt([one[k].variance_rad2 for one in met]) / abs(channel.units_per_m)
        seen = np.isfinite(value)
        error = (value - true)[seen] - np.median((value - true)[seen])
        # The stated noise is that of the receiver; the factor's error of 0.03 % adds 1 µm of 5 mm.
        assert np.std(error) < 1.1 * np.median(std[seen]) + 1e3 * target.relative_std * np.std(true)
        assert np.mean(np.abs(error) < 1.96 * std[seen]) > 0.9
        assert 0 < np.count_nonzero(~seen[64:]) < 60
        assert np.isfinite([one[k].phase_rad for one in met if one[k].status == Status.TRACKING]).all()
    assert any(event.kind == "lost frames" for one in met for event in one[0].events)


def test_a_channel_says_its_unit_its_zero_and_its_noise(known) -> None:
    _, recording, calibration = known
    chain, channels = radar_chain(calibration, recording.radar.info, sensor="radar north")
    assert isinstance(chain, RadarChain)
    assert [channel.target for channel in channels] == ["1", "2"]
    info = recording.radar.info
    for target, channel in zip(calibration.used, channels, strict=True):
        assert (channel.sensor, channel.source) == ("radar north", Source.RADAR)
        assert channel.units_per_m * target.conversion_factor == pytest.approx(info.axis.phase_per_m(target.range_m))
        assert channel.variance_factor == calibration.variance_factor
    best = calibration.best
    assert channels[0].zero_std_m == pytest.approx(best.noise_m, rel=0.2)
    assert channels[1].zero_std_m == OTHER_ZERO_STD_M
    # One range bin is 0.22 m: the places of both targets and two bins on either side.
    assert set(chain.bins) >= {np.floor(target.place_bin) for target in calibration.used}
    bent = replace(best, modulation_rad=0.3)
    other = replace(calibration, targets=(replace(calibration.targets[0], target=bent), *calibration.targets[1:]))
    units = abs(channels[0].units_per_m)
    assert radar_chain(other, info)[1][0].zero_std_m == pytest.approx(np.hypot(best.noise_m, 0.3 / units), rel=1e-6)
