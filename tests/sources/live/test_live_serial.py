"""Serial lines: their text, check sums, stamps by arrival, and a line over a pseudo terminal."""

import json
import os
import threading
import time
import tty
from functools import partial

import numpy as np
import pytest

from midspan.records import NANOSECONDS
from midspan.service.camera_process import ReadingThread
from midspan.sources.live.blocks import ACCELERATION
from midspan.sources.live.instants import LOOK_S, SourceFault
from midspan.sources.live.serial_line import Dating, block_of, blocks, device_and_baud

T0_NS = 1_790_000_000 * NANOSECONDS


def line(sequence, values=(0.25, -0.5), check=True, **more):
    body = json.dumps({"sequence": sequence, "dt_s": 0.01, "values": list(values), **more}).encode()
    found = 0
    for byte in body:
        found ^= byte
    return body + (b"*%02x" % found if check else b"") + b"\r\n"


def test_a_line_is_a_block():
    for check in (True, False):
        block = block_of(line(7, check=check, t0=T0_NS), ACCELERATION, Dating(), 0)
        assert (block.sequence, block.t0_ns, block.dt_ns) == (7, T0_NS, 10**7)
        np.testing.assert_array_equal(block.values, [0.25, -0.5])


@pytest.mark.parametrize(
    "text",
    [b"\xff\x00", b"*", b"{}", b"0.1,0.2", line(1, t0=T0_NS).replace(b"0.25", b"0.75"), b"[" * 100_000],
)
def test_a_line_that_is_no_block_is_a_fault(text):
    with pytest.raises(SourceFault) as fault:
        block_of(text, ACCELERATION, Dating(), T0_NS)
    assert fault.value.code == "payload"


def test_without_a_clock_the_least_delay_dates_all():
    rng, dating, errors = np.random.default_rng(0), Dating(), []
    for number in range(400):
        if number in (50, 51, 200):
            continue
        # The last of 20 values is there at 0.2 s a block; it comes 5 ms later or more.
        arrived_ns = T0_NS + round((0.2 * (number + 1) + 0.005 + rng.exponential(0.01)) * NANOSECONDS)
        errors.append(dating.t0_ns(number, 0.01, 20, arrived_ns) - T0_NS - round(0.2 * number * NANOSECONDS))
    # Once a hundred blocks came the least of their exponential delays is 0.1 ms on average; lost blocks shift nothing.
    late_ms = np.array(errors)[100:] / 1e6
    assert late_ms.min() > 5.0
    assert late_ms.max() < 5.6


def test_a_sender_that_was_started_again_is_dated_anew():
    dating = Dating()
    for number in range(1000, 1010):
        dating.t0_ns(number, 0.01, 10, T0_NS + number * 10**8)
    later_ns = T0_NS + 3600 * NANOSECONDS
    assert dating.t0_ns(0, 0.01, 10, later_ns) == later_ns - 10**8


def test_devices_have_a_speed():
    assert device_and_baud("/dev/ttyUSB0") == ("/dev/ttyUSB0", 115_200)
    assert device_and_baud("/dev/ttyUSB0@9600") == ("/dev/ttyUSB0", 9600)
    for wrong in ("", "@9600", "/dev/ttyUSB0@fast", "/dev/ttyUSB0@1"):
        with pytest.raises(ValueError, match="device"):
            device_and_baud(wrong)


def test_a_device_that_is_not_there_says_so():
    pytest.importorskip("serial")
    with pytest.raises(SourceFault) as fault:
        next(blocks("/dev/no-such-line", ACCELERATION))
    assert fault.value.code == "not_found"


def test_blocks_come_over_a_terminal_and_rubbish_between_them_is_a_fault():
    pytest.importorskip("serial")
    host, device = os.openpty()
    tty.setraw(device)
    found = []

    def read():
        try:
            found.extend(blocks(os.ttyname(device), ACCELERATION))
        except SourceFault as fault:
            found.append(fault)

    reader = threading.Thread(target=read)
    reader.start()
    # What the terminal holds from before it was opened is thrown away: write until it is read.
    until_s = time.monotonic() + 30.0
    while not found and time.monotonic() < until_s:
        os.write(host, b'sh": 1}\n' + line(1, t0=T0_NS))
        time.sleep(0.05)
    os.write(host, b"noise\xff\n" + line(2) + line(3))
    while (len(found) < 4 or getattr(found[-1], "sequence", 0) != 3) and time.monotonic() < until_s:
        time.sleep(0.05)
    os.close(host)
    os.close(device)
    reader.join(timeout=30.0)
    numbers = [item.sequence for item in found if not isinstance(item, SourceFault)]
    assert numbers[-2:] == [2, 3]
    codes = [item.code for item in found if isinstance(item, SourceFault)]
    assert "payload" in codes[:-1]
    assert codes[-1] == "stopped"
    assert 0 <= time.time_ns() - found[-2].t0_ns < 60 * NANOSECONDS


def test_who_opens_a_line_next_gets_every_line():
    """A reader that is stopped has left the line by then, though it waits ten seconds for the next one."""
    pytest.importorskip("serial")
    host, device = os.openpty()
    tty.setraw(device)
    found = {"old": [], "new": []}

    def reader(name):
        read = partial(blocks, os.ttyname(device), ACCELERATION)
        return ReadingThread(name, read, found[name].append)

    def sent(name, sequence):
        until_s = time.monotonic() + 10.0
        while not found[name] and time.monotonic() < until_s:
            # What the terminal holds from before it was opened is thrown away: write until it is read.
            os.write(host, line(sequence, t0=T0_NS))
            time.sleep(0.05)

    old, new = reader("old"), reader("new")
    old.start()
    sent("old", 0)
    old.stop()
    assert not old._thread.is_alive()
    before = len(found["old"])
    new.start()
    sent("new", 1)
    # A line in two parts, with a look whether the reader is to end between them, is one.
    text = line(2, t0=T0_NS)
    os.write(host, text[:20])
    time.sleep(1.5 * LOOK_S)
    os.write(host, text[20:])
    until_s = time.monotonic() + 10.0
    while found["new"][-1].sequence != 2 and time.monotonic() < until_s:
        time.sleep(0.02)
    new.stop()
    os.close(host)
    os.close(device)
    assert len(found["old"]) == before
    assert {one.sequence for one in found["new"]} == {1, 2}
