"""How the points of a group stand, while the group changes."""

import asyncio

import numpy as np

from midspan.engine.point import PointStatus
from midspan.serve.groups import GroupTables
from midspan.service.live_socket import ROW

REASONS = ["", "starting"]


class Link:
    """An engine whose group gets other points while it is asked."""

    def __init__(self, before, after):
        self.reason, self._after = "", after
        self.state = self.of(before)

    @staticmethod
    def of(numbers):
        return {"groups": [{"group": "north", "numbers": [numbers.start, numbers.stop, numbers.step]}]}

    async def ask(self, command, **_):
        assert command == "group"
        await asyncio.sleep(0)
        self.state = self.of(self._after)
        newest = np.zeros(len(self._after), dtype=ROW)
        newest["status"], newest["displacement_mm"] = PointStatus.TRACKING, list(self._after)
        numbers = self.state["groups"][0]["numbers"]
        return {"reasons": REASONS, "numbers": numbers}, newest.tobytes() + bytes(len(self._after))


def states(before, after):
    return asyncio.run(GroupTables(Link(before, after)).states(None))


def test_a_group_that_changes_while_it_is_asked_shows_its_points_as_they_are_then():
    for before, after in ((range(12), range(4)), (range(4), range(12)), (range(0, 12, 3), range(1, 12, 3))):
        found = states(before, after)
        assert [(one["name"], one["displacement_mm"]) for one in found] == [(f"north-{k}", float(k)) for k in after]


def test_a_point_is_looked_up_among_the_points_of_the_answer():
    tables = GroupTables(Link(range(12), range(2, 12, 5)))
    assert asyncio.run(tables.state("north-7"))["displacement_mm"] == 7.0
    assert asyncio.run(GroupTables(Link(range(12), range(4))).state("north-7")) is None
