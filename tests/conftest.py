"""Fixtures of all tests: simulated recordings, rendered once a session, and the folder of real data."""

import hashlib
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from benchmarks.live.servers import Postgres
from hypothesis import HealthCheck, settings

from midspan.simulate.motion.sensors import AccelerometerModel
from midspan.simulate.scenarios.stage import CameraSetup, Scenario
from midspan.simulate.scenarios.table import SCENARIOS, pedestrians
from midspan.simulate.scenarios.write import write
from midspan.thermal import cleaning

# How long an example takes says how busy the machine is.
settings.register_profile("any machine", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")


FOOTBRIDGE = Scenario(
    line="a small footbridge for tests",
    title="small footbridge",
    duration_s=25.0,
    motion=pedestrians,
    accelerometer=AccelerometerModel(rate_hz=100.0, noise_std_m_s2=2.5e-3, bias_m_s2=0.05),
    # Small pictures are rendered and tracked in a fraction of a second.
    camera=CameraSetup(size_px=(96, 96)),
)


@pytest.fixture(scope="session", autouse=True)
def patterns_estimated_once():
    """The fixed pattern of the same thermal pictures is estimated once in a session.

    It takes most of the time of a short infrared recording; calibration and estimate learn it from the same pictures,
    and tests of one recording again and again. tests/thermal call `estimate_pattern` itself.
    """
    real, known = cleaning.estimate_pattern, {}

    def once(frames, translation_px):
        key = frames.shape, hashlib.sha256(frames.tobytes() + translation_px.tobytes()).digest()
        if key not in known:
            known[key] = real(frames, translation_px)
            known[key].values_k.setflags(write=False)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cleaning, "estimate_pattern", once)
        yield


@pytest.fixture
def undrawn(monkeypatch):
    """A report's pictures stay empty, where a test reads its words: drawing takes nearly all of the time of one."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    from midspan.report import drawing

    monkeypatch.setattr(ConstrainedLayoutEngine, "execute", lambda _self, _figure: None)
    monkeypatch.setattr(drawing, "_drawing", lambda _figure: "<svg></svg>")


@pytest.fixture(scope="session")
def postgres():
    """A PostgreSQL server on loopback, with a folder and a port of its own."""
    pytest.importorskip("psycopg")
    if Postgres.programs() is None:
        pytest.skip("PostgreSQL is not installed")
    server = Postgres(synced=False)
    server.start()
    yield server
    server.stop()
    server.remove()


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real data together with the checkout, or MIDSPAN_DATA."""
    companions = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("MIDSPAN_DATA", companions))
    if not folder.is_dir():
        pytest.skip(f"real data are absent: {folder} is no folder; MIDSPAN_DATA names another")
    return folder


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """A function that renders a variation of FOOTBRIDGE, once for each; the folder it gives is not to be changed.

    Keywords of `Scenario` change it; `camera` is a dictionary of `CameraSetup`'s keywords.
    """
    known: dict[str, Path] = {}

    def render(name: str, *, seed: int = 0, camera: dict[str, Any] | None = None, **changes: Any) -> Path:
        if name not in known:
            folder = tmp_path_factory.mktemp("simulated") / name
            scenario = replace(FOOTBRIDGE, camera=replace(FOOTBRIDGE.camera, **(camera or {})), **changes)
            with pytest.MonkeyPatch.context() as patch:
                patch.setitem(SCENARIOS, name, scenario)
                write(name, folder, seed=seed)
            known[name] = folder
        return known[name]

    return render


@pytest.fixture(scope="session")
def footbridge(simulated: Callable[..., Path]) -> Path:
    """25 s of a footbridge before a camera; not to be changed, see `footbridge_copy`."""
    return simulated("footbridge")


@pytest.fixture
def footbridge_copy(footbridge: Path, tmp_path: Path) -> Path:
    """A copy of `footbridge` that may be changed; blanks and umlauts in its path are part of every test."""
    folder = tmp_path / "Brücke 7 süd"
    shutil.copytree(footbridge, folder)
    return folder


@pytest.fixture(scope="session")
def gnss(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scenario `gnss`: an accelerometer and heights at 1 Hz, no camera; not to be changed."""
    return write("gnss", tmp_path_factory.mktemp("simulated") / "gnss")


@pytest.fixture(scope="module")
def browser():
    """A browser without a window; each module its own, for its loop would be in the way of other tests."""
    play = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no Chromium is on the PATH")
    with play.sync_playwright() as running:
        started = running.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield started
        started.close()
