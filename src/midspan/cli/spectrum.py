"""`midspan spectrum RESULT`."""

import math
from pathlib import Path

import click

from midspan.cli.console import Console, common_options

_HEADER = "frequency_hz,density_mm2_hz"


@click.command("spectrum")
@click.argument("result", type=click.Path())
@click.option("--axis", type=click.Choice(["x", "y"]), help="Image axis of a two-axis result.")
@click.option("--unit", help="Unit, if the file has none.")
@click.option("-o", "--output", type=click.Path(), help="Write frequency and density as CSV.")
@common_options
def command(result: str, quiet: bool, as_json: bool, **options: str | None) -> None:
    """Natural frequencies of a displacement, with damping and standard deviations."""
    from midspan.evaluate.result_file import read_result
    from midspan.evaluate.spectrum import spectrum
    from midspan.writing import write_whole

    console = Console(quiet, as_json)
    target = _target(options["output"]) if options["output"] else None
    found = spectrum(read_result(result, options["unit"], options["axis"]).series)
    for mode in found.modes:
        damping = f"damping {100 * mode.damping:6.2f} ± {100 * mode.damping_std:.2f} %"
        known = damping if math.isfinite(mode.damping) else "a tone or several modes"
        console.say(
            f"  {mode.frequency_hz:9.4f} ± {mode.frequency_std_hz:.4f} Hz   {known:25}   {mode.rms_mm:.3g} mm rms"
        )
    if not found.modes:
        console.say("The spectrum has no significant peak.")
    written = None
    if target:
        lines = [_HEADER]
        lines += [f"{f:.9g},{s:.9g}" for f, s in zip(found.frequency_hz, found.density_mm2_hz, strict=True)]
        write_whole(target, ("\n".join(lines) + "\n").encode())
        written = str(target)
        console.say(f"{written}: written.")
    console.document({**found.to_dict(), "written": written})


def _target(output: str) -> Path:
    """The file to write; UsageError for one of another format, or in place of anything but a spectrum."""
    path = Path(output)
    if path.suffix.lower() != ".csv":
        raise click.UsageError(f"-o {path}: the suffix must be .csv.")
    if path.is_file() and not path.read_bytes().startswith(_HEADER.encode()):
        raise click.UsageError(f"-o {path}: is not a spectrum and is not overwritten. Choose another name.")
    return path
