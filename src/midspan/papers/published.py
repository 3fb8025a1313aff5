"""The papers whose methods midspan has: which tracker and fusion method each one is, and its command.

The table costs no import.
"""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Paper:
    """A paper: what it is called here, authors and title, where it appeared, the sensors besides the accelerometer.

    key: of `midspan papers --only`; tracker: empty without a camera; method: a fusion method; scene: a test of it that
    `midspan simulate` writes; settings: keys of recording.toml that it needs besides.
    """

    key: str
    name: str
    citation: str
    where: str
    sensors: tuple[str, ...]
    tracker: str
    method: str
    scene: str
    settings: dict[str, str] = field(default_factory=dict)

    def of_section(self, section: str) -> dict[str, Any]:
        """The keys of a section of recording.toml that the method needs besides the options."""
        import tomllib

        tree: dict[str, Any] = tomllib.loads("\n".join(f"{key} = {value}" for key, value in self.settings.items()))
        return dict(tree.get(section, {}))

    @property
    def flags(self) -> tuple[str, ...]:
        """Options of `midspan estimate` for the method as printed."""
        tracker = ("--tracker", self.tracker) if self.tracker else ()
        return (*tracker, "--method", self.method, "--literal")

    @property
    def command(self) -> str:
        """The command for a recording; --paper sets the keys as well."""
        return f"midspan estimate RECORDING {f'--paper {self.key}' if self.settings else ' '.join(self.flags)}"


PAPERS = (
    Paper(
        "003",
        "two-stage",
        "Ma, Liu, Choi, Sohn: High-sampled structural displacement estimation through the FIR filter-based two-stage "
        "fusion of high-sampled acceleration and temporally aliased low-sampled displacement measurements",
        "",
        ("camera",),
        "template",
        "two-stage-fir",
        "003-storey-1",
    ),
    Paper(
        "004",
        "AMKF",
        "Ma, Choi, Sohn: Real-time structural displacement estimation by fusing asynchronous acceleration and computer "
        "vision measurements",
        "doi:10.1111/mice.12767",
        ("camera",),
        "features",
        "adaptive-kalman",
        "004-footbridge-noisy",
    ),
    Paper(
        "002",
        "radar",
        "Ma, Choi, Yang, Sohn: Structural displacement estimation using accelerometer and FMCW millimeter wave radar",
        "doi:10.1016/j.ymssp.2022.109582",
        ("radar",),
        "",
        "fir",
        "002-wall",
    ),
    Paper(
        "001",
        "vision and infrared",
        "Choi, Ma, Kim, Sohn: Continuous structural displacement monitoring using accelerometer, vision, and infrared "
        "(IR) cameras",
        "doi:10.3390/s23115241",
        ("camera", "infrared"),
        "features",
        "adaptive-kalman",
        "001-case-1",
        {
            "camera.reference": '"updating"',
            "camera.reference_settings": "{ literal = true }",
            "infrared.reference": '"updating"',
            "infrared.reference_settings": "{ literal = true }",
            "fusion.switching": '"matches"',
        },
    ),
    Paper(
        "000",
        "hybrid phase",
        "Ma, Choi, Liu, Sohn: Structural displacement estimation by fusing vision camera and accelerometer using "
        "hybrid computer vision algorithm and adaptive multi-rate Kalman filter",
        "",
        ("camera",),
        "hybrid",
        "adaptive-kalman",
        "000-footbridge-phase-noisy",
    ),
)
"""The papers, in the order of their methods here."""

PAPER_KEYS = tuple(sorted(paper.key for paper in PAPERS))
