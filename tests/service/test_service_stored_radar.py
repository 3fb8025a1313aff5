"""A radar's phasors in a store: kept before and after the point opens, and computed again."""

import numpy as np
import pyarrow.parquet

import midspan
from midspan.cli.main import run
from midspan.records import NANOSECONDS, Arrival, RangeFrame
from midspan.service.journal import Journal
from midspan.service.replay import replay
from midspan.simulate.radar.signal import Reflector
from midspan.store.store import open_store
from radar_recordings import PLATE, Case, write

WALL = Reflector(3.4, 900.0, ratio=1 / 1.27, azimuth_rad=0.2)


def test_a_replayed_radar_is_computed_again_from_the_store(tmp_path):
    recording = midspan.open_recording(write(tmp_path / "recording", Case((WALL, PLATE), frames=3000)))
    calibration = midspan.calibrate(recording)
    store = open_store(tmp_path / "store")
    replay(recording, store, name="p", calibration=calibration)
    store.close()
    for method in ("kalman", "smoother"):
        output = tmp_path / f"{method}.parquet"
        assert run(["estimate", str(tmp_path / "store"), "--method", method, "-o", str(output), "--quiet"]) == 0
        expected = midspan.estimate(recording, calibration, method=method)
        again = pyarrow.parquet.read_table(output)["displacement_mm"].to_numpy()
        # Phasors are kept in single precision, between bins as they were read; the noise is 0.01 mm.
        np.testing.assert_allclose(again, expected.displacement_mm, atol=1e-4)


def test_whole_profiles_and_the_bins_of_targets_are_kept_apart(tmp_path):
    store = open_store(tmp_path / "store", points=["p"])
    profiles, bins = Journal("p", {}), Journal("p", {}, calibration=1)
    for k in range(400):
        journal, width = (profiles, 64) if k < 50 else (bins, 2)
        frame = RangeFrame(k * NANOSECONDS // 10, np.full((3, width), 1j, np.complex64), np.ones(3, np.bool_))
        journal.arrived(Arrival("radar", k, frame))
        store.write(journal.batch())
    kept = list(store.chunks("p", "radar", 0, 2**62))
    store.close()
    # All within the first slot of ten seconds, which is joined when the next one begins.
    widths = {(one.calibration, one.columns["phasors"].shape[1]) for one in kept}
    assert widths == {(0, 3 * 64), (1, 3 * 2)}
    assert sum(len(one.time_ns) for one in kept) == 400
