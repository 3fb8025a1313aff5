"""The errors that midspan raises, one tree:

    MidspanError                     anything a user can mend
    ├── UsageError          exit 2   wrong use or wrong settings
    ├── DataError           exit 3   unreadable or unusable data
    └── UntrustedError      exit 4   the result could not be trusted
        └── NoAgreementError         both sensors moved, but not together

A message says what was found, the rule with its unit, the value received and what to do.
"""


class MidspanError(Exception):
    """A problem that the user can mend; `exit_code` is what the command line returns for it.

    more: figures and other causes, for whom the message does not help.
    """

    exit_code = 1
    more = ""


class UsageError(MidspanError):
    """Wrong use or wrong settings: an unknown key, a value outside its range, a region outside the image."""

    exit_code = 2


class DataError(MidspanError):
    """Data that cannot be read or used: a missing file, time running backwards, streams that do not overlap."""

    exit_code = 3


class UntrustedError(MidspanError):
    """A result that could not be trusted was refused: too little motion, an ambiguity, no agreement of the sensors."""

    exit_code = 4

    def __init__(self, text: str, more: str = "") -> None:
        super().__init__(text)
        self.more = more


class NoAgreementError(UntrustedError):
    """What the image shows moves, but not with the accelerometer: another thing, axis or event.

    clock_offset_s: what to add to the camera's times for both to agree, s; None where no offset does.
    """

    def __init__(self, text: str, clock_offset_s: float | None = None, more: str = "") -> None:
        super().__init__(text, more)
        self.clock_offset_s = clock_offset_s
