"""The alarms of a running site: rows and ages to the rules, changes to the book, the broker, the page and people."""

import asyncio
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from midspan.alarms.book import Audit, Entry, Message
from midspan.alarms.delivery import Delivery
from midspan.alarms.messages import body_of
from midspan.alarms.senders import Deliver, deliver_to, target_of
from midspan.alarms.watch import MQTT_TARGET, Ages, Watch
from midspan.errors import MidspanError
from midspan.records import NANOSECONDS
from midspan.service.mqtt import Broker
from midspan.service.places import place_of
from midspan.service.running import Running
from midspan.settings.alarms import AlarmSettings
from midspan.settings.site import Site
from midspan.store.chunk import Chunk

Tree = dict[str, Any]
# What does not come is looked for so often, s: a quarter of what an alarm may be late.
LOOK_S = 0.25
# The broker's acknowledgement is waited for so long before the next look at whether the service ends, s.
PUBLISH_S = 2.0


class MqttTarget:
    """Delivers to the broker's topics; what was handed to the client is not handed over again."""

    def __init__(self) -> None:
        self.broker: Broker | None = None
        self._under_way: tuple[Broker, Message, Any] | None = None

    def __call__(self, message: Message) -> None:
        """Raises OSError until the broker has it."""
        broker = self.broker
        if broker is None:
            raise OSError("the broker is away")
        if self._under_way is None or self._under_way[0] is not broker or self._under_way[1] is not message:
            # A test is for whoever listens now.
            retain = message.tree["state"] != "test"
            sent = broker.deliver(message.topic, body_of(message.tree), retain=retain, wait_s=PUBLISH_S)
            self._under_way = (broker, message, sent)
        with suppress(RuntimeError, ValueError):
            self._under_way[2].wait_for_publish(PUBLISH_S)
        if not self._under_way[2].is_published():
            raise OSError("the broker has not acknowledged it yet")
        self._under_way = None


def ages_of(point: Running, row_s: float | None, now_s: float, begun_s: float) -> Ages:
    """How long ago a point's newest row came (row_s: when), and the newest record of the source that is silent longest.
    Of what is paused nothing is expected. begun_s: since when anything is expected of the site.
    """
    streams = point.streams.values()
    row_s = now_s if any(stream.paused for stream in streams) else row_s
    # Rows need every source: those from before the last one was resumed say nothing.
    rows_expected_s = max((begun_s, *(one.expected_s for one in streams)))
    rows_came = row_s is not None and row_s >= rows_expected_s
    heard = [
        (max(begun_s, one.expected_s) if one.heard_s is None else one.heard_s, one) for one in streams if not one.paused
    ]
    oldest_s, oldest = min(heard, key=lambda one: one[0], default=(now_s, None))
    return Ages(
        rows_s=max(now_s - (row_s if rows_came and row_s is not None else rows_expected_s), 0.0),
        block_s=max(now_s - oldest_s, 0.0),
        rows_came=rows_came,
        block_came=all(one.heard_s is not None for _, one in heard),
        source="" if oldest is None else f"{oldest.point}.{oldest.sensor}",
    )


def alarms_of(site: Site) -> dict[str, tuple[AlarmSettings, ...]]:
    """The alarms of each point."""
    return {plan.name: plan.alarms for plan in site.points}


def people_of(site: Site) -> list[str]:
    """The names of the targets that people read."""
    return [target_of(one) for one in site.settings.notify]


class Alarming:
    """say: takes one line for a person; frame: takes what goes to the page's server."""

    def __init__(self, site: Site, say: Callable[[str], None], frame: Callable[[Tree], None]) -> None:
        self._site, self._say, self._frame = site, say, frame
        self._mqtt = MqttTarget()
        self.delivery = Delivery(place_of(site.store), self._targets_of(site), say)
        watched = (alarms_of(site), site.settings.maintenance, people_of(site))
        self._watch = Watch(*watched, self._put, mqtt=site.settings.mqtt is not None)
        self._begun_s = self._looked_s = time.time()
        self._is_open, self._is_faulty = False, False
        # When each point's newest row came: those that a restart makes again are none.
        self._row_s: dict[str, float] = {}
        self.commands: dict[str, Callable[[Tree], Tree]] = {
            "alarms": lambda _: {
                "alarms": self._watch.trees(), "targets": self._targets(), "limits": self._watch.limits(),
                "silences": self._watch.silences(),
            },
            "acknowledge": self._acknowledge,
            "silence": self._silence,
            "unsilence": self._unsilence,
            "end_silence": self._end_silence,
            "test_alarms": self._test,
            "note": self._note,
        }  # fmt: skip

    def open(self) -> None:
        """Go on from what was kept; called in a thread."""
        book, now_ns = self.delivery.open(), time.time_ns()
        if book is not None:
            try:
                self._watch.restore(book.alarms(now_ns - 86_400 * NANOSECONDS), book.kept(), now_ns)
            except MidspanError as error:
                self._say(f"alarms: the stored alarms cannot be read ({error}); the list starts empty.")
        self.delivery.start()
        self._begun_s, self._is_open = time.time(), True

    def _targets_of(self, site: Site) -> dict[str, Deliver]:
        own: dict[str, Deliver] = {} if site.settings.mqtt is None else {MQTT_TARGET: self._mqtt}
        return {**own, **{target_of(one): deliver_to(one, site.name) for one in site.settings.notify}}

    async def change(self, site: Site) -> None:
        """Go on with other settings; called in the loop that gives the rows."""
        self._site = site
        # First, so that the new targets get what follows from the new rules.
        await asyncio.to_thread(self.delivery.change, self._targets_of(site))
        watched = (alarms_of(site), site.settings.maintenance, people_of(site))
        self._watch.change(*watched, time.time_ns(), mqtt=site.settings.mqtt is not None)

    def connect(self, broker: Broker) -> None:
        """The broker that changes go to."""
        self._mqtt.broker = broker

    def close(self) -> None:
        """Keep what waits, and end; called in a thread. Rows that come later are left out."""
        self._is_open = False
        self.delivery.stop()

    def rows(self, point: str, rows: Chunk) -> None:
        """A point's newest rows."""
        self._row_s[point] = time.time()
        self._guarded(lambda: self._watch.rows(point, rows, time.time_ns()))

    def new_datum(self, point: str, time_ns: int) -> None:
        """A point's displacement counts from another zero."""
        self._watch.new_datum(point, time_ns)

    def look(self, now_ns: int, points: Sequence[Running]) -> None:
        """Look for what does not come, and for what is to be said again; seldom enough."""
        now_s = now_ns / NANOSECONDS
        # A clock that was set back does not keep it from looking.
        if 0.0 <= now_s - self._looked_s < LOOK_S:
            return
        self._looked_s = now_s
        ages = {one.name: ages_of(one, self._row_s.get(one.name), now_s, self._begun_s) for one in points}
        self._guarded(lambda: self._watch.tick(now_ns, ages, self.delivery.disk_percent))

    def _guarded(self, work: Callable[[], None]) -> None:
        """A defect of the alarms is said once, and ends no row."""
        if not self._is_open:
            return
        try:
            work()
        except Exception as error:
            if not self._is_faulty:
                self._is_faulty = True
                self._say(f"alarms: a defect of midspan ({type(error).__name__}: {error}); rows continue.")

    def _put(self, entry: Entry, trees: Sequence[Tree]) -> None:
        self.delivery.put(entry)
        for tree in trees:
            self._say(f"{tree['point']}: alarm {tree['name']} {tree['state']}: {tree['text']}")
            self._frame({"kind": "alarm", **tree})

    def _targets(self) -> list[Tree]:
        """How delivery stands."""
        return [
            {"target": one.target, "waiting": one.waiting, "sent": one.sent, "fault": one.fault,
             "sent_s": one.sent_s or None}
            for one in self.delivery.senders.values()
        ]  # fmt: skip

    def _acknowledge(self, head: Tree) -> Tree:
        return {"text": self._watch.acknowledge(str(head["alarm"]), str(head["who"]), time.time_ns())}

    def _silence(self, head: Tree) -> Tree:
        until_ns, reason = int(head["until_ns"]), str(head["reason"])[:200]
        text = self._watch.silence(str(head["alarm"]), str(head["who"]), until_ns, reason, time.time_ns())
        return {"text": text}

    def _unsilence(self, head: Tree) -> Tree:
        return {"text": self._watch.unsilence(str(head["alarm"]), str(head["who"]), time.time_ns())}

    def _end_silence(self, head: Tree) -> Tree:
        return {"text": self._watch.end_silence(str(head["silence"]), str(head["who"]), time.time_ns())}

    def _note(self, head: Tree) -> Tree:
        """A line of the audit list of something else that a person did."""
        words = [str(head[key]) for key in ("about", "what", "who", "text")]
        self.delivery.put(Entry(audit=[Audit(time.time_ns(), *words)]))
        return {"text": ""}

    def _test(self, head: Tree) -> Tree:
        return {"text": self._watch.test(str(head["who"]), self._site.name, time.time_ns())}
