"""Whole files of every format that is read, small and made here: what the damage is done to."""

from fuzz.camera_seeds import CAMERAS, INFRARED
from fuzz.radar_seeds import RADARS
from fuzz.table_seeds import TABLES
from fuzz.whole_seeds import CONFIGURED, RESULTS
from fuzz.world import Seed

GROUPS: dict[str, tuple[Seed, ...]] = {
    "tables": TABLES,
    "cameras": CAMERAS,
    "infrared": INFRARED,
    "radar": RADARS,
    "settings": CONFIGURED,
    "results": RESULTS,
}
