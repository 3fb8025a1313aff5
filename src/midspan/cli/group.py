"""The commands as click shows and finds them."""

import importlib

import click

from midspan.cli.main import COMMANDS


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
    """Displacement of bridges and buildings in millimetres, from an accelerometer and a camera that sit on them.

    Start with `midspan demo`; then `midspan estimate RECORDING`, where RECORDING is a folder with recording.toml.

    Exit codes: 0 done; 2 wrong use or settings; 3 unreadable or unusable data; 4 refused, the result could not be
    trusted. 130, 143 and 129: stopped by Ctrl-C, SIGTERM or SIGHUP; 141: nobody reads the output any more.
    """
