"""Why an analyst should look at a picture, as its result tells it."""

from collections.abc import Iterable

__all__ = ["attention_of"]


def attention_of(
    status: str, messages: Iterable[str], bodies: Iterable[tuple[str | None, str | None]] = ()
) -> tuple[str, ...]:
    """Return the reasons to look at a picture; none where all is well.

    Parameters
    ----------
    status : str
        Of the picture: ok, partial or failed.
    messages : iterable of str
        Of the picture.
    bodies : iterable of (name, status)

    Examples
    --------
    >>> attention_of("ok", ["3 pixels masked"])
    ()
    >>> attention_of("partial", [], [("PLUTO", "ok"), ("NIX", "uncertain")])
    ('NIX: uncertain',)
    """
    if status == "ok":
        return ()
    said = tuple(dict.fromkeys(messages))
    doubtful = tuple(
        f"{name}: {verdict.replace('_', ' ')}"
        for name, verdict in bodies
        if verdict not in (None, "ok") and not any(message.startswith(f"{name}:") for message in said)
    )
    return (*said, *doubtful) or (f"status {status}",)
