"""The `midspan` command: its table of commands, and how errors become messages and exit codes.

Nothing is imported before `main` runs, so that Ctrl-C during the imports ends in a sentence, too.
"""

import sys

TYPE_CHECKING = False  # typing itself would be one of those imports
if TYPE_CHECKING:
    import click

# Name → module and the line of the overview. The module is imported when its command runs, which keeps `--help` quick.
COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("demo", "A complete run on a simulated recording; under a minute."),
    "simulate": ("simulate", "Simulate a recording with known truth; --list shows the scenarios."),
    "init": ("init", "Write a recording.toml for an accelerometer file and a video."),
    "inspect": ("inspect", "Check a recording or a file: streams, rates, gaps, units, overlap."),
    "calibrate": ("calibrate", "Estimate scale factor, clock offset and noise; write calibration.json."),
    "estimate": (
        "estimate",
        "Displacement in mm at the accelerometer's rate, from a recording or two files.",
    ),
    "batch": ("batch", "Estimate many recordings as one campaign; what is done is skipped."),
    "track": ("track", "Camera alone: translation of a target in pixels, frame by frame."),
    "lens": ("lens", "Calibrate a lens from checkerboard images, for [camera.lens]."),
    "compare": ("compare", "Compare a result with a reference: RMSE, bias, correlation, lag."),
    "spectrum": ("spectrum", "Natural frequencies of a result, with damping and standard deviations."),
    "open": ("open", "Recordings in the browser: inspect, draw the region, calibrate, estimate, compare, export."),
    "run": ("run", "Run a live site: from sources to store, page and MQTT."),
    "fleet": ("fleet", "Run a live site as shards: start, watch and replace them."),
    "serve": ("serve", "Serve the page and the REST interface of a store."),
    "access": ("access", "Users and tokens of a store's page."),
    "store": ("store", "Check, repair or back up a store."),
    "replay": ("replay", "Replay a recording through a live point into a store."),
    "export": ("export", "Export rows of a store, or convert a result to another format."),
    "formats": ("formats", "File formats that midspan reads and writes."),
    "methods": ("methods", "Trackers and fusion methods, and when to use each."),
    "papers": ("papers", "Repeat the papers' experiments in simulation and compare the figures."),
    "check-config": ("check_config", "Validate a recording.toml or a SITE.toml without running it."),
    "help": ("help", "Explain a command, a section of the settings' files, or a key."),
}

# What file systems take.
MAX_NAME_BYTES = 255


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit code."""
    given = sys.argv[1:] if arguments is None else arguments
    try:
        from midspan.cli.process import supervised

        code = supervised(lambda: run(given))
    except KeyboardInterrupt:
        sys.stderr.write("midspan: interrupted; no partial files were left.\n")
        code = 130
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Run the command line; every foreseeable error is one message and an exit code, never a traceback."""
    import os

    import click

    from midspan.cli.console import commands
    from midspan.errors import MidspanError

    try:
        os.getcwd()
    except FileNotFoundError:
        text = 'the current folder no longer exists; it was replaced or removed. Enter it again: `cd "$PWD"`.'
        return _explain(arguments, text, 2, None)
    # An argument that, as a path, holds a name that no file can have.
    names = ((given, os.fsencode(name)) for given in arguments for name in given.split("/"))
    long = next((given for given, name in names if len(name) > MAX_NAME_BYTES), None)
    if long is not None:
        text = f"{long[:60]}…: each name in a path must have at most {MAX_NAME_BYTES} bytes. Give a shorter one."
        return _explain(arguments, text, 2, None)
    try:
        left = commands.main(args=arguments, prog_name="midspan", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return 2
    except click.ClickException as error:
        return _explain(arguments, _said(error), 2, error)
    except MidspanError as error:
        # Commands without --verbose say all.
        whole = "estimate" not in arguments[:1] or bool({"-v", "--verbose"} & set(arguments))
        more = error.more if whole else "--verbose lists figures and other causes."
        return _explain(arguments, f"{error} {more}" if error.more else str(error), error.exit_code, None)
    except (KeyboardInterrupt, click.Abort):
        click.echo("midspan: interrupted; no partial files were left.", err=True)
        return 130
    except MemoryError:
        return _explain(arguments, "not enough memory for this. Use a shorter recording.", 3, None)
    except Exception as error:
        if os.environ.get("MIDSPAN_TRACEBACK"):
            raise
        what = f"{type(error).__name__}: {error}"
        text = f"internal error ({what}). This is a defect of midspan; MIDSPAN_TRACEBACK=1 shows where it happened."
        return _explain(arguments, text, 1, None)
    return left if isinstance(left, int) else 0


def _said(error: "click.ClickException") -> str:
    """The message of a wrong use; an option that is a key of a recording is led to its file."""
    import click

    if not isinstance(error, click.NoSuchOption) or error.ctx is None:
        text = error.format_message()
        blank = text.startswith("Got unexpected extra argument")
        return f"{text}. Names with blanks need quotes: --value 'Acc Z'." if blank else text
    from midspan.settings.keys import recording_sections

    key = error.option_name.lstrip("-").replace("-", "_")
    # Of sections within others, theirs is enough.
    sections = [one for one in recording_sections() if one.name and "." not in one.name]
    places = [f"[{one.name}]" for one in sections if key in [known.name for known in one.keys]]
    if not places or all(one.name != "recording" for one in error.ctx.command.params):
        return error.format_message()
    return (
        f"No such option {error.option_name!r}. {key} is a key of recording.toml ({', '.join(places)}), which "
        f"`midspan init ACCEL VIDEO` writes; `midspan help {key}` explains it."
    )


def _explain(arguments: list[str], message: str, code: int, error: "click.ClickException | None") -> int:
    import click

    from midspan.cli.process import stop_if_asked

    # A library may have made an error of its own out of a signal that arrived inside it.
    stop_if_asked()
    if "--json" in arguments:
        import json

        click.echo(json.dumps({"error": message, "exit_code": code}))
    context = error.ctx if isinstance(error, click.UsageError) else None
    hint = f"\nSee `{context.command_path} --help`." if context else ""
    click.echo(f"midspan: {message}{hint}", err=True)
    return code
