"""Makes the pictures of docs/gallery.md: `python tools/gallery.py [NAME ...]`, all of them without a NAME.

Each scenario is simulated, estimated with the defaults and compared with its truth; the figures are printed.
"""

import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

import midspan
from midspan.evaluate.result_file import Comparison
from midspan.papers.scenes import write_scene
from midspan.report.drawing import Colour, sheet, style, write_picture
from midspan.report.thinning import envelope

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
# Scenario of each picture.
SCENES = {
    "footbridge": "footbridge",
    "tower": "building",
    "gnss": "gnss",
    "radar": "radar-blockage",
    "infrared": "day-and-night",
}
# 7.5 in × 100 dpi is the width of a column of text.
DPI, SIZE_IN = 100, (7.5, 3.6)
# Enough for lines and their edges; a third of the bytes.
COLOURS = 32


def draw(result: midspan.Result, truth_mm: np.ndarray) -> "Figure":
    """The history over the truth, and below it their difference in the 95 % band; truth_mm: (rows,), at the rows."""
    figure = sheet(SIZE_IN[1], SIZE_IN[0])
    above, below = figure.subplots(2, sharex=True, height_ratios=(2, 1))
    time_s, value, half = result.time_s, result.displacement_mm, 1.96 * result.displacement_std_mm
    band = envelope(time_s, value - half, value + half)
    above.fill_between(band.t, band.low, band.high, color=Colour.SKY, alpha=0.5, linewidth=0, label="95 % band")
    # The truth lies under the estimate, wide enough to show.
    above.plot(*envelope(time_s, truth_mm, truth_mm).line(), color=Colour.ORANGE, linewidth=2.0, label="truth")
    above.plot(*envelope(time_s, value, value).line(), color=Colour.BLUE, linewidth=0.7, label="displacement")
    above.set_ylabel("displacement (mm)")
    above.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    claimed = envelope(time_s, -half, half)
    below.fill_between(claimed.t, claimed.low, claimed.high, color=Colour.SKY, alpha=0.5, linewidth=0)
    error = value - truth_mm
    below.plot(*envelope(time_s, error, error).line(), color=Colour.BLUE, linewidth=0.6)
    below.set_ylabel("error (mm)")
    below.set_xlabel("time (s)")
    return figure


def make(name: str, images: Path = IMAGES) -> Comparison:
    """Simulate, estimate, compare and draw one scenario; its picture goes into `images`."""
    with tempfile.TemporaryDirectory() as folder:
        recording = write_scene(SCENES[name], Path(folder) / name, seed=0)
        result = midspan.estimate(recording)
        truth = np.genfromtxt(Path(recording) / "truth.csv", delimiter=",", names=True)
        truth_mm = np.interp(result.time_s, truth["time_s"], truth["displacement_mm"])
        with style():
            picture = write_picture(draw(result, truth_mm), images / f"gallery_{name}.png", DPI)
        drawn = Image.open(picture).convert("RGBA")
        opaque = Image.alpha_composite(Image.new("RGBA", drawn.size, "white"), drawn).convert("RGB")
        opaque.quantize(COLOURS).save(picture, optimize=True)
        return midspan.compare(result, Path(recording) / "truth.csv", unit="mm")


if __name__ == "__main__":
    for name in sys.argv[1:] or SCENES:
        compared = make(name)
        print(f"{name}: {compared.rmse_mm:.4g} mm rms, {100 * compared.coverage_95:.3g} % in the band")
