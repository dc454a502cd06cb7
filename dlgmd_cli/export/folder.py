"""The folder of an export: the sources, and a test of frames with Python's answers."""

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from dlgmd_cli import __version__
from dlgmd_cli.errors import printable
from dlgmd_cli.export.project import Export
from dlgmd_cli.models.detection import Alarm, Detection

STATIC = (
    "README.md",
    "dlgmd.h",
    "dlgmd.c",
    "example.c",
    "test.c",
    "board.c",
    "mps2.ld",
    "Makefile",
)

ACCURACY = {
    False: "Its membrane potential is Python's to 1e-5 of it.",
    True: "Integers round: in rendered flights mp_abs differs from Python's by 0.03 at most, and\n"
    "the alarms are the same; expect a frame of difference in others.",
}

Frames = list[npt.NDArray[np.uint8]]


def looming(export: Export, approaches: Iterable[Frames]) -> tuple[Frames, list[Detection]]:
    """Frames up to contact, and the answers to them.

    They are of the first approach that raises an alarm; if none does, of that with the highest MP.
    """
    tried = [(frames, _answers(export, frames)) for frames in approaches]
    with_alarm = [one for one in tried if any(answer.alarm for answer in one[1])]
    return with_alarm[0] if with_alarm else max(tried, key=lambda one: _peak(one[1]))


def _answers(export: Export, frames: Frames) -> list[Detection]:
    alarm = Alarm(export.params, repeats="keep", engine="opencv")
    return [alarm.step(frame) for frame in frames]


def _peak(answers: list[Detection]) -> float:
    return max(answer.mp_abs for answer in answers if answer.is_valid)


def files(export: Export, approaches: Iterable[Frames]) -> dict[str, bytes]:
    """The contents of all files, by name; test vectors are of one of the `approaches`."""
    frames, answers = looming(export, approaches)
    texts = {name: _filled(export, name) for name in STATIC}
    texts |= {"dlgmd_model.h": export.model_header(), "vectors.h": vectors(export, answers)}
    contents = {name: text.encode() for name, text in texts.items()}
    return contents | {"frames.gray": b"".join(frame.tobytes() for frame in frames)}


def _filled(export: Export, name: str) -> str:
    """A source with what is particular to this export."""
    values = {
        "sizes": export.definitions,
        "label": printable(export.label),
        "model": export.params.model,
        "version": __version__,
        "arithmetic": "integers" if export.is_fixed else "single precision",
        "width": str(export.width),
        "height": str(export.height),
        "costs": "\n   ".join(_costs(export)),
        "list_of_costs": "\n".join(f"- {line}" for line in _costs(export)),
        "accuracy": ACCURACY[export.is_fixed],
        "parameters": "\n".join(f"    {k}: {v}" for k, v in export.params.to_dict().items()),
    }
    text = export.source(name)
    for key, value in values.items():
        text = text.replace(f"/* @{key}@ */", value).replace(f"@{key}@", value)
    return text


def _costs(export: Export) -> list[str]:
    """What a frame costs, in words."""
    costs = {key: f"{n:,}" for key, n in export.costs.items()}
    multiplications, additions = export.code.operations
    return [
        f"RAM: {costs['ram_bytes']} bytes of state, and at most {costs['stack_bytes']} of stack",
        f"Flash: about {costs['flash_bytes']} bytes (gcc -O2, Cortex-M4)",
        f"A frame: {costs['multiplications']} multiplications and {costs['additions']} additions "
        "in the kernels",
        f"A cell: {multiplications} and {additions} of them",
    ]


def vectors(export: Export, answers: list[Detection]) -> str:
    """`vectors.h`."""
    rows = []
    for answer in answers:
        flags = [str(int(flag)) for flag in (answer.is_valid, answer.spike, answer.alarm)]
        values = [answer.mp, answer.mp_abs, answer.g_x, answer.g_y]
        numbers = [f"{0.0 if np.isnan(value) else value:.9g}" for value in values]
        rows.append(f"    {{{', '.join(flags + numbers)}}},\n")
    return (
        "/* What Python answers to the frames of frames.gray; 0 where nothing is defined. */\n"
        f"#define N_FRAMES {len(rows)}\n"
        "/* K at which mp_abs is 1/2. */\n"
        f"#define HALF {export.params.kappa * export.n_cells:.9g}\n\n"
        "static const struct expected {\n"
        "    bool valid, spike, alarm;\n"
        "    double mp, mp_abs, g_x, g_y;\n"
        "} expected[N_FRAMES] = {\n" + "".join(rows) + "};\n"
    )
