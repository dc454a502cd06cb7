"""What records and errors say of an input, the same for every command that reads one."""

from typing import TYPE_CHECKING, Any

from dlgmd_cli.errors import SourceError
from dlgmd_cli.video.frames import InputOptions

if TYPE_CHECKING:
    from dlgmd_cli.video.frames import Frame, Video


def too_short(
    name: str, source: "Video", label: str, options: InputOptions, first_valid: int
) -> SourceError:
    """The error for an input that ends before the model can answer."""
    n_read = source.progress.n_decoded
    if options.start or options.end is not None or options.fps is not None:
        return SourceError(
            name,
            f"--start, --end and --fps leave fewer than the {first_valid + 1} frames that "
            f"{label} needs",
            f"Its last frame read is at {source.progress.last_time_s:.3f} s.",
        )
    return SourceError(
        name,
        f"{n_read} frame{'s' * (n_read > 1)}, but {label} needs at least {first_valid + 1}",
        "Use a longer clip.",
    )


def facts(source: "Video", n_processed: int, last: "Frame | None" = None) -> dict[str, Any]:
    """What a record says of the input and of what was made of it.

    `last` is the frame that the reading was stopped at, if it was: decoding may be ahead of it.
    """
    info, progress = source.info, source.progress
    n_read, last_s = progress.n_decoded, progress.last_time_s
    if last is not None:
        n_read, last_s = last.index + 1, last.time_s
    return {
        "input": {
            "path": info.path,
            "width": info.width,
            "height": info.height,
            "fps": info.fps,
            "frames": n_read,
            "duration_s": last_s + 1.0 / info.fps,
            "decoder": info.decoder,
        },
        "processed": {
            "width": source.size_wh[0],
            "height": source.size_wh[1],
            "frames": n_processed,
        },
    }
