"""Text from files made fit for a message."""


def printable(text: str, keep: str = "") -> str:
    r"""Returns a text with characters that cannot be printed, line breaks among them, spelled as ``\n`` or ``\x1b``.

    Args:
        text: the text.
        keep: characters that stay as they are.
    """
    return "".join(
        it if it.isprintable() or it in keep else it.encode("unicode_escape", "surrogatepass").decode() for it in text
    )
