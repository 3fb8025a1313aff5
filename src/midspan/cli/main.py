"""The `midspan` command: its table of commands, and how errors become messages and exit codes."""

import importlib
import os
import sys

import click

from midspan.errors import MidspanError

# Name → module and the line of the overview. The module is imported when its command runs, which keeps `--help` quick.
COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("demo", "A complete run on a recording that it makes itself; under a minute."),
    "simulate": ("simulate", "Write a recording folder with its truth; --list names the scenarios."),
    "inspect": ("inspect", "What is in a recording or a file: streams, rates, gaps, units, overlap."),
    "calibrate": ("calibrate", "Scale factor, clock offset and noise, written to calibration.json."),
    "estimate": ("estimate", "The main job: displacement in mm at the accelerometer's rate."),
    "track": ("track", "Camera alone: translation of a target in pixels, frame by frame."),
    "lens": ("lens", "A camera's lens from pictures of a checkerboard, for [camera.lens]."),
    "compare": ("compare", "A result against a reference: RMSE, bias, correlation, lag."),
    "formats": ("formats", "What can be read and written."),
    "methods": ("methods", "Trackers and fusion methods, and when to use each."),
    "check-config": ("check_config", "Validate a recording.toml without running it."),
}


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

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The overview, without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in COMMANDS.items()])


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="midspan", message="midspan %(version)s")
def commands() -> None:
    """Displacement of bridges and buildings in millimetres, from an accelerometer and a camera that sit on them.

    Start with `midspan demo`; then `midspan estimate RECORDING`, where RECORDING is a folder with recording.toml.

    Exit codes: 0 done; 2 wrong use or settings; 3 unreadable or unusable data; 4 refused, the result could not be
    trusted.
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit code."""
    given = sys.argv[1:] if arguments is None else arguments
    sys.exit(run(given))


def run(arguments: list[str]) -> int:
    """Run the command line; every foreseeable error is one message and an exit code, never a traceback."""
    try:
        left = commands.main(args=arguments, prog_name="midspan", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return 2
    except click.ClickException as error:
        return _tell(arguments, error.format_message(), 2, error)
    except MidspanError as error:
        return _tell(arguments, str(error), error.exit_code, None)
    except (KeyboardInterrupt, click.Abort):
        click.echo("midspan: interrupted; nothing half-written was left.", err=True)
        return 130
    except MemoryError:
        return _tell(arguments, "not enough memory for this. Use a shorter recording.", 3, None)
    except Exception as error:
        if os.environ.get("MIDSPAN_TRACEBACK"):
            raise
        what = f"{type(error).__name__}: {error}"
        text = f"internal error ({what}). This is a defect of midspan; MIDSPAN_TRACEBACK=1 shows where it happened."
        return _tell(arguments, text, 1, None)
    return left if isinstance(left, int) else 0


def _tell(arguments: list[str], message: str, code: int, error: click.ClickException | None) -> int:
    if "--json" in arguments:
        import json

        click.echo(json.dumps({"error": message, "exit_code": code}))
    context = error.ctx if isinstance(error, click.UsageError) else None
    hint = f"\nSee `{context.command_path} --help`." if context else ""
    click.echo(f"midspan: {message}{hint}", err=True)
    return code
