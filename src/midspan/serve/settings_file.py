"""SITE.toml as text: read, checked and written by one after another."""

import hashlib
import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import PlainTextResponse
from pydantic import BaseModel

from midspan.errors import MidspanError
from midspan.recording.tracking.opening import require_inside
from midspan.serve.engine_link import AwayError
from midspan.serve.login import ADMIN
from midspan.serve.problems import Problem, declared
from midspan.serve.serving import Serving, Shared
from midspan.service.changes import Changes
from midspan.service.live_socket import Tree
from midspan.service.settings_fault import SettingsFault
from midspan.settings.camera import CameraSettings
from midspan.settings.live_sources import without_secrets
from midspan.settings.site import load_site, require_folders
from midspan.writing import cannot_be_written, write_whole

TEXT = {"text/plain": {"schema": {"type": "string"}}}


class SettingsDone(BaseModel):
    """What became of new settings, or would; restart: keys that hold only once `midspan run` is started again.

    added, changed, removed: names of the points that begin, end and begin anew, and end; the others go on.
    """

    text: str
    restart: list[str]
    added: list[str] = []
    changed: list[str] = []
    removed: list[str] = []


def tag_of(content: bytes) -> str:
    """The ETag of a file's content."""
    return f'"{hashlib.sha256(content).hexdigest()[:32]}"'


async def text_of(request: Request, if_match: str | None) -> bytes:
    """The new text of a file of settings. Raises Problem."""
    if if_match is None:
        raise Problem(428, "If-Match: must be the ETag of the settings that you changed. Send it.")
    kind = request.headers.get("content-type", "text/plain").partition(";")[0].strip().lower()
    if kind not in ("text/plain", "application/toml"):
        raise Problem(415, "Content-Type: must be text/plain or application/toml.")
    content = await request.body()
    if not content.strip():
        raise Problem(422, "The content is empty. Send the settings as text.")
    return content


def require_unchanged(file: Path, if_match: str | None) -> None:
    """Raises Problem 412 where a file is another one than what a change was made from."""
    before = tag_of(file.read_bytes())
    if (if_match or "").strip() not in (before, "*"):
        text = "Another user changed the settings meanwhile. GET them again and repeat your change."
        raise Problem(412, text, headers={"ETag": before})


@contextmanager
def on_trial(file: Path, content: bytes) -> Iterator[Path]:
    """New content as a file in the folder of `file`, which its paths are relative to.

    Raises Problem 422 with the key for what settings may not say.
    """
    try:
        content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise Problem(422, f"{file.name}: must be UTF-8; byte {error.start} is not.") from None
    with cannot_be_written(file):
        descriptor, name = tempfile.mkstemp(prefix=f".{file.stem}-", suffix=".toml", dir=file.parent)
    try:
        with os.fdopen(descriptor, "wb") as trial:
            trial.write(content)
        yield Path(name)
    except MidspanError as error:
        fault = SettingsFault.of(str(error).replace(name, str(file)))
        raise Problem(422, fault.text, file=fault.file, key=fault.key) from None
    finally:
        os.unlink(name)


async def tried(serving: Serving, file: Path, content: bytes) -> SettingsDone:
    """What settings would change. Raises Problem 422 with the key for those that a site could not run with."""
    with on_trial(file, content) as trial:
        shown = [(name, tree) for name, (_, tree, _) in serving.pictures.items() if "width" in tree]
        sizes_px = {(name, tree["address"]): (tree["width"], tree["height"]) for name, tree in shown}
        changes = await serving.quick.run(changes_of, file, trial, sizes_px)
        try:
            answer, _ = await serving.link.ask("reload", trial=str(trial))
        except AwayError:
            text = "Not saved. The settings take effect when `midspan run` is started."
            return SettingsDone(text=text, restart=[], **changes.to_dict())
    return done(answer)


def changes_of(file: Path, trial: Path, sizes_px: Mapping[tuple[str, str], tuple[int, int]]) -> Changes:
    """What the settings of a file would change of those of another one, where nothing runs with them.

    sizes_px: width and height of the newest picture of each camera (POINT.KIND and address) that somebody looked at.
    Raises what is wrong with them.
    """
    site = load_site(trial)
    require_folders(site)
    for point in site.points:
        for name, _, section in point.recording.streams:
            size_px = sizes_px.get((f"{point.name}.{name}", without_secrets(point.sources[name])))
            if size_px is not None and isinstance(section, CameraSettings):
                require_inside(section, size_px, f"{trial}: point {point.name!r}: {name}")
    with suppress(MidspanError):
        return Changes.between(load_site(file), site)
    return Changes.between(None, site)


def done(answer: Tree) -> SettingsDone:
    """What the engine says of settings."""
    names = {key: list(answer.get(key, [])) for key in ("added", "changed", "removed")}
    return SettingsDone(text=str(answer["text"]), restart=list(answer["restart"]), **names)


routes = APIRouter(prefix="/settings", tags=["settings"])


def file_of(serving: Serving) -> Path:
    """The site's file. Raises Problem where there is none."""
    file = serving.settings_file
    if file is None or not file.is_file():
        raise Problem(404, "This store has no SITE.toml here: no `midspan run` was started on it.")
    return file


@routes.get(
    "", dependencies=ADMIN, response_class=PlainTextResponse,
    responses={**declared(401, 403, 404), 200: {"content": TEXT}},
)  # fmt: skip
async def settings(serving: Shared) -> PlainTextResponse:
    """SITE.toml as text; its ETag is what a change is sent with."""
    content = file_of(serving).read_bytes()
    return PlainTextResponse(content, headers={"ETag": tag_of(content)})


@routes.put(
    "", response_model=SettingsDone, dependencies=ADMIN, responses=declared(401, 403, 404, 412, 413, 415, 422, 428),
    openapi_extra={"requestBody": {"required": True, "content": TEXT}},
)  # fmt: skip
async def change(
    request: Request,
    response: Response,
    serving: Shared,
    if_match: Annotated[str | None, Header(max_length=200)] = None,
    dry_run: Annotated[bool, Query(description="report the effect without saving")] = False,
) -> SettingsDone:
    """Check new settings and put them in force; the points that they leave as they are lose no row."""
    content = await text_of(request, if_match)
    async with serving.changing:
        file = file_of(serving)
        require_unchanged(file, if_match)
        found = await tried(serving, file, content)
        if dry_run:
            return found
        write_whole(file, content, mode=stat.S_IMODE(file.stat().st_mode))
    response.headers["ETag"] = tag_of(content)
    try:
        answer, _ = await serving.link.ask("reload")
    except AwayError:
        # One that is busy with the change before takes them up next.
        when = "the measuring process answers" if serving.link.is_connected else "`midspan run` is started"
        return found.model_copy(update={"text": f"Saved. The settings take effect when {when}."})
    return done(answer)
