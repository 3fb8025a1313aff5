"""What the routes over recordings share: who may come in, the recordings, the work and the files that it makes."""

import asyncio
from dataclasses import dataclass, field
from pathlib import Path

from starlette.requests import HTTPConnection

from midspan.serve.problems import Problem
from midspan.serve.recordings.access import LinkAccess
from midspan.serve.recordings.commands import Commands
from midspan.serve.recordings.tickets import Tickets
from midspan.serve.serving import Worker, process, thread


@dataclass(slots=True)
class Desk:
    """files: the recording.toml of each recording; folder: of this process alone, for what is made to be saved."""

    files: list[Path]
    folder: Path
    access: LinkAccess = field(default_factory=LinkAccess)
    commands: Commands = field(default_factory=Commands)
    tickets: Tickets = field(default_factory=Tickets)
    quick: Worker = field(default_factory=lambda: Worker(thread))
    long: Worker = field(default_factory=lambda: Worker(process))
    changing: asyncio.Lock = field(default_factory=asyncio.Lock)

    def require(self, number: int) -> Path:
        """A recording's file. Raises Problem 404 for a number that is none's."""
        if not 0 <= number < len(self.files):
            raise Problem(404, f"{number}: is not a recording here. GET /api/v1/recordings lists them.")
        if not self.files[number].is_file():
            raise Problem(404, f"{self.files[number]}: no longer exists.")
        return self.files[number]

    async def close(self) -> None:
        """End the work and the workers."""
        await self.commands.close()
        for worker in (self.quick, self.long):
            worker.close()


async def desk_of(connection: HTTPConnection) -> Desk:
    """What a request's application shares."""
    desk: Desk = connection.app.state.serving
    return desk
