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

    def points(self) -> list[tuple[int, str, str]]:
        """Every single frame with its text, and `mark`, `collision` or `false positive`."""
        points = [(frame, text, "mark") for frame, text in self.marks]
        named = {"collision": self.collision_frame, "false positive": self.false_positive_frame}
        return points + [(frame, name, name) for name, frame in named.items() if frame is not None]

    def outside(self, first_frame: int, last_frame: int) -> list[str]:
        """What a figure of frames `first_frame` to `last_frame` cannot show, one line for each."""
        frames = f"frames {first_frame} to {last_frame}"
        lines = [
            f"{text!r} at frame {frame} is outside {frames} and is left out"
            for frame, text, _ in self.points()
            if not first_frame <= frame <= last_frame
        ]
        for start, end, text in self.spans:
            if end < first_frame or start > last_frame:
                lines.append(
                    f"{text!r} at frames {start} to {end} is outside {frames} and is left out"
                )
            elif start < first_frame or end > last_frame:
                lines.append(f"{text!r} at frames {start} to {end} is cut off at {frames}")
        return lines


NONE = Annotations()
