"""From the frames of a source to rows: models, the measured expansion, health and alarm rules."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import Model, Response
from dlgmd_cli.models.corridor import Motion
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import Expansion, Measured
from dlgmd_cli.models.health import UNMEASURED, Health, Measuring
from dlgmd_cli.models.normalise import absolute
from dlgmd_cli.models.rules import rule_of

# What a step may leave out.
NEURON, EXPANSION = "neuron", "expansion"


class Session:
    """Steps the frames of one source through models, the expansion, and the models' rules.

    Everything that looks at frames steps a session. It skips duplicates and restarts after a gap in
    time. Nothing else resets its models.

    Parameters
    ----------
    models : sequence of Model
        The models, with their ignored cells already set, see `Model.ignore`.
    expansion : Expansion, optional
        The measurement on the frames' `small` images, common to all models. Without a measurement
        or a `small` image, the expansion is NaN.
    sizes_wh : sequence of (int, int)
        Width and height of the frames of each model, if a source gives several sizes.
    headings : callable, optional
        Frame number -> motion of the drone.
    health : Health, optional
        Says why the images show nothing. Without it, `Detection.blind` says only whether the
        expansion cannot be measured.

    Attributes
    ----------
    models, expansion, health
        As given.
    rules : list of Rule
        The rule of each model's alarm.
    left_out : str
        `NEURON` or `EXPANSION`: numbers that are NaN from the next frame on, to save time. The part
        restarts once it is not left out any more. Empty for nothing.
    """

    def __init__(
        self,
        models: Sequence[Model],
        expansion: Expansion | None = None,
        sizes_wh: Sequence[tuple[int, int]] = (),
        headings: Callable[[int], Motion] | None = None,
        health: Health | None = None,
    ) -> None:
        self.models, self.expansion, self._headings = [*models], expansion, headings
        self.sizes_wh: list[tuple[int, int] | None] = [*sizes_wh] or [None] * len(self.models)
        self.rules = [rule_of(model.params) for model in self.models]
        self.health, self.left_out, self._measuring = health, "", Measuring()
        self._forget()

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self._restart()
        self._measuring.reset()
        if self.health is not None:
            self.health.reset()

    def _restart(self) -> None:
        """Forget all earlier frames, as after a gap; the images' health goes on."""
        self._restart_part(NEURON)
        self._restart_part(EXPANSION)
        for rule in self.rules:
            rule.restart()
        self._forget()

    def _restart_part(self, part: str) -> None:
        for model in self.models if part == NEURON else ():
            model.reset()
        if self.expansion is not None and part == EXPANSION:
            self.expansion.reset()

    def _forget(self) -> None:
        self._rows = [Detection(rule=rule.name) for rule in self.rules]
        self._restarts, self._was_left_out = False, ""

    def step(self, frame: Frame, *, layers: bool = False) -> list[Detection]:
        """The row of each model at the next frame; a duplicate repeats the numbers of the last row.

        Parameters
        ----------
        frame : Frame
            The frame, with its time, and whether it is a duplicate or follows a gap.
        layers : bool
            Whether the rows contain the layers; rows of duplicates contain none.

        Raises
        ------
        FrameError, MissingExtraError
            As `Model.step`.
        ModelError
            If a custom model or a custom rule fails.
        """
        time_s = None if math.isnan(frame.time_s) else frame.time_s
        self._restarts = self._restarts or frame.after_gap
        if frame.is_repeat:
            blind = self._blind(frame, self._rows[0].expansion_quality)
            self._rows = [
                _repeated(row, frame, rule.blind(blind, alarm=row.alarm))
                for row, rule in zip(self._rows, self.rules, strict=True)
            ]
            return self._rows
        is_gap = self._restarts
        if is_gap:
            self._restart()
        if self.left_out != self._was_left_out:
            self._restart_part(self._was_left_out)
        self._was_left_out = self.left_out
        responses = [
            model.step(frame.at(size_wh), time_s, layers=layers)
            if self.left_out != NEURON
            else Response()
            for model, size_wh in zip(self.models, self.sizes_wh, strict=True)
        ]
        measured = self._measured(frame, time_s)
        blind = self._blind(frame, measured.expansion_quality)
        self._rows = [
            rule.step(_row(frame, model, response, measured, gap=is_gap, blind=blind))
            for model, response, rule in zip(self.models, responses, self.rules, strict=True)
        ]
        return self._rows

    def _blind(self, frame: Frame, quality: float) -> str:
        """Why the images show nothing, or `UNMEASURED`, whatever the rule; empty for neither."""
        is_unmeasured = self.expansion is not None and self._measuring.step(quality, frame.time_s)
        time_s = None if math.isnan(frame.time_s) else frame.time_s
        reason = None if self.health is None else self.health.step(frame.grey, time_s)
        return reason or (UNMEASURED if is_unmeasured else "")

    def _measured(self, frame: Frame, time_s: float | None) -> Measured:
        """The expansion at a frame."""
        if self.expansion is None or frame.small is None or self.left_out == EXPANSION:
            return Measured()
        if self._headings is not None:
            self.expansion.head(self._headings(frame.index))
        return self.expansion.step(frame.small, time_s)


def _row(
    frame: Frame,
    model: Model,
    response: Response,
    measured: Measured,
    *,
    gap: bool,
    blind: str,
) -> Detection:
    """The row of a frame before the rule has judged it."""
    mp, params = response.mp, model.params
    is_scaled = params.rest is not None
    mp_abs = mp if is_scaled else float(absolute(mp, model.n_cells, params.kappa))
    return Detection(
        **vars(response),
        **vars(measured),
        frame=frame.index,
        time_s=frame.time_s,
        gap=gap,
        mp_abs=mp_abs,
        level=mp_abs,
        blind=blind,
    )


def _repeated(row: Detection, frame: Frame, blind: str) -> Detection:
    """The row of a duplicate: a copy, unless the model had no number to copy yet."""
    return replace(
        row,
        frame=frame.index,
        time_s=frame.time_s,
        gap=False,
        repeat=row.is_valid,
        blind=blind,
        layers=None,
    )
