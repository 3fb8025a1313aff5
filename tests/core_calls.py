"""Random calls into every public class and function of the compiled core: `python tests/core_calls.py CALLS SEED FILE`.

The calls of a few small recordings are recorded at the border; then each is made again with some of its arguments
damaged. An error of Python is an answer; a panic, or the end of the process, is a defect. It runs as a process of its
own, with bounded memory, so that a crash is seen and named: FILE keeps the last call.
"""

import copy
import faulthandler
import inspect
import os
import resource
import sys
import tempfile
from collections import Counter, defaultdict
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

import midspan._core as core

MEMORY_BYTES = 6 << 30
LAST_CALL = os.open(sys.argv[3], os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
MAX_CALL_S = 60.0
MAX_TRACES, MAX_CALLS = 12, 12  # of a class; of one object
METHODS = ("kalman", "lag", "smoother", "adaptive-kalman")
TRACKERS = ("registration", "template", "features", "phase", "hybrid")


@dataclass
class Call:
    """One call at the border, with copies of its arguments as they were."""

    name: str
    arguments: tuple[Any, ...]
    named: dict[str, Any]


@dataclass
class Trace:
    """An object's construction and its first calls; of a function the one call."""

    made: Call
    calls: list[Call] = field(default_factory=list)


traces: defaultdict[str, list[Trace]] = defaultdict(list)


def plain(value: Any) -> Any:
    """The core's own object where a recorded one is given."""
    return value._inner if isinstance(value, Recorded) else value


def copied(value: Any) -> Any:
    """A copy that later calls do not change; what cannot be copied is kept as it is."""
    value = plain(value)
    try:
        return copy.deepcopy(value)
    except TypeError:
        return value


def call_of(name: str, arguments: tuple[Any, ...], named: dict[str, Any]) -> Call:
    return Call(name, tuple(map(copied, arguments)), {key: copied(value) for key, value in named.items()})


class Recorded:
    """Stands for a class of the core (`_target`) while its calls are recorded."""

    _target: Any = None

    def __init__(self, *arguments: Any, **named: Any) -> None:
        self._trace = Trace(call_of(self._target.__name__, arguments, named))
        self._inner = self._target(*map(plain, arguments), **{key: plain(value) for key, value in named.items()})
        of_class = traces[self._target.__name__]
        if len(of_class) < MAX_TRACES:
            of_class.append(self._trace)

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._inner, name)
        if not callable(value):
            return value

        def method(*arguments: Any, **named: Any) -> Any:
            if len(self._trace.calls) < MAX_CALLS:
                self._trace.calls.append(call_of(name, arguments, named))
            return value(*map(plain, arguments), **{key: plain(given) for key, given in named.items()})

        return method


def recorder(name: str, target: Any) -> Any:
    """What stands for a class or function of the core while calls are recorded."""
    if isinstance(target, type):
        return type(name, (Recorded,), {"_target": target})

    def call(*arguments: Any, **named: Any) -> Any:
        if len(traces[name]) < MAX_TRACES:
            traces[name].append(Trace(call_of(name, arguments, named)))
        return target(*map(plain, arguments), **{key: plain(value) for key, value in named.items()})

    return call


def public() -> dict[str, Any]:
    """The classes and functions of the core."""
    return {name: value for name in dir(core) if callable(value := getattr(core, name)) and not name.startswith("_")}


def record(folder: Path) -> None:
    """Tracks and estimates small recordings with every tracker and method, and simulates one."""
    for name, value in public().items():
        setattr(core, name, recorder(name, value))
    import lively_recordings
    import midspan

    np.save(folder / "stack.npy", stack())
    for tracker in TRACKERS:
        midspan.track(folder / "stack.npy", tracker=tracker, rate_hz=20.0)
    case = lively_recordings.Lively(rate_hz=50.0, rms_m=1e-3)
    for sensor in ("camera", "radar", "displacement"):
        written = lively_recordings.write(folder / sensor, case, sensor)
        recording = midspan.open_recording(written)
        calibration = midspan.calibrate(recording)
        for method in METHODS:
            midspan.estimate(recording, calibration=calibration, method=method)


def stack() -> Any:
    """Frames (60, 96 rows, 128 columns) of a texture that moves by up to 3 px."""
    rng, shape = np.random.default_rng(1), (96, 128)
    texture = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) * lowpass(shape), s=shape)
    texture *= 35.0 / texture.std()
    frames = []
    for k in range(60):
        moved = np.fft.irfft2(np.fft.rfft2(texture) * phase(shape, 2 * np.sin(0.3 * k), 3 * np.sin(0.2 * k)), s=shape)
        frames.append(np.clip(np.rint(128 + moved + rng.normal(0, 2, shape)), 0, 255).astype(np.uint8))
    return np.array(frames)


def lowpass(shape: tuple[int, int]) -> Any:
    down, across = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    return np.exp(-0.5 * (np.hypot(down, across) / 0.07) ** 2)


def phase(shape: tuple[int, int], x: float, y: float) -> Any:
    down, across = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    return np.exp(-2j * np.pi * (across * x + down * y))


# What an argument may be instead of what it should be.
ODD: tuple[Any, ...] = (
    None, True, 0, 1, -1, 2**31, -(2**63), 2**63 - 1, 2**70, 0.0, -0.0, 1e-320, -1.5, 1e308, np.nan, np.inf, -np.inf,
    "", "kalman", b"", b"\x00" * 16, b"\xff" * 200, (), [], {}, [1.0], (0, 0), (-3, 5), (1, 2, 3, 4), [[1.0, 2.0]],
    object(), np.zeros(0), np.zeros((0, 2)), np.zeros(3), np.full(5, np.nan), np.zeros((4, 4)), np.full((9, 9), np.inf),
    np.zeros((40, 50), np.uint8), np.zeros((40, 50), np.uint16), np.zeros((7, 1), np.uint8), np.zeros((40, 50), bool),
    np.arange(20)[::-1], np.arange(40.0).reshape(8, 5).T, np.array(1.0), np.zeros(3, complex), np.zeros((2, 2, 2)),
    np.array(["a"]), np.array([None]),
)  # fmt: skip


def damaged_array(value: Any, rng: Any) -> Any:
    """An array with another dtype, order, length, shape or some values that are not plausible."""
    kind = int(rng.integers(9))
    if kind == 0:
        return value.astype(rng.choice([np.float32, np.float64, np.int64, np.uint8, np.int32]))
    if kind == 1:
        return value[::-1]
    if kind == 2:
        return value[: len(value) // 2] if value.ndim else value
    if kind == 3:
        return value.T if value.ndim > 1 else value[::2]
    if kind == 4:
        return np.concatenate([value, value]) if value.ndim else value
    if kind == 5:
        return value[..., None]
    if kind == 6:
        return ~value if value.dtype == bool else -value
    if kind == 7:
        return value * 0
    spoilt = np.array(value)
    if spoilt.size:
        odd = [np.nan, np.inf, -1e30, 1e30] if spoilt.dtype.kind == "f" else [0, 1, 100]
        spoilt.reshape(-1)[int(rng.integers(spoilt.size))] = rng.choice(odd)
    return spoilt


def damaged(value: Any, rng: Any) -> Any:
    """The argument, damaged at random."""
    if rng.random() < 0.25:
        return ODD[int(rng.integers(len(ODD)))]
    if isinstance(value, np.ndarray):
        return damaged_array(value, rng) if value.dtype != object else value
    if isinstance(value, bytes) and value:
        cut = bytearray(value[: int(rng.integers(1, len(value) + 1))])
        cut[int(rng.integers(len(cut)))] ^= 1 << int(rng.integers(8))
        return bytes(cut)
    if isinstance(value, (tuple, list)) and value:
        place = int(rng.integers(len(value)))
        return type(value)(damaged(each, rng) if k == place else each for k, each in enumerate(value))
    if isinstance(value, bool) or value is None:
        return not value
    if isinstance(value, int | float):
        return (
            value * float(rng.choice([-1.0, 0.0, 0.5, 3.0, 1e3, 1e9, np.nan]))
            if isinstance(value, float)
            else (int(value * rng.choice([-1, 0, 2, 1000]) + rng.integers(-1, 2)))
        )
    if is_dataclass(value) or hasattr(value, "__slots__"):
        return damaged_record(value, rng)
    return ODD[int(rng.integers(len(ODD)))]


def damaged_record(value: Any, rng: Any) -> Any:
    """A copy of a settings record with one field damaged."""
    names = [each.name for each in fields(value)] if is_dataclass(value) else []
    if not names:
        return value
    changed, name = copy.copy(value), names[int(rng.integers(len(names)))]
    object.__setattr__(changed, name, damaged(getattr(value, name), rng))
    return changed


def make(target: Any, call: Call, rng: Any, share: float) -> Any:
    """The call, in `share` of all cases with one of its arguments damaged."""
    arguments, named = list(call.arguments), dict(call.named)
    if rng.random() < share and (arguments or named):
        place = int(rng.integers(len(arguments) + len(named)))
        if place < len(arguments):
            arguments[place] = damaged(arguments[place], rng)
        else:
            key = list(named)[place - len(arguments)]
            named[key] = damaged(named[key], rng)
    # What a crash leaves behind, at the file's beginning.
    os.pwrite(LAST_CALL, f"{call.name} {arguments!r} {named!r}"[:1999].ljust(2000).encode(), 0)
    # A call that takes so long waits for something that will not come.
    faulthandler.dump_traceback_later(MAX_CALL_S, exit=True)
    try:
        return target(*arguments, **named)
    finally:
        faulthandler.cancel_dump_traceback_later()


def tried(target: Any, call: Call, rng: Any, share: float, panics: Counter[str]) -> Any:
    """What the call returns; None where it raises, which is counted where it is a panic."""
    try:
        return make(target, call, rng, share)
    except Exception:
        return None
    except BaseException as error:
        if type(error).__name__ != "PanicException":
            raise
        panics[f"{call.name}: {error}"] += 1
        return None


def guessed(name: str, target: Any, rng: Any) -> Trace:
    """A call of what the recordings do not use, with as many arguments as it takes, none of them meant for it."""
    arguments, named = [], {}
    for each in inspect.signature(target).parameters.values():
        value = ODD[int(rng.integers(len(ODD)))]
        if each.kind is each.KEYWORD_ONLY:
            named[each.name] = value
        else:
            arguments.append(value)
    return Trace(Call(name, tuple(arguments), named))


def calls_at_random(count: int, seed: int, panics: Counter[str]) -> int:
    """Makes `count` calls; the number of those that were made of an object whose state may be odd already."""
    rng, names, done = np.random.default_rng(seed), sorted(public()), 0
    while done < count:
        name = names[int(rng.integers(len(names)))]
        of_name = traces.get(name)
        trace = of_name[int(rng.integers(len(of_name)))] if of_name else guessed(name, getattr(core, name), rng)
        made = tried(getattr(core, trace.made.name), trace.made, rng, 0.5 if trace.calls else 1.0, panics)
        done += 1
        if made is None or not isinstance(getattr(core, trace.made.name), type):
            continue
        for _ in range(int(rng.integers(1, 8))):
            call = trace.calls[int(rng.integers(len(trace.calls)))] if trace.calls else None
            if call is None:
                break
            tried(getattr(made, call.name), call, rng, 0.5, panics)
            done += 1
    return done


def main() -> None:
    np.set_printoptions(threshold=6, edgeitems=2)
    count, seed = int(sys.argv[1]), int(sys.argv[2])
    originals = public()
    with tempfile.TemporaryDirectory() as name:
        record(Path(name))
    for key, value in originals.items():
        setattr(core, key, value)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    panics: Counter[str] = Counter()
    done = calls_at_random(count, seed, panics)
    for text, times in panics.most_common():
        print(f"panic, {times} times: {text}")
    missing = sorted(set(originals) - set(traces))
    print(f"{done} calls of {len(traces)} classes and functions; not recorded: {', '.join(missing)}")
    sys.exit(1 if panics else 0)


if __name__ == "__main__":
    main()
