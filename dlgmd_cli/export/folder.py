"""The files of an export: the sources, and a test that compares them with Python's answers."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dlgmd_cli import __version__
from dlgmd_cli.errors import printable
from dlgmd_cli.export.project import Export, defines
from dlgmd_cli.models.detection import Alarm, Detection

SOURCES = Path(__file__).parent / "c"

# By whether the expansion raises the alarm.
WITHOUT = {
    False: "- the expansion, unless `DLGMD_EXPANSION` is defined as 1\n",
    True: """
Bands of mains light and steps of the exposure are removed as in Python. With `DLGMD_DEFLICKER`
defined as 0, they are not, and the code is smaller.

`dlgmd_state` has a union of what different parts of a step use (MISRA C:2012, rule 19.2, advisory):
each member is written before it is read, within the same part.
""",
}
ACCURACY = {
    False: "`mp_abs` differs from Python's by at most 1e-5, `expansion` by at most 3e-5.",
    True: "Integers are rounded: in rendered flights `mp_abs` differs from Python's by at most "
    "0.03, and an\nalarm may start one frame earlier or later.",
}

# Of an answer, as in C.
NUMBERS = ("mp", "mp_abs", "g_x", "g_y", "expansion", "ttc_s", "expansion_x", "expansion_y")

Frames = list[npt.NDArray[np.uint8]]


def looming(export: Export, approaches: Iterable[Frames]) -> tuple[Frames, list[Detection]]:
    """Frames of an approach up to contact, and Python's answers to them.

    The approach is the first that raises an alarm; if none does, the one with the highest MP.
    """
    tried = []
    for frames in approaches:
        alarm = Alarm(export.params, resize=False, repeats="keep", engine="opencv")
        answers = [alarm.step(frame) for frame in frames]
        if any(answer.alarm for answer in answers):
            return frames, answers
        tried.append((frames, answers))
    return max(tried, key=lambda pair: max(a.mp_abs for a in pair[1] if a.is_valid))


def files(export: Export, approaches: Iterable[Frames]) -> dict[str, bytes]:
    """The contents of all files, by name; the test vectors are of one of the `approaches`."""
    frames, answers = looming(export, approaches)
    contents = {name: text.encode() for name, text in sources(export).items()}
    contents["vectors.h"] = vectors(export, answers).encode()
    return contents | {"frames.gray": b"".join(frame.tobytes() for frame in frames)}


def sources(export: Export) -> dict[str, str]:
    """The sources by name, with the values of this export in place of `@key@`."""
    costs = {key: f"{n:,}" for key, n in export.costs.items()}
    multiplications, additions = export.code.operations
    lines = [
        f"RAM: {costs['ram_bytes']} bytes of state, and at most {costs['stack_bytes']} of stack",
        f"Flash: about {costs['flash_bytes']} bytes (gcc -O2, Cortex-M4)",
        f"Operations of the kernels per frame: {costs['multiplications']} multiplications and "
        f"{costs['additions']} additions",
        f"Per cell: {multiplications} multiplications and {additions} additions",
    ]
    values = {
        "sizes": defines(export.sizes),
        "label": printable(export.label),
        "model": export.params.model,
        "version": __version__,
        "fixed": str(int(export.is_fixed)),
        "arithmetic": "integers" if export.is_fixed else "single precision",
        "width": str(export.width),
        "height": str(export.height),
        "command": export.command,
        "fps": f"{export.fps:g}",
        "costs": "\n   ".join(lines),
        "list_of_costs": "\n".join(f"- {line}" for line in lines),
        "accuracy": ACCURACY[export.is_fixed],
        "without": WITHOUT[export.expands],
        "parameters": "\n".join(f"    {k}: {v}" for k, v in export.params.to_dict().items()),
    }

    contents = {"dlgmd_model.h": export.model_header()}
    for path in SOURCES.iterdir():
        text = path.read_text(encoding="utf-8")
        for key, value in values.items():
            text = text.replace(f"/* @{key}@ */", value).replace(f"@{key}@", value)
        contents[path.name] = text
    return contents


def vectors(export: Export, answers: list[Detection]) -> str:
    """The text of `vectors.h`."""
    rows = []
    for answer in answers:
        flags = [str(int(flag)) for flag in (answer.is_valid, answer.spike, answer.alarm)]
        values = [getattr(answer, name) for name in NUMBERS]
        numbers = [f"{0.0 if np.isnan(value) else value:.9g}" for value in values]
        rows.append(f"    {{{', '.join(flags + numbers)}}},\n")
    return (
        "/* Python's answers to the frames in frames.gray; 0 where they are undefined. */\n"
        f"#define N_FRAMES {len(rows)}\n"
        "/* Half-saturation constant of mp_abs, as K. */\n"
        f"#define HALF {export.params.kappa * export.n_cells:.9g}\n\n"
        "static const struct expected {\n"
        "    bool valid, spike, alarm;\n"
        f"    double {', '.join(NUMBERS)};\n"
        "} expected[N_FRAMES] = {\n" + "".join(rows) + "};\n"
    )
