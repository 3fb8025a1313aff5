"""Sections of `SITE.toml` that say when a point alarms, who is notified, and when nobody is."""

from datetime import UTC, datetime
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, SecretStr, model_validator

from midspan.settings.fields import Form, IsNumber, Section, limited

Quantity = Literal["displacement", "drift", "velocity", "std", "silent", "disk"]
# A limit on more than a kilometre, or within less than a nanometre, is a unit that was mistaken.
Length = Annotated[float, IsNumber, limited(1e-6, 1e6, "mm")]
Speed = Annotated[float, IsNumber, limited(1e-6, 1e7, "mm/s")]
# Up to a week.
Delay = Annotated[float, IsNumber, limited(0.0, 604_800.0, "s")]
LIMITS: dict[str, tuple[str, str]] = {
    # quantity: (unit of its limit, what the keys of limit and hysteresis end with)
    "displacement": ("mm", "mm"),
    "drift": ("mm", "mm"),
    "velocity": ("mm/s", "mm_s"),
    "std": ("mm", "mm"),
    "silent": ("s", ""),
    "disk": ("%", "percent"),
}
ENDINGS = ("mm", "mm_s", "percent")


def _is_a_name(value: str) -> str:
    if not 1 <= len(value) <= 64 or not value.isprintable() or "/" in value:
        raise ValueError("must be 1 to 64 characters other than / and control characters")
    return value


class AlarmSettings(Section):
    """One alarm of a point: what it watches, its limit and its delays."""

    name: Annotated[str, AfterValidator(_is_a_name)] = Field(description="name of the alarm, unique within its point")
    on: Quantity = Field(
        description="monitored quantity; drift: of the daily mean; silent: no data from a source; disk: usage of the "
        "store's disk"
    )
    limit_mm: Length | None = Field(None, description="limit of |displacement|, |drift| or std")
    span_m: Annotated[float, IsNumber, limited(1e-3, 1e5, "m")] | None = Field(
        None, description="span length; with span_over it replaces limit_mm"
    )
    span_over: Annotated[float, IsNumber, limited(1.0, 1e6)] | None = Field(
        None, description="limit as a fraction of the span: 800 is span_m / 800; larger fires earlier"
    )
    limit_mm_s: Speed | None = Field(None, description="limit of |velocity|")
    limit_percent: Annotated[float, IsNumber, limited(1.0, 100.0, "%")] | None = Field(
        None, description="limit of the used share of the store's disk"
    )
    level: Literal["warning", "critical"] = Field("warning", description="how serious it is")
    delay_s: Delay = Field(
        0.0,
        description="time above the limit before the alarm fires; silent: age of the source's newest data",
    )
    hysteresis_mm: Annotated[float, IsNumber, limited(0.0, 1e6, "mm")] = Field(
        0.0, description="distance below the limit at which the alarm ends; more prevents chatter"
    )
    hysteresis_mm_s: Annotated[float, IsNumber, limited(0.0, 1e7, "mm/s")] = Field(
        0.0, description="hysteresis of velocity"
    )
    hysteresis_percent: Annotated[float, IsNumber, limited(0.0, 100.0, "%")] = Field(
        0.0, description="hysteresis of disk usage"
    )
    keep_firing_s: Delay = Field(10.0, description="time below the limit before the alarm ends")
    no_data_s: Annotated[float, IsNumber, limited(0.1, 604_800.0, "s")] | None = Field(
        None, description="time without rows before a separate alarm no_data fires"
    )
    repeat_s: Annotated[float, IsNumber, limited(1.0, 604_800.0, "s")] = Field(
        3600.0, description="interval of reminders until the alarm is acknowledged"
    )

    @model_validator(mode="after")
    def _has_its_limit(self) -> "AlarmSettings":
        ending, has_span = LIMITS[self.on][1], self.span_m is not None or self.span_over is not None
        for other in ENDINGS:
            if other != ending and {f"limit_{other}", f"hysteresis_{other}"} & self.model_fields_set:
                raise ValueError(f'must have no limit_{other} and hysteresis_{other} with on = "{self.on}"')
        if has_span and self.on != "displacement":
            raise ValueError('must have on = "displacement" with span_m and span_over')
        if has_span and (self.span_m is None or self.span_over is None or self.limit_mm is not None):
            raise ValueError("must have limit_mm, or both span_m and span_over")
        if self.on == "silent" and self.delay_s == 0.0:
            raise ValueError('must have delay_s with on = "silent": how long after the newest block it fires')
        if ending and not has_span and getattr(self, f"limit_{ending}") is None:
            raise ValueError(f'must have limit_{ending} with on = "{self.on}"')
        if ending and self.hysteresis >= self.limit:
            raise ValueError(f"must have a hysteresis below the limit of {self.limit:g} {self.unit}")
        return self

    @property
    def unit(self) -> str:
        """Of limit and value."""
        return LIMITS[self.on][0]

    @property
    def limit(self) -> float:
        """The limit in `unit`: of a silent source its delay."""
        if self.on == "silent":
            return self.delay_s
        if self.span_m is not None and self.span_over is not None:
            return 1e3 * self.span_m / self.span_over
        return float(getattr(self, f"limit_{LIMITS[self.on][1]}"))

    @property
    def hysteresis(self) -> float:
        """How far below the limit it ends, in `unit`."""
        ending = LIMITS[self.on][1]
        return float(getattr(self, f"hysteresis_{ending}")) if ending else 0.0


def _require_http(value: str) -> None:
    """ValueError for what is no address of a webhook; the address, which may hold a secret, is not shown."""
    parts = urlsplit(value)
    if parts.scheme not in ("http", "https") or not parts.hostname or not value.isascii() or not value.isprintable():
        raise ValueError("must have a webhook that begins with http:// or https://")


def _is_a_server(value: str) -> str:
    host, _, port = value.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError('must be a host and a port, like "127.0.0.1:25"')
    return value


def _is_mail(value: str) -> str:
    if value.count("@") != 1 or not value.isprintable() or set(" ,;<>") & set(value):
        raise ValueError('must be an e-mail address, like "night@example.org"')
    return value


Mail = Annotated[str, AfterValidator(_is_mail), Form("address")]


class NotifySettings(Section):
    """Where alarms go besides page, store and MQTT: a webhook, or mail."""

    webhook: Annotated[SecretStr, Form("address")] | None = Field(
        None, description="http(s) address to which each change is sent by POST, as JSON"
    )
    secret: Annotated[SecretStr, Form("text")] | None = Field(
        None, description='key of the HMAC-SHA256 signature; write "{NAME}"'
    )
    smtp: Annotated[str, AfterValidator(_is_a_server), Form("HOST:PORT")] | None = Field(
        None, description="host and port of a mail server, instead of webhook; port 465: TLS from the start"
    )
    to: Annotated[tuple[Mail, ...], Form("list of addresses")] = Field((), description="addresses that get mail")
    sender: Mail = Field("midspan@localhost", description="whom mail is from")
    user: str | None = Field(None, description="user of the mail server")
    password: Annotated[SecretStr, Form("text")] | None = Field(None, description='its password; write "{NAME}"')

    @model_validator(mode="after")
    def _is_one(self) -> "NotifySettings":
        if (self.webhook is None) == (self.smtp is None):
            raise ValueError("must have either webhook or smtp")
        if self.webhook is not None:
            _require_http(self.webhook.get_secret_value())
        if self.smtp is not None and not self.to:
            raise ValueError("must have to with smtp: a list of addresses")
        if self.smtp is None and {"to", "sender", "user", "password"} & self.model_fields_set:
            raise ValueError("must have smtp with to, sender, user and password")
        if self.webhook is None and self.secret is not None:
            raise ValueError("must have webhook with secret")
        if self.password is not None and self.user is None:
            raise ValueError("must have user with password")
        return self


class MaintenanceSettings(Section):
    """A time without messages; alarms are evaluated and kept."""

    begin: Annotated[datetime, Form("time")] = Field(description="first instant, UTC without a zone")
    end: Annotated[datetime, Form("time")] = Field(description="end, UTC without a zone")
    reason: str = Field("", description="what is done then")
    points: Annotated[tuple[str, ...], Form("list of names")] = Field(
        (), description="points whose notifications are muted; default: all"
    )

    @model_validator(mode="after")
    def _is_a_time(self) -> "MaintenanceSettings":
        if _utc(self.end) <= _utc(self.begin):
            raise ValueError("must end after it begins")
        return self

    def covers(self, point: str, time_s: float) -> bool:
        """Whether messages about a point are silent at a time, s since 1970."""
        inside = _utc(self.begin).timestamp() <= time_s < _utc(self.end).timestamp()
        return inside and (not self.points or point in self.points)


def _utc(instant: datetime) -> datetime:
    return instant if instant.tzinfo else instant.replace(tzinfo=UTC)
