"""Live capture: datagrams in any order, with losses, through a sender on the loopback."""

import errno
import socket
import threading
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from radar_captures import echoes

from midspan.errors import DataError, UsageError
from midspan.radar.chirp import ChirpProfile
from midspan.radar.layout import Layout, pack
from midspan.simulate.radar.setup import packets
from midspan.sources.live.radar import LiveCapture, PacketOrder, UdpSettings

# A busy machine may keep a sender or the receiving thread waiting this long, s; a quiet one takes milliseconds.
WAIT_S = 100.0
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
    settings = UdpSettings("127.0.0.1", 0, timeout_s=WAIT_S, late_packets=8, first_time_ns=10**18)
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


def test_a_socket_that_fails_is_reported_with_its_reason_and_not_as_silence(monkeypatch) -> None:
    def fails(*_: object) -> bytes:
        raise OSError(errno.ENETDOWN, "Network is down")

    monkeypatch.setattr(socket.socket, "recvfrom", fails, raising=False)
    with LiveCapture(LAYOUT, UdpSettings("127.0.0.1", 0, timeout_s=0.2)) as capture:
        # The receiving thread has met the failure before frames are asked for.
        for thread in threading.enumerate():
            if thread.name == "radar capture":
                thread.join(WAIT_S)
        with pytest.raises(DataError, match="ended: Network is down"):
            next(capture.frames())


def test_a_reader_that_is_too_slow_loses_whole_frames_and_is_reported() -> None:
    with LiveCapture(LAYOUT, UdpSettings("127.0.0.1", 0, timeout_s=WAIT_S, waiting=5)) as capture:
        send(DATAGRAMS, capture.port).join()
        deadline = threading.Event()
        for _ in range(round(WAIT_S / 0.02)):
            if capture.dropped_frames >= 35:
                break
            deadline.wait(0.02)
        frames = list(capture.frames(5))
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4]
    assert capture.dropped_frames == 35


def test_a_port_in_use_is_a_usage_error() -> None:
    with (
        LiveCapture(LAYOUT, UdpSettings("127.0.0.1", 0)) as capture,
        pytest.raises(UsageError, match="Cannot listen on port"),
        LiveCapture(LAYOUT, UdpSettings("127.0.0.1", capture.port)),
    ):
        pass


# 10 s of the configured rate: a jump beyond that is no gap of the stream but another position.
AHEAD_FRAMES = 1000


def datagram(start: int, size: int = 1456) -> bytes:
    return (1).to_bytes(4, "little") + start.to_bytes(6, "little") + bytes(size)


@pytest.mark.parametrize("start", [10**9, 2**46, 2**48 - 1])
def test_one_datagram_with_a_count_far_ahead_is_a_stray_and_makes_no_frames(start: int) -> None:
    order = PacketOrder(2048, 64)
    out = [item for k in range(4) for item in order.push(DATAGRAMS[k])]
    out += order.push(datagram(start))
    out += [item for k in range(4, 20) for item in order.push(DATAGRAMS[k])]
    out += order.flush()
    assert b"".join(data for _, data, _ in out)[: 20 * 1456] == pack(CUBE, LAYOUT).tobytes()[: 20 * 1456]
    assert (order.stray_packets, order.positions) == (1, 0)


def test_strays_at_random_counts_cost_neither_memory_nor_frames() -> None:
    order = PacketOrder(1 << 20, 64)
    counts = np.random.default_rng(5).integers(0, 2**48, 5000)
    tracemalloc.start()
    frames = sum(len(order.push(datagram(int(start)))) for start in counts)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert frames == 0
    assert order.stray_packets >= 4990
    # Two bytes each (data, mask) of the packets that are waited for and of the frames they begin in.
    assert peak < 2 * (64 * 1456 + 3 * (1 << 20))


def test_a_gap_within_ten_seconds_is_filled_with_holes_at_hardly_any_memory() -> None:
    order = PacketOrder(1 << 20, 64)
    begin = AHEAD_FRAMES * (1 << 20) - 1456 * 8
    tracemalloc.start()
    out = [item for start in (0, *range(begin, begin + 9 * 1456, 1456)) for item in order.push(datagram(start))]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [number for number, _, _ in out] == list(range(AHEAD_FRAMES - 1))
    assert all(missing == b"\1" * (1 << 20) for _, _, missing in out[1:4])
    assert peak < 32 << 20  # not the 2 GiB of 999 frames and their masks


def test_a_card_that_restarts_is_a_new_position_whose_frames_count_on() -> None:
    order = PacketOrder(LAYOUT.frame_bytes, 4)
    first = [item for part in DATAGRAMS[:20] for item in order.push(part)]
    again = [item for part in DATAGRAMS for item in order.push(part)] + order.flush()
    assert order.positions == 1
    numbers = [number for number, _, _ in first + again]
    assert numbers == list(range(len(numbers)))
    assert b"".join(data for _, data, _ in again).endswith(pack(CUBE, LAYOUT).tobytes())


def test_a_capture_that_begins_in_mid_stream_begins_with_the_first_whole_frame() -> None:
    far = 3 * 10**9 // LAYOUT.frame_bytes * LAYOUT.frame_bytes
    moved = [d[:4] + (far + int.from_bytes(d[4:10], "little")).to_bytes(6, "little") + d[10:] for d in DATAGRAMS]
    order = PacketOrder(LAYOUT.frame_bytes, 64)
    out = [item for part in moved[1:] for item in order.push(part)] + order.flush()
    # The second datagram begins within frame 1.
    assert b"".join(data for _, data, _ in out) == pack(CUBE, LAYOUT).tobytes()[2 * LAYOUT.frame_bytes :]
    assert [number for number, _, _ in out] == list(range(38))
    assert order.lost_bytes == 0


def test_two_streams_at_once_leave_the_one_that_came_first_undisturbed() -> None:
    order = PacketOrder(LAYOUT.frame_bytes, 64)
    out = []
    for k, part in enumerate(DATAGRAMS):
        out += order.push(part)
        order.push(datagram(10**12 + 1456 * k))
    out += order.flush()
    assert b"".join(data for _, data, _ in out) == pack(CUBE, LAYOUT).tobytes()
    assert order.positions == 0


def test_packets_of_other_senders_are_counted_and_not_taken() -> None:
    with LiveCapture(LAYOUT, UdpSettings("127.0.0.1", 0, timeout_s=0.2, senders=("192.168.33.180",))) as capture:
        send(DATAGRAMS[:4], capture.port).join()
        # However long the thread that receives them takes on a busy machine.
        while capture.foreign_packets < 4:
            threading.Event().wait(0.01)
        with pytest.raises(DataError, match=r"4 packets came from senders other than 192\.168\.33\.180"):
            next(capture.frames())
    assert (capture.foreign_packets, capture.order.begun) == (4, False)


def test_a_restarted_card_is_an_event_and_its_frames_are_dated_by_their_arrival() -> None:
    settings = UdpSettings("127.0.0.1", 0, timeout_s=WAIT_S, first_time_ns=10**18, late_packets=4)
    layout = replace(LAYOUT, profile=replace(LAYOUT.profile, frame_period_s=1e-6))
    with LiveCapture(layout, settings) as capture:
        send(DATAGRAMS, capture.port).join()
        frames = list(capture.frames(35))
        threading.Event().wait(0.05)
        send(DATAGRAMS[:10], capture.port).join()
        frames += list(capture.frames(10))
    (event,) = capture.events
    assert event.kind == "gap"
    assert np.all(np.diff([frame.time_ns for frame in frames]) > 0)
    # 45 frames of 1 microsecond; only the gap, as the wall clock saw it, can make 50 ms.
    assert frames[-1].time_ns - frames[0].time_ns >= 50_000_000
    assert [frame.index for frame in frames] == list(range(45))


def test_nothing_but_the_card_and_the_loopback_is_listened_to_unless_it_is_asked_for() -> None:
    assert UdpSettings().address != "0.0.0.0"
    assert set(UdpSettings().senders or ()) == {"192.168.33.180", "127.0.0.1"}
