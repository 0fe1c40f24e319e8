"""What the commands of all sub-applications share."""

from typing import Annotated

import typer

from usarmjx.errors import UsarmjxError


class Failure:
    """Turns our own exceptions into one line and exit code 2; anything else is a bug and shows itself."""

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> bool:
        """End the command if the error is one of ours."""
        if isinstance(error, UsarmjxError):
            typer.echo(f"usarmjx: {error}", err=True)
            raise typer.Exit(2)
        return False


SeedOption = Annotated[int, typer.Option(help="Seed of all random numbers.")]
