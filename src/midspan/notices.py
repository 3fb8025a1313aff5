"""What is reported of data and results: sentences with a code, and the table of the codes with their severity."""

from collections.abc import Iterable
from enum import StrEnum


class Severity(StrEnum):
    """How far a result is affected."""

    NOTE = "note"  # something was found and dealt with; nothing has to be done
    WARNING = "warning"  # the result holds within its band, but is worse or shorter than it could be
    SERIOUS = "serious"  # the displacement may be wrong by more than its band: what was declared, given or sampled is
    # doubtful. Where the sensors themselves contradict each other, the band holds both readings, or there is no result.


# The codes by their severity; docs/troubleshooting.md says what each means and what to do.
_CODES = {
    Severity.NOTE: (
        "clock-corrected", "depth-by-size", "exposure", "film-turned", "frames-skipped", "frames-untimed",
        "gain-estimated", "method-rates", "pose-unchecked", "pose-unseen", "slow-error-included", "stamps-corrected",
        "tilt", "tilt-unverified", "window-moved",
    ),
    Severity.WARNING: (
        "acceleration-wrong", "accelerometer-line", "accelerometer-noisy", "accelerometer-resonates",
        "clock-differs", "clock-uncertain", "coasting", "file-damaged", "frames-blurred", "frozen",
        "gain-corrected", "gain-drifts", "geometry-wrong", "lens", "light-changed", "literal", "logger-low-pass",
        "lost", "misfit", "motion-not-shared", "outliers", "part-left-out", "picture-zooms", "play", "radar-data",
        "radar-target", "radar-zero", "region-exposure", "region-texture", "samples-bridged",
        "scale-uncertain", "slow-error", "slow-motion", "thermal", "uncoded", "video-compressed", "zero-shifted",
        "zero-uncertain",
    ),
    Severity.SERIOUS: (
        "calibration-foreign", "channel-doubtful", "rate-too-low", "scale-implausible", "unit-doubtful",
    ),
}  # fmt: skip
NOTICES = {code: severity for severity, codes in _CODES.items() for code in codes}


class Notice(str):
    """A sentence with the `code` of its cause; it is a str wherever text is wanted."""

    __slots__ = ("code",)
    code: str

    def __new__(cls, code: str, text: str) -> "Notice":
        """A sentence under a code of `NOTICES`."""
        if code not in NOTICES:
            raise ValueError(f"{code!r} is no code of NOTICES")
        made = super().__new__(cls, text)
        made.code = code
        return made

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        """What a copy is made of."""
        return self.code, str(self)

    @property
    def severity(self) -> Severity:
        """How far a result is affected."""
        return NOTICES[self.code]

    @property
    def about(self) -> str:
        """The sensor or target that the sentence begins with, as in `camera: …`; empty without one.

        Of a key, as in `calibration.literal: …`, it is the section.
        """
        name, colon, _ = self.partition(": ")
        return name.removesuffix(".literal") if colon else ""

    def worded(self, text: str) -> "Notice":
        """Other words of the same code."""
        return Notice(self.code, text)


def once(notices: Iterable[Notice], before: Iterable[Notice] = ()) -> tuple[Notice, ...]:
    """`before` and `notices` without repetitions, a cause that both name in the words of `notices`.

    before: of an earlier stage, such as the calibration; a cause is one code of one sensor or target.
    """
    own = tuple(dict.fromkeys(notices))
    again = {(one.code, one.about) for one in own}
    return (*(one for one in dict.fromkeys(before) if (one.code, one.about) not in again), *own)


def worst_first(notices: Iterable[str]) -> list[Notice]:
    """Notices by their severity, the serious ones first; of one severity in their order."""
    return sorted(map(coded, notices), key=lambda one: list(Severity)[::-1].index(one.severity))


def rounded(value: float) -> str:
    """A number of a sentence: two significant digits, and no exponent."""
    import numpy as np

    return np.format_float_positional(value, precision=2, fractional=False, trim="-")


def notice_trees(notices: Iterable[str]) -> list[dict[str, str]]:
    """Notices as plain values: code, severity and text of each."""
    return [{"code": one.code, "severity": str(one.severity), "text": str(one)} for one in map(coded, notices)]


def coded(text: str) -> Notice:
    """A text of an earlier version as a notice; a notice as it is."""
    return text if isinstance(text, Notice) else Notice("uncoded", text)
