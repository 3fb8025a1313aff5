"""The tree of `SITE.toml`: the points of a live site, where their records come from and where their rows go."""

import os
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, SecretStr, model_validator

from midspan.errors import UsageError
from midspan.fusion.methods import METHODS, no_literal_form
from midspan.settings.alarms import AlarmSettings, MaintenanceSettings, NotifySettings
from midspan.settings.fields import FileName, Form, IsNumber, Section, limited
from midspan.settings.group import MQTT, NUMBER, GroupPlan, PointName, groups_of, require_names, require_topics
from midspan.settings.kinds import ACCELEROMETER, KINDS, LIVE
from midspan.settings.live_axes import axis_of, by_axis, of_rotation
from midspan.settings.live_sources import address_of, one_use
from midspan.settings.load import RECORDING_FILE, validate
from midspan.settings.messages import unknown
from midspan.settings.recording import RecordingSettings
from midspan.settings.sensors import turning_axis
from midspan.trees import TreeError, read_toml

SITE_FILE = "SITE.toml"
# Keys of a recording's section that say where its file is: a live section has `source` instead.
FILE_KEYS = ("file", "times", "time", "value", "value_x", "value_y", "value_z", "axis", "start_s", "cross_values")
VARIABLE = re.compile(r"\{([A-Za-z_][A-Za-z0-9_]*)\}")


def _is_a_site(value: str) -> str:
    if not 1 <= len(value) <= 64 or not value.isprintable() or any(sign in "+#/" for sign in value):
        raise ValueError(
            "must be 1 to 64 characters other than +, #, / and control characters, because topics contain it"
        )
    return value


def _is_an_address(value: str) -> str:
    """Host and port."""
    host, _, port = value.rpartition(":")
    if not host or not port.isdecimal() or not 0 <= int(port) < 65536:
        raise ValueError('must be a host and a port, like "127.0.0.1:8080"')
    return value


def is_loopback(listen: str) -> bool:
    """Whether HOST:PORT is an address of this machine alone."""
    host = listen.rpartition(":")[0].strip("[]").lower()
    return host in ("localhost", "::1") or bool(re.fullmatch(r"127(\.\d{1,3}){3}", host))


def require_service(listen: str, tls_cert: str | None, tls_key: str | None, where: str) -> None:
    """UsageError for no HOST:PORT, for half of TLS, and for an address that others reach without TLS."""
    try:
        _is_an_address(listen)
        _is_safe(listen, tls_cert, tls_key)
    except ValueError as error:
        raise UsageError(f"{where}: {error}; received {listen!r}.") from None


def _is_safe(listen: str, tls_cert: str | None, tls_key: str | None) -> None:
    if (tls_cert is None) != (tls_key is None):
        raise ValueError("must have both tls_cert and tls_key, or neither")
    if not is_loopback(listen) and tls_cert is None:
        raise ValueError(
            "must be a loopback address such as 127.0.0.1 without TLS: passwords would be sent in clear text. Add "
            "tls_cert and tls_key, or use a reverse proxy with TLS"
        )


def _is_a_host(value: str) -> str:
    match = re.fullmatch(r"(?:[a-z]+://)?(\[[^\]]*\]|[^:/]*)(?::(\d+))?/?", value)
    host, port = (match[1].strip("[]"), match[2]) if match else (value, None)
    if port is not None:
        raise ValueError(f"must be a host without port; port is another key: host = {host!r}, port = {port}")
    if host != value or re.search(r"[\s/@\[\]]", value):
        raise ValueError('must be a host without port, such as "broker.example.org", "192.168.1.5" or "::1"')
    return value


class StoreSettings(Section):
    """Where rows are kept: a folder of SQLite files, or a PostgreSQL database."""

    path: FileName | None = Field(None, description="folder for SQLite files")
    url: Annotated[SecretStr, Form("address")] | None = Field(
        None, description="postgresql://user@host/database, instead of path"
    )
    captures: FileName | None = Field(
        None,
        description="folder for calibration recordings; default: inside path, or SITE-captures with url",
    )
    keep_days: Annotated[float, IsNumber, limited(1.0, 36500.0, "days")] = Field(
        365.0, description="retention time of rows and raw records"
    )
    archive: FileName | None = Field(None, description="folder for each day's records as Parquet")

    @model_validator(mode="after")
    def _is_one(self) -> "StoreSettings":
        if (self.path is None) == (self.url is None):
            raise ValueError("must have either path (a folder) or url (a PostgreSQL database)")
        if self.url is not None and not self.url.get_secret_value().startswith(("postgresql://", "postgres://")):
            raise ValueError("must have a url that begins with postgresql://")
        return self


class MqttSettings(Section):
    """The broker that blocks come from and results go to."""

    host: Annotated[str, Field(min_length=1), AfterValidator(_is_a_host)] = Field(
        "127.0.0.1", description="the broker; with TLS a name in its certificate"
    )
    port: Annotated[int, IsNumber, Field(ge=1, le=65535)] = Field(1883, description="its port; with TLS usually 8883")
    user: Annotated[str, Field(min_length=1)] | None = Field(None, description="user name")
    password: Annotated[SecretStr, Form("text")] | None = Field(
        None, description='password; write "{NAME}" to take it from the environment'
    )
    prefix: Annotated[str, Field(min_length=1, pattern=r"^[^+#]+$")] = Field(
        "midspan", description="prefix of all result topics"
    )
    discovery: Annotated[str, Field(min_length=1, pattern=r"^[^+#]+$")] | None = Field(
        None, description='Home Assistant\'s discovery prefix, usually "homeassistant"'
    )
    ca: FileName | None = Field(
        None,
        description="CA certificates (PEM) that verify the broker; enables TLS",
    )
    cert: FileName | None = Field(None, description="client certificate (PEM), if the broker requires one")
    key: FileName | None = Field(None, description="private key of cert (PEM), without a password")

    @model_validator(mode="after")
    def _has_both(self) -> "MqttSettings":
        if (self.cert is None) != (self.key is None):
            raise ValueError("must have both cert and key, or neither")
        if self.cert is not None and self.ca is None:
            raise ValueError("must have ca with cert and key: without TLS no certificate is sent")
        return self

    @model_validator(mode="after")
    def _has_a_user(self) -> "MqttSettings":
        if self.password is not None and self.user is None:
            raise ValueError("must have user with password; add it, or remove password")
        return self


class ServiceSettings(Section):
    """The web service of the site."""

    listen: Annotated[str, AfterValidator(_is_an_address), Form("HOST:PORT")] = Field(
        "127.0.0.1:8080", description="host and port of page, REST, /healthz, /readyz and /metrics"
    )
    tls_cert: FileName | None = Field(
        None, description="certificate (PEM) with its chain; needed on any address but loopback"
    )
    tls_key: FileName | None = Field(None, description="its key (PEM)")

    @model_validator(mode="after")
    def _is_protected(self) -> "ServiceSettings":
        try:
            _is_safe(self.listen, self.tls_cert, self.tls_key)
        except ValueError as error:
            raise ValueError(f"{error}; received listen = {self.listen!r}") from None
        return self


class PointSettings(Section):
    """How a point is estimated; its sensors are sections of their own."""

    name: PointName = Field(description="name of the point, part of topics, files and addresses")
    method: Literal["kalman", "lag", "adaptive-kalman", "fir", "two-stage-fir"] = Field(
        "kalman",
        description="fusion method; see `midspan methods`",
    )
    literal: bool = Field(False, strict=True, description="method, calibration and tracker as printed in the papers")
    lag_s: Annotated[float, IsNumber, limited(1e-6, 60.0, "s")] = Field(
        0.5, description="delay of `lag`, refused with any other method; longer approaches the smoother's error"
    )
    calibration: FileName | None = Field(
        None,
        description="calibration.json of `midspan calibrate` or an earlier run; default: the point calibrates itself",
    )
    accept: Literal["auto", "manual"] = Field(
        "auto", description="auto: a new calibration takes effect at once; manual: after cmd/accept"
    )
    calibration_s: Annotated[float, IsNumber, limited(10.0, 3600.0, "s")] = Field(
        60.0, description="length of the calibration recording; longer needs less motion"
    )

    @model_validator(mode="after")
    def _lag_has_its_method(self) -> "PointSettings":
        if "lag_s" in self.model_fields_set and self.method != "lag":
            raise ValueError('must have method = "lag" with lag_s; add it, or remove lag_s')
        if self.literal and not METHODS[self.method].literal:
            raise ValueError(no_literal_form(self.method))
        return self


class SiteFile(Section):
    """The sections of the file apart from the points."""

    name: Annotated[str, AfterValidator(_is_a_site)] = Field(
        description="name of the site, part of every topic; may contain blanks, not +, # and /"
    )
    store: StoreSettings
    mqtt: MqttSettings | None = None
    service: ServiceSettings = Field(default_factory=lambda: ServiceSettings.model_validate({}))
    notify: tuple[NotifySettings, ...] = ()
    maintenance: tuple[MaintenanceSettings, ...] = ()


@dataclass(frozen=True, slots=True)
class PointPlan:
    """One point: its settings, what its recordings say of the sensors, and by each sensor's name the address that its
    records come from; configs: the file of each radar's settings, relative to SITE.toml. place: which [[point]] of the
    file it is, from 0.
    """

    settings: PointSettings
    recording: RecordingSettings
    sources: dict[str, str]
    configs: dict[str, str]
    alarms: tuple[AlarmSettings, ...] = ()
    place: int = 0

    @property
    def name(self) -> str:
        """The point's name."""
        return self.settings.name

    @property
    def axis(self) -> str:
        """The image axis "x" or "y" that it measures along; empty without a camera."""
        return (*self.recording.axes, "")[0]


@dataclass(frozen=True, slots=True)
class Shard:
    """Which fixed part of a site a process runs: number `number` (from 1) of `count`."""

    number: int
    count: int

    @property
    def name(self) -> str:
        """Its folder in a store, and the level of its topics."""
        return f"shard-{self.number}"


@dataclass(frozen=True, slots=True)
class Site:
    """A whole SITE.toml, or the part of it that a shard runs; file: where it was read."""

    file: Path
    settings: SiteFile
    points: tuple[PointPlan, ...]
    groups: tuple[GroupPlan, ...] = ()
    shard: Shard | None = None

    @property
    def name(self) -> str:
        """The site's name."""
        return self.settings.name

    @property
    def names(self) -> list[str]:
        """The names of what is written by one process alone: points and groups."""
        return [*(plan.name for plan in self.points), *(plan.key for plan in self.groups)]

    @property
    def store(self) -> str:
        """Where its store is: a folder or an address."""
        given = self.settings.store
        return str(self.file.parent / given.path) if given.path else given.url.get_secret_value() if given.url else ""


def load_site(path: str | Path) -> Site:
    """Read and validate a SITE.toml (or the folder that holds it).

    Raises UsageError for what it may not say, and where it is missing.
    """
    file = Path(path)
    file = file / SITE_FILE if file.is_dir() else file
    try:
        tree = read_toml(file)
    except TreeError as error:
        raise UsageError(f"{file}: {error}.") from None
    except OSError as error:
        raise UsageError(f"{file}: cannot be read ({error.strerror}). A live site is a SITE.toml.") from None
    if not tree:
        raise UsageError(f"{file}: is empty. A site has name, [store] and one [[point]] for each measuring point.")
    tree = filled(tree, str(file), lambda name: os.environ.get(name))
    _require_known(tree, SiteFile, ("point", "group"), f"{file}: ")
    points, groups = tree.pop("point", []), groups_of(tree.pop("group", []), str(file))
    if not points and not groups:
        raise UsageError(f"{file}: point: is missing. Add one [[point]] for each measuring point.")
    if not isinstance(points, list) or not all(isinstance(one, dict) for one in points):
        raise UsageError(f"{file}: point: must be one [[point]] for each measuring point, at least one.")
    settings = validate(tree, str(file), SiteFile)
    places = [f"{file}: {point_at(number, point)}" for number, point in enumerate(points, start=1)]
    axes = [by_axis(point, place, file.parent) for point, place in zip(points, places, strict=True)]
    plans = tuple(
        replace(_plan(half, places[number]), place=number) for number, halves in enumerate(axes) for half in halves
    )
    _require_unique(plans, axes, str(file))
    require_names(groups, [plan.name for plan in plans], str(file))
    for plan in plans:
        _require_topics(settings, plan, f"{file}: point {plan.name!r}")
    _require_one_use(plans, str(file))
    root = None if settings.mqtt is None else f"{settings.mqtt.prefix}/v1/{settings.name}/"
    taken = [at.removeprefix(MQTT) for plan in plans for at in plan.sources.values() if at.startswith(MQTT)]
    require_topics(groups, root, taken, str(file))
    return Site(file, settings, plans, groups)


def _require_unique(plans: Sequence[PointPlan], axes: Sequence[Sequence[dict[str, Any]]], where: str) -> None:
    """UsageError for two points of one name, capitals or not; axes: the halves of each point of the file."""
    if not plans:
        return
    name, count = Counter(plan.name for plan in plans).most_common(1)[0]
    if count > 1:
        seconds = [half.get("name") for halves in axes for half in halves[1:]]
        hint = ' One is the x axis of a point with direction = "xy".' if name in seconds else ""
        raise UsageError(f"{where}: point.name: must be unique; {count} points have the name {name!r}.{hint}")
    alike = Counter(plan.name.casefold() for plan in plans).most_common(1)[0]
    if alike[1] > 1:
        both = " and ".join(repr(plan.name) for plan in plans if plan.name.casefold() == alike[0])
        raise UsageError(f"{where}: point.name: must differ by more than case; received {both}. Rename one.")


def _require_one_use(plans: Sequence[PointPlan], where: str) -> None:
    """UsageError for a serial line or a radar's port that sensors use in different ways: it is opened once for all."""
    uses: dict[str, tuple[str, str]] = {}
    for plan in plans:
        for name, kind, section in plan.recording.streams:
            opened, use = one_use(kind, plan.sources[name], section)
            first, by = uses.setdefault(opened, (use, f"{plan.name}.{name}"))
            if first != use:
                raise UsageError(
                    f"{where}: point {plan.name!r}: {name}.source: {opened} is opened once and needs the same "
                    f"settings everywhere; received {use} here and {first} for {by}. Write the same for both."
                )


def _require_topics(settings: SiteFile, plan: PointPlan, where: str) -> None:
    """UsageError for a source of MQTT without a broker, and for a topic that the site itself publishes."""
    for sensor, address in plan.sources.items():
        if not address.startswith("mqtt:"):
            continue
        if settings.mqtt is None:
            raise UsageError(f"{where}: {sensor}.source: is mqtt:…, but [mqtt] is missing. Add [mqtt].")
        own = f"{settings.mqtt.prefix}/v1/{settings.name}/"
        if address.removeprefix("mqtt:").startswith(own):
            raise UsageError(
                f"{where}: {sensor}.source: must not be a topic of the site's results, {own}…; received {address!r}."
            )


def _require_known(tree: dict[str, Any], model: type[Section], others: Sequence[str], where: str) -> None:
    """UsageError for a key or section that is neither one of a model nor one of the others."""
    for key, value in tree.items():
        known = [*model.model_fields, *others]
        if key not in known:
            raise UsageError(where + unknown(key, value, known))


def point_at(number: int, point: Any) -> str:
    """How messages name a point: by its name, where it has one, else by its number."""
    name = point.get("name") if isinstance(point, dict) else None
    return f"point {name!r}" if isinstance(name, str) and name else f"point[{number}]"


def is_site(path: str | Path) -> bool:
    """Whether a file is a SITE.toml, by its name or by a section that only such a file has, or a folder with one."""
    file = Path(path)
    try:
        if file.is_dir():
            return (file / SITE_FILE).is_file() and not (file / RECORDING_FILE).exists()
        if file.name == SITE_FILE and file.is_file():
            return True
        return not read_toml(file).keys().isdisjoint(("point", "group", "store", "mqtt", "service"))
    except (TreeError, OSError, ValueError):
        return False


def filled(tree: Any, where: str, value_of: Callable[[str], str | None], key: str = "") -> Any:
    """A tree in whose texts each {NAME} is taken from the environment; UsageError for one that is not set. In a group
    {i} stays: it is a point's number.
    """
    if isinstance(tree, dict):
        return {name: filled(one, where, value_of, f"{key}.{name}".lstrip(".")) for name, one in tree.items()}
    if isinstance(tree, list):
        places = [point_at(n, one) if key == "point" else f"{key}[{n}]" for n, one in enumerate(tree, start=1)]
        return [filled(one, where, value_of, place) for place, one in zip(places, tree, strict=True)]
    if not isinstance(tree, str):
        return tree

    def found(match: re.Match[str]) -> str:
        if match[0] == NUMBER and key.startswith("group"):
            return NUMBER
        value = value_of(match[1])
        if not value:
            state = "not set" if value is None else "empty"
            raise UsageError(
                f"{where}: {key}: {{{match[1]}}} needs the environment variable {match[1]}, which is {state}. Set it."
            )
        return value

    return VARIABLE.sub(found, tree)


def _plan(tree: dict[str, Any], where: str) -> PointPlan:
    """One point of plain values; `where` names it in messages."""
    _require_known(tree, PointSettings, (*LIVE, "alarm"), f"{where}: ")
    own = {key: value for key, value in tree.items() if key not in (*LIVE, "alarm")}
    settings = validate(own, where, PointSettings)
    sections: dict[str, Any] = {}
    addresses: dict[str, Iterator[str]] = {}
    for kind in LIVE:
        if kind not in tree:
            continue
        given = tree[kind] if isinstance(tree[kind], list) else [tree[kind]]
        if not given or not all(isinstance(one, dict) for one in given):
            raise UsageError(f"{where}: {kind}: must be a section with keys, [point.{kind}].")
        if kind not in KINDS and len(given) > 1:
            raise UsageError(f"{where}: {kind}: must be one section.")
        column: dict[str, Any] = {}
        if LIVE[kind].turns:
            axis = axis_of(tree)
            given, column = [of_rotation(given[0], axis, f"{where}: {kind}")], {f"value_{turning_axis(axis)}": "value"}
        sections[kind] = [_captured(kind, number, one, where) | column for number, one in enumerate(given)]
        addresses[kind] = iter([address_of(kind, one, f"{where}: {kind}") for one in given])
    fusion = {"method": settings.method, "lag_s": settings.lag_s, "literal": settings.literal}
    plain = {key: value if len(value) > 1 else value[0] for key, value in sections.items()}
    if ACCELEROMETER not in plain:
        raise UsageError(f"{where}: accelerometer: is missing. Add [point.accelerometer] with its source.")
    recording = validate({"name": settings.name, "fusion": fusion, **plain}, where, RecordingSettings)
    recording = recording.calibrated_as_printed() if settings.literal else recording
    sources = {name: next(addresses[kind]) for name, kind, _ in recording.streams}
    configs = {one.name: config for one in recording.sensors if (config := getattr(one.settings, "config", None))}
    for name, address in sources.items():
        if name not in configs and address.startswith("udp:"):
            raise UsageError(
                f"{where}: radar.config: is missing for {name!r}. Add the .cfg or .json that the radar runs with."
            )
    return PointPlan(settings, recording, sources, configs, _alarms(tree.get("alarm", []), where))


def _alarms(tree: Any, where: str) -> tuple[AlarmSettings, ...]:
    """The alarms of a point; `where` names it in messages."""
    if not isinstance(tree, list) or not all(isinstance(one, dict) for one in tree):
        raise UsageError(f"{where}: alarm: must be one [[point.alarm]] for each alarm.")
    places = [f"{where}: alarm {one['name']!r}" if "name" in one else f"{where}: alarm[{n}]"
              for n, one in enumerate(tree, start=1)]  # fmt: skip
    for one, place in zip(tree, places, strict=True):
        _require_known(one, AlarmSettings, (), f"{place}: ")
    alarms = tuple(validate(one, place, AlarmSettings) for one, place in zip(tree, places, strict=True))
    name, count = Counter(one.name for one in alarms).most_common(1)[0] if alarms else ("", 0)
    if count > 1:
        raise UsageError(f"{where}: alarm.name: must be unique; {count} alarms have the name {name!r}.")
    return alarms


def _captured(kind: str, number: int, section: dict[str, Any], where: str) -> dict[str, Any]:
    """A live section as that of a recording of what came from its source."""
    refused = [key for key in FILE_KEYS if key in section]
    if refused:
        raise UsageError(
            f"{where}: {kind}.{refused[0]}: is for files only; a live sensor has source instead. Remove it."
        )
    sources = [f"source_{axis}" for axis in LIVE[kind].axes if LIVE[kind].turns]
    known = ["source", *sources, *(key for key in LIVE[kind].section.model_fields if key not in FILE_KEYS)]
    for key, value in section.items():
        if key not in known:
            raise UsageError(f"{where}: {unknown(f'{kind}.{key}', value, known)}")
    name = LIVE[kind].captured
    stem, dot, suffix = name.partition(".")
    own = {"file": f"{stem}-{number + 1}{dot}{suffix}" if number else name}
    return {**{key: value for key, value in section.items() if key != "source"}, **own}


def captures_of(site: Site) -> Path:
    """The folder below which each point has its captured recordings."""
    own = site.settings.store.captures
    if own is not None:
        return site.file.parent / own
    return Path(site.store) / "captures" if site.settings.store.path else site.file.parent / f"{site.name}-captures"


def require_folders(site: Site) -> None:
    """Raises UsageError with the key for a store, an archive or captures in a folder that is a file or cannot be made,
    and for a certificate that is missing.

    A folder that this user may not write is refused too: the service's user has to be the one who asks.
    """
    _require_tls(site)
    store = site.settings.store
    captures = store.captures or (None if store.path else str(captures_of(site)))
    for key, given in (("path", store.path), ("archive", store.archive), ("captures", captures)):
        if given is not None and (wrong := _why_not(site.file.parent / given)):
            raise UsageError(
                f"{site.file}: store.{key} = {given!r}: must be a writable folder; {wrong}. Choose another folder, "
                "or change its permissions."
            )


def _require_tls(site: Site) -> None:
    """UsageError for a certificate or a key that is not there."""
    service, mqtt = site.settings.service, site.settings.mqtt
    files = {"service.tls_cert": service.tls_cert, "service.tls_key": service.tls_key}
    if mqtt is not None:
        files |= {"mqtt.ca": mqtt.ca, "mqtt.cert": mqtt.cert, "mqtt.key": mqtt.key}
    for key, name in files.items():
        if name is not None and not os.access(site.file.parent / name, os.R_OK):
            raise UsageError(
                f"{site.file}: {key} = {name!r}: must be a readable file. Name another one, or change its permissions."
            )


def _why_not(folder: Path) -> str:
    """Why files cannot be written into a folder, which is not made; empty where they can."""
    there = folder.absolute()
    try:
        there = next(place for place in (there, *there.parents) if place.exists())
        if not there.is_dir():
            return f"{there} is a file"
        if there == folder.absolute():
            # Another process may write into it: nothing is touched.
            return "" if os.access(there, os.W_OK | os.X_OK) else f"{there} is not writable"
        tempfile.TemporaryDirectory(prefix=".midspan-", dir=there).cleanup()
    except OSError as error:
        return f"{there}: {error.strerror}"
    return ""
