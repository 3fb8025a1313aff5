"""What is reported of data and results: sentences with a code and a severity, from one table of codes."""

from collections.abc import Iterable
from enum import StrEnum


class Severity(StrEnum):
    """How far a result is affected."""

    NOTE = "note"  # something was found and dealt with; nothing has to be done
    WARNING = "warning"  # the result holds within its band, but is worse or shorter than it could be
    SERIOUS = "serious"  # the displacement may be wrong by more than its band: what was declared, given or sampled is
    # doubtful. Where the sensors themselves contradict each other, the band holds both readings, or there is no result.


_NOTE, _WARNING, _SERIOUS = Severity.NOTE, Severity.WARNING, Severity.SERIOUS

NOTICES: dict[str, tuple[Severity, str, str]] = {
    # code: (severity, what it means, what to do)
    "acceleration-wrong": (
        _WARNING,
        "for a time the acceleration led the displacement away from the other sensor, which it was brought back to",
        "check range and mounting of the accelerometer, and look at the innovations in the report",
    ),
    "accelerometer-noisy": (
        _WARNING,
        "the accelerometer differs from the other sensor by far more than its own noise, and the band takes it for "
        "noise: drift, cross motion, a mounting or bracket that vibrates, clipped crests",
        "check mounting, axes and region; raise the frame rate",
    ),
    "accelerometer-resonates": (
        _WARNING,
        "the accelerometer feels fast motion too strongly, as on a bracket or railing that resonates",
        "mount it stiffly on the structure itself",
    ),
    "calibration-foreign": (
        _SERIOUS,
        "the calibration that was given does not fit this recording: other lens, distance, sign or clocks",
        "calibrate this recording",
    ),
    "clock-corrected": (
        _NOTE,
        "the clocks drift, jump or are apart; the motion tells by how much, and it was corrected",
        "give each frame its own time stamp where frames are lost; else nothing",
    ),
    "clock-differs": (
        _WARNING,
        "the clocks differ, or differ for a part of the record, by what was not corrected; the band holds it",
        "check for lost frames, correct start_s, or split the recording there",
    ),
    "clock-uncertain": (
        _WARNING,
        "the motion hardly tells the clock offset: fast motion is blurred by velocity times its deviation",
        "more motion in calibration.window_s, best with changing frequency",
    ),
    "coasting": (
        _WARNING,
        "rows rest on the accelerometer alone, for so long that they hold more than 5 % of the record's variance",
        "keep the target in sight; their band holds the error",
    ),
    "exposure": (
        _NOTE,
        "the sensor averages fast motion over its exposure, which was not declared; it is corrected where no slow "
        "response and no error of the accelerometer explains it as well, else in the band alone",
        "declare exposure_s, or shorten the exposure",
    ),
    "file-damaged": (
        _WARNING,
        "a part of a file is damaged, cut off or out of order, and is not used",
        "copy or export the file again; a logger that was stopped while it wrote loses its last line",
    ),
    "film-turned": (
        _NOTE,
        "a film's display matrix turns its pictures, as a phone held upright writes it; the sentence says whether they "
        "were turned",
        "give direction and roi as a player shows the film",
    ),
    "frames-blurred": (
        _WARNING,
        "many frames are blurred, or the first one is; their variances are raised",
        "start at a sharp frame, shorten the exposure, fix the focus",
    ),
    "frames-untimed": (
        _NOTE,
        "the frames have no time stamps, and are counted",
        "give --rate-hz, or a file of times",
    ),
    "frames-skipped": (
        _NOTE,
        "the first frames are dark or show something else than the target; the zero is at the first one used",
        "nothing, where the shown time is the intended one",
    ),
    "frozen": (
        _WARNING,
        "a sensor repeats one frame or value while the structure moves; the repetitions are not used",
        "check camera, recorder or sensor: it repeats what it had, as a slow-motion or resampled file does too",
    ),
    "lens": (
        _WARNING,
        "the lens model is uncertain where the target lies",
        "calibrate the lens with boards at the rim, or choose a region nearer to the middle",
    ),
    "light-changed": (
        _WARNING,
        "light has changed the target relative to its reference frame, which may move the result",
        'take camera.reference = "key-frames"',
    ),
    "literal": (
        _WARNING,
        "a method runs as its paper prints it, without guards; the band rests on the innovations",
        "leave fusion.literal out where the result is to be used",
    ),
    "logger-low-pass": (
        _WARNING,
        "a low-pass in the accelerometer's logger delays and weakens fast motion; the band is wider",
        "set its corner far above the motion",
    ),
    "lost": (
        _WARNING,
        "a sensor or its target was lost for long, or the result begins late or ends early",
        "see the report: something stands in front of it, it left the region, or a stream ended",
    ),
    "method-rates": (
        _NOTE,
        "the method's filters do not suit the sensors' rates everywhere",
        "take the method smoother, or read what the sentence says of the rates",
    ),
    "misfit": (
        _WARNING,
        "what the two sensors differ by is no white noise; the band is wider by it",
        "look for cross motion, an exposure or low-pass that was not declared, tilt, a mounting that is not stiff",
    ),
    "gain-corrected": (
        _WARNING,
        "relative to the displacement sensor, which counts as right, the accelerometer has a gain, which is taken out",
        "check unit and sensitivity of [accelerometer], unit of [displacement]",
    ),
    "motion-not-shared": (
        _WARNING,
        "one sensor shows motion that the other one does not: bracket, camera or axis; the band holds the difference",
        "stiffen the mounting, raise the frame rate, check the axis and the region",
    ),
    "outliers": (
        _WARNING,
        "measurements contradict the other sensors and were left out",
        "see the innovations in the report: something passes in front of the target, or it moves on its own",
    ),
    "part-left-out": (
        _WARNING,
        "a sensor, a target or an image axis could not be trusted and is not used; the reason is stated",
        "the result rests on the others; mend the cause where that one is needed",
    ),
    "radar-data": (
        _WARNING,
        "frames or packets of the radar are missing or damaged, or its settings contradict them",
        "check the network and the configuration file",
    ),
    "radar-target": (
        _WARNING,
        "a target of the radar is seldom seen, shares its range, or moves on its own",
        "aim at a target that stands alone; name it with radar.target_range_m",
    ),
    "radar-zero": (
        _WARNING,
        "the cycle of a radar's target was lost, or may have been lost; its zero is new, or others carry the result on",
        "keep the target in sight; the band is wider across it",
    ),
    "rate-too-low": (
        _SERIOUS,
        "most of the acceleration lies too near the sample rate: integrating it errs by more than 1 %",
        "record at ten times the highest frequency; check that the file was not thinned out",
    ),
    "region-exposure": (
        _WARNING,
        "pixels of the region are at the end of the scale and show no motion",
        "change the exposure, or choose a region without glare and deep shadow",
    ),
    "region-texture": (
        _WARNING,
        "the region has little texture for its noise",
        "take a larger region, one with more edges, or more light",
    ),
    "samples-bridged": (
        _WARNING,
        "samples are missing, frozen, clipped or no numbers; they were bridged with wider noise",
        "check the sensor, its range, its cable and the export",
    ),
    "scale-implausible": (
        _SERIOUS,
        "the scale factor is not what distance and focal length make it",
        "check accelerometer.unit and sensitivity, the camera's optics, and whether the video was resized",
    ),
    "scale-uncertain": (
        _WARNING,
        "the scale factor is known to more than ± 1 % only, and so are all displacements; the band holds it",
        "mend the part that the sentence names as the largest",
    ),
    "slow-error": (
        _NOTE,
        "a displacement sensor has a slow error, or one would not show; the sentence says what the band holds",
        "declare displacement.noise_time_s",
    ),
    "slow-motion": (
        _WARNING,
        "a film's container declares another rate of taking than the one it is played at (slow motion, time lapse); "
        "the sentence gives both, and which one the times follow",
        "give camera.rate_hz (--rate-hz), or a file of times, where the sentence is wrong",
    ),
    "stamps-corrected": (
        _NOTE,
        "rows that were delivered twice were dropped, or equal time stamps were spread within their rounding",
        "nothing; let the logger write finer stamps where it can",
    ),
    "tilt": (
        _NOTE,
        "gravity reaches the accelerometer because the structure leans as it moves; it is taken out",
        "nothing on a tower; elsewhere check the mounting",
    ),
    "unit-doubtful": (
        _SERIOUS,
        "what the accelerometer reads at rest fits another unit: all displacements would be off by the same factor",
        "check unit and sensitivity of [accelerometer]",
    ),
    "video-compressed": (
        _WARNING,
        "the video is compressed: motion of a few hundredths of a pixel may be missing, and the scale may be off",
        "record raw, lossless or at the best quality; see what compression costs in mounting.md",
    ),
    "window-moved": (
        _NOTE,
        "the calibration rests on another part of the record than asked for, or on less",
        "set calibration.window_s where another part is meant",
    ),
    "zero-shifted": (
        _WARNING,
        "the zero of a sensor shifted while it measured; the displacement keeps its own",
        "check whether the target, the camera or the sensor was knocked",
    ),
    "zero-uncertain": (
        _WARNING,
        "the zero of the displacement is known far worse than a later row relative to it",
        "begin where the picture is quiet; take a large constant reading off its column",
    ),
    "thermal": (
        _WARNING,
        "the thermal camera's pattern, range or grey levels limit what it can measure",
        "record radiometric data, correct its shutter before recording, choose a region of more contrast",
    ),
    "uncoded": (
        _WARNING,
        "a warning of a calibration.json that an earlier version wrote",
        "calibrate again for its code",
    ),
}


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
        return NOTICES[self.code][0]

    @property
    def about(self) -> str:
        """The sensor or target that the sentence begins with, as in `camera: …`; empty without one."""
        name, colon, _ = self.partition(": ")
        return name if colon else ""

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


def notice_trees(notices: Iterable[str]) -> list[dict[str, str]]:
    """Notices as plain values: code, severity and text of each."""
    return [{"code": one.code, "severity": str(one.severity), "text": str(one)} for one in map(coded, notices)]


def coded(text: str) -> Notice:
    """A text of an earlier version as a notice; a notice as it is."""
    return text if isinstance(text, Notice) else Notice("uncoded", text)
