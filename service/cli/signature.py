"""Commands that share options: they stand in one place, so that they cannot drift apart."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection


def with_options_of(
    command: Callable[..., None], other: Callable[..., None], *, leave_out: Collection[str]
) -> Callable[..., None]:
    """``command`` with the parameters of ``other`` in place of its ``**`` parameter, in the eyes of typer.

    Args:
        command: a function whose last parameter is ``**``.
        other: the function whose parameters are to be taken as well.
        leave_out: names of those that are not.
    """
    own = inspect.signature(command, eval_str=True)
    plain = [item for item in own.parameters.values() if item.kind is not inspect.Parameter.VAR_KEYWORD]
    shared = inspect.signature(other, eval_str=True).parameters
    taken = [
        item.replace(kind=inspect.Parameter.KEYWORD_ONLY) for name, item in shared.items() if name not in leave_out
    ]
    command.__signature__ = own.replace(parameters=[*plain, *taken])  # type: ignore[attr-defined]
    return command
