"""Live capture: datagrams in any order, with losses, through a sender on the loopback."""

import errno
import socket
import threading

import numpy as np
import pytest
from radar_captures import echoes

from midspan.errors import DataError, UsageError
from midspan.radar.chirp import ChirpProfile
from midspan.radar.layout import Layout, pack
from midspan.simulate.radar.files import packets
from midspan.sources.radar.udp import LiveCapture, PacketOrder, UdpSettings

LAYOUT = Layout(ChirpProfile(77e9, 64.985e12, 6e6, 64, 0.01))
CUBE = echoes((7.0,))
DATAGRAMS = list(packets(pack(CUBE, LAYOUT)))


def shuffled(seed: int, reach: int = 6) -> list[bytes]:
    """Datagrams that overtake each other by a few places."""
    order = np.argsort(np.arange(len(DATAGRAMS)) + np.random.default_rng(seed).uniform(0, reach, len(DATAGRAMS)))
    return [DATAGRAMS[k] for k in order]


def ordered(datagrams: list[bytes], late: int = 64):
    order = PacketOrder(LAYOUT.frame_bytes, late)
    out = [item for datagram in datagrams for item in order.push(datagram)]
    return order, out + order.flush()


@pytest.mark.parametrize("seed", [0, 1])
def test_datagrams_in_any_order_make_the_frames_that_were_sent(seed: int) -> None:
    order, out = ordered(shuffled(seed))
    assert b"".join(data for _, data, _ in out) == pack(CUBE, LAYOUT).tobytes()
    assert [number for number, _, _ in out] == list(range(40))
    assert (order.lost_bytes, order.stale_packets) == (0, 0)


def test_a_lost_datagram_leaves_a_hole_of_its_exact_place_and_length() -> None:
    order, out = ordered([d for k, d in enumerate(DATAGRAMS) if k not in (4, 11, 12)])
    missing = np.frombuffer(b"".join(m for _, _, m in out), dtype=np.uint8)
    expected = np.zeros(len(missing), dtype=np.uint8)
    for k in (4, 11, 12):
        expected[k * 1456 : (k + 1) * 1456] = 1
    np.testing.assert_array_equal(missing, expected)
    assert order.lost_bytes == 3 * 1456


def test_a_frame_is_given_out_when_it_is_whole_and_a_datagram_after_that_is_stale() -> None:
    order = PacketOrder(LAYOUT.frame_bytes, late_packets=2)
    assert order.push(DATAGRAMS[0]) != []  # 1456 bytes hold the first frame of 1024
    assert order.push(DATAGRAMS[2]) == []
    given = order.push(DATAGRAMS[3])  # two packets beyond the end of frame 1: it is not waited for any longer
    assert [number for number, _, _ in given][:1] == [1]
    assert order.push(DATAGRAMS[0]) == []
    assert order.stale_packets == 1


def send(datagrams: list[bytes], port: int) -> threading.Thread:
    def work() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for datagram in datagrams:
                sender.sendto(datagram, ("127.0.0.1", port))

    thread = threading.Thread(target=work)
    thread.start()
    return thread


def test_frames_arrive_over_the_loopback_in_order_with_holes_marked_and_even_stamps() -> None:
    lost = 9
    kept = [d for d in shuffled(2) if d is not DATAGRAMS[lost]]
    settings = UdpSettings("127.0.0.1", 0, timeout_s=1.0, late_packets=8, first_time_ns=10**18)
    with LiveCapture(LAYOUT, settings) as capture:
        sending = send(kept, capture.port)
        frames = list(capture.frames(35))
        sending.join()
    assert [frame.index for frame in frames] == list(range(35))
    for frame in frames:
        np.testing.assert_array_equal(frame.samples[frame.valid], CUBE[frame.index][frame.valid])
    # Datagram 9 holds bytes 13104 to 14560: blocks 51 to 56 of 256 bytes, which are receivers of frames 12 to 14.
    holes = {(frame.index, int(r)) for frame in frames for r in np.flatnonzero(~frame.valid[0])}
    assert holes == {(block // 4, block % 4) for block in range(51, 57)}
    np.testing.assert_array_equal(np.diff([frame.time_ns for frame in frames]), 10_000_000)
    assert capture.dropped_frames == 0


def test_silence_ends_the_capture_with_an_error_instead_of_waiting_for_ever() -> None:
    with (
        LiveCapture(LAYOUT, UdpSettings("127.0.0.1", 0, timeout_s=0.1)) as capture,
        pytest.raises(DataError, match=r"No frame came .* for 0\.1 s"),
    ):
        next(capture.frames())


def test_a_socket_that_fails_is_told_with_its_reason_and_not_as_silence(monkeypatch) -> None:
    def fails(*_: object) -> bytes:
        raise OSError(errno.ENETDOWN, "Network is down")

    monkeypatch.setattr(socket.socket, "recv", fails, raising=False)
    with (
        LiveCapture(LAYOUT, UdpSettings("127.0.0.1", 0, timeout_s=0.2)) as capture,
        pytest.raises(DataError, match="ended: Network is down"),
    ):
        next(capture.frames())


def test_a_reader_that_is_too_slow_loses_whole_frames_and_is_told() -> None:
    with LiveCapture(LAYOUT, UdpSettings("127.0.0.1", 0, timeout_s=1.0, waiting=5)) as capture:
        send(DATAGRAMS, capture.port).join()
        deadline = threading.Event()
        for _ in range(100):
            if capture.dropped_frames >= 35:
                break
            deadline.wait(0.02)
        frames = list(capture.frames(5))
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4]
    assert capture.dropped_frames == 35


def test_a_port_in_use_is_a_usage_error() -> None:
    with (
        LiveCapture(LAYOUT, UdpSettings("127.0.0.1", 0)) as capture,
        pytest.raises(UsageError, match="cannot be listened on"),
        LiveCapture(LAYOUT, UdpSettings("127.0.0.1", capture.port)),
    ):
        pass
