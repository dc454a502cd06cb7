"""Numbers in sentences: their plural, and enough of their digits."""


def counted(n: int, noun: str) -> str:
    """A number with its noun: 0 videos, 1 video, 2 videos."""
    return f"{n} {noun}{'s' * (n != 1)}"


def threshold_text(value: float, digits: int = 4) -> str:
    """A number in a few digits, but in nine where these would round it up to 1."""
    text = f"{value:.{digits}g}"
    return text if value >= 1.0 or float(text) < 1.0 else f"{value:.9g}"
