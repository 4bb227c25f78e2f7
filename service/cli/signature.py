"""Commands that share the options of another one, so that they cannot diverge."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection


def with_options_of(
    command: Callable[..., None], other: Callable[..., None], *, leave_out: Collection[str]
) -> Callable[..., None]:
    """``command`` whose signature has the parameters of ``other`` in place of its ``**`` parameter, for typer.

    Args:
        command: a function whose last parameter is ``**``.
        other: the function whose parameters are to be taken as well.
        leave_out: names of parameters of ``other`` to leave out.
    """
    own = inspect.signature(command, eval_str=True)
    plain = [item for item in own.parameters.values() if item.kind is not inspect.Parameter.VAR_KEYWORD]
    shared = inspect.signature(other, eval_str=True).parameters
    taken = [
        item.replace(kind=inspect.Parameter.KEYWORD_ONLY) for name, item in shared.items() if name not in leave_out
    ]
    command.__signature__ = own.replace(parameters=[*plain, *taken])  # type: ignore[attr-defined]
    return command
