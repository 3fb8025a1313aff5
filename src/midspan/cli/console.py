"""What all commands share: --quiet and --json, what is printed where, progress bars; their group, as click has it."""

import importlib
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import click

from midspan.cli.main import COMMANDS
from midspan.cli.process import stop_if_asked
from midspan.notices import Notice, worst_first

Command = TypeVar("Command", bound=Callable[..., Any])

# With this value of this variable progress comes as lines of JSON on standard error, this often, s: for a program that
# runs a command and shows how far it is.
PROGRESS, AS_LINES, LINES_S = "MIDSPAN_PROGRESS", "json", 0.2
# A bar appears once the command has lasted this long.
BAR_AFTER_S = 0.5
# Below a result; a person reads this many.
MAX_WARNINGS = 3


def common_options(function: Command) -> Command:
    """Add --quiet and --json to a command; they arrive as `quiet` and `as_json`."""
    function = click.option("--json", "as_json", is_flag=True, help="One JSON document on standard output.")(function)
    return click.option("-q", "--quiet", is_flag=True, help="Print errors only (and JSON).")(function)


class Console:
    """Where a command's words go: text to standard output, warnings and progress to standard error."""

    def __init__(self, quiet: bool, as_json: bool) -> None:
        self.quiet, self.as_json = quiet, as_json
        self._bar: Any = None
        self._what = ""
        self._begun_s = time.monotonic()
        self._line_s = -math.inf

    def say(self, text: str = "") -> None:
        """Print a line for a person."""
        if not (self.quiet or self.as_json):
            click.echo(text)

    def table(self, rows: Iterable[tuple[str, str]], indent: int = 2) -> None:
        """Print names and values in two columns."""
        rows = list(rows)
        width = max((len(name) for name, _ in rows), default=0)
        for name, value in rows:
            self.say(f"{' ' * indent}{name:<{width}}  {value}".rstrip())

    def columns(self, headings: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
        """Print a table with headings; columns without any value are left out."""
        table = list(zip(headings, *rows, strict=True))
        kept = [column for column in table if any(column[1:])]
        widths = [max(map(len, column)) for column in kept]
        for line in zip(*kept, strict=True):
            cells = (f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True))
            self.say(f"  {'  '.join(cells)}".rstrip())

    def warn(self, lines: Iterable[str]) -> None:
        """Print warnings on standard error, those of the table with their severity and code."""
        if not self.quiet:
            for line in lines:
                coded = f"{line.severity}: {line} [{line.code}]" if isinstance(line, Notice) else f"warning: {line}"
                click.echo(coded, err=True)

    def warn_first(self, lines: Iterable[str]) -> None:
        """Print the worst warnings, and how many more there are."""
        listed = worst_first(lines)
        self.warn(listed[:MAX_WARNINGS])
        if len(listed) > MAX_WARNINGS and not self.quiet:
            click.echo(f"and {len(listed) - MAX_WARNINGS} more: see --verbose or the report", err=True)

    def document(self, tree: dict[str, Any]) -> None:
        """Print the JSON document where it was asked for; numbers that are not finite become null."""
        if self.as_json:
            click.echo(json.dumps(_finite(tree), indent=2, ensure_ascii=False))

    def progress(self, done: int, total: int, what: str) -> None:
        """Show how far the work is, on a terminal and when it lasts."""
        # Where a library has swallowed a signal, the work ends here.
        stop_if_asked()
        if os.environ.get(PROGRESS) == AS_LINES:
            self._line(done, total, what)
            return
        if self.quiet or not sys.stderr.isatty():
            return
        from tqdm import tqdm

        if what != self._what:
            self.done()
            self._what = what
            context = click.get_current_context(silent=True)
            if context is not None:
                # Before the message of an error, which would stand in the bar's line.
                context.call_on_close(self.done)
            delay = max(BAR_AFTER_S - (time.monotonic() - self._begun_s), 0.0)
            self._bar = tqdm(total=total, desc=what, delay=delay, leave=False, file=sys.stderr, unit="")
        self._bar.total = total
        self._bar.update(done - self._bar.n)
        if done >= total:
            self.done()

    def _line(self, done: int, total: int, what: str) -> None:
        """Say how far the work is in a line of JSON, unless that was said just now."""
        if what == self._what and done < total and time.monotonic() - self._line_s < LINES_S:
            return
        self._what, self._line_s = what, time.monotonic()
        click.echo(json.dumps({"done": done, "total": total, "what": what}), err=True)

    def done(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.close()
        self._bar, self._what = None, ""


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if hasattr(value, "item") and not isinstance(value, (str, bytes)):
        return _finite(value.item()) if getattr(value, "ndim", 0) == 0 else _finite(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


class RegionType(click.ParamType):  # type: ignore[type-arg]
    """A region of interest written X,Y,W,H."""

    name = "X,Y,W,H"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Four whole numbers, or a usage error."""
        if isinstance(value, tuple):
            return value
        parts = [part.strip() for part in str(value).split(",")]
        if len(parts) == 4 and all(part.isdigit() for part in parts) and int(parts[2]) > 0 and int(parts[3]) > 0:
            return tuple(int(part) for part in parts)
        return self.fail(f"must be four whole numbers X,Y,W,H in px, W and H above 0; received {value!r}.", param, ctx)


class Commands(click.Group):
    """The commands of the table, imported one at a time."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All names, in the table's order."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, imported now."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"midspan.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that the arguments begin with; click's error for an unknown one names the nearest."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            from midspan.checks import nearest

            raise click.UsageError(f"{error.message} {nearest(args[0], COMMANDS)}".rstrip(), error.ctx) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The overview, without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in COMMANDS.items()])


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="midspan", message="midspan %(version)s")
def commands() -> None:
    """Displacement of bridges and buildings in millimetres, from an accelerometer and a camera or another sensor.

    Start with `midspan demo`; then `midspan estimate RECORDING`, where RECORDING is a folder with recording.toml.

    Exit codes: 0 done; 2 wrong use or settings; 3 unreadable or unusable data; 4 refused, the result could not be
    trusted. 130, 143 and 129: stopped by Ctrl-C, SIGTERM or SIGHUP; 141: standard output was closed.
    """
