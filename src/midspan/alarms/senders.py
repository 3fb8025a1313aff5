"""Delivery: each target has a thread and a queue of its own, so that one that is away delays neither rows nor others.

A message is tried until it is taken, the first one first; the order holds over restarts.
"""

import hashlib
import http.client
import smtplib
import ssl
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from email.message import EmailMessage
from email.utils import formatdate, make_msgid
from typing import Any
from urllib.parse import urlsplit

from midspan.alarms.book import Message
from midspan.alarms.messages import body_of, mail_text, signature, subject_of
from midspan.settings.alarms import NotifySettings
from midspan.settings.site import is_loopback

# One attempt may take so long at each step, s; between two of them is a second, doubled up to a minute.
ATTEMPT_S, AGAIN_S, MAX_AGAIN_S = 10.0, 1.0, 60.0
# What could not be delivered for a day is given up, and what is too much to wait: both are in the audit list.
MAX_AGE_S, MAX_WAITING = 86_400.0, 10_000
SMTPS_PORT = 465

Deliver = Callable[[Message], None]
"""Hands a message over; raises OSError, HTTPException, SMTPException or ValueError where it was not taken."""


class Sender(threading.Thread):
    """done: called with each message and why it was given up, "" where it was delivered."""

    def __init__(self, target: str, deliver: Deliver, done: Callable[[Message, str], None]) -> None:
        super().__init__(name=f"notify {target}", daemon=True)
        self.target, self.fault, self.sent, self.sent_s = target, "", 0, 0.0
        self.deliver, self._done = deliver, done
        self._waiting: deque[Message] = deque()
        # Something waits; the next attempt is due at once; no further one.
        self._some, self._due, self._is_ending = threading.Event(), threading.Event(), False

    @property
    def waiting(self) -> int:
        """How many messages wait."""
        return len(self._waiting)

    def put(self, message: Message) -> None:
        """Queue a message; of too many the oldest is given up."""
        self._waiting.append(message)
        if len(self._waiting) > MAX_WAITING:
            self._done(self._waiting.popleft(), f"more than {MAX_WAITING} messages were queued")
        self._some.set()

    def change(self, deliver: Deliver) -> None:
        """Deliver otherwise from the next attempt on, which is due at once; the one under way may still succeed."""
        if deliver != self.deliver:
            self.deliver = deliver
            self._due.set()

    def stop(self) -> None:
        """End after the attempt that is under way; what waits stays in the book."""
        self._is_ending = True
        self._some.set()
        self._due.set()

    def run(self) -> None:
        """Deliver one after another."""
        again_s = AGAIN_S
        while not self._is_ending:
            if not self._waiting:
                self._some.wait()
                self._some.clear()
                continue
            message = self._waiting[0]
            try:
                self.deliver(message)
            except (OSError, http.client.HTTPException, smtplib.SMTPException, ValueError) as error:
                self.fault = f"{type(error).__name__}: {error}"[:300]
                if time.time() - message.time_ns / 1e9 > MAX_AGE_S:
                    self._gone(message, f"not delivered within a day ({self.fault})")
                    continue
                again_s = AGAIN_S if self._due.wait(again_s) else min(2 * again_s, MAX_AGAIN_S)
                self._due.clear()
            else:
                self.fault, again_s, self.sent, self.sent_s = "", AGAIN_S, self.sent + 1, time.time()
                self._gone(message, "")

    def _gone(self, message: Message, why: str) -> None:
        if self._waiting and self._waiting[0] is message:
            self._waiting.popleft()
        self._done(message, why)


@dataclass(frozen=True, slots=True)
class Webhook:
    """POST of an alarm as JSON; with a secret the body is signed."""

    url: str
    secret: str | None

    def __call__(self, message: Message) -> None:
        """Deliver; any answer but 2xx is a refusal. A redirection is not followed."""
        parts, body = urlsplit(self.url), body_of(message.tree)
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        headers = {"Content-Type": "application/json", "User-Agent": "midspan"}
        if message.number:
            # The same message has the same number whenever it is tried: a receiver can leave it out the second time.
            headers["X-Midspan-Delivery"] = str(message.number)
        if self.secret:
            headers["X-Midspan-Signature"] = signature(self.secret, body)
        connection = kind(str(parts.hostname), parts.port, timeout=ATTEMPT_S)
        try:
            path = (parts.path or "/") + f"?{parts.query}" * bool(parts.query)
            connection.request("POST", path, body, headers)
            status = connection.getresponse().status
        finally:
            connection.close()
        if not 200 <= status < 300:
            raise ValueError(f"the webhook answered {status}")


@dataclass(frozen=True, slots=True)
class Mailer:
    """Mail over SMTP, with TLS where another machine's server offers it."""

    settings: NotifySettings
    site: str

    def __call__(self, message: Message) -> None:
        """Deliver; a server that refuses every recipient refuses the message."""
        host, _, port = str(self.settings.smtp).rpartition(":")
        context = ssl.create_default_context()
        kind: Any = smtplib.SMTP
        options: dict[str, Any] = {"timeout": ATTEMPT_S}
        if int(port) == SMTPS_PORT:
            kind, options["context"] = smtplib.SMTP_SSL, context
        with kind(host.strip("[]"), int(port), **options) as server:
            server.ehlo()
            # This machine's own server has a certificate of nobody, as Debian installs it.
            if kind is smtplib.SMTP and not is_loopback(str(self.settings.smtp)):
                if server.has_extn("starttls"):
                    server.starttls(context=context)
                    server.ehlo()
                elif self.settings.user is not None:
                    raise smtplib.SMTPNotSupportedError(
                        "the server has no TLS; the password would be sent in clear text"
                    )
            if self.settings.user is not None:
                secret = self.settings.password.get_secret_value() if self.settings.password else ""
                server.login(self.settings.user, secret)
            server.send_message(self._mail(message))

    def _mail(self, message: Message) -> EmailMessage:
        mail = EmailMessage()
        mail["Subject"] = subject_of(message.tree, self.site)
        mail["From"], mail["To"] = self.settings.sender, ", ".join(self.settings.to)
        mail["Date"], mail["Message-ID"] = formatdate(message.time_ns / 1e9), make_msgid(domain="midspan")
        mail["X-Midspan-Alarm"] = str(message.tree["id"])
        mail.set_content(mail_text(message.tree, self.site))
        return mail


def target_of(settings: NotifySettings) -> str:
    """How a target is called. Of a webhook only the host is shown: its path may be a secret."""
    if settings.webhook is None:
        return f"smtp {settings.smtp} {', '.join(settings.to)}"
    url = settings.webhook.get_secret_value()
    parts = urlsplit(url)
    number = hashlib.blake2b(url.encode(), digest_size=4).hexdigest()
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]} {number}"


def deliver_to(settings: NotifySettings, site: str) -> Deliver:
    """What delivers to a target."""
    if settings.webhook is None:
        return Mailer(settings, site)
    secret = settings.secret.get_secret_value() if settings.secret else None
    return Webhook(settings.webhook.get_secret_value(), secret)
