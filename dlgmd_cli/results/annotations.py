"""What figures over time show, as data: their kinds, and annotations of frames."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Annotations:
    """Annotated frames and ranges of frames; frame numbers are those of the input, from 0.

    Attributes
    ----------
    marks : tuple of (int, str)
        Frame and text.
    spans : tuple of (int, int, str)
        First frame, last frame, text.
    collision_frame : int or None
        Frame of the true collision.
    false_positive_frame : int or None
        Frame of a false alarm.
    """

    marks: tuple[tuple[int, str], ...] = ()
    spans: tuple[tuple[int, int, str], ...] = ()
    collision_frame: int | None = None
    false_positive_frame: int | None = None

    def remarks(self) -> list[tuple[int, int, str, str]]:
        """First frame, last frame, text, and `mark`, `collision`, `false positive` or `span`."""
        named = {"collision": self.collision_frame, "false positive": self.false_positive_frame}
        return [
            *((frame, frame, text, "mark") for frame, text in self.marks),
            *((frame, frame, name, name) for name, frame in named.items() if frame is not None),
            *((start, end, text, "span") for start, end, text in self.spans),
        ]

    def outside(self, first_frame: int, last_frame: int) -> list[str]:
        """A line for each annotation that a figure of these frames cannot show in full."""
        frames = f"frames {first_frame} to {last_frame}"
        lines = []
        for start, end, text, kind in self.remarks():
            where = f"frames {start} to {end}" if kind == "span" else f"frame {start}"
            if end < first_frame or start > last_frame:
                lines.append(f"{text!r} at {where} is outside {frames} and is left out")
            elif start < first_frame or end > last_frame:
                lines.append(f"{text!r} at {where} is cut off at {frames}")
        return lines


NONE = Annotations()

# Kinds of figures over time, and the panels of each from the top down.
KINDS: dict[str, tuple[str, ...]] = {
    "mp": ("level",),
    "attenuation": ("attenuation",),
    "spikes": ("level", "raster"),
    "overview": ("level", "attenuation", "raster"),
}
