"""Long work in a process of its own: calibrating a captured recording."""

import asyncio
import json
import os
import sys
from contextlib import suppress
from pathlib import Path

from midspan.errors import DataError, UntrustedError
from midspan.settings.stored.calibration import CALIBRATION_FILE

# A calibration of an hour's recording takes minutes.
LONGEST_S = 1800.0
# Of the process, as of POSIX (0 usual, 19 least urgent): a tenth of the processor where the engine needs it all.
NICENESS = 10
COMMAND = "from midspan.cli.main import main; main()"


async def calibrated_folder(folder: Path) -> str:
    """Calibrate a captured recording; returns the calibration as JSON text.

    Raises UntrustedError where it is refused, DataError where it fails or lasts too long.
    """
    code, printed = await _ran(COMMAND, "calibrate", str(folder), "--json", "--quiet")
    if code == 0:
        return (folder / CALIBRATION_FILE).read_text(encoding="utf-8")
    try:
        text = json.loads(printed)["error"]
    except (ValueError, KeyError, TypeError):
        text = f"The calibration's process ended with code {code}."
    raise UntrustedError(text) if code == UntrustedError.exit_code else DataError(text)


async def _ran(program: str, *arguments: str) -> tuple[int | None, bytes]:
    """Run Python on a program at low urgency; returns its exit code and what it printed.

    Raises DataError where it lasted too long. Where it is cancelled its process ends too.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", program, *arguments,
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL,
    )  # fmt: skip
    with suppress(OSError):
        # The rows of all points go first.
        os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
    try:
        printed, _ = await asyncio.wait_for(process.communicate(), LONGEST_S)
    except (TimeoutError, asyncio.CancelledError) as ended:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        if isinstance(ended, asyncio.CancelledError):
            raise
        raise DataError(f"The work lasted longer than {LONGEST_S:g} s.") from None
    return process.returncode, printed
