"""What other settings of a site change: which of its points begin, begin anew and end. The others go on."""

from dataclasses import dataclass, replace
from typing import Any

from midspan.settings.group import GroupPlan
from midspan.settings.site import PointPlan, Site, captures_of


@dataclass(frozen=True, slots=True)
class Changes:
    """Names of points and groups: of those that begin, end and begin anew with other settings, and end."""

    added: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()

    @classmethod
    def between(cls, before: Site | None, after: Site) -> "Changes":
        """From one site to another; before: None where none runs. Alarms are no reason to begin a point anew."""
        old, new = {} if before is None else _measuring(before), _measuring(after)
        moved = before is not None and captures_of(before) != captures_of(after)
        return cls(
            tuple(name for name in new if name not in old),
            tuple(name for name in new if name in old and (moved or new[name] != old[name])),
            tuple(name for name in old if name not in new),
        )

    @property
    def beginning(self) -> tuple[str, ...]:
        """Those that begin, anew or for the first time."""
        return (*self.added, *self.changed)

    @property
    def ending(self) -> tuple[str, ...]:
        """Those that end, for good or to begin anew."""
        return (*self.changed, *self.removed)

    @property
    def text(self) -> str:
        """What becomes of the points, in sentences."""
        done = [("start", self.added), ("restart", self.changed), ("stop", self.removed)]
        lines = [
            f"Point{'s' * (len(names) > 1)} {', '.join(names)} {what}{'s' * (len(names) == 1)}."
            for what, names in done
            if names
        ]
        return " ".join([*lines, "The other points continue." if lines else "All points continue."])

    def to_dict(self) -> dict[str, Any]:
        """As the interface has it."""
        return {"added": list(self.added), "changed": list(self.changed), "removed": list(self.removed)}


def _measuring(site: Site) -> dict[str, PointPlan | GroupPlan]:
    """The plans of points and groups by name, without what measures nothing."""
    return {plan.name: replace(plan, alarms=(), place=0) for plan in site.points} | {
        plan.name: plan for plan in site.groups
    }
