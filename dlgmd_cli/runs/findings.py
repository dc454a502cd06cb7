"""What a run comes to: its result, its record, and whether there is any to keep."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dlgmd_cli.parameters import Parameters
from dlgmd_cli.results.measures import Summary
from dlgmd_cli.results.record import write_record
from dlgmd_cli.results.tables import Result, write_tables
from dlgmd_cli.runs.compare import Entry
from dlgmd_cli.runs.facts import facts, too_short
from dlgmd_cli.runs.reading import Reading
from dlgmd_cli.video.frames import InputOptions

if TYPE_CHECKING:
    from dlgmd_cli.errors import SourceError
    from dlgmd_cli.video.frames import Video


@dataclass(frozen=True)
class Asked:
    """What is asked for.

    Attributes
    ----------
    params : Parameters
        The model's.
    label : str
        What messages call the model.
    options : InputOptions
        What is read of the input.
    identity : dict
        What tells the input from another of its name, see `fingerprint`; for the record.
    """

    params: Parameters
    label: str
    options: InputOptions
    identity: dict[str, Any]


@dataclass(frozen=True)
class Findings:
    """A result in pieces, and what run.yaml says of it, less the versions.

    `shortage` is the error for an input that ended before the model could answer, if it did.
    """

    reading: Reading
    record: dict[str, Any]
    shortage: "SourceError | None"

    @property
    def warnings(self) -> list[str]:
        """What is doubtful, a line each."""
        warnings: list[str] = self.record["warnings"]
        return warnings

    @cached_property
    def result(self) -> Result:
        """The whole result, joined when it is first asked for: plots need it at once."""
        return self.reading.whole()


def conclude(name: str, source: "Video", entry: Entry, asked: Asked, *, complete: bool) -> Findings:
    """Everything that follows from what was computed.

    Parameters
    ----------
    name : str
        What errors call the input.
    source : Video
        It was read as far as the recording goes.
    entry : Entry
        The model and its recording, of at least one frame.
    asked : Asked
        How the model was asked for.
    complete : bool
        Whether it came to the end of the input.
    """
    recording, model = entry.recording, entry.model
    reading = Reading(recording, entry.size_wh, asked.params, by_sequence=asked.options.by_sequence)
    summary = Summary.of(reading)
    known = facts(source, len(recording))
    known["input"].update(asked.identity)
    known["processed"].update(width=entry.size_wh[0], height=entry.size_wh[1])
    record = {
        **known,
        "model": asked.params.model,
        "engine": model.engine_name,
        **asked.params.to_dict(),
        "options": asked.options.to_record(),
        "warnings": [*source.progress.warnings, *summary.doubts(source.info.decoder)],
        "complete": complete,
        "summary": summary.to_dict(),
    }
    shortage = None
    if complete and recording.n_valid == 0:
        shortage = too_short(name, source, asked.label, asked.options, model.first_valid_frame)
    return Findings(reading, record, shortage)


def write_findings(folder: Path, findings: Findings) -> None:
    """Write the tables and run.yaml; OSError passes through."""
    write_tables(folder, findings.reading)
    write_record(folder, findings.record, engines=[findings.record["engine"]])
