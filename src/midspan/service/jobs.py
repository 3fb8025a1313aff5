"""Long work in a process of its own: calibrating a captured recording, by the ordinary command."""

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
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", COMMAND, "calibrate", str(folder), "--json", "--quiet",
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL,
    )  # fmt: skip
    with suppress(OSError):
        # The rows of all points go first.
        os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
    try:
        printed, _ = await asyncio.wait_for(process.communicate(), LONGEST_S)
    except (TimeoutError, asyncio.CancelledError):
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        raise DataError(f"The calibration lasted longer than {LONGEST_S:g} s, or was stopped.") from None
    if process.returncode == 0:
        return (folder / CALIBRATION_FILE).read_text(encoding="utf-8")
    try:
        text = json.loads(printed)["error"]
    except (ValueError, KeyError, TypeError):
        text = f"The calibration's process ended with code {process.returncode}."
    raise UntrustedError(text) if process.returncode == UntrustedError.exit_code else DataError(text)
