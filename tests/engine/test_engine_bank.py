"""The bank's filter against other solutions of the same model, and what must not change its rows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from tests.engine.bank_bridge import RATE_HZ, T0_NS, block, measured, motion, run, seconds_of, table

from midspan.engine.bank import Bank, BankBlocks, BankCode, BankSensor, BankSettings
from midspan.errors import UsageError
from midspan.fusion.streams import KalmanSettings, filtered
from midspan.records import Acceleration, Displacement, Source, Status

SETTINGS = BankSettings(0.005, 0.0015)
PLAIN = replace(SETTINGS, slow_std_m=0.0, delay_std_s=0.0, gain_std=0.0, as_stated=True, rounded=False)


def plain_filter(record, settings):
    """Displacement, deviation and velocity (n,) of x'' = a − b with the same input and noise: matrix exponentials."""
    dt, interval = 1.0 / RATE_HZ, 1.0 / record.displacement_hz
    a, density = record.acceleration, settings.acceleration_std_m_s2**2 / RATE_HZ
    f = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
    noise = np.diag([0.0, density, settings.bias_walk])
    loan = expm(np.block([[-f, noise], [np.zeros((3, 3)), f.T]]) * dt)
    phi = loan[3:, 3:].T
    q = phi @ loan[:3, 3:]
    x, p = np.array([record.displacement_m[0], 0.0, a[0]]), np.diag([settings.displacement_std_m**2, 0.09, 0.09])
    rows, lead = [], dt * dt / 12.0
    every, h = round(interval / dt), np.array([1.0, 0.0, 0.0])
    before = 0.0
    for k in range(1, len(a)):
        slope = (a[k] - a[k - 1]) / dt
        # The velocity state is ahead of the velocity by lead · a', see estimator::motion; the first interval begins it.
        push = np.array([dt * dt * (5.0 * a[k - 1] + a[k]) / 12.0, 0.5 * dt * (a[k - 1] + a[k]), 0.0])
        x, p = phi @ x + push, phi @ p @ phi.T + q
        if k % every == 0:
            s = p[0, 0] + settings.displacement_std_m**2
            gain = p @ h / s
            x, p = x + gain * (record.displacement_m[k // every] - x[0]), p - np.outer(gain, gain) * s
        before = slope
        rows.append((x[0], np.sqrt(p[0, 0]), x[1] - lead * before))
    return np.array(rows)


def quiet_record(seconds=40, seed=3):
    """A record without any measurement that may be an outlier: its errors are cut at two deviations."""
    record = measured(*motion(seconds, seed), seed)
    noise = np.random.default_rng(seed).standard_normal(len(record.displacement_m)).clip(-2.0, 2.0)
    record.displacement_m = record.truth_m[:: round(RATE_HZ / record.displacement_hz)] + 0.0015 * noise
    return record


def test_the_rows_are_those_of_a_plain_kalman_filter():
    record = quiet_record()
    rows, events = run(record, PLAIN)
    plain = plain_filter(record, PLAIN)[rows.index - 1]
    assert events == []
    # The state is taken from the first measurement in both; rounding of seconds to floats is what is left.
    assert np.abs(rows.displacement_m - plain[:, 0]).max() < 1e-9 * np.abs(plain[:, 0]).max()
    assert np.abs(rows.std_m / plain[:, 1] - 1.0).max() < 1e-9
    assert np.abs(rows.velocity_m_s - plain[:, 2]).max() < 1e-9 * np.abs(plain[:, 2]).max()


def test_the_rows_are_those_of_the_estimator():
    record = quiet_record()
    rows, _ = run(record, PLAIN)
    time_ns = T0_NS + np.arange(len(record.acceleration), dtype=np.int64) * 10_000_000
    count = len(record.displacement_m)
    peer = filtered(
        Acceleration(time_ns, record.acceleration, np.full(len(time_ns), PLAIN.acceleration_std_m_s2**2 / RATE_HZ)),
        Displacement(
            T0_NS + np.arange(count, dtype=np.int64) * 100_000_000,
            record.displacement_m,
            np.full(count, PLAIN.displacement_std_m**2),
            np.full(count, Source.DISPLACEMENT, dtype=np.uint8),
        ),
        KalmanSettings(bias=float(record.acceleration[0]), noise_memory=np.inf),
    ).estimate
    after = rows.index > 10 * RATE_HZ
    place = np.searchsorted(peer.time_ns, T0_NS + rows.index[after] * 10_000_000)
    std = np.sqrt(peer.variance_m2[place])
    assert np.abs(rows.std_m[after] / std - 1.0).max() < 0.03
    difference = (rows.displacement_m[after] - peer.displacement_m[place]) / std
    assert np.sqrt(np.mean(difference**2)) < 0.03


@pytest.mark.parametrize("cut", [1, 7, 33, 1000])
def test_any_cutting_gives_the_same_rows(cut):
    record = measured(*motion(30, 5), 5)
    whole, _ = run(record, SETTINGS)
    bank, parts, rng = Bank(1, SETTINGS), [], np.random.default_rng(cut)
    pieces = [
        (sensor, begin, values[begin : begin + cut], step)
        for sensor, values, step in (
            (BankSensor.ACCELERATION, record.acceleration, 10_000_000),
            (BankSensor.DISPLACEMENT, record.displacement_m, 100_000_000),
        )
        for begin in range(0, len(values), cut)
    ]
    # In the order of their stamps, but for neighbours that change places and pieces that come twice.
    pieces.sort(key=lambda one: one[1] * one[3] + rng.uniform(0.0, 5e8))
    for sensor, begin, values, step in pieces:
        for _ in range(1 + (rng.random() < 0.2)):
            bank.push(block(sensor, values, T0_NS + begin * step, step))
        if rng.random() < 0.3:
            parts.append(bank.rows(T0_NS))
    parts.append(bank.rows(T0_NS + 30_000_000_000))
    again = table(parts)
    for name in ("index", "displacement_m", "std_m", "velocity_m_s", "status"):
        assert np.array_equal(getattr(again, name), getattr(whole, name))


def test_a_bank_goes_on_from_its_state_with_the_same_rows():
    record = measured(*motion(40, 6), 6)
    bank, parts = Bank(1, SETTINGS), []
    for second, (now_ns, blocks) in enumerate(seconds_of(record)):
        for one in blocks:
            bank.push(one)
        if second % 7 == 3:
            bank = Bank.restored(bank.state(), SETTINGS)
        parts.append(bank.rows(now_ns))
    whole, _ = run(record, SETTINGS)
    assert np.array_equal(table(parts).displacement_m, whole.displacement_m)
    assert np.array_equal(table(parts).std_m, whole.std_m)


def test_the_rows_of_a_point_do_not_depend_on_the_others():
    records = [measured(*motion(12, 20 + k), 20 + k) for k in range(5)]
    bank, parts = Bank(1000, SETTINGS), []
    numbers = np.arange(1000, dtype=np.uint32)
    for k, group in enumerate(zip(*[list(seconds_of(one)) for one in records], strict=True)):
        for sensor in BankSensor:
            values = np.concatenate([group[j % 5][1][sensor].values for j in range(1000)])
            single = group[0][1][sensor]
            bank.push(
                BankBlocks(
                    sensor,
                    numbers,
                    np.full(1000, single.t0_ns[0]),
                    np.full(1000, single.dt_ns[0]),
                    np.full(1000, single.count[0], dtype=np.uint32),
                    values,
                )
            )
        parts.append(bank.rows(group[0][0]))
        assert k < 12
    for point in (0, 3, 501, 999):
        alone, _ = run(records[point % 5], SETTINGS)
        together = table(parts, point)
        assert np.array_equal(together.displacement_m, alone.displacement_m)
        assert np.array_equal(together.std_m, alone.std_m)


def test_rows_are_rounded_to_what_their_deviation_leaves():
    record = measured(*motion(30, 8), 8)
    rounded, _ = run(record, SETTINGS)
    exact, _ = run(record, replace(SETTINGS, rounded=False))
    assert np.abs(rounded.displacement_m - exact.displacement_m).max() <= (exact.std_m / 512).max()
    assert np.all((rounded.std_m >= exact.std_m) & (rounded.std_m <= exact.std_m * (1 + 1 / 64)))
    unit = 2.0 ** np.floor(np.log2(exact.std_m)) / 256
    assert np.array_equal(rounded.displacement_m / unit, np.rint(rounded.displacement_m / unit))


def test_a_point_without_displacement_coasts_is_lost_and_ends():
    record = measured(*motion(80, 9), 9)
    record.displacement_m[200:] = np.nan
    rows, events = run(record, SETTINGS, wait_s=5)
    last = 199 * RATE_HZ // 10
    status = dict(zip(rows.index, rows.status, strict=True))
    assert status[last + 40] == Status.TRACKING
    assert status[last + 60] == status[last + 990] == Status.COASTING
    assert status[last + 1010] == Status.LOST
    # Lost after 10 s, and rows for 30 s more.
    assert rows.index[-1] == pytest.approx(last + 4000, abs=1)
    assert [one.code for one in events] == [BankCode.LOST]
    assert np.all(np.diff(rows.std_m[rows.index > last]) >= 0.0)


def test_a_gap_of_the_acceleration_has_no_rows_and_a_wide_band_after_it():
    record = measured(*motion(60, 10), 10)
    record.acceleration[3000:3200] = np.nan
    rows, _ = run(record, SETTINGS)
    assert not np.any((rows.index >= 3000) & (rows.index < 3200))
    # The slow error of the displacement sensor stands in both.
    before, after = (rows.std_m[rows.index == index] ** 2 for index in (2999, 3200))
    assert after - before > SETTINGS.displacement_std_m**2
    error = np.abs(rows.displacement_m - record.truth_m[rows.index])
    assert np.mean(error < 1.96 * rows.std_m) > 0.93


def test_what_comes_too_late_is_left_out_with_an_event():
    record = measured(*motion(20, 11), 11)
    blocks = list(seconds_of(record))
    bank = Bank(1, SETTINGS)
    for now_ns, both in blocks:
        for one in both:
            bank.push(one)
        bank.rows(now_ns)
    bank.push(blocks[5][1][0])
    assert [one.code for one in bank.events()] == [BankCode.LATE]


@pytest.mark.parametrize(
    ("t0_ns", "dt_ns"), [(2**63 - 1, 1), (-(2**63), 10**7), (T0_NS, 2**63 - 1), (T0_NS + 10**18, 10**7)]
)
def test_absurd_stamps_do_no_harm(t0_ns, dt_ns):
    record = measured(*motion(20, 12), 12)
    whole, _ = run(record, SETTINGS)
    bank, parts = Bank(1, SETTINGS), []
    for now_ns, both in seconds_of(record):
        for one in both:
            bank.push(one)
            bank.push(block(one.sensor, np.array([1e300, np.inf, 3.0, np.nan]), t0_ns, dt_ns))
        parts.append(bank.rows(now_ns))
    assert np.array_equal(table(parts).displacement_m, whole.displacement_m)


def test_what_waits_is_bounded():
    bank = Bank(1, SETTINGS)
    for k in range(100):
        bank.push(block(BankSensor.ACCELERATION, np.zeros(100), T0_NS + k * 10**9, 10**7))
    assert BankCode.OVERFLOW in {one.code for one in bank.events()}
    assert len(bank.state()) < 150_000


def test_displacements_without_accelerations_do_not_pile_up():
    bank, parts = Bank(1, SETTINGS), list(seconds_of(measured(*motion(20, 12), 12)))
    for now_ns, both in parts:
        for one in both:
            bank.push(one)
        bank.rows(now_ns)
    displacement, first_ns = parts[-1][1][1], parts[-1][1][1].t0_ns.copy()
    for second in range(1, 600):
        bank.push(replace(displacement, t0_ns=first_ns + second * 10**9))
        bank.rows(int(first_ns[0]) + (second + 1) * 10**9)
    # Of 33 s at 10 Hz: stamp, step and value of each.
    assert len(bank.state()) < 33 * 10 * 24 + 600
    assert bank.events() == []


def test_a_point_needs_some_260_bytes_besides_what_waits():
    assert len(Bank(1000, SETTINGS).state()) < 1000 * 268


def test_wrong_arguments_and_states_are_refused():
    with pytest.raises(UsageError, match="acceleration_std_m_s2"):
        BankSettings(0.0, 0.001)
    with pytest.raises(UsageError, match="points"):
        Bank(0, SETTINGS)
    bank = Bank(2, SETTINGS)
    with pytest.raises(ValueError, match="point: 2 of 2"):
        bank.push(block(BankSensor.ACCELERATION, np.zeros(3), T0_NS, 10**7, point=2))
    with pytest.raises(ValueError, match="other settings"):
        Bank.restored(bank.state(), replace(SETTINGS, wait_s=3.0))
    with pytest.raises(ValueError, match="cut short or changed"):
        Bank.restored(bank.state()[:-1], SETTINGS)
