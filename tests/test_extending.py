"""What a new tracker, fusion method and sensor take: a file each and a row in a table, nothing else is touched."""

import sys
from dataclasses import dataclass
from types import ModuleType

import numpy as np
import pytest

import midspan
from lively_recordings import Lively, write
from midspan.engine.axis import AxisFigures
from midspan.engine.camera import CameraChain, CameraState, Target
from midspan.engine.checkpoint import from_bytes, to_bytes
from midspan.engine.guard import Guard, GuardSettings
from midspan.engine.merge import Merge
from midspan.engine.point import ACCELEROMETER, Point
from midspan.engine.sensors import Seen
from midspan.engine.target_opening import Opening
from midspan.fusion.blocks import Rows
from midspan.fusion.estimator import Estimator
from midspan.fusion.methods import METHODS, Method, Pass
from midspan.fusion.model import EstimatorSettings
from midspan.fusion.on_series import MethodRows
from midspan.records import (
    Arrival,
    Channel,
    Frame,
    Measured,
    PixelTranslation,
    Readings,
    Region,
    Source,
    Status,
    joined,
)
from midspan.simulate.scene.texture import textured_scene
from midspan.vision.tracker import TRACKERS, Tracker, TrackerEntry

LIVELY = Lively(duration_s=14.0, rms_m=2e-3, band_hz=(1.0, 3.0))


@dataclass(frozen=True)
class NoSettings:
    pass


@dataclass(frozen=True, slots=True)
class Place:
    x_px: float
    y_px: float


class CorrelationTracker(Tracker):
    """The largest value of the circular cross correlation of the whole region, refined by a parabola."""

    _state: Place

    def __init__(self, reference, region, settings):
        super().__init__(reference, region)
        self._state = Place(0.0, 0.0)
        self._template = np.conj(np.fft.fft2(self._cut(reference)))

    def _cut(self, frame):
        r = self.region
        cut = frame.pixels[r.y : r.y + r.height, r.x : r.x + r.width].astype(float)
        return (cut - cut.mean()) * np.outer(np.hanning(r.height), np.hanning(r.width))

    def push(self, frame, prediction=None):
        found = np.fft.ifft2(np.fft.fft2(self._cut(frame)) * self._template).real
        y, x = np.unravel_index(int(np.argmax(found)), found.shape)
        moved = []
        for line, k in ((found[y], x), (found[:, x], y)):
            a, b, c = line[k - 1], line[k], line[(k + 1) % len(line)]
            moved.append((k + len(line) // 2) % len(line) - len(line) // 2 + 0.5 * (a - c) / (a - 2 * b + c))
        self._state = Place(*moved)
        return PixelTranslation(frame.time_ns, *moved, 0.02**2, 0.02**2, 1.0, Status.TRACKING, 100.0)


def as_module(monkeypatch, name, **members):
    module = ModuleType(name)
    vars(module).update(members)
    monkeypatch.setitem(sys.modules, name, module)


def rms_mm(result):
    settled = result.time_s > 3.0
    return float(np.std((result.displacement_mm - LIVELY.from_zero_mm(result.time_s))[settled]))


@pytest.fixture
def correlation(monkeypatch):
    as_module(monkeypatch, "correlation", CorrelationTracker=CorrelationTracker, NoSettings=NoSettings)
    monkeypatch.setitem(TRACKERS, "correlation", TrackerEntry("correlation", "CorrelationTracker", "NoSettings", "toy"))


@pytest.mark.usefixtures("correlation")
def test_a_tracker_is_a_file_and_a_row(tmp_path):
    folder = write(tmp_path, LIVELY, "camera", 'tracker = "correlation"')
    result = midspan.estimate(folder)
    # A window that does not move with the target weakens what is correlated: a few hundredths of a pixel of 1.5 mm.
    assert rms_mm(result) < 0.1


@pytest.mark.usefixtures("correlation")
def test_a_checkpoint_keeps_its_state():
    scene = textured_scene("natural", (64, 64), rng=np.random.default_rng(0))
    frames = [Frame(k, scene.render(0.2 * k, 0.3)) for k in range(3)]
    chain, other = (CameraChain(frames[0], (Target(Region(8, 8, 48, 48)),), Opening("correlation")) for _ in range(2))
    chain.push(frames[1])
    other.restore(from_bytes(to_bytes(chain.state), CameraState))
    assert other.push(frames[2]) == chain.push(frames[2])
    assert other.state.targets[0].tracker == chain.state.targets[0].tracker != Place(0.0, 0.0)


def test_a_method_is_a_file_and_a_row(tmp_path, monkeypatch):
    class Nearest:
        """The last displacement before each sample, a millimetre off."""

        delay_samples, state = 0, ()

        def __init__(self, settings, usual):
            self.time_ns, self.value_m = np.empty(0, dtype=np.int64), np.empty(0)

        def wait(self, met):
            self.time_ns, self.value_m = np.append(self.time_ns, met.time_ns), np.append(self.value_m, met.value_m)

        def push(self, acceleration):
            pass

        def rows(self, time_ns):
            place = np.searchsorted(self.time_ns, time_ns, side="right") - 1
            value = self.value_m[np.maximum(place, 0)] + 1e-3
            return MethodRows(value, np.zeros(len(value)), place >= 0)

        def predict(self, time_ns):
            return None

    as_module(monkeypatch, "off", Nearest=Nearest)
    monkeypatch.setitem(METHODS, "off-by-one", Method("toy", Pass.CAUSAL, on_series="off:Nearest"))
    folder = write(tmp_path, LIVELY, "displacement")
    result = midspan.estimate(folder, method="off-by-one")
    assert result.method == "off-by-one"
    # A name that nothing knows: the class alone can have made the rows, and their band holds what it is off by.
    error = result.displacement_mm - 1e3 * LIVELY.motion(result.time_s)
    assert np.mean(error[result.time_s > 3.0]) == pytest.approx(1.0, abs=0.1)
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.95


@pytest.mark.parametrize("known", ["kalman", "lag", "smoother", "adaptive-kalman"])
def test_a_method_of_the_estimator_is_a_row_under_any_name(tmp_path, monkeypatch, known):
    monkeypatch.setitem(METHODS, "toy", METHODS[known])
    folder = write(tmp_path, LIVELY, "displacement")
    toy, own = (midspan.estimate(folder, method=name) for name in ("toy", known))
    assert np.array_equal(toy.displacement_mm, own.displacement_mm)
    assert np.array_equal(toy.displacement_std_mm, own.displacement_std_mm)


def test_a_row_that_nothing_can_run_is_refused():
    with pytest.raises(midspan.UsageError, match="as printed must have on_series"):
        Method("toy", Pass.CAUSAL, literal=True)


class Potentiometer:
    """A sensor that measures the displacement in V: 40 V a metre."""

    state = None
    reached = None

    def restore(self, state):
        pass

    def push(self, record, expect):
        n = len(record.time_ns)
        measured = Measured(
            record.time_ns, np.zeros(n, dtype=np.int64), record.value[:, 0], np.full(n, 4e-3**2), np.zeros(n)
        )
        return Seen("potentiometer", measured)


def test_a_sensor_is_a_class_and_a_channel():
    rng = np.random.default_rng(0)
    time_ns = np.arange(1000) * 10_000_000
    value = LIVELY.motion(time_ns / 1e9, 2) + rng.normal(0.0, LIVELY.noise_m_s2, 1000)
    met_ns = np.arange(5_000_000, 9_900_000_000, 100_000_000)
    volts = 40.0 * (LIVELY.motion(met_ns / 1e9) + rng.normal(0.0, 1e-4, len(met_ns)))
    settings = EstimatorSettings((Channel("potentiometer", Source.DISPLACEMENT, units_per_m=40.0),))
    figures = AxisFigures(0.0, 1.0, 2.0, noise_density=LIVELY.noise_m_s2**2 / 100.0)
    point = Point(
        Merge([ACCELEROMETER, "potentiometer"]),
        Guard(GuardSettings(100.0, (figures,))),
        {"potentiometer": Potentiometer()},
        Estimator(settings),
    )
    outputs = []
    for k in range(10):
        a, m = slice(100 * k, 100 * k + 100), slice(10 * k, 10 * k + 10)
        outputs += point.push(Arrival(ACCELEROMETER, k, Readings(time_ns[a], value[a, None])))
        outputs += point.push(Arrival("potentiometer", k, Readings(met_ns[m], volts[m, None])))
    rows = joined([one.estimates[0] for one in [*outputs, *point.finish()] if isinstance(one, Rows) and one.estimates])
    error = rows.displacement_m - LIVELY.motion(rows.time_ns / 1e9)
    settled = rows.time_ns > 3e9
    # A few independent errors: their mean square is above 2.5 once in a hundred times.
    assert np.sqrt(np.mean(error[settled] ** 2 / rows.variance_m2[settled])) < 1.6
    assert np.median(np.sqrt(rows.variance_m2[settled])) < 1.5e-4
