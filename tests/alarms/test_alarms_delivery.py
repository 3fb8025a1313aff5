"""Delivery on loopback: signed, in order, over refusals and restarts, and nobody waits for it."""

import hashlib
import hmac
import http.server
import json
import socketserver
import threading
import time

import pytest

from midspan.alarms.book import Audit, Book, Entry, Message, has_book
from midspan.alarms.delivery import Delivery
from midspan.alarms.machine import Alarm
from midspan.alarms.messages import tree_of
from midspan.alarms.senders import deliver_to, target_of
from midspan.settings.alarms import NotifySettings
from served import until


def alarm(number, state="firing"):
    now_ns = time.time_ns()
    return Alarm(str(number), "p/a", "p", "a", "critical", "displacement", "mm", 20.0, state, "limit", 25.0, 0.1, 25.0,
                 now_ns, now_ns)  # fmt: skip


def entry(number, *targets):
    one = alarm(number)
    messages = [Message(target, time.time_ns(), "p/alarm", tree_of(one)) for target in targets]
    return Entry([one], [Audit(time.time_ns(), one.id, one.state, "", "")], messages)


class Hook:
    """A receiver of webhooks that refuses the first ones it gets."""

    def __init__(self, refuse=0):
        self.came, self.refuse = [], refuse
        hook = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self):
                body = self.rfile.read(int(self.headers["content-length"]))
                hook.refuse -= 1
                if hook.refuse < 0:
                    hook.came.append((dict(self.headers), body))
                self.send_response(503 if hook.refuse >= 0 else 204)
                self.end_headers()

            def log_message(self, *_):
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server.server_address[1]}/hook?key=s3cret"

    @property
    def ids(self):
        return [json.loads(body)["id"] for _, body in self.came]

    def stop(self):
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture
def hook():
    hook = Hook()
    yield hook
    hook.stop()


class Mailbox(socketserver.ThreadingTCPServer):
    """A mail server of the few commands that sending needs."""

    daemon_threads, allow_reuse_address = True, True

    def __init__(self):
        self.mails = []
        super().__init__(("127.0.0.1", 0), Session)
        threading.Thread(target=self.serve_forever, daemon=True).start()


class Session(socketserver.StreamRequestHandler):
    def handle(self):
        say = lambda text: self.wfile.write(text.encode() + b"\r\n")  # noqa: E731
        say("220 mailbox")
        recipients = []
        while line := self.rfile.readline().strip().decode():
            word = line[:4].upper()
            if word == "RCPT":
                recipients.append(line)
            if word == "DATA":
                say("354 go on")
                text = b"".join(iter(self.rfile.readline, b".\r\n"))
                self.server.mails.append((recipients, text.decode()))
            if word == "EHLO":
                # With a certificate of nobody, as Debian installs it.
                say("250-mailbox")
                say("250 STARTTLS")
                continue
            if word == "STAR":
                say("454 not now")
                continue
            if word == "QUIT":
                say("221 bye")
                return
            say("250 ok")


def settings(**keys):
    return NotifySettings.model_validate(keys)


def delivery(folder, *targets):
    made = Delivery(folder, {target_of(one): deliver_to(one, "river bridge") for one in targets}, lambda _: None)
    made.open()
    made.start()
    return made


def test_a_webhook_is_signed(tmp_path, hook):
    target = settings(webhook=hook.url, secret="key")
    running = delivery(tmp_path, target)
    running.put(entry(1, target_of(target)))
    until(lambda: hook.came)
    running.stop()
    headers, body = hook.came[0]
    assert headers["X-Midspan-Signature"] == "sha256=" + hmac.new(b"key", body, hashlib.sha256).hexdigest()
    assert headers["X-Midspan-Delivery"] == "1"
    tree = json.loads(body)
    assert {key: tree[key] for key in ("id", "state", "value", "limit", "unit")} == {
        "id": "1", "state": "firing", "value": 25.0, "limit": 20.0, "unit": "mm",
    }  # fmt: skip
    # The address may hold a secret.
    assert "s3cret" not in target_of(target) + repr(target)


def test_refused_messages_are_tried_again_in_their_order(tmp_path):
    hook = Hook(refuse=1)
    target = settings(webhook=hook.url)
    running = delivery(tmp_path, target)
    for number in range(3):
        running.put(entry(number, target_of(target)))
    until(lambda: len(hook.came) == 3)
    running.stop()
    hook.stop()
    assert hook.ids == ["0", "1", "2"]
    assert Book(tmp_path).waiting() == []


def test_what_was_not_delivered_is_delivered_after_a_restart_once(tmp_path, hook):
    target = settings(webhook=hook.url)
    away = settings(webhook="http://127.0.0.1:9/nobody")
    running = delivery(tmp_path, away)
    running.put(entry(1, target_of(away)))
    running.put(entry(2, target_of(away)))
    until(lambda: running.senders[target_of(away)].fault)
    running.stop()
    # The same target, which is there now.
    again = Delivery(tmp_path, {target_of(away): deliver_to(target, "")}, lambda _: None)
    again.open()
    again.start()
    until(lambda: len(hook.came) == 2)
    again.stop()
    third = delivery(tmp_path, target)
    time.sleep(0.3)
    third.stop()
    assert hook.ids == ["1", "2"]


def test_other_targets_get_what_waits_for_their_name_and_the_same_ones_go_on(tmp_path, hook):
    good, away = settings(webhook=hook.url), settings(webhook="http://127.0.0.1:9/nobody")
    running = delivery(tmp_path, good, away)
    same = running.senders[target_of(good)]
    running.put(entry(1, target_of(away)))
    running.put(entry(2, target_of(away)))
    until(lambda: running.senders[target_of(away)].fault)
    running.change({target_of(good): deliver_to(good, "river bridge"), target_of(away): deliver_to(good, "")})
    until(lambda: len(hook.came) == 2)
    assert running.senders[target_of(good)] is same
    running.change({})
    assert not same.is_alive()
    running.stop()
    assert hook.ids == ["1", "2"]
    assert Book(tmp_path).waiting() == []


def test_a_message_under_way_while_its_target_changes_goes_out_once(tmp_path):
    begun, end, came = threading.Event(), threading.Event(), []

    def slow(message):
        begun.set()
        end.wait(10.0)
        came.append(("old", message.tree["id"]))

    running = Delivery(tmp_path, {"people": slow}, lambda _: None)
    running.open()
    running.start()
    running.put(entry(1, "people"))
    begun.wait(10.0)
    sender = running.senders["people"]
    running.change({"people": lambda message: came.append(("new", message.tree["id"]))})
    # One that a thread still hands to the sender of before is delivered, too.
    sender.put(Message("people", time.time_ns(), "p/alarm", tree_of(alarm(2))))
    end.set()
    until(lambda: len(came) == 2)
    running.stop()
    assert came == [("old", "1"), ("new", "2")]
    assert Book(tmp_path).waiting() == []


def test_a_target_that_failed_is_tried_at_once_where_it_changed(tmp_path, monkeypatch):
    monkeypatch.setattr("midspan.alarms.senders.AGAIN_S", 60.0)
    away, came = settings(webhook="http://127.0.0.1:9/nobody"), []
    running = delivery(tmp_path, away)
    running.put(entry(1, target_of(away)))
    until(lambda: running.senders[target_of(away)].fault)
    running.change({target_of(away): came.append})
    until(lambda: came)
    running.stop()


def test_mail_says_what_it_is_about(tmp_path):
    box = Mailbox()
    target = settings(smtp=f"127.0.0.1:{box.server_address[1]}", to=["night@example.org", "day@example.org"])
    running = delivery(tmp_path, target)
    running.put(entry(1, target_of(target)))
    until(lambda: box.mails)
    running.stop()
    box.shutdown()
    box.server_close()
    recipients, text = box.mails[0]
    assert len(recipients) == 2
    assert "Subject: [critical] river bridge, p: a firing" in text
    assert "exceeded" in text


def test_a_target_that_takes_nothing_delays_neither_the_others_nor_who_puts_it_in(tmp_path, hook):
    silent = socketserver.TCPServer(("127.0.0.1", 0), socketserver.BaseRequestHandler)
    deaf, good = settings(webhook=f"http://127.0.0.1:{silent.server_address[1]}/"), settings(webhook=hook.url)
    running = delivery(tmp_path, deaf, good)
    begun_s = time.monotonic()
    running.put(entry(1, target_of(deaf), target_of(good)))
    assert time.monotonic() - begun_s < 0.05
    until(lambda: hook.came)
    # On a busy machine; the deaf one would take 10 s.
    assert time.monotonic() - begun_s < 5.0
    silent.server_close()
    running.stop()


def test_without_its_file_messages_go_out_all_the_same(tmp_path, hook):
    (tmp_path / "alarms.sqlite").mkdir()
    target, lines = settings(webhook=hook.url), []
    running = Delivery(tmp_path, {target_of(target): deliver_to(target, "")}, lines.append)
    assert running.open() is None
    running.start()
    running.put(entry(1, target_of(target)))
    until(lambda: hook.came)
    assert "cannot be saved" in lines[0]
    # It can be written again: the alarm is kept late, and not sent twice.
    (tmp_path / "alarms.sqlite").rmdir()
    running.put(entry(2, target_of(target)))
    until(lambda: len(hook.came) == 2)
    running.stop()
    assert hook.ids == ["1", "2"]
    assert {one.id for one in Book(tmp_path).alarms()} == {"1", "2"}


def test_what_is_too_old_is_removed(tmp_path):
    book = Book(tmp_path)
    day_ns, now_ns = 86_400 * 10**9, time.time_ns()
    old = Alarm(**{**{name: getattr(alarm(1, "ended"), name) for name in Alarm.__slots__}, "time_ns": 1})
    book.write(Entry([old, alarm(2, "ended"), alarm(3)]))
    book.forget(now_ns)
    assert {one.id for one in book.alarms()} == {"2", "3"}
    assert {one.id for one in book.alarms(now_ns + day_ns)} == {"3"}
    assert has_book(tmp_path)
    book.close()
