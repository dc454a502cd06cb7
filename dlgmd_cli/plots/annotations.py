"""Remarks on single frames: data for the figures."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Annotations:
    """Frames and stretches of frames worth a remark.

    Attributes
    ----------
    marks : tuple of (int, str)
        A frame and its text.
    spans : tuple of (int, int, str)
        First frame, last frame, text.
    collision_frame : int or None
        Where the camera truly collides.
    false_positive_frame : int or None
        Where an alarm is a false one.

    Notes
    -----
    Frames are numbers of the input's frames, from 0.
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
        """What a figure of frames `first_frame` to `last_frame` cannot show, one line for each."""
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
