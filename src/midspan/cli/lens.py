"""`midspan lens IMAGES`."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from midspan.cli.console import Console, common_options

if TYPE_CHECKING:
    from midspan.sources.camera.lens import CalibratedLens


@click.command("lens")
@click.argument("images", type=click.Path())
@click.option("-o", "--output", default="lens.json", show_default=True, type=click.Path(), help="File to write.")
@click.option(
    "--columns",
    default=9,
    show_default=True,
    type=click.IntRange(min=3),
    help="Inner corners along the board (where four squares meet).",
)
@click.option("--rows", default=6, show_default=True, type=click.IntRange(min=3), help="Inner corners across it.")
@click.option("--square-mm", default=25.0, show_default=True, type=float, help="Side of a square, mm.")
@click.option("--model", default="pinhole", show_default=True, help="pinhole, or fisheye for very wide lenses.")
@click.option("--every", type=click.IntRange(min=1), help="Use every n-th image. Default: at most 150 images.")
@click.option("--picture", type=click.Path(), help="Draw coverage, residuals and correction.")
@common_options
def command(images: str, output: str, quiet: bool, as_json: bool, **options: Any) -> None:
    """Calibrate a camera's lens from images of a checkerboard, for [camera.lens].

    IMAGES is a folder, glob or video, taken in the mode of the recording: same size, focus and zoom, stabiliser off.
    """
    from midspan.checks import option, positive
    from midspan.cli.targets import check_lens, check_result
    from midspan.report.lens import draw_lens
    from midspan.sources.camera.lens import LensRequest, lens_from_pictures
    from midspan.vision.checkerboard import Board
    from midspan.vision.lens import MODELS

    console = Console(quiet, as_json)
    target, drawn = _targets(images, output, options["picture"])
    check_lens(target)
    if drawn is not None:
        check_result(drawn, option="--picture")
    option("--model", options["model"], MODELS)
    positive("--square-mm", options["square_mm"], "mm")
    board = Board(options["columns"], options["rows"], options["square_mm"])
    found = lens_from_pictures(images, LensRequest(board, options["model"], options["every"]), console.progress)
    console.done()
    if drawn is not None:
        draw_lens(found.fit, found.picture, drawn)
    found.save(target)
    _describe(console, found)
    console.warn(found.fit.warnings)
    console.say(f"written to {', '.join(str(path) for path in (target, drawn) if path)}")
    console.document({**found.to_dict(), "file": str(target), "picture": str(drawn) if drawn else None})


def _targets(images: str, output: str, picture: str | None) -> tuple[Path, Path | None]:
    """The files to write, refused before the work where they would not do."""
    from midspan.cli.targets import PICTURES, require_place

    target, drawn = Path(output), None if picture is None else Path(picture)
    require_place("-o", target, (".json",), "lens file")
    if drawn is not None:
        require_place("--picture", drawn, (*PICTURES, ".jpg"), "picture")
    # A drawing inside the folder of pictures would be taken for one of them the next time.
    folder = Path(images) if Path(images).is_dir() else Path(images).parent
    if drawn is not None and drawn.absolute().parent.resolve() == folder.resolve() and not Path(images).is_file():
        raise click.UsageError(
            f"--picture {picture}: must lie outside the folder of the images. Choose another folder."
        )
    if Path(images).resolve() in {path.resolve() for path in (target, drawn) if path}:
        raise click.UsageError(f"{images}: would be overwritten. Choose another name.")
    return target, drawn


def _describe(console: Console, found: "CalibratedLens") -> None:
    fit, lens = found.fit, found.fit.lens
    fx, fy, cx, cy = lens.matrix
    rim = f"± {100 * fit.rim_std:.2g} %" if math.isfinite(fit.rim_std) else "outside the model"
    console.table(
        [
            ("images", f"{found.pictures}, board found in {found.found}, {fit.boards} distinct views used"),
            ("misfit", f"{fit.rms_px:.3f} px rms from detected to fitted corners"),
            ("focal length", f"{fx:.1f}, {fy:.1f} px ± {100 * fit.focal_std:.2g} %"),
            ("principal point", f"{cx:.1f}, {cy:.1f} px of {lens.size[0]} × {lens.size[1]}"),
            ("distortion", f"{', '.join(f'{k:.4g}' for k in lens.distortion)} ({lens.model})"),
            ("coverage", f"{100 * fit.coverage:.0f} % of the image; scale at its corners {rim}"),
        ]
    )
