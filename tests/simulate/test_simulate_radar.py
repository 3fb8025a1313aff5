"""The simulated radar: its beat signal against the mixing of two chirps, its noise, antennas and files."""

import numpy as np
import pytest

from midspan.radar.chirp import SPEED_OF_LIGHT_M_S, ChirpProfile
from midspan.radar.layout import PACKET_BYTES, Layout, unpack
from midspan.simulate.motion.motion import Rest, Sines
from midspan.simulate.radar.setup import Capture, packets, write_capture
from midspan.simulate.radar.signal import SHORT_RANGE, RadarModel, Reflector, beat, noise_for, phase_bound_m

SMALL = ChirpProfile(77e9, 64.985e12, 6e6, 64, 0.01, receivers=4)


def test_the_beat_is_the_sent_chirp_times_the_conjugate_of_its_echo() -> None:
    delay = 2 * 7.46 / SPEED_OF_LIGHT_M_S
    time = SMALL.adc_start_s + np.arange(64) / SMALL.sample_rate_hz

    def turns(t):  # of a chirp, in extended precision: 77 GHz over 20 µs are 1.5 million of them
        t = t.astype(np.longdouble)
        return 77e9 * t + np.longdouble(64.985e12) * t * t / 2

    mixed = np.exp(2j * np.pi * np.asarray((turns(time) - turns(time - delay)) % 1, dtype=np.float64))
    np.testing.assert_allclose(beat(np.array([7.46]), SMALL)[0], mixed, atol=2e-5)


def test_noise_has_the_asked_ratio_and_antennas_see_the_azimuth() -> None:
    azimuth = 0.4
    model = RadarModel((Reflector(3.0, 100.0, 1.0, azimuth),), SMALL, noise_for(100.0, 20.0))
    cube = next(model.blocks(Rest(), 300, rng=np.random.default_rng(0)))
    mean = cube.mean(axis=0)
    assert np.mean(np.abs(cube - mean) ** 2) == pytest.approx(100.0, rel=0.02)
    turn = np.angle(np.sum(mean[0, 1:] * mean[0, :-1].conj(), axis=-1))
    np.testing.assert_allclose(turn, np.pi * np.sin(azimuth), atol=0.01)


def test_each_reflector_moves_by_its_ratio_and_its_own_motion_and_is_gone_when_blocked() -> None:
    motion, own = Sines(np.array([1e-3]), np.array([1.0])), Sines(np.array([0.4e-3]), np.array([3.0]))
    model = RadarModel((Reflector(3.0, 100.0, -0.5, own=own, blocked=((0.5, 0.6),)),), SMALL, 0.0, time_offset_s=0.02)
    cube = np.concatenate(list(model.blocks(motion, 100, rng=np.random.default_rng(0))))
    true = model.frame_s(100) + 0.02
    blocked = (true >= 0.5) & (true < 0.6)
    assert (cube[blocked] == 0).all()
    place = 3.0 - 0.5 * motion.displacement(true) + own.displacement(true)
    np.testing.assert_allclose(cube[~blocked, 0, 0], 100 * beat(place[~blocked], SMALL), atol=1e-3)


def test_a_capture_holds_the_cube_rounded_with_lost_packets_as_zeros_and_its_end_cut(tmp_path) -> None:
    model = RadarModel((Reflector(3.0, 1000.0),), SMALL, 10.0)
    layout = Layout(SMALL, "QIQI")
    cubes = list(model.blocks(Rest(), 600, rng=np.random.default_rng(1)))  # two blocks
    size = write_capture(tmp_path / "a.bin", cubes, Capture(layout, lost=(3, 400), cut_bytes=7))
    data = (tmp_path / "a.bin").read_bytes()
    assert len(data) == size == 600 * layout.frame_bytes - 7
    for packet in (3, 400):
        assert data[packet * PACKET_BYTES : (packet + 1) * PACKET_BYTES] == bytes(PACKET_BYTES)
    read = unpack(np.frombuffer(data[: 500 * layout.frame_bytes], dtype="<i2"), layout)
    np.testing.assert_allclose(read[100:300].real, cubes[0][100:300].real, atol=0.5)
    # Two blocks are written as one stream.
    assert np.abs(np.frombuffer(data[500 * layout.frame_bytes : 501 * layout.frame_bytes], dtype="<i2")).max() > 500


def test_datagrams_count_their_bytes() -> None:
    words = np.arange(2000, dtype=np.int16)
    sent = list(packets(words))
    assert [int.from_bytes(d[:4], "little") for d in sent] == [1, 2, 3]
    assert [int.from_bytes(d[4:10], "little") for d in sent] == [0, 1456, 2912]
    assert b"".join(d[10:] for d in sent) == words.tobytes()


def test_the_bound_of_the_phase_is_micrometres_at_twenty_decibels() -> None:
    # λ / (4 π sqrt(2 · 100 · 256)) with λ = 3.806 mm
    assert phase_bound_m(20.0, SHORT_RANGE) == pytest.approx(1.338e-6, rel=1e-3)
    assert phase_bound_m(20.0, SHORT_RANGE, 4) == pytest.approx(0.669e-6, rel=1e-3)
