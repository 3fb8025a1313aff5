"""`midspan inspect RECORDING`, or `midspan inspect ACCEL FILE2`."""

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from midspan.cli.console import Console, common_options

if TYPE_CHECKING:
    from midspan.recording.streams.recording import Recording
    from midspan.settings.two_files import Choices


@click.command("inspect")
@click.argument("recording", type=click.Path())
@click.argument("file2", type=click.Path(), required=False)
@click.option("--value", help="Two files: channel along the motion.")
@click.option("--unit", help="Two files: unit of the channel, if the file has none.")
@click.option("--direction", type=click.Choice(["x", "y"]), help="Two files: image axis of the motion. Default: y.")
@click.option("--rate-hz", type=float, help="Two files: rate of FILE2, if it has no times.")
@click.option("--all-frames", is_flag=True, help="Check all frames, not only the first 600.")
@click.option(
    "--picture", type=click.Path(), help="Draw the first frame, candidate regions and motion (.png .svg .pdf)."
)
@common_options
def command(
    recording: str, file2: str | None, all_frames: bool, picture: str | None, quiet: bool, as_json: bool, **options: Any
) -> None:
    """Check a recording, a phone's log or a file: streams, rates, gaps, clipping, frozen frames, overlap, units.

    Of an accelerometer file and FILE2 both, and with --picture the region that `estimate` selects.
    """
    from midspan.cli.targets import check_picture
    from midspan.recording.streams.recording import open_recording
    from midspan.settings.two_files import Choices, in_words_of_two_files
    from midspan.sources.accelerometer.phone import is_phone_log

    console, path, choices = Console(quiet, as_json), Path(recording), Choices(**options)
    second, log = None if file2 is None else Path(file2), is_phone_log(path)
    if choices.named and file2 is None and not log:
        raise click.UsageError(f"--{choices.named[0].replace('_', '-')}: needs two files, ACCEL FILE2.")
    opened = None
    if second is not None or (log and picture is not None):
        with in_words_of_two_files(path, second):
            opened = _of_two_files(path, second, choices)
    elif not log and not _is_single(path):
        opened = open_recording(path)
    # Refused before the work where it could not be written.
    target = None if picture is None else check_picture(picture, "--picture", *([] if opened is None else [opened]))
    tree = _looked(console, path, None if log and second is None else opened, all_frames)
    if target is not None:
        tree |= _picture(console, target, path if opened is None else opened)
    console.document(tree)
    if opened is None:
        return
    for branch in tree.values():
        if isinstance(branch, dict) and "error" in branch:
            click.echo(f"midspan: {branch['error']}", err=True)
            raise click.exceptions.Exit(branch["exit_code"])


def _of_two_files(accel: Path, second: Path | None, choices: "Choices") -> "Recording":
    from midspan.recording.streams.recording import Recording
    from midspan.settings.two_files import draft, settings_of

    return Recording(*settings_of(draft(accel, second, choices)))


def _looked(console: Console, path: Path, opened: "Recording | None", all_frames: bool) -> dict[str, Any]:
    """Look at a recording, or at a phone's log or a single file where none is open, and print what is found."""
    from midspan.recording.inspect import inspect_recording
    from midspan.sources.accelerometer.phone import is_phone_log
    from midspan.sources.inspect import inspect_file, inspect_phone

    if opened is not None:
        tree, printed = inspect_recording(opened, all_frames, console.progress), show
    elif is_phone_log(path):
        tree, printed = inspect_phone(path, console.progress), _show_phone
    else:
        tree, printed = inspect_file(path, console.progress), _show_file
    console.done()
    printed(console, tree)
    return tree


def _is_single(path: Path) -> bool:
    """Whether a path is a single file to look at, or a folder of pictures or FLIR frames that is no recording."""
    from midspan.settings.load import RECORDING_FILE
    from midspan.sources.camera.formats import IMAGES
    from midspan.sources.thermal.formats import is_thermal

    if os.path.isdir(path):
        names = [] if (path / RECORDING_FILE).is_file() else [file.suffix.lower() for file in path.iterdir()]
        return any(name in IMAGES for name in names) or (bool(names) and is_thermal(path))
    try:
        path.stat()
    except FileNotFoundError:
        return False
    except (OSError, ValueError):
        # No path that can be: refused with the reason as the file that it is not.
        return True
    return path.suffix.lower() != ".toml"


def _picture(console: Console, target: Path, source: "Path | Recording") -> dict[str, Any]:
    """Write the picture and print the places to track."""
    from midspan.report.first_look import draw_first_look, look_at_file, look_at_recording, verdict

    if isinstance(source, Path):
        found = look_at_file(source, console.progress)
    else:
        found = look_at_recording(source, console.progress)
    console.done()
    draw_first_look(found, target)
    console.say("\ncandidate regions:")
    rows = []
    for number, place in enumerate(found.places, start=1):
        r, score = place.region, f"{place.predicted_std_px:.4f} px"
        rows.append((str(number), f"{r.x},{r.y},{r.width},{r.height}", score, verdict(place)))
    console.columns(("no", "roi", "expected σ", "verdict"), rows)
    for note in found.notes:
        console.say(f"  {note}")
    console.say(f"{target}: written.")
    return {"picture": str(target), "regions": found.to_dict()}


def show(console: Console, tree: dict[str, Any]) -> None:
    """Print what `inspect_recording` found."""
    console.say(f"{tree['name']} ({tree['recording']})")
    for section, branch in tree.items():
        if isinstance(branch, dict) and "file" in branch:
            _show_stream(console, section, branch)
    if overlap := tree["overlap"]:
        names = " and ".join(overlap["streams"])
        if overlap["overlapping"]:
            console.say(f"\noverlap of {names}: {overlap['duration_s']:.3f} s from {overlap['start']}")
        else:
            console.say(f"\n{names} do not overlap in time. Correct start_s.")


def _show_stream(console: Console, section: str, branch: dict[str, Any]) -> None:
    console.say(f"\n{section}: {branch['file']}")
    if "error" in branch:
        console.say(f"  cannot be used: {branch['error']}")
        return
    rows = _times(branch)
    if "samples" in branch:
        # In the file's unit; in SI where that takes a sensitivity.
        factor, unit = branch["unit_in_si"], branch["unit"]
        if factor is None:
            factor, unit = 1.0, branch["value_unit"]
        low, high, mean, std = (branch[name] / factor for name in ("smallest", "largest", "mean", "std"))
        digits = _digits(low, high, 4)
        rows += [
            ("channel", f"{branch['channel']} in {branch['unit']}, {branch['samples']} samples"),
            ("values", f"{_values(low, high, unit, 4)}, mean {mean:.{digits}g}, rms about the mean {std:.4g}"),
            ("missing, frozen, clipped", f"{branch['missing_samples']}, {branch['frozen_samples']}, "
                                         f"{branch['clipped_samples']} samples"),
        ]  # fmt: skip
    elif "carrier_hz" in branch:
        rows += _radar(branch)
    else:
        warmth = []
        if "coldest_c" in branch:
            warmth = [("temperatures", f"{branch['coldest_c']:.2f} … {branch['warmest_c']:.2f} °C")]
        lossless = {True: "lossless", False: "lossy", None: "compression unknown"}[branch["lossless"]]
        rows += [
            ("image", f"{branch['width']} × {branch['height']} px, {branch['bit_depth']} bit, "
                        f"{branch['codec']}, {lossless}"),
            ("frames", f"{branch['frames_used']} used of {branch['frames_in_file'] or 'an unknown number'}"),
            *warmth,
            ("frozen, dark, saturated", f"{branch['frozen_frames']}, {branch['dark_frames']}, "
                                        f"{branch['saturated_frames']} of {branch['frames_looked_at']} checked"),
        ]  # fmt: skip
    rows += [("found", note) for note in branch["notes"]]
    rows += [("warning", line) for line in branch.get("warnings", ())]
    console.table(rows)


def _times(branch: dict[str, Any]) -> list[tuple[str, str]]:
    """When a stream runs, and its gaps; a single frame has no rate, and a file may have no stamps."""
    if branch["start"] is None:
        return [("time", "no time stamps in the file: set rate_hz or times")]
    if branch["rate_hz"] is None:
        return [("time", branch["start"])]
    gaps = branch["gaps"]
    longest = max((gap["length_s"] for gap in gaps), default=0.0)
    rate = f"{branch['rate_hz']:.6g} Hz, jitter {branch['jitter_ms']:.3g} ms rms"
    return [
        ("time", f"{branch['start']}, {branch['duration_s']:.3f} s long, {rate}"),
        ("gaps", f"{len(gaps)}, the longest {longest:.3g} s" if gaps else "none"),
    ]


def _radar(branch: dict[str, Any]) -> list[tuple[str, str]]:
    """What a radar sees, and how."""
    chirp, resolution = branch["chirp"], branch["range_resolution_m"]
    reach = "" if branch["largest_range_m"] is None else f" up to {branch['largest_range_m']:.4g} m"
    rows = [
        ("radar", f"{branch['kind']}, {branch['frames']} frames, {branch['channels']} channels"),
        ("carrier", f"{branch['carrier_hz'] / 1e9:.6g} GHz, a cycle is {branch['cycle_mm']:.4g} mm of range"),
        ("limit speed", f"{branch['limit_speed_mm_s']:.4g} mm/s for unwrapping without the accelerometer"),
        ("range", f"{branch['bins']} bins" + (f" of {resolution:.4g} m" if resolution else "") + reach),
    ]
    if chirp is not None:
        form = "complex" if chirp["complex_samples"] else "real"
        rows.append(
            ("chirp", f"from {chirp['start_frequency_hz'] / 1e9:.6g} GHz, {chirp['slope_hz_s'] / 1e12:.5g} MHz/µs, "
                      f"{chirp['samples']} samples at {chirp['sample_rate_hz'] / 1e6:.4g} MHz "
                      f"({chirp['bandwidth_hz'] / 1e9:.4g} GHz), {chirp['bits']} bit {form} {branch['iq_order']}")
        )  # fmt: skip
    rows.append(("frames with holes", f"{branch['frames_with_holes']} of {branch['frames_looked_at']} checked"))
    for peak in branch["peaks"]:
        place = "" if peak["range_m"] is None or peak["range_m"] != peak["range_m"] else f" at {peak['range_m']:.3f} m"
        rows.append(("peak", f"{peak['level_db']:.0f} dB{place} (bin {peak['bin']:.2f})"))
    return rows


def _show_phone(console: Console, tree: dict[str, Any]) -> None:
    """Print what `inspect_phone` found."""
    console.say(f"{tree['file']} ({tree['app']})")
    rows: list[tuple[str, str]] = []
    for name in ("acceleration", "gravity", "gyroscope"):
        if name in tree:
            one = tree[name]
            mean = ", ".join(f"{value:.4g}" for value in one["mean"])
            columns = ", ".join(one["columns"])
            rows.append((name, f"{one['file']}: {columns} in {one['unit']}, {one['samples']} samples, mean {mean}"))
            rows += _times(one)
            if "camera_axes" in one:
                right, down, view = map(repr, one["camera_axes"])
                rows.append(("camera's axes", f"x (right) {right}, y (down) {down}, z (view) {view}: its film's tilt"))
    upright = tree["vertical"]
    if upright is not None:
        value, angle = upright["gravity_m_s2"], upright["angle_deg"]
        rows.append(("vertical", f"{upright['column']!r} ({value:+.3f} m/s²), {angle:.1f} degrees from gravity"))
    if tree["pauses"]:
        rows.append(("warning", f"pauses: {tree['pauses']}, left out by the clock"))
    console.table(rows)
    for film in tree["films"]:
        _show_stream(console, "film", film)


def _show_file(console: Console, tree: dict[str, Any]) -> None:
    if "frames" in tree:
        _show_stream(console, "frames", {"file": tree["file"], **tree["frames"]})
        return
    console.say(tree["file"])
    for channel in tree["channels"]:
        if "not_read" in channel:
            console.say(f"  {channel['name']}: {channel['samples']} samples, not read: {channel['not_read']}")
            continue
        low, high = channel["smallest"], channel["largest"]
        rate = f", {channel['rate_hz']:.6g} Hz" if channel["rate_hz"] else ""
        missing = f" ({channel['missing']} without a number)" if channel["missing"] else ""
        values = _values(low, high, channel["unit"] or "(no unit)", 6)
        console.say(f"  {channel['name']}: {channel['samples']} samples{missing}, {values}{rate}")
    console.table([("found", note) for note in tree["notes"]] + [("warning", line) for line in tree["warnings"]])


def _values(low: float | str | None, high: float | str | None, unit: str, least: int) -> str:
    """The range of a channel; times are texts that have their unit with them."""
    if low is None or high is None:
        return f"no numbers {unit}"
    if isinstance(low, str) or isinstance(high, str):
        return f"{low} … {high}"
    digits = _digits(low, high, least)
    return f"{low:.{digits}g} … {high:.{digits}g} {unit}"


def _digits(low: float, high: float, least: int) -> int:
    """Significant digits, at least this many, that show three digits of how far two numbers lie apart."""
    apart, size = high - low, max(abs(low), abs(high))
    if not 0.0 < apart < math.inf:
        return least
    # A double holds 17.
    return min(max(least, math.ceil(math.log10(size / apart)) + 3), 17)
