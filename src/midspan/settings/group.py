"""`[[group]]` of SITE.toml: many points, each an acceleration and a slow displacement by MQTT, filtered together."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from midspan.errors import UsageError
from midspan.records import member_name, member_of
from midspan.settings.fields import Form, IsNumber, Noise, Section
from midspan.settings.live_axes import MAX_NAME
from midspan.settings.load import validate
from midspan.sources.accelerometer.units import ACCELERATION_UNITS, LENGTH_UNITS, factor_to_si, measures

# What stands in a topic for a point's number.
NUMBER = "{i}"
MAX_POINTS = 100_000
MQTT = "mqtt:"


def is_a_point(value: str) -> str:
    """A point's name; ValueError for another text."""
    if not re.fullmatch(rf"[A-Za-z0-9_-]{{1,{MAX_NAME}}}", value):
        raise ValueError(f"must be 1 to {MAX_NAME} letters, digits, - and _, because topics and file names contain it")
    return value


def _is_a_topic(value: str) -> str:
    """The address of a topic, or with {i} of a topic for each point."""
    topic = value.removeprefix(MQTT)
    if topic == value or not topic:
        raise ValueError(f'must be mqtt: and a topic, such as "mqtt:north/{NUMBER}/acc"')
    if any(sign in topic for sign in "+#\0"):
        raise ValueError(f"must be one topic without the wildcards + and #; write {NUMBER} for the point's number")
    return value


def _is_an_acceleration(value: str) -> str:
    if not measures(value, "acceleration"):
        raise ValueError(f"must be a unit of acceleration, such as {', '.join(ACCELERATION_UNITS[:1])}, g or mg")
    return value


def _is_a_length(value: str) -> str:
    if not measures(value, "displacement"):
        raise ValueError(f"must be a unit of length, such as {', '.join(LENGTH_UNITS[:3])}")
    return value


Topic = Annotated[str, AfterValidator(_is_a_topic), Form("mqtt:TOPIC")]
PointName = Annotated[str, AfterValidator(is_a_point), Form("letters, digits, -, _")]


class GroupSettings(Section):
    """Many points without image and calibration: one filter for all, one topic for each point (`{i}`) or for all."""

    name: PointName = Field(description="name of the group; its points are NAME-0, NAME-1 and so on")
    points: Annotated[int, IsNumber, Field(ge=1, le=MAX_POINTS, strict=True)] = Field(description="number of points")
    accelerometer: Topic = Field(
        description="topic of the accelerations; `{i}` is the point's number from 0, without it all points share it"
    )
    displacement: Topic = Field(description="topic of the displacements; `{i}` likewise")
    accelerometer_unit: Annotated[str, AfterValidator(_is_an_acceleration), Form("acceleration")] = Field(
        "m/s^2", description="unit of the accelerations"
    )
    displacement_unit: Annotated[str, AfterValidator(_is_a_length), Form("length")] = Field(
        "mm", description="unit of the displacements"
    )
    accelerometer_noise_std: Noise = Field(
        description="σ of an accelerometer's noise per sample; larger trusts it less"
    )
    displacement_noise_std: Noise = Field(description="σ of a displacement's noise; larger trusts it less")
    displacement_slow_std: Noise | None = Field(
        None, description="σ of its slow error, as multipath of GNSS. Default: as large as its noise"
    )


@dataclass(frozen=True, slots=True)
class GroupPlan:
    """A group, and the numbers of its points that are filtered here: all of them, or in a shard evenly spaced ones."""

    settings: GroupSettings
    numbers: range = field(default_factory=lambda: range(0))

    @property
    def name(self) -> str:
        """The group's name."""
        return self.settings.name

    @property
    def part(self) -> str:
        """Which part of the group it is, empty for all of it."""
        return "" if self.numbers.step == 1 else f"{self.numbers.start} {self.numbers.step}"

    @property
    def key(self) -> str:
        """What one process alone writes: the group, or its part."""
        return f"{self.name} {self.part}".strip()

    @property
    def accelerometer_factor(self) -> float:
        """m/s² in one unit of the accelerations."""
        return factor_to_si(self.settings.accelerometer_unit, "acceleration") or 1.0

    @property
    def displacement_factor(self) -> float:
        """Metres in one unit of the displacements."""
        return factor_to_si(self.settings.displacement_unit, "displacement") or 1.0

    def point(self, number: int) -> str:
        """The name of the point of a number."""
        return member_name(self.settings.name, number)

    def number(self, point: str) -> int | None:
        """The number of one of the points that are filtered here by its name; None for another name."""
        name, number = member_of(point) or ("", 0)
        return number if name == self.name and number in self.numbers else None


def topic_of(address: str, number: int) -> str:
    """The topic of a point's number at an address, or that of all points."""
    return address.removeprefix(MQTT).replace(NUMBER, str(number))


def topics_of(plan: GroupPlan) -> list[str]:
    """The topics of the points that are filtered here: those of the accelerations first."""
    addresses = (plan.settings.accelerometer, plan.settings.displacement)
    return [
        topic for one in addresses for topic in dict.fromkeys(topic_of(one, number) for number in plan.numbers)
    ]  # fmt: skip


def groups_of(tree: Any, where: str) -> tuple[GroupPlan, ...]:
    """The groups of a site's file. Raises UsageError for what they may not say; where: names the file."""
    if not isinstance(tree, list) or not all(isinstance(one, dict) for one in tree):
        raise UsageError(f"{where}: group: must be one [[group]] for each group.")
    plans = []
    for number, one in enumerate(tree, start=1):
        name = one.get("name")
        place = f"{where}: group {name!r}" if isinstance(name, str) and name else f"{where}: group[{number}]"
        settings = validate(one, place, GroupSettings)
        if len(f"{settings.name}-{settings.points - 1}") > MAX_NAME:
            raise UsageError(f"{place}: name: must be shorter: with a point's number at most {MAX_NAME} characters..")
        plans.append(GroupPlan(settings, range(settings.points)))
    return tuple(plans)


def require_names(plans: Sequence[GroupPlan], points: Sequence[str], where: str) -> None:
    """UsageError for a name that a group or a point of it shares with another one, capitals or not."""
    taken = {name.casefold(): f"the point {name!r}" for name in points}
    for plan in plans:
        place = f"{where}: group {plan.name!r}"
        if (first := taken.get(plan.name.casefold())) is not None:
            raise UsageError(f"{place}: name: must be unique; {first} has it too. Rename one.")
        taken[plan.name.casefold()] = f"the group {plan.name!r}"
    for plan in plans:
        for name, first in taken.items():
            group, number = member_of(name) or ("", 0)
            if group == plan.name.casefold() and number in plan.numbers:
                raise UsageError(
                    f"{where}: group {plan.name!r}: name: its point {plan.point(number)} has the name of {first}. "
                    "Rename one."
                )


def require_topics(plans: Sequence[GroupPlan], root: str | None, taken: Sequence[str], where: str) -> None:
    """UsageError for topics without a broker, of the site's own results, or that two sensors have.

    root: of the site's results, None without a broker; taken: topics of the site's other points.
    """
    users = dict.fromkeys(taken, "a [[point]]")
    for plan in plans:
        place = f"{where}: group {plan.name!r}"
        if root is None:
            raise UsageError(f"{place}: its topics need a broker, but [mqtt] is missing. Add [mqtt].")
        for key in ("accelerometer", "displacement"):
            address = getattr(plan.settings, key)
            if topic_of(address, 0).startswith(root):
                raise UsageError(
                    f"{place}: {key}: must not be a topic of the site's results, {root}…; received {address!r}."
                )
            numbers = plan.numbers if NUMBER in address else plan.numbers[:1]
            own = [topic_of(address, number) for number in numbers]
            if (both := next((topic for topic in own if topic in users), None)) is not None:
                raise UsageError(
                    f"{place}: {key}: each topic belongs to one sensor; {both!r} is that of {users[both]} too. Use "
                    "another topic."
                )
            users |= dict.fromkeys(own, f"the group {plan.name!r}, {key},")
