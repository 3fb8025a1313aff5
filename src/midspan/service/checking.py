"""Whether a site's points can be run with settings: all that they name can be read, and lies where they say."""

from collections.abc import Collection, Mapping
from pathlib import Path

from midspan.errors import DataError
from midspan.service.mqtt import tls_context
from midspan.service.running import Running, drafted
from midspan.settings.camera import CameraSettings
from midspan.settings.kinds import ACCELEROMETER
from midspan.settings.load import load_settings
from midspan.settings.sensors import RotationSettings, turning_axis
from midspan.settings.site import PointPlan, Site
from midspan.settings.stored.calibration import load_calibration

REPLAY = "replay:"


def checked(site: Site, names: Collection[str], sizes_px: Mapping[str, tuple[int, int]] | None = None) -> list[Running]:
    """The points of a site that have these names, before anything is begun, where all that the site names can be read:
    the broker's certificates, recordings, and the calibration of every point, since those of points that go on are read
    again too.

    sizes_px: width and height of the pictures of cameras that run, by address. Raises UsageError and DataError for what
    cannot be read, and UsageError for a region that lies beyond the picture.
    """
    folder = site.file.parent
    if site.settings.mqtt is not None:
        tls_context(site.settings.mqtt, folder)
    for plan in site.points:
        if plan.settings.calibration is not None:
            load_calibration(folder / plan.settings.calibration, axis=plan.axis)
        if plan.name in names:
            _require_sources(plan, site.file, sizes_px or {})
    return drafted(site, names)


def _require_sources(plan: PointPlan, file: Path, sizes_px: Mapping[str, tuple[int, int]]) -> None:
    from midspan.recording.tracking.opening import require_inside

    for name, kind, section in plan.recording.streams:
        address, where = plan.sources[name], f"{file}: point {plan.name!r}: {name}"
        if address.startswith(REPLAY):
            recording = load_settings(file.parent / address.removeprefix(REPLAY))
            own = {name: one for name, _, one in recording.streams}.get(name)
            if kind != ACCELEROMETER and own is None:
                raise DataError(f"{where}.source: {address} has no [{name}].")
            if isinstance(own, RotationSettings) and not own.about(plan.axis):
                raise DataError(f"{where}.source: {address} has no {name}.value_{turning_axis(plan.axis)}.")
        if address in sizes_px and isinstance(section, CameraSettings):
            require_inside(section, sizes_px[address], where)
