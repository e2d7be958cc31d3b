"""What ``cli.view`` takes from the commands."""

from getagrip.commands.command import ClipsFolder, Command

__all__ = ["ClipsFolder", "Command"]
