"""One warning for each cause: what calibrate and estimate both find, compression, and coasting that does not matter."""

import json

import numpy as np

from midspan.cli.main import run
from midspan.engine.row_messages import shares
from midspan.records import Estimate, Innovation, Status
from recording_edits import set_keys


def rows_with(coasting: int, std_m: float) -> tuple[Innovation, Estimate]:
    """A long record in which some rows coast with this deviation; the others have 0.01 mm."""
    count = 17_758
    status = np.full(count, Status.TRACKING, dtype=np.uint8)
    status[5000 : 5000 + coasting] = Status.COASTING
    variance = np.where(status == Status.COASTING, std_m**2, 1e-5**2)
    zeros = np.zeros(count)
    time_ns = np.arange(count) * 5_000_000
    rows = Estimate(time_ns, zeros, variance, zeros, np.ones(count, dtype=np.uint8), status)
    return Innovation(time_ns, zeros, variance, np.zeros(count, dtype=np.int8)), rows


def test_coasting_is_reported_by_what_it_holds_of_the_records_variance():
    assert shares(*rows_with(3, 2e-5)) == []
    # A second at 0.2 mm holds 200 · 400 of 97 558 units of variance.
    (line,) = shares(*rows_with(200, 2e-4))
    assert (line.code, line.severity) == ("coasting", "warning")
    (line,) = shares(*rows_with(1776, 1e-5))
    assert line.code == "coasting"


def test_compression_is_reported_once_and_by_calibrate(footbridge_copy, capsys):
    import av

    with (
        av.open(str(footbridge_copy / "camera.mkv")) as source,
        av.open(str(footbridge_copy / "phone.mp4"), "w") as target,
    ):
        made = None
        for frame in source.decode(video=0):
            if made is None:
                made = target.add_stream("h264", rate=10, options={"crf": "20"})
                made.width, made.height, made.pix_fmt = frame.width, frame.height, "yuv420p"
            target.mux(made.encode(frame.reformat(format="yuv420p")))
        target.mux(made.encode())
    set_keys(footbridge_copy, "camera", file="phone.mp4")
    for command in ("calibrate", "estimate"):
        assert run([command, str(footbridge_copy), "--json"]) == 0
        said = capsys.readouterr()
        tree = json.loads(said.out)
        assert [one["code"] for one in tree["notices"]].count("video-compressed") == 1
        assert [one["text"] for one in tree["notices"]] == tree["warnings"]
        assert said.err.count("[video-compressed]") == 1
